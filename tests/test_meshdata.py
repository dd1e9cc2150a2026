"""Results of finite-element analyses as fields, expected to be the formulas that the meshes' values were taken from."""

from __future__ import annotations

import base64
import re
import resource
import struct
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.spatial import Delaunay

from amslicer import JobError
from amslicer.fields import FieldSpec, Frame, Inputs, open_field, open_orientation, results
from amslicer.fields.constant import ConstantSampler
from amslicer.fields.meshiochild import read_beside
from amslicer.fields.orientation import Angles
from amslicer.fields.simplices import cut
from amslicer.fields.tensors import von_mises
from amslicer.pipeline import prepare

pytest.importorskip("igl")
meshio = pytest.importorskip("meshio")

Floats = NDArray[np.float64]
Cells = list[tuple[str, NDArray[np.int64]]]

MINIMUM, SIZE = np.array([3.1, -4.7, 5.3]), np.array([8.0, 6.0, 4.0])
FRAME = Frame(MINIMUM, SIZE)
NAME = "result.vtu"
PLACES = np.random.default_rng(1).uniform(0, 1, (500, 3)) * SIZE
FLOAT32 = 1e-6  # of values about 1: the grid keeps its nodes in single precision


APART = results._run_reader


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """meshio takes half a second to start: only the tests of that have it in a process of its own."""
    monkeypatch.setattr(results, "_run_reader", lambda path, reader, array, size: read_beside(path, reader, array))


# Meshes of a box, cut independently of the package


