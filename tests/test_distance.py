"""Fields by the depth below the part's surface, against formulas of spheres, boxes and tori."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
import trimesh
from meshes import Solid
from numpy.typing import NDArray
from pydantic import ValidationError

from amslicer.errors import JobError
from amslicer.fields import Frame, open_field, open_orientation
from amslicer.fields.distance import DistanceSource
from amslicer.fields.source import Inputs, Part
from amslicer.mesh import read_mesh
from amslicer.painted import Painted
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]
NOTHING = Inputs(Path())


def frame(folder: Path, solid: Solid) -> Frame:
    path = folder / "part.ply"
    path.write_bytes(meshes.ply(solid))
    mesh = read_mesh(path)
    return Frame(mesh.minimum_mm, mesh.size_mm, None, lambda: Part(path, mesh))


def source(distance: Any, **more: Any) -> DistanceSource:
    return DistanceSource.model_validate({"distance": distance, **more})


def depth_of(frame: Frame, places: Floats, depth: float = 5.0, **more: Any) -> Floats:
    """Depths in mm at (N, 3) places of the file: a field that is the depth itself."""
    field = open_field(source({"from": 0.0, "to": depth, "depth": depth}, **more), frame, NOTHING)
    return field.scalar(*(places - frame.minimum_mm).T)


def normals_of(frame: Frame, places: Floats, **more: Any) -> Floats:
    field = open_orientation(source("normal", **more), frame, NOTHING)
    return field.normals(*(places - frame.minimum_mm).T)


def off_line_deg(found: Floats, expected: Floats) -> Floats:
    """Angles between lines."""
    length = np.linalg.norm(found, axis=1) * np.linalg.norm(expected, axis=1)
    return np.rad2deg(np.arccos(np.clip(np.abs((found * expected).sum(axis=1)) / length, 0, 1)))


def in_ball(count: int, radius: float, least: float = 0.0, seed: int = 0) -> Floats:
    random = np.random.default_rng(seed)
    way = random.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return way * random.uniform(least, radius, (count, 1))


def test_lines_are_compared_as_lines() -> None:
    ways = np.array([[1.0, 0, 0], [np.cos(0.1), np.sin(0.1), 0]])
    np.testing.assert_allclose(off_line_deg(ways, np.array([[-2.0, 0, 0]])), [0, np.rad2deg(0.1)], atol=1e-6)


def test_depth_in_a_sphere(tmp_path: Path) -> None:
    """The mesh's facets lie up to 0.011 mm below the sphere."""
    solid = meshes.sphere(3.0, 4)
    inner = np.linalg.norm(solid[0][solid[1]].mean(axis=1), axis=1).min()
    sphere = frame(tmp_path, solid)
    places = in_ball(2000, 2.95)
    found = depth_of(sphere, places, grid_mm=0.15)
    r = np.linalg.norm(places, axis=1)
    within = r > 0.2  # of the centre, where all sides are equally near
    assert np.abs(found - (3.0 - r))[within].max() < (3.0 - inner) + 0.15**2 / 0.2
    assert np.abs(found - (3.0 - r))[r > 1].max() < 0.02
    assert np.abs(found - (3.0 - r)).max() < 0.15


def test_normals_in_a_sphere(tmp_path: Path) -> None:
    sphere = frame(tmp_path, meshes.sphere(3.0, 4))
    places = in_ball(2000, 3.4, 0.8)
    off = off_line_deg(normals_of(sphere, places, grid_mm=0.15), places)
    assert np.median(off) < 1
    assert off.max() < 3.5  # facets of 0.2 mm are turned by up to 2.2° against the sphere