def lattice(counts: tuple[int, int, int] = (4, 3, 2), low: Floats = MINIMUM, size: Floats = SIZE) -> tuple[Floats, Any]:
    """Nodes of a regular lattice, and their numbers (x, y, z)."""
    axes = [np.linspace(a, a + s, n + 1) for a, s, n in zip(low, size, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, np.arange(len(points)).reshape([n + 1 for n in counts])


def hexahedra(numbers: Any) -> NDArray[np.int64]:
    corners = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    nx, ny, nz = (n - 1 for n in numbers.shape)
    return np.stack([numbers[i : nx + i, j : ny + j, k : nz + k].ravel() for i, j, k in corners], axis=1)


def hexahedron_mesh(**settings: Any) -> tuple[Floats, Cells]:
    points, numbers = lattice(**settings)
    return points, [("hexahedron", hexahedra(numbers))]


def wedge_mesh() -> tuple[Floats, Cells]:
    points, ((_, cells),) = hexahedron_mesh()
    return points, [("wedge", np.concatenate([cells[:, [0, 1, 2, 4, 5, 6]], cells[:, [0, 2, 3, 4, 6, 7]]]))]


def pyramid_mesh() -> tuple[Floats, Cells]:
    points, ((_, cells),) = hexahedron_mesh()
    middle = (len(points) + np.arange(len(cells)))[:, None]
    faces = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    pyramids = [np.hstack([cells[:, list(face)], middle]) for face in faces]
    return np.vstack([points, points[cells].mean(axis=1)]), [("pyramid", np.concatenate(pyramids))]


def tetra_mesh(count: int = 300) -> tuple[Floats, Cells]:
    """Tetrahedra (Qhull's) of random nodes, with those of a lattice on the box's sides."""
    points, _ = lattice()
    inside = MINIMUM + np.random.default_rng(3).uniform(0.05, 0.95, (count, 3)) * SIZE
    points = np.vstack([points, inside])
    return points, [("tetra", Delaunay(points).simplices.astype(np.int64))]


def tetra10_mesh() -> tuple[Floats, Cells]:
    """Nodes in the middle of edges that no cell shares, with values that only corners may hide."""
    points, ((_, cells),) = tetra_mesh(60)
    edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    middles = np.stack([(points[cells[:, a]] + points[cells[:, b]]) / 2 for a, b in edges], axis=1)
    numbers = len(points) + np.arange(middles.shape[0] * 6).reshape(-1, 6)
    return np.vstack([points, middles.reshape(-1, 3)]), [("tetra10", np.hstack([cells, numbers]))]


def mixed_mesh() -> tuple[Floats, Cells]:
    """Hexahedra, wedges and the triangles and lines that mesh generators leave on the borders."""
    points, ((_, cells),) = hexahedron_mesh()
    half, others = cells[: len(cells) // 2], cells[len(cells) // 2 :]
    wedges = np.concatenate([others[:, [0, 1, 2, 4, 5, 6]], others[:, [0, 2, 3, 4, 6, 7]]])
    return points, [("line", cells[:3, :2]), ("triangle", cells[:5, :3]), ("hexahedron", half), ("wedge", wedges)]


MESHES = {
    "hexahedron": hexahedron_mesh,
    "wedge": wedge_mesh,
    "pyramid": pyramid_mesh,
    "tetra": tetra_mesh,
    "tetra10": tetra10_mesh,
    "mixed": mixed_mesh,
}


def linear(points: Floats) -> Floats:
    """0.1 … 0.9 over the box or so."""
    return 0.5 + (points - MINIMUM - SIZE / 2) @ [0.04, -0.03, 0.05]


def vtu(points: Floats, cells: Cells, folder: Path, name: str = NAME, **data: Any) -> bytes:
    """A mesh's file.

    Args:
        data: arrays at points; those whose name begins with cell_ in cells.
    """
    at_points = {key: value for key, value in data.items() if not key.startswith("cell_")}
    in_cells = {key: value for key, value in data.items() if key.startswith("cell_")}
    file = folder / name
    meshio.Mesh(points, cells, point_data=at_points, cell_data=in_cells).write(file)
    return file.read_bytes()


GRID = 0.25  # mm: some 14 000 nodes, sooner made than by default


def source(name: str = NAME, **settings: Any) -> Any:
    return TypeAdapter(FieldSpec).validate_python({"mesh_data": name, "grid_mm": GRID, **settings})


def opened(content: bytes, frame: Frame = FRAME, name: str = NAME, **settings: Any) -> Any:
    return open_field(source(name, **settings), frame, Inputs(Path("nowhere"), {name: content}))


def directions(content: bytes, frame: Frame = FRAME, name: str = NAME, **settings: Any) -> Any:
    return open_orientation(source(name, **settings), frame, Inputs(Path("nowhere"), {name: content}))


def at(field: Any, places: Floats = PLACES) -> Floats:
    return np.broadcast_to(field.scalar(*places.T), len(places))


def taps(field: Any, places: Floats = PLACES) -> Floats:
    samples, weights = field.taps(*places.T)
    return np.asarray((samples * weights).sum(axis=0))


def line_errors(found: Floats, expected: Floats) -> Floats:
    """Degrees between lines, (N, 3) unit vectors each."""
    return np.rad2deg(np.arcsin(np.clip(np.linalg.norm(np.cross(found, expected), axis=-1), 0, 1)))


def in_plane(angle_deg: Floats) -> Floats:
    angle = np.deg2rad(np.asarray(angle_deg, np.float64))
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def tensor(vectors: Floats) -> Floats:
    """xx, yy, zz, xy, yz, xz of v vᵀ."""
    x, y, z = vectors.T
    return np.column_stack([x * x, y * y, z * z, x * y, y * z, x * z])


IDENTITY = {"data": [0, 1], "range": [0, 1]}  # values as they are


def test_the_comparison_of_lines_can_fail() -> None:
    assert line_errors(in_plane(np.array([10.0])), in_plane(np.array([190.0]))) == pytest.approx(0, abs=1e-6)
    assert line_errors(in_plane(np.array([1.0])), in_plane(np.array([179.0]))) == pytest.approx(2)


# Interpolation


@pytest.mark.parametrize("kind", MESHES)
def test_a_linear_field_is_met_exactly(kind: str, tmp_path: Path) -> None:
    points, cells = MESHES[kind]()
    values = linear(points)
    if kind == "tetra10":
        values[len(tetra_mesh(60)[0]) :] = 0.5  # nodes in the middle of edges do not count
    field = opened(vtu(points, cells, tmp_path, a=values), array="a", **IDENTITY)
    expected = linear(PLACES + MINIMUM)
    print(f"{kind}: on the grid {abs(at(field) - expected).max():.1e}, direct {abs(taps(field) - expected).max():.1e}")
    np.testing.assert_allclose(at(field), expected, atol=FLOAT32)
    np.testing.assert_allclose(taps(field), expected, atol=1e-12)
    assert field.varies == (True, True, True)
    low, high = field.bounds
    assert low <= at(field).min()
    assert at(field).max() <= high
    assert (low, high) == pytest.approx((linear(points).min(), linear(points).max()), abs=1e-9)


@pytest.mark.parametrize("kind", MESHES)
def test_cells_are_cut_without_gaps(kind: str) -> None:
    """Volumes sum to the box's; only its six sides have no neighbour; every place is a mean of its corners."""
    points, blocks = MESHES[kind]()
    corners = {"tetra10": ("tetra", 4)}
    solid = [
        (corners.get(name, (name, 0))[0], nodes[:, : corners[name][1]] if name in corners else nodes)
        for name, nodes in blocks
        if name not in ("line", "triangle")
    ]
    mesh = cut(points, solid, NAME)
    assert mesh.sizes.sum() == pytest.approx(SIZE.prod())
    a, b, c = np.moveaxis(points[mesh.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    if not kind.startswith("tetra"):  # Qhull leaves flat ones, which are dropped
        assert area == pytest.approx(2 * (SIZE[0] * SIZE[1] + SIZE[1] * SIZE[2] + SIZE[0] * SIZE[2]))
    fine, _ = lattice((16, 12, 8))  # on faces, edges and nodes of the lattice meshes, and between
    places = np.vstack([fine, fine + 1e-12, PLACES + MINIMUM])
    located = mesh.locate(places)
    assert (located.weights >= 0).all()
    np.testing.assert_allclose(located.weights.sum(axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(located.between(points), places, atol=3e-12)


def test_places_on_faces_are_found_far_from_the_origin() -> None:
    """Where coordinates have few digits left, rounding must not lose places between two cells."""
    low = np.array([12345.6789, -98765.4321, 55555.5555])
    points, blocks = hexahedron_mesh(low=low, counts=(7, 7, 7))
    mesh = cut(points, blocks, NAME)
    fine, _ = lattice((21, 21, 21), low)
    np.testing.assert_allclose(mesh.locate(fine).between(points), fine, atol=1e-9)


def test_distorted_hexahedra_keep_their_volume_together() -> None:
    """Faces that are not flat: neighbours cut them alike, so nothing is counted twice."""
    points, blocks = hexahedron_mesh(counts=(4, 4, 4))
    inner = ((points > MINIMUM + 1e-9) & (points < MINIMUM + SIZE - 1e-9)).all(axis=1)
    points[inner] += np.random.default_rng(5).uniform(-0.25, 0.25, (int(inner.sum()), 3))
    mesh = cut(points, blocks, NAME)
    assert mesh.sizes.sum() == pytest.approx(SIZE.prod())
    located = mesh.locate(PLACES + MINIMUM)
    np.testing.assert_allclose(located.between(points), PLACES + MINIMUM, atol=1e-11)


def test_outside_it_is_as_at_the_nearest_place(tmp_path: Path) -> None:
    """The mesh covers the lower half of a part: above, the nearest place of a box is the clamped one."""
    points, cells = hexahedron_mesh(size=SIZE / 2)
    field = opened(vtu(points, cells, tmp_path, a=linear(points)), array="a", **IDENTITY)
    expected = linear(np.clip(PLACES, 0, SIZE / 2) + MINIMUM)
    np.testing.assert_allclose(taps(field), expected, atol=1e-12)
    field = opened(vtu(points, cells, tmp_path, a=linear(points)), array="a", grid_mm=0.25, **IDENTITY)
    np.testing.assert_allclose(at(field), expected, atol=FLOAT32)  # the half is at nodes of the grid


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_flat_meshes_are_the_same_at_all_heights(kind: str, tmp_path: Path) -> None:
    points, numbers = lattice((6, 5, 1))
    quads = hexahedra(numbers)[:, :4]
    cells = quads if kind == "quad" else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    values = linear(points * (1, 1, 0))
    field = opened(vtu(points, [(kind, cells)], tmp_path, a=values), array="a", data=[-1, 2], range=[-1, 2])
    assert field.varies == (True, True, False)
    expected = linear((PLACES + MINIMUM) * (1, 1, 0))
    np.testing.assert_allclose(at(field), expected, atol=FLOAT32)
    np.testing.assert_allclose(taps(field), expected, atol=1e-12)
    lines = directions(vtu(points, [(kind, cells)], tmp_path, a=values), array="a", **IDENTITY)
    assert lines.varies == (True, True, False)


def test_flat_meshes_may_lie_at_any_height(tmp_path: Path) -> None:
    """Two-dimensional analyses are at z = 0, wherever the part is."""
    points, numbers = lattice((6, 5, 1))
    content = vtu(points * (1, 1, 0), [("quad", hexahedra(numbers)[:, :4])], tmp_path, a=linear(points * (1, 1, 0)))
    field = opened(content, array="a", data=[-1, 2], range=[-1, 2])
    np.testing.assert_allclose(at(field), linear((PLACES + MINIMUM) * (1, 1, 0)), atol=FLOAT32)


def test_shells_give_their_nearest_value(tmp_path: Path) -> None:
    """A cylinder's wall with the height as value: everywhere, the height."""
    turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, 25)[:-1], np.linspace(0, SIZE[2], 5), indexing="ij")
    centre = MINIMUM + SIZE * (0.5, 0.5, 0)
    points = np.stack([2 * np.cos(turn), 2 * np.sin(turn), height], axis=-1).reshape(-1, 3) + centre
    n = np.arange(24 * 5).reshape(24, 5)
    quads = np.stack([n, np.roll(n, -1, 0)], axis=-1)
    cells = np.stack([quads[:, :-1, 0], quads[:, :-1, 1], quads[:, 1:, 1], quads[:, 1:, 0]], axis=-1).reshape(-1, 4)
    content = vtu(points, [("quad", cells)], tmp_path, a=points[:, 2])
    field = opened(content, array="a", data=[0, 10], range=[0, 10])
    assert field.varies == (True, True, True)
    np.testing.assert_allclose(at(field), PLACES[:, 2] + MINIMUM[2], atol=1e-5)


def test_values_do_not_depend_on_how_points_are_grouped(tmp_path: Path) -> None:
    points, cells = tetra_mesh()
    content = vtu(points, cells, tmp_path, a=np.sin(points.sum(axis=1)))
    field, again = (opened(content, array="a") for _ in range(2))
    one = np.concatenate([at(again, place[None]) for place in PLACES[::-1]])[::-1]
    np.testing.assert_allclose(at(field), one, atol=1e-15)
    np.testing.assert_array_equal(taps(field), np.concatenate([taps(again, place[None]) for place in PLACES]))


# Cells


def cell_values(points: Floats, cells: Cells, function: Callable[[Floats], Floats]) -> list[Floats]:
    return [function(points[nodes].mean(axis=1)) for _, nodes in cells]


def test_values_of_cells_are_smoothed_to_the_nodes(tmp_path: Path) -> None:
    """Inside a regular mesh, the mean of the eight cells around a node is the linear field's value there."""
    points, cells = hexahedron_mesh(counts=(8, 6, 4))
    content = vtu(points, cells, tmp_path, cell_a=cell_values(points, cells, linear))
    inside = PLACES[((PLACES > 1.1) & (PLACES < SIZE - 1.1)).all(axis=1)]
    assert len(inside) > 80
    field = opened(content, array="cell_a", **IDENTITY)
    np.testing.assert_allclose(at(field, inside), linear(inside + MINIMUM), atol=FLOAT32)


def test_smoothing_weighs_cells_by_volume(tmp_path: Path) -> None:
    """A small cell of 1 beside a large one of 4: between them it is their mean by volume."""
    points, _ = lattice((2, 1, 1))
    points[:, 0] = np.where(np.isclose(points[:, 0], MINIMUM[0] + SIZE[0] / 2), MINIMUM[0] + 2.0, points[:, 0])
    _, numbers = lattice((2, 1, 1))
    content = vtu(points, [("hexahedron", hexahedra(numbers))], tmp_path, cell_a=[np.array([1.0, 4.0])])
    field = opened(content, array="cell_a", data=[0, 10], range=[0, 10], grid_mm=0.5)
    places = np.array([[0.0, 1, 1], [2, 1, 1], [8, 1, 1]])
    assert at(field, places) == pytest.approx([1, (2 * 1 + 6 * 4) / 8, 4])


def test_without_smoothing_each_cell_has_its_value(tmp_path: Path) -> None:
    points, cells = hexahedron_mesh(counts=(4, 3, 2))
    content = vtu(points, cells, tmp_path, cell_a=cell_values(points, cells, linear))
    field = opened(content, array="cell_a", smooth=False, grid_mm=0.1, **IDENTITY)
    side = SIZE / (4, 3, 2)
    within = PLACES % side
    inside = ((within > 0.15) & (within < side - 0.15)).all(axis=1)
    expected = linear((np.floor(PLACES / side) + 0.5) * side + MINIMUM)
    np.testing.assert_allclose(at(field)[inside], expected[inside], atol=FLOAT32)
    np.testing.assert_allclose(taps(field)[inside], expected[inside], atol=1e-12)


# Mapping


def test_data_and_range(tmp_path: Path) -> None:
    points, cells = hexahedron_mesh(counts=(8, 3, 2))
    mpa = 10 * (points[:, 0] - MINIMUM[0])  # 0 … 80
    content = vtu(points, cells, tmp_path, a=mpa)
    assert at(opened(content, array="a")) == pytest.approx(PLACES[:, 0] / 8, abs=FLOAT32)  # its own least and greatest
    field = opened(content, array="a", data=[20, 40], range=[0.9, 0.1])
    assert at(field) == pytest.approx(np.clip(0.9 - 0.8 * (PLACES[:, 0] - 2) / 2, 0.1, 0.9), abs=FLOAT32)
    assert field.bounds == (0.1, 0.9)
    assert at(field).min() == 0.1  # exactly
    assert at(field).max() == 0.9
    narrow = opened(content, array="a", data=[0, 200], range=[0, 1])
    assert narrow.bounds == pytest.approx((0, 0.4))


def test_one_value_is_that_value_to_the_last_bit(tmp_path: Path) -> None:
    points, cells = tetra_mesh()
    content = vtu(points, cells, tmp_path, a=np.full(len(points), 2.0))
    for range_, expected in (([0, 10], 2.0), ([0, 1], 0.2)):
        field = opened(content, array="a", data=[0, 10], range=range_)
        assert (at(field) == expected).all()
        assert field.varies == (False, False, False)
    with pytest.raises(JobError, match=r"'a' of 'result.vtu' is 2 everywhere") as refused:
        opened(content, array="a")
    assert "data: [low, high]" in str(refused.value.hint)


@pytest.mark.parametrize(("units", "mm"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0), ("inch", 25.4)])
def test_units(units: str, mm: float, tmp_path: Path) -> None:
    points, cells = hexahedron_mesh()
    field = opened(vtu(points / mm, cells, tmp_path, a=linear(points)), array="a", units=units, **IDENTITY)
    np.testing.assert_allclose(at(field), linear(PLACES + MINIMUM), atol=FLOAT32)


# Numbers of vectors and tensors


def test_numbers_of_tensors(tmp_path: Path) -> None:
    """Uniaxial s: s; pure shear: √3 τ; the same all around: 0. Eigenvalues of a turned diag(5, 2, -3) are 5, 2, -3."""
    zero = np.zeros(6)
    states = np.array([[70, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 40], [25, 25, 25, 0, 0, 0], zero])
    assert von_mises(states) == pytest.approx([70, np.sqrt(3) * 40, 0, 0])
    stress = np.random.default_rng(2).normal(size=(50, 6))
    full = stress[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    deviator = full - np.trace(full, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    assert von_mises(stress) == pytest.approx(np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))))

    points, cells = hexahedron_mesh()
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    one = turn @ np.diag([5.0, 2.0, -3.0]) @ turn.T
    everywhere = np.broadcast_to(one[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]], (len(points), 6))
    content = vtu(points, cells, tmp_path, s=everywhere, nine=np.broadcast_to(one.ravel(), (len(points), 9)))
    for array in ("s", "nine"):
        kept = {"array": array, "data": [-10, 10], "range": [-10, 10]}
        for which, value in ((1, 5), (2, 2), (3, -3)):
            field = opened(content, component="principal", principal=which, **kept)
            assert at(field) == pytest.approx(value)
            found = directions(content, array=array, principal=which).normals(*PLACES.T)
            assert line_errors(found, turn[:, which - 1]).max() < 0.01
        assert at(opened(content, component="von_mises", **kept)) == pytest.approx(7.0)  # √((3² + 5² + 8²) / 2)
        for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))):
            name = ("xx", "yy", "zz", "xy", "yz", "xz")[k]
            assert at(opened(content, component=name, **kept)) == pytest.approx(one[i, j])


def test_order_of_components(tmp_path: Path) -> None:
    """Abaqus has xx, yy, zz, xy, xz, yz; XDMF xx, xy, xz, yy, yz, zz."""
    points, cells = tetra_mesh(50)
    n = in_plane(20 * points[:, 0]) * (1, 1, 0) + (0, 0, 0.3)
    stress = tensor(n)
    orders = {"abaqus": ["xx", "yy", "zz", "xy", "xz", "yz"], "xdmf": ["xx", "xy", "xz", "yy", "yz", "zz"]}
    names = ["xx", "yy", "zz", "xy", "yz", "xz"]
    plain = directions(vtu(points, cells, tmp_path, s=stress), array="s", principal=1).normals(*PLACES.T)
    for order in orders.values():
        content = vtu(points, cells, tmp_path, s=stress[:, [names.index(name) for name in order]])
        found = directions(content, array="s", principal=1, order=order).normals(*PLACES.T)
        np.testing.assert_array_equal(found, plain)
        assert line_errors(directions(content, array="s", principal=1).normals(*PLACES.T), plain).max() > 5


def test_numbers_of_vectors(tmp_path: Path) -> None:
    points, cells = tetra_mesh(50)
    v = np.column_stack([linear(points), 3 * linear(points), -2 * linear(points)])
    content = vtu(points, cells, tmp_path, v=v)
    for component, factor in {"x": 1, "y": 3, "z": -2, "magnitude": np.sqrt(14)}.items():
        field = opened(content, array="v", component=component, data=[-5, 5], range=[-5, 5])
        assert at(field) == pytest.approx(factor * linear(PLACES + MINIMUM), abs=5e-6)