def test_depth_in_a_box_is_exact_but_at_ridges(tmp_path: Path) -> None:
    size = np.array([6.0, 5.0, 4.0])
    box = frame(tmp_path, meshes.box((6.0, 5.0, 4.0), (10.0, -20.0, 3.0)))
    places = np.random.default_rng(0).uniform(0, 1, (5000, 3)) * size
    to_faces = np.sort(np.minimum(places, size - places), axis=1)
    found = depth_of(box, places + np.array([10, -20, 3]), grid_mm=0.1)
    off = np.abs(found - to_faces[:, 0])
    assert off.max() < 0.1 / 2
    ridge = to_faces[:, 1] - to_faces[:, 0] < 0.2
    assert off[~ridge].max() < 1e-6
    default = depth_of(box, places[:1000] + np.array([10, -20, 3]))
    assert np.abs(default - to_faces[:1000, 0]).max() < 0.06 / 2


def test_depth_on_the_skin_is_none(tmp_path: Path) -> None:
    """Whatever the spacing, also where skin lies between nodes."""
    solid = meshes.torus(4.0, 1.5)
    torus = frame(tmp_path, solid)
    centres = solid[0][solid[1]].mean(axis=1)
    for grid in (0.17, 0.25):
        assert depth_of(torus, centres, 1.5, grid_mm=grid).max() < grid**2 / 1.5
    cube = frame(tmp_path, meshes.box((4.0, 4.0, 4.0)))
    below = np.array([[2.0, 2.0, 4.0 - d] for d in (0.0, 0.01, 0.03, 0.3)])
    np.testing.assert_allclose(depth_of(cube, below, grid_mm=0.7), [0, 0.01, 0.03, 0.3], atol=1e-6)


def test_depth_in_a_torus(tmp_path: Path) -> None:
    shape = meshes.from_trimesh(trimesh.creation.torus(4.0, 1.5, major_sections=96, minor_sections=48))
    torus = frame(tmp_path, shape)
    random = np.random.default_rng(0)
    around, turn, r = (
        random.uniform(0, 2 * np.pi, 2000),
        random.uniform(0, 2 * np.pi, 2000),
        random.uniform(0.3, 1.4, 2000),
    )
    out = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    way = out * np.cos(turn)[:, None] + np.array([0, 0, 1]) * np.sin(turn)[:, None]
    places = 4 * out + r[:, None] * way
    assert np.abs(depth_of(torus, places, grid_mm=0.2) - (1.5 - r)).max() < 0.03
    off = off_line_deg(normals_of(torus, places, grid_mm=0.2), way)
    assert np.median(off) < 2
    assert off.max() < 5.5  # facets are turned by up to 3.75° against the torus


def test_a_cavity_is_a_surface_too(tmp_path: Path) -> None:
    hollow = meshes.joined(meshes.box((8.0, 8.0, 8.0), (-4.0, -4.0, -4.0)), meshes.turned(meshes.sphere(2.0, 3)))
    cube = frame(tmp_path, hollow)
    places = np.random.default_rng(0).uniform(-4, 4, (4000, 3))
    r = np.linalg.norm(places, axis=1)
    places, r = places[r > 2], r[r > 2]
    expected = np.minimum(4 - np.abs(places).max(axis=1), r - 2)
    found = depth_of(cube, places, grid_mm=0.25)
    assert np.abs(found - expected).max() < 0.25 / 2
    assert np.median(np.abs(found - expected)) < 0.01


def test_values_by_depth_end_at_the_depth(tmp_path: Path) -> None:
    cube = frame(tmp_path, meshes.box((6.0, 6.0, 6.0)))
    field = open_field(source({"from": 0.2, "to": 0.8, "depth": 2.0}, grid_mm=0.35), cube, NOTHING)
    z = np.array([-1.0, 0.0, 0.5, 1.0, 1.9, 2.0, 2.01, 2.5, 3.0])
    middle = np.full(len(z), 3.0)
    np.testing.assert_allclose(
        field.scalar(middle, middle, z), [0.2, 0.2, 0.35, 0.5, 0.77, 0.8, 0.8, 0.8, 0.8], atol=1e-6
    )
    assert field.scalar(middle, middle, z)[-1] == 0.8
    assert field.bounds == (0.2, 0.8)
    assert field.varies == (True, True, True)