# Directions


def turning(points: Floats) -> Floats:
    """Half a turn along x, degrees."""
    return np.asarray(180 * (points[:, 0] - MINIMUM[0]) / SIZE[0])


@pytest.mark.parametrize("how", ["stress", "compression", "vector", "angle", "cells"])
def test_directions_turn_half_around(how: str, tmp_path: Path) -> None:
    """Nodes 1 mm apart along x of 8 mm are 22.5° apart: between them the line is linear within 0.3°, or 0.5° of cells
    that are smoothed. (Halfway between nodes it is exact; by symmetry the error is odd around it.)"""
    counts = (8, 3, 2)
    points, cells = hexahedron_mesh(counts=counts)
    if how == "cells":
        points, cells = hexahedron_mesh(counts=(24, 3, 2))
    n = in_plane(turning(points))
    sign = np.random.default_rng(6).choice([-1.0, 1.0], (len(points), 1))
    settings: dict[str, Any] = {
        "stress": {"principal": 1},
        "compression": {"principal": 3},
        "vector": {},
        "angle": {"data": [0, 180], "range": [0, 180]},
        "cells": {"principal": 1},
    }[how]
    if how == "cells":
        of_cells = cell_values(points, cells, lambda p: 70 * tensor(in_plane(turning(p))))
        content = vtu(points, cells, tmp_path, cell_a=of_cells)
    else:
        values = {
            "stress": 70 * tensor(n),
            "compression": -70 * tensor(n),
            "vector": sign * n * 3,
            "angle": turning(points),
        }
        content = vtu(points, cells, tmp_path, a=values[how])
    field = directions(content, array="cell_a" if how == "cells" else "a", **settings)
    places = PLACES[(PLACES[:, 0] > 0.5) & (PLACES[:, 0] < 7.5)] if how == "cells" else PLACES
    found = field.normals(*places.T)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    errors = line_errors(found, in_plane(turning(places + MINIMUM)))
    print(f"{how}: at most {errors.max():.3f}°, mean {errors.mean():.3f}°")
    assert errors.max() < 0.5
    assert field.turns


def test_directions_in_a_tetrahedral_mesh(tmp_path: Path) -> None:
    """A uniaxial stress of σ = n nᵀ that turns by 180° along x, at about 700 random nodes."""
    points, cells = tetra_mesh(700)
    field = directions(vtu(points, cells, tmp_path, s=tensor(in_plane(turning(points)))), array="s", principal=1)
    errors = line_errors(field.normals(*PLACES.T), in_plane(turning(PLACES + MINIMUM)))
    print(f"random tetrahedra: at most {errors.max():.2f}°, mean {errors.mean():.2f}°")
    assert errors.max() < 4


@pytest.mark.parametrize("how", ["stress", "vector", "angle", "azimuth", "cells"])
def test_between_1_and_179_degrees_it_is_never_90(how: str, tmp_path: Path) -> None:
    """Nodes, or cells, of 1° and 179° in turn: as lines they are 2° apart."""
    points, cells = hexahedron_mesh(counts=(8, 3, 2))
    angle = np.where(np.round(points[:, 0] - MINIMUM[0]) % 2 == 0, 1.0, 179.0)
    n = in_plane(angle)
    settings: dict[str, Any] = {"array": "a", "data": [0, 180], "range": [0, 180]}
    if how == "cells":
        ones = cell_values(points, cells, lambda p: np.where(np.floor(p[:, 0] - MINIMUM[0]) % 2 == 0, 1.0, 179.0))
        content = vtu(points, cells, tmp_path, cell_a=ones)
        settings["array"] = "cell_a"
    else:
        content = vtu(points, cells, tmp_path, a={"stress": tensor(n), "vector": n}.get(how, angle))
    if how in ("stress", "vector"):
        settings = {"array": "a", **({"principal": 1} if how == "stress" else {})}
    if how == "azimuth":
        found = Angles(opened(content, **settings), ConstantSampler(0.0)).normals(*PLACES.T)
    else:
        found = directions(content, **settings).normals(*PLACES.T)
    assert line_errors(found, np.array([1.0, 0, 0])).max() <= 1 + 1e-3


def test_where_there_is_no_direction_it_is_x(tmp_path: Path) -> None:
    """Vectors of 0; stresses that are the same all around, and of 0."""
    points, cells = tetra_mesh(50)
    pressure = np.tile([-3.0, -3, -3, 0, 0, 0], (len(points), 1))
    content = vtu(points, cells, tmp_path, v=np.zeros((len(points), 3)), s=np.zeros((len(points), 6)), p=pressure)
    for settings in ({"array": "v"}, {"array": "s", "principal": 1}, {"array": "p", "principal": 3}):
        assert line_errors(directions(content, **settings).normals(*PLACES.T), np.array([1.0, 0, 0])).max() < 1e-6


def kirsch(points: Floats, hole: float) -> Floats:
    """xx, yy, xy of a plate with a hole under tension 1 along x (Kirsch 1898), from its centre."""
    r, t = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    q = (hole / r) ** 2
    rr = (1 - q) / 2 + (1 - 4 * q + 3 * q**2) / 2 * np.cos(2 * t)
    tt = (1 + q) / 2 - (1 + 3 * q**2) / 2 * np.cos(2 * t)
    rt = -(1 + 2 * q - 3 * q**2) / 2 * np.sin(2 * t)
    c, s = np.cos(t), np.sin(t)
    xx, yy = rr * c**2 + tt * s**2 - 2 * rt * s * c, rr * s**2 + tt * c**2 + 2 * rt * s * c
    return np.column_stack([xx, yy, (rr - tt) * s * c + rt * (c**2 - s**2)])


def test_plate_with_a_hole(tmp_path: Path) -> None:
    """The direction of most tension around a hole of 2 mm radius in a plate of 20 mm, and the peak of 3 at its rim."""
    hole, half = 2.0, 10.0
    turn = np.linspace(0, 2 * np.pi, 97)[:-1]
    rays = half / np.maximum(np.abs(np.cos(turn)), np.abs(np.sin(turn)))
    share = np.linspace(0, 1, 25) ** 1.5
    radii = hole + share[:, None] * (rays - hole)
    points = np.column_stack([(radii * np.cos(turn)).ravel(), (radii * np.sin(turn)).ravel(), np.zeros(radii.size)])
    n = np.arange(radii.size).reshape(radii.shape)
    around = np.roll(n, -1, axis=1)
    cells = np.stack([n[:-1], n[1:], around[1:], around[:-1]], axis=-1).reshape(-1, 4)
    s = kirsch(points, hole)
    zero = np.zeros(len(s))
    stress = np.column_stack([s[:, 0], s[:, 1], zero, s[:, 2], zero, zero])
    content = vtu(points, [("quad", cells)], tmp_path, stress=stress)
    frame = Frame(np.array([-half, -half, 0.0]), np.array([2 * half, 2 * half, 3.0]))

    places = np.random.default_rng(8).uniform(-half, half, (4000, 2))
    xx, yy, xy = kirsch(places, hole).T
    gap = np.hypot((xx - yy) / 2, xy)  # half of what tells the two directions apart; where it is 0, there are none
    # Where both are compressed, the most tension is the 0 along z.
    clear = (np.hypot(*places.T) > hole + 0.1) & (gap > 0.15) & ((xx + yy) / 2 + gap > 0.05)
    expected = in_plane(np.rad2deg(np.arctan2(2 * xy, xx - yy) / 2))
    asked = np.column_stack([places + half, np.full(len(places), 1.0)])
    found = directions(content, frame, array="stress", principal=1, grid_mm=0.05).normals(*asked.T)
    errors = line_errors(found, expected)[clear]
    print(f"Kirsch: {clear.sum()} places, mean {errors.mean():.2f}°, at most {errors.max():.2f}°")
    assert errors.max() < 3
    assert errors.mean() < 0.3
    peak = opened(content, frame, array="stress", component="principal", principal=1, data=[0, 3], range=[0, 3])
    assert peak.bounds[1] == pytest.approx(3, abs=1e-6)
    assert at(peak, np.array([[half, half + hole, 1.0]])) == pytest.approx(3, abs=0.1)


# Frames


def test_the_field_moves_with_its_part(tmp_path: Path) -> None:
    points, cells = tetra_mesh()
    shift = np.array([100.0, -20.0, 7.0])
    here = opened(vtu(points, cells, tmp_path, a=linear(points)), array="a", **IDENTITY)
    there = opened(
        vtu(points + shift, cells, tmp_path, a=linear(points)), Frame(MINIMUM + shift, SIZE), array="a", **IDENTITY
    )
    np.testing.assert_allclose(at(there), at(here), atol=FLOAT32)
    moved = opened(vtu(points, cells, tmp_path, a=linear(points)), Frame(MINIMUM + 1, SIZE - 1), array="a", **IDENTITY)
    np.testing.assert_allclose(taps(moved, PLACES / 2), taps(here, PLACES / 2 + 1), atol=1e-12)


@pytest.mark.parametrize("settings", [{}, {"rotate": [0, 0, 90]}, {"rotate": [90, 0, 30], "scale": 1.5}])
def test_a_job_paints_the_same_as_an_expression(settings: dict[str, Any], tmp_path: Path) -> None:
    """Black and white at a slanted plane: every pixel is known from the expression, wherever the part stands."""
    part = parts.stl(tmp_path, meshes.box((6.0, 5.0, 4.0), at=(16.0, -8.0, 4.0)))
    points, cells = hexahedron_mesh(low=np.array([16.0, -8.0, 4.0]), size=np.array([6.0, 5.0, 4.0]))
    vtu(points, cells, tmp_path, a=points @ [1.0, 0.5, 0.25])
    printer = {"pitch_um": 100, "layer_um": 500}
    asked: dict[str, Any] = {"printer": printer, "settings": settings, "dimensions": 3}
    # A hair wide, at a place where no pixel is.
    ratio = {"mesh_data": NAME, "array": "a", "data": [16.4245, 16.4255], "grid_mm": 0.5}
    found = parts.labels(parts.job(part, ratio=ratio, **asked))
    expected = parts.labels(parts.job(part, ratio={"expression": "where(x + 0.5*y + 0.25*z > 16.425, 1, 0)"}, **asked))
    assert np.mean(found != expected) < 1e-4
    assert 0.2 < np.mean(found == 1) / np.mean(found > 0) < 0.8


def test_a_job_turns_directions_with_its_part(tmp_path: Path) -> None:
    part = parts.stl(tmp_path, meshes.box((6.0, 6.0, 6.0)))
    points, cells = hexahedron_mesh(low=np.zeros(3), size=np.full(3, 6.0))
    vtu(points, cells, tmp_path, s=tensor(np.tile(in_plane(np.array(25.0)), (len(points), 1))))
    orientation = {"mesh_data": NAME, "array": "s", "principal": 1, "grid_mm": 0.5}
    for turn in (0, 40):
        settings = {"rotate": [0, 0, turn]}
        job = parts.job(part, orientation=orientation, settings=settings)
        found = prepare(job).painted.normals(np.full((1, 3), 3.0))
        assert line_errors(found, in_plane(np.array([25.0 + turn]))).max() < 1e-3