def test_a_raster_has_the_values_of_its_points(tmp_path: Path) -> None:
    field = open_field(source({"from": 0, "to": 1, "depth": 1}), frame(tmp_path, meshes.sphere(2.0, 2)), NOTHING)
    x, y = np.linspace(0, 4, 13)[None, :], np.linspace(0, 4, 11)[:, None]
    raster = field.scalar(x, y, np.asarray(1.7))
    column = np.broadcast_to(x, raster.shape).ravel(), np.broadcast_to(y, raster.shape).ravel()
    np.testing.assert_allclose(raster.ravel(), field.scalar(*column, np.full(raster.size, 1.7)), rtol=0, atol=1e-14)


def test_faces_above_below_and_beside(tmp_path: Path) -> None:
    cube = frame(tmp_path, meshes.box((4.0, 4.0, 4.0), (1.0, 1.0, 1.0)))
    places = np.random.default_rng(0).uniform(0, 4, (1000, 3))
    x, y, z = places.T
    sides = np.minimum(np.minimum(x, 4 - x), np.minimum(y, 4 - y))
    for faces, expected in (
        ("top", 4 - z),
        ("bottom", z),
        ("sides", sides),
        ("all", np.minimum(sides, np.minimum(z, 4 - z))),
    ):
        found = depth_of(cube, places + 1, from_faces=faces, grid_mm=0.1)
        assert np.abs(found - expected).max() < 0.05, faces
        assert np.median(np.abs(found - expected)) < 1e-6, faces
    flat = open_field(source({"from": 0, "to": 1, "depth": 2.0}, from_faces="top", grid_mm=0.3), cube, NOTHING)
    skin = np.array([[0.0, 2.0, 1.0], [4.0, 2.0, 3.0], [2.0, 0.0, 3.5], [2.0, 2.0, 4.0]])  # three on the sides
    np.testing.assert_allclose(flat.scalar(*skin.T), [1.0, 0.5, 0.25, 0.0], atol=0.01)


def test_touching_bodies_are_one_part_or_two_bodies(tmp_path: Path) -> None:
    two = meshes.joined(meshes.box((4.0, 4.0, 2.0)), meshes.box((4.0, 4.0, 2.0), (0.0, 0.0, 2.0)))
    stack = frame(tmp_path, two)
    places = np.array([[2.0, 2.0, 2.0], [2.0, 2.0, 1.0], [2.0, 2.0, 3.5]])
    np.testing.assert_allclose(depth_of(stack, places, grid_mm=0.1), [2, 1, 0.5], atol=1e-6)
    np.testing.assert_allclose(depth_of(stack, places, grid_mm=0.1, per="body"), [0, 1, 0.5], atol=1e-6)