def test_in_bed_coordinates(tmp_path: Path) -> None:
    """The mesh as the printer sees it: a part that is turned and moved keeps the analysis of the printed one."""
    part = parts.stl(tmp_path, meshes.box((6.0, 6.0, 4.0)))
    printed = {"rotate": [0, 0, 90]}  # its box is then -6 … 0 along x
    points, cells = hexahedron_mesh(low=np.array([-6.0, 0, 0]), size=np.array([6.0, 6.0, 4.0]))
    vtu(points, cells, tmp_path, a=0.1 + 0.1 * (points[:, 0] + 6))
    ratio = {"mesh_data": NAME, "array": "a", "frame": "bed", "data": [0, 1]}
    prepared = prepare(parts.job(part, ratio=ratio, settings=printed))
    found = prepared.painted.ratio_map(prepared.grid, 0)[0]
    expected = np.minimum(0.1 + 0.1 * prepared.grid.x_mm(), 0.7)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-5)


# File formats


XDMF = """<?xml version="1.0"?>
<Xdmf Version="3.0"><Domain><Grid Name="Grid" GridType="Uniform">
<Geometry GeometryType="XYZ"><DataItem DataType="Float" Dimensions="{points} 3" Format="XML" Precision="8">
{coordinates}</DataItem></Geometry>
<Topology TopologyType="Hexahedron" NumberOfElements="{cells}">
<DataItem DataType="Int" Dimensions="{cells} 8" Format="{form}" Precision="8">{nodes}</DataItem></Topology>
<Attribute Name="a" AttributeType="Scalar" Center="Node">
<DataItem DataType="Float" Dimensions="{points}" Format="XML" Precision="8">{values}</DataItem></Attribute>
</Grid></Domain></Xdmf>"""


def xdmf(form: str = "XML", nodes: str | None = None) -> bytes:
    points, ((_, cells),) = hexahedron_mesh()

    def text(values: Any) -> str:
        return " ".join(repr(value) for value in np.asarray(values).ravel().tolist())

    return XDMF.format(
        points=len(points), cells=len(cells), coordinates=text(points), form=form,
        nodes=text(cells) if nodes is None else nodes, values=text(linear(points)),
    ).encode()  # fmt: skip


FORMATS: dict[str, tuple[str, dict[str, Any]]] = {
    "vtu": ("result.vtu", {}),
    "vtu-ascii": ("result.vtu", {"binary": False}),
    "vtu-plain": ("result.vtu", {"compression": None}),
    "vtk": ("result.vtk", {}),
    "vtk-ascii": ("result.vtk", {"binary": False}),
    "vtk42": ("result.vtk", {"file_format": "vtk42"}),
    "msh41": ("result.msh", {"file_format": "gmsh"}),
    "msh41-ascii": ("result.msh", {"file_format": "gmsh", "binary": False}),
    "msh22": ("result.msh", {"file_format": "gmsh22", "binary": False}),
    "msh22-binary": ("result.msh", {"file_format": "gmsh22"}),
    "avs": ("result.avs", {}),
}


def written(format_: str, folder: Path) -> tuple[str, bytes]:
    if format_ == "xdmf":
        return "result.xdmf", xdmf()
    name, settings = FORMATS[format_]
    points, cells = hexahedron_mesh()
    mesh = meshio.Mesh(points, cells, point_data={"a": linear(points)})
    file = folder / name
    mesh.write(file, **settings)
    # meshio 5.3.5 under NumPy 2 writes some numbers as np.float64(0.5).
    return name, re.sub(rb"np\.float64\(([^)]*)\)", rb"\1", file.read_bytes())


@pytest.mark.parametrize("format_", [*FORMATS, "xdmf"])
def test_formats(format_: str, tmp_path: Path, capfd: Any) -> None:
    name, content = written(format_, tmp_path)
    capfd.readouterr()
    field = opened(content, name=name, array="a", **IDENTITY)
    tolerance = 1e-5 if format_ == "avs" else FLOAT32
    np.testing.assert_allclose(at(field), linear(PLACES + MINIMUM), atol=tolerance)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["TENSORS", "VECTORS"])
def test_directions_of_a_vtk_file_written_by_hand(kind: str) -> None:
    points, ((_, cells),) = hexahedron_mesh(counts=(8, 3, 2))
    n = in_plane(turning(points))
    values = n if kind == "VECTORS" else n[:, :, None] * n[:, None, :]
    lines = ["# vtk DataFile Version 3.0", "by hand", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    lines += [f"POINTS {len(points)} double", *(" ".join(map(repr, point)) for point in points.tolist())]
    lines += [f"CELLS {len(cells)} {9 * len(cells)}", *("8 " + " ".join(map(str, cell)) for cell in cells.tolist())]
    lines += [f"CELL_TYPES {len(cells)}", *["12"] * len(cells), f"POINT_DATA {len(points)}", f"{kind} s double"]
    lines += [" ".join(map(repr, value)) for value in values.reshape(-1, 3).tolist()]
    settings = {"principal": 1} if kind == "TENSORS" else {}
    content = "\n".join([*lines, ""]).encode()
    found = directions(content, name="result.vtk", array="s", **settings).normals(*PLACES.T)
    assert line_errors(found, in_plane(turning(PLACES + MINIMUM))).max() < 0.5


@pytest.mark.parametrize("format_", [*FORMATS, "xdmf"])
def test_cut_off_files_are_refused(format_: str, tmp_path: Path, capfd: Any) -> None:
    """At no length is half a file taken for a mesh, and nothing is printed."""
    name, content = written(format_, tmp_path)
    capfd.readouterr()
    for length in np.linspace(0, 0.9 * len(content), 12).astype(int):
        with pytest.raises(JobError):
            opened(content[:length], name=name, array="a", **IDENTITY)
    assert capfd.readouterr() == ("", "")


def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: Any) -> None:
    name, content = written("vtu", tmp_path)
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(results.tempfile, "tempdir", str(folder))
    opened(content, name=name, array="a")
    with pytest.raises(JobError):
        opened(content[:500], name=name, array="a")
    assert not list(folder.iterdir())


def test_cells_and_points_of_the_same_name(tmp_path: Path) -> None:
    points, cells = tetra_mesh(20)
    file = tmp_path / NAME
    count = len(cells[0][1])
    data = {"point_data": {"a": linear(points)}, "cell_data": {"a": [np.linspace(0, 1, count)]}}
    meshio.Mesh(points, cells, **data).write(file)
    content = file.read_bytes()
    with pytest.raises(JobError, match="there twice"):
        opened(content, array="a")
    assert opened(content, array="a", on="points", **IDENTITY).bounds == pytest.approx(
        (linear(points).min(), linear(points).max())
    )
    assert opened(content, array="a", on="cells", data=[-1, 2], range=[-1, 2]).bounds == pytest.approx((0, 1))


# Refusals


def box_file(folder: Path, **data: Any) -> bytes:
    points, cells = hexahedron_mesh()
    return vtu(points, cells, folder, **(data or {"a": linear(points)}))


def ones(*shape: int) -> Floats:
    """Values at the box's nodes."""
    return np.ones((len(hexahedron_mesh()[0]), *shape))


def test_unknown_array(tmp_path: Path) -> None:
    content = box_file(tmp_path, a=ones(), stress=ones(6), cell_d=[np.ones(24)])
    with pytest.raises(JobError, match=r"'result.vtu' has no array 'strain'") as refused:
        opened(content, array="strain")
    assert "at points: a, stress; at cells: cell_d" in str(refused.value.hint)
    with pytest.raises(JobError, match="no array 'a' at cells"):
        opened(content, array="a", on="cells")


def test_directions_where_numbers_are_asked_for(tmp_path: Path) -> None:
    content = box_file(tmp_path, v=ones(3), s=ones(6))
    with pytest.raises(JobError, match=r"vectors of the array 'v' of 'result.vtu' make directions") as refused:
        opened(content, array="v")
    assert "magnitude" in str(refused.value.hint)
    with pytest.raises(JobError, match=r"tensors of the array 's' .* make directions"):
        opened(content, array="s", principal=1)
    with pytest.raises(JobError, match="which direction of the tensors") as refused:
        directions(content, array="s")
    assert "principal: 1" in str(refused.value.hint)


@pytest.mark.parametrize(
    ("array", "settings", "message"),
    [
        ("a", {"component": "x"}, "holds scalars .* no component x"),
        ("v", {"component": "von_mises"}, "holds vectors .* no component von_mises"),
        ("s", {"component": "x"}, "holds tensors .* no component x"),
        ("a", {"principal": 1}, "holds scalars .* no principal direction"),
        ("v", {"principal": 1}, "holds vectors .* no principal direction"),
        ("four", {"component": "x"}, "'four' of 'result.vtu' has 4 components"),
    ],
)
def test_wrong_components(array: str, settings: dict[str, Any], message: str, tmp_path: Path) -> None:
    content = box_file(tmp_path, a=ones(), v=ones(3), s=ones(6), four=ones(4))
    with pytest.raises(JobError, match=message):
        opened(content, array=array, **settings)
    if array != "four":
        with pytest.raises(JobError, match=message):
            directions(content, array=array, **settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"data": [1, 1]}, "low < high"),
        ({"data": [0, float("nan")]}, "finite"),
        ({"principal": 4}, "less than or equal to 3"),
        ({"principal": 1.0}, "integer"),
        ({"component": "principal"}, "needs principal"),
        ({"component": "xx", "principal": 1}, "give one of them"),
        ({"order": ["xx", "yy", "zz", "xy", "xz", "xz"]}, "once"),
        ({"grid_mm": 0}, "greater than"),
        ({"units": "feet"}, "mm"),
        ({"outside": "zero"}, "Extra inputs"),
    ],
)
def test_wrong_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        source(array="a", **settings)


def test_numbers_that_are_none(tmp_path: Path) -> None:
    values = ones(3)
    values[7, 1] = np.nan
    values[9] = np.inf
    content = box_file(tmp_path, v=values, cell_d=[np.where(np.arange(24) == 5, np.inf, 1.0)])
    with pytest.raises(JobError, match=r"'v' of 'result.vtu': nan at node 7 .* 2 of 60"):
        directions(content, array="v")
    with pytest.raises(JobError, match=r"1e\+200 at node 0"):
        opened(box_file(tmp_path, a=1e200 * ones()), array="a")
    with pytest.raises(JobError, match="inf at cell 5"):
        opened(content, array="cell_d")
    points, cells = hexahedron_mesh()
    points[3, 2] = np.nan
    with pytest.raises(JobError, match=r"coordinates of 'result.vtu': nan at node 3"):
        opened(vtu(points, cells, tmp_path, a=ones()), array="a")


def test_nodes_that_no_cell_has_do_not_count(tmp_path: Path) -> None:
    points, cells = hexahedron_mesh()
    points, values = np.vstack([points, [[1e12, np.nan, 0]]]), np.append(linear(points), np.nan)
    field = opened(vtu(points, cells, tmp_path, a=values), array="a", **IDENTITY)
    np.testing.assert_allclose(at(field), linear(PLACES + MINIMUM), atol=FLOAT32)


def test_meshes_without_cells(tmp_path: Path) -> None:
    points, ((_, cells),) = hexahedron_mesh()
    with pytest.raises(JobError, match=r"no cells to interpolate in: 60 nodes; cells: 24 line"):
        opened(vtu(points, [("line", cells[:, :2])], tmp_path, a=ones()), array="a")
    with pytest.raises(JobError, match=r"no cells to interpolate in|cannot be read"):
        opened(vtu(points, [], tmp_path, a=ones()), array="a")
    with pytest.raises(JobError, match=r"have no volume"):
        opened(vtu(points * (1, 1, 0), [("hexahedron", cells)], tmp_path, a=ones()), array="a")
    sides = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    polyhedra = vtu(points, [("polyhedron8", [[cells[0][list(side)] for side in sides]])], tmp_path, a=ones())
    with pytest.raises(JobError, match=r"has cells that are not read: polyhedron8"):
        opened(polyhedra, array="a")
    cells[3, 4] = 60
    with pytest.raises(JobError, match="has the node 60, and there are 60"):
        opened(vtu(points, [("hexahedron", cells)], tmp_path, a=ones()), array="a")