def test_an_angle_by_depth_is_a_plain_number(tmp_path: Path) -> None:
    cube = frame(tmp_path, meshes.box((6.0, 6.0, 6.0)))
    turning = open_orientation(source({"from": 1, "to": 179, "depth": 2}), cube, NOTHING)
    at = np.full(3, 3.0)
    found = turning.normals(at, at, np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(np.rad2deg(np.arctan2(found[:, 1], found[:, 0])), [1, 90, 179], atol=1e-4)


def test_a_shifted_part_takes_its_field_along(tmp_path: Path) -> None:
    places = in_ball(500, 2.0)
    here = depth_of(frame(tmp_path, meshes.sphere(2.0, 2)), places, grid_mm=0.2)
    there = depth_of(
        frame(tmp_path, meshes.moved(meshes.sphere(2.0, 2), (64.0, -32.0, 16.0))),
        places + np.array([64, -32, 16]),
        grid_mm=0.2,
    )
    np.testing.assert_allclose(here, there, atol=1e-6)


def painted(folder: Path, settings: dict[str, Any]) -> Painted:
    wedge = parts.stl(folder, meshes.random_boolean(3))
    ratio = {"distance": {"from": 0.1, "to": 0.9, "depth": 1.0}, "grid_mm": 0.2}
    job = parts.job(
        wedge, ratio=ratio, orientation={"distance": "normal", "grid_mm": 0.2}, settings=settings, dimensions=3
    )
    return prepare(job).painted


def test_a_turned_and_scaled_part_takes_its_field_along(tmp_path: Path) -> None:
    plain = painted(tmp_path, {})
    turned = painted(tmp_path, {"rotate": [20, 40, 75], "scale": 1.5})
    points = np.random.default_rng(0).uniform(0, 1, (500, 3)) * plain.placement.size_mm
    field = plain.placement.to_field(*points.T)
    there = np.stack(turned.placement.to_pattern(*field), axis=1)
    first, again = plain.ratios[0], turned.ratios[0]
    assert first is not None
    assert again is not None
    np.testing.assert_allclose(first.scalar(*field), again.scalar(*turned.placement.to_field(*there.T)), atol=1e-6)
    expected = turned.placement.turn(plain.normals(points))
    assert np.median(off_line_deg(turned.normals(there), expected)) < 1e-3


def test_a_cube_is_filled_from_its_skin(tmp_path: Path) -> None:
    """From none of the first material at the skin to nothing else in a core of 4 mm, at the middle layer."""
    cube = parts.box(tmp_path, (6.0, 6.0, 6.0))
    ratio = {"distance": {"from": 0, "to": 1, "depth": 1.0}}
    grid = prepare(parts.job(cube, ratio=ratio, printer={"pitch_um": 100, "layer_um": 100}))
    middle = grid.painted.ratio_map(grid.grid, 30)[0]
    x, y = grid.grid.x_mm()[None, :], grid.grid.y_mm()[:, None]
    depth = np.minimum(np.minimum(x, 6 - x), np.minimum(y, 6 - y))
    assert np.abs(middle - np.clip(depth, 0, 1)).max() < 0.05
    assert np.median(np.abs(middle - np.clip(depth, 0, 1))) < 1e-6


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"distance": {"from": 0, "to": 1, "depth": 0}}, "greater than 0"),
        ({"distance": {"from": 0, "to": 1}}, "depth"),
        ({"distance": {"from": 0, "to": float("nan"), "depth": 1}}, "finite"),
        ({"distance": "skin"}, "normal"),
        ({"distance": "normal", "from_faces": "left"}, "top"),
        ({"distance": "normal", "grid_mm": -1}, "greater than 0"),
        ({"distance": "normal", "body": 1}, "body"),
    ],
)
def test_wrong_settings(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        DistanceSource.model_validate(wrong)


def test_refusals(tmp_path: Path) -> None:
    cube = frame(tmp_path, meshes.octahedron())
    with pytest.raises(JobError, match="makes directions, and numbers are asked for"):
        open_field(source("normal"), cube, NOTHING)
    with pytest.raises(JobError, match=r"part\.ply has no top faces"):
        open_field(source({"from": 0, "to": 1, "depth": 1}, from_faces="top"), cube, NOTHING)
    with pytest.raises(JobError, match="needs the part's mesh"):
        open_field(source({"from": 0, "to": 1, "depth": 1}), Frame(np.zeros(3), np.ones(3)), NOTHING)


@pytest.mark.parametrize("grid_mm", [1e-300, 5e-324, 1e-3])
def test_too_many_nodes_are_refused(tmp_path: Path, grid_mm: float) -> None:
    cube = frame(tmp_path, meshes.octahedron())
    for opening, what in ((open_field, {"from": 0, "to": 1, "depth": 1}), (open_orientation, "normal")):
        with pytest.raises(JobError, match=r"a field by distance with grid_mm: .* nodes over the part") as caught:
            opening(source(what, grid_mm=grid_mm), cube, NOTHING)
        assert "try grid_mm" in str(caught.value.hint)