def test_a_mesh_in_another_place_or_unit(tmp_path: Path) -> None:
    points, cells = hexahedron_mesh()
    with pytest.raises(JobError, match=r"lies outside the part: it is 103.1 … 111.1 x .* the part's file 3.1 … 11.1"):
        opened(vtu(points + 100 * np.eye(3)[0], cells, tmp_path, a=ones()), array="a", data=[0, 1])
    with pytest.raises(JobError, match="lies outside the part") as refused:
        opened(vtu(points / 1000, cells, tmp_path, a=ones()), array="a", data=[0, 1])
    assert "units: mm may be another one" in str(refused.value.hint)
    centred = Frame(np.array([-4.0, -3.0, -2.0]), SIZE)
    with pytest.raises(JobError, match="is tiny beside the part"):
        opened(vtu((points - MINIMUM - SIZE / 2) / 1000, cells, tmp_path, a=ones()), centred, array="a", data=[0, 1])


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"'result.vtu' cannot be read as .vtu"):
        opened(b"not a mesh", array="a")
    for name in ("result.inp", "result.e", "result.stl", "result"):
        with pytest.raises(JobError, match="not read from") as refused:
            opened(b"", name=name, array="a")
        assert "vtu" in str(refused.value.hint)
    entity = b'<?xml version="1.0"?><!DOCTYPE v [<!ENTITY a "b">]><VTKFile type="UnstructuredGrid"/>'
    with pytest.raises(JobError, match="entities"):
        opened(entity, array="a")
    with pytest.raises(JobError, match=r"'gone.vtu' cannot be read"):
        open_field(source("gone.vtu", array="a"), FRAME, Inputs(tmp_path))


def test_xdmf_reads_no_other_file(tmp_path: Path) -> None:
    """Whether the other file is there or not."""
    for form, other in (("HDF", "result.h5:/data0"), ("Binary", "/etc/hostname")):
        with pytest.raises(JobError, match="keeps its numbers in another place") as refused:
            opened(xdmf(form, other), name="result.xdmf", array="a")
        assert other in refused.value.message
        assert "vtu" in str(refused.value.hint)


def test_xdmf_with_words_among_its_numbers() -> None:
    with pytest.raises(JobError, match=r"cannot be read as .xdmf"):
        opened(xdmf(nodes="0 1 2 three 4"), name="result.xdmf", array="a")


def test_sizes(tmp_path: Path, monkeypatch: Any) -> None:
    content = box_file(tmp_path)
    with pytest.raises(JobError, match=r"grid_mm: 0.01 makes .* at most 50000000"):
        opened(content, array="a", grid_mm=0.01)
    huge = content.replace(b'NumberOfCells="24"', b'NumberOfCells="99000000000"')
    assert huge != content
    with pytest.raises(JobError, match="has 99000000000 nodes or cells"):
        opened(huge, array="a")
    monkeypatch.setattr(results, "MOST_BYTES", 100)
    with pytest.raises(JobError, match="at most 100 are read"):
        opened(content, array="a")


@pytest.mark.parametrize("name", ["meshio", "igl"])
def test_a_library_that_is_missing(name: str, tmp_path: Path, monkeypatch: Any) -> None:
    content = box_file(tmp_path)
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(JobError, match=f"needs the library {name}") as refused:
        opened(content, array="a")
    assert "amslicer[fields]" in str(refused.value.hint)


def test_paths() -> None:
    spec = source(array="a")
    assert spec.paths() == (NAME,)
    assert spec.with_paths({NAME: "other.vtu"}).mesh_data == "other.vtu"


# Files that ask for too much: meshio reads in a process of its own


def packed_vtu(megabytes: int) -> bytes:
    """One tetrahedron, and an array whose only block says 16 MB and inflates to so many."""
    packer = zlib.compressobj(9)
    block = b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(megabytes)), packer.flush()])
    text = base64.b64encode(struct.pack("<IIII", 1, 1 << 24, 0, len(block))) + base64.b64encode(block)

    def array(name: str, kind: str, numbers: str, components: int = 1) -> str:
        return f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}">{numbers}</DataArray>'

    return (
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">'
        '<UnstructuredGrid><Piece NumberOfPoints="4" NumberOfCells="1"><Points>'
        f"{array('p', 'Float64', '0 0 0 1 0 0 0 1 0 0 0 1', 3)}</Points><Cells>"
        f"{array('connectivity', 'Int64', '0 1 2 3')}{array('offsets', 'Int64', '4')}{array('types', 'Int64', '10')}"
        '</Cells><PointData><DataArray type="Float64" Name="a" format="binary">'
    ).encode() + text + b"</DataArray></PointData></Piece></UnstructuredGrid></VTKFile>"  # fmt: skip


POINTS_OF_A_GRID = (
    b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 500 500 500\nORIGIN 0 0 0\n"
    b"SPACING 1 1 1\nPOINT_DATA 1\nSCALARS a double 1\nLOOKUP_TABLE default\n1\n"
)
COORDINATES = (
    b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET RECTILINEAR_GRID\nDIMENSIONS 9000 9000 9000\n"
    b"X_COORDINATES 2 double\n0 1\nY_COORDINATES 2 double\n0 1\nZ_COORDINATES 2 double\n0 1\n"
)
TAGS = b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$NodeData\n99999999999\n"
SPARSE = b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 90000000 1 90000000\n2 1 0 90000000\n1\n0 0 0\n$EndNodes\n"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems keep to no limit of memory")
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.vtu", packed_vtu(600)),
        ("a.vtk", POINTS_OF_A_GRID),
        ("a.vtk", COORDINATES),
        ("a.msh", TAGS),
        ("a.msh", SPARSE),
    ],
    ids=["vtu", "points", "coordinates", "tags", "sparse"],
)
def test_files_that_ask_for_too_much(name: str, content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "_run_reader", APART)
    monkeypatch.setattr(results, "MOST_MEMORY", 1 << 30)
    monkeypatch.setattr(results, "MOST_SECONDS", 2)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.monotonic()
    with pytest.raises(JobError, match=r"takes? too much memory"):
        opened(content, name=name, array="a")
    assert time.monotonic() - started < 8 * 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


@pytest.mark.parametrize("format_", ["vtu", "xdmf"])
def test_in_a_process_of_its_own_the_same_is_read(
    format_: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, content = written(format_, tmp_path)
    here = opened(content, name=name, array="a", **IDENTITY)
    monkeypatch.setattr(results, "_run_reader", APART)
    apart = opened(content, name=name, array="a", **IDENTITY)
    np.testing.assert_array_equal(at(apart), at(here))
    with pytest.raises(JobError, match="has no array 'b'") as refused:
        opened(content, name=name, array="b")
    assert "at points: a" in str(refused.value.hint)


def test_a_process_that_does_not_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "_run_reader", APART)
    monkeypatch.setattr(results, "WAITING", 0.001)
    with pytest.raises(JobError, match="no end of it within"):
        opened(box_file(tmp_path), array="a")


def test_gmsh_text_that_numpy_spoilt(tmp_path: Path) -> None:
    points, cells = tetra_mesh(20)
    file = tmp_path / "a.msh"
    meshio.gmsh.write(file, meshio.Mesh(points, cells, point_data={"a": linear(points)}), "4.1", binary=False)
    content = file.read_bytes().replace(b"$Nodes\n", b"$Nodes\nnp.float64(0.5)")
    with pytest.raises(JobError, match=r"cannot be read as \.msh") as refused:
        opened(content, name="a.msh", array="a")
    assert refused.value.hint == "write it binary, or as vtu"
