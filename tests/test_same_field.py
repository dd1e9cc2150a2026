"""One field, written in every way that it can be: the same stack; and each way follows the part, or the bed if asked.

What they are compared with is an expression; all other sources are data that was made from the same formula.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshes
import meshio
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from PIL import Image

import amslicer
from amslicer import analysis
from amslicer.fields import SOURCES
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]

PRINTER = {"pitch_um": 83, "layer_um": 83}
WIDTH, DEPTH, HEIGHT = 12.0, 6.0, 2.0
LOW, HIGH = 0.2, 0.7  # of the ratio, from the left to the right
RAMP = f"{LOW} + {HIGH - LOW}*u"
SHARE = 1e-3  # of the pixels may differ


def grid_box() -> tuple[Floats, NDArray[np.int64]]:
    """A box of the part's size whose sides have vertices every half millimetre along x."""
    xs = np.linspace(0, WIDTH, 25)
    ring = np.array([[0, 0], [DEPTH, 0], [DEPTH, HEIGHT], [0, HEIGHT]])
    vertices = np.array([[x, y, z] for x in xs for y, z in ring])
    faces = []
    for i in range(len(xs) - 1):
        for k in range(4):
            a, b = 4 * i + k, 4 * i + (k + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    n = 4 * (len(xs) - 1)
    faces += [[0, 2, 1], [0, 3, 2], [n, n + 1, n + 2], [n, n + 2, n + 3]]
    turned = np.array(faces)[:, ::-1]
    return vertices, turned


def write_part(folder: Path, **properties: Floats) -> Path:
    """The box as PLY, with properties of its vertices."""
    vertices, faces = grid_box()
    names = list(properties)
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property float {a}" for a in "xyz")]
    head += [f"property float {name}" for name in names]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = np.column_stack([vertices, *(properties[name] for name in names)])
    lines = [" ".join(f"{v:.9g}" for v in row) for row in rows] + [f"3 {a} {b} {c}" for a, b, c in faces]
    path = folder / "part.ply"
    path.write_text("\n".join([*head, *lines]) + "\n")
    return path


def u(points: Floats) -> Floats:
    return points[:, 0] / WIDTH


def results(folder: Path, **arrays: Callable[[Floats], Floats]) -> str:
    """A mesh of tetrahedra over the part, with arrays at its points."""
    x, y, z = (np.linspace(0, side, n) for side, n in ((WIDTH, 49), (DEPTH, 3), (HEIGHT, 2)))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(49, 3, 2)
    corner = [number[i : i + 48, j : j + 2, k : k + 1].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    a, b, c, d, e, f, g, h = corner
    cells = np.concatenate([np.column_stack(t) for t in ((a, c, g, h), (a, g, e, h), (a, e, f, h), (a, f, b, h),
                                                         (a, b, d, h), (a, d, c, h))])  # fmt: skip
    data = {name: function(points) for name, function in arrays.items()}
    meshio.Mesh(points, [("tetra", cells)], point_data=data).write(folder / "results.vtu")
    return "results.vtu"


# Ratio: from LOW to HIGH along x


def ratio(points: Floats) -> Floats:
    return LOW + (HIGH - LOW) * u(points)


def an_image(folder: Path) -> Any:
    """Texel centres at both ends of the part: bilinear is linear between them."""
    Image.fromarray(np.array([[0, 65535]] * 2, np.uint16)).save(folder / "ramp.png")
    return {"image": "ramp.png", "range": [LOW, HIGH], "box": [-WIDTH / 2, 0, 1.5 * WIDTH, DEPTH]}


def a_stack(folder: Path) -> Any:
    Image.fromarray(np.array([[0, 65535]], np.uint16)).save(folder / "low.png")
    Image.fromarray(np.array([[0, 65535]] * 3, np.uint16)).save(folder / "high.png")
    return {"stack": {"0": "low.png", "2": "high.png"}, "range": [LOW, HIGH], "box": [-WIDTH / 2, 0, 1.5 * WIDTH, 6]}


def a_volume(folder: Path) -> Any:
    np.save(folder / "ramp.npy", np.linspace(LOW, HIGH, 7)[None, None].repeat(2, axis=0))
    step = WIDTH / 6
    return {"volume": "ramp.npy", "box": [-step / 2, 0, 0, WIDTH + step / 2, DEPTH, HEIGHT]}


def a_nrrd(folder: Path) -> Any:
    import nrrd

    samples = np.linspace(LOW, HIGH, 7)[:, None, None].repeat(2, axis=1).repeat(2, axis=2)  # x, y, z
    header = {"space dimension": 3, "space directions": np.diag([WIDTH / 6, DEPTH, HEIGHT]), "space origin": [0, 0, 0]}
    nrrd.write(str(folder / "ramp.nrrd"), samples, header)
    return {"volume": "ramp.nrrd"}


def points(folder: Path) -> Any:
    rows = [(x, y, z, float(ratio(np.array([[x, y, z]]))[0])) for x in (0, 5, 12) for y in (0, 6) for z in (0, 2)]
    (folder / "p.csv").write_text("x,y,z,value\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    return {"points": "p.csv"}


def a_stroke(folder: Path) -> Any:
    """A brush as wide as the part, its colour changing along its way."""
    path = [[0, DEPTH / 2], [WIDTH, DEPTH / 2]]
    return {"strokes": [{"path": path, "radius": 20, "falloff": 0.1, "value": [LOW, HIGH]}], "base": 0}


RATIOS: dict[str, Callable[[Path], Any]] = {
    "gradient": lambda folder: {"gradient": {"axis": "x", "from": LOW, "to": HIGH}},
    "expression": lambda folder: {"expression": f"{LOW} + {HIGH - LOW}*x/{WIDTH}"},
    "image": an_image,
    "stack": a_stack,
    "volume": a_volume,
    "nrrd": a_nrrd,
    "points": points,
    "strokes": a_stroke,
    "vertex": lambda folder: {"vertex": "share"},
    "mesh_data": lambda folder: {
        "mesh_data": results(folder, share=ratio), "array": "share", "data": [0, 1], "range": [0, 1]
    },
    "mix": lambda folder: {"mix": {"a": LOW, "b": HIGH, "by": {"expression": "u"}}},
    "remap": lambda folder: {"remap": {"field": {"expression": "u"}, "curve": [[0, LOW], [1, HIGH]]}},
    "clip": lambda folder: {"clip": {"field": {"expression": RAMP}, "from": 0, "to": 1}},
    "where": lambda folder: {
        "where": {"mask": {"expression": "v"}, "then": an_image(folder), "else": {"expression": RAMP}}
    },
    "per_body": lambda folder: {"per_body": {"1": {"gradient": {"axis": "x", "from": LOW, "to": HIGH}}}},
    "blur": lambda folder: {"blur": {"field": {"clip": {"field": {"expression": RAMP}}}, "mm": 0.05}},
    "bed": lambda folder: {"gradient": {"axis": "x", "from": LOW, "to": HIGH}, "frame": "bed"},
}  # fmt: skip


def stack_of(folder: Path, **keys: Any) -> NDArray[np.uint8]:
    vertices, _ = grid_box()
    part = write_part(folder, share=ratio(vertices), **directions_of(vertices))
    return parts.labels(parts.job(part, printer=PRINTER, dimensions=3, period=0.8, **keys))


@pytest.fixture(scope="module")
def painted_ratio(tmp_path_factory: pytest.TempPathFactory) -> NDArray[np.uint8]:
    folder = tmp_path_factory.mktemp("ratio")
    return stack_of(folder, ratio=RATIOS["expression"](folder), orientation=30)


@pytest.mark.parametrize("way", RATIOS)
def test_a_ratio_gives_the_same_stack(tmp_path: Path, way: str, painted_ratio: NDArray[np.uint8]) -> None:
    found = stack_of(tmp_path, ratio=RATIOS[way](tmp_path), orientation=30)
    differ = np.count_nonzero(found != painted_ratio) / np.count_nonzero(painted_ratio)
    print(f"ratio by {way}: {100 * differ:.4f} % of the pixels differ")
    assert np.array_equal(found > 0, painted_ratio > 0)
    assert differ <= SHARE


def test_the_comparison_can_fail(tmp_path: Path, painted_ratio: NDArray[np.uint8]) -> None:
    other = stack_of(tmp_path, ratio={"expression": f"{LOW} + {HIGH - LOW}*u + 0.005"}, orientation=30)
    assert np.count_nonzero(other != painted_ratio) > 2 * SHARE * np.count_nonzero(painted_ratio)


CONSTANTS: dict[str, Callable[[Path], Any]] = {
    "gradient": lambda folder: {"gradient": {"axis": "y", "from": 0.3, "to": 0.3}},
    "expression": lambda folder: {"expression": "0.3"},
    "image": lambda folder: {"image": parts.paint(folder, np.full((3, 4), 77, np.uint8)), "range": [0.3, 0.3]},
    "volume": lambda folder: (np.save(folder / "c.npy", np.full((2, 3, 4), 0.3)), {"volume": "c.npy"})[1],
    "points": lambda folder: {"points": [[0, 0, 0, 0.3], [5, 4, 1, 0.3], [9, 1, 2, 0.3], [3, 3, 3, 0.3]]},
    "strokes": lambda folder: {
        "strokes": [{"path": [[0, 3], [12, 3]], "radius": 20, "falloff": 0.1, "value": 0.3}], "base": 0.3
    },
    "mesh_data": lambda folder: {
        "mesh_data": results(folder, share=lambda p: np.full(len(p), 0.3)), "array": "share", "data": [0, 1],
    },
    "vertex": lambda folder: {"vertex": "steady"},
    "distance": lambda folder: {"distance": {"from": 0.3, "to": 0.3, "depth": 1}},
    "mix": lambda folder: {"mix": {"a": 0.3, "b": 0.3, "by": {"expression": "u"}}},
    "blur": lambda folder: {"blur": {"field": 0.3, "mm": 1}},
    "per_body": lambda folder: {"per_body": {"1": 0.3}},
}  # fmt: skip


@pytest.mark.parametrize("way", CONSTANTS)
def test_a_constant_gives_the_same_stack(tmp_path: Path, way: str) -> None:
    vertices, _ = grid_box()
    part = write_part(tmp_path, steady=np.full(len(vertices), 0.3))
    keys: dict[str, Any] = {"printer": PRINTER, "dimensions": 3, "period": 0.8, "orientation": 30}
    plain, found = (parts.labels(parts.job(part, ratio=r, **keys)) for r in (0.3, CONSTANTS[way](tmp_path)))
    differ = np.count_nonzero(found != plain) / np.count_nonzero(plain)
    print(f"constant by {way}: {100 * differ:.4f} % of the pixels differ")
    assert differ <= SHARE


# Direction: turning by 180° along x


def angle(points: Floats) -> Floats:
    return np.pi * u(points)


def directions_of(vertices: Floats) -> dict[str, Floats]:
    """The same direction as vectors and as colours of the vertices."""
    a = angle(vertices)
    return {"nx": np.cos(a), "ny": np.sin(a), "nz": 0 * a}


def tensor(points: Floats) -> Floats:
    """Tension along the normal: xx, yy, zz, xy, yz, xz."""
    c, s = np.cos(angle(points)), np.sin(angle(points))
    return np.column_stack([c * c, s * s, 0 * c, c * s, 0 * c, 0 * c])


def an_angle_picture(folder: Path) -> Any:
    Image.fromarray(np.array([np.linspace(0, 65535, 97)] * 2).astype(np.uint16)).save(folder / "angle.png")
    step = WIDTH / 96
    return {"image": "angle.png", "range": [0, 180], "box": [-step / 2, 0, WIDTH + step / 2, DEPTH]}


def a_vector_volume(folder: Path, samples: Callable[[Floats], Floats]) -> Any:
    x = np.linspace(0, WIDTH, 97)
    np.save(folder / "n.npy", samples(np.column_stack([x, 0 * x, 0 * x]))[None, None].repeat(2, axis=1))
    step = WIDTH / 96
    return {"volume": "n.npy", "box": [-step / 2, 0, 0, WIDTH + step / 2, DEPTH, HEIGHT]}


def some_points(folder: Path) -> Any:
    rows = [(x, y, float(np.rad2deg(np.pi * x / WIDTH))) for x in np.linspace(0, WIDTH, 33) for y in (0, DEPTH)]
    (folder / "a.csv").write_text("x,y,angle\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    return {"points": "a.csv", "method": "linear"}


DIRECTIONS: dict[str, Callable[[Path], Any]] = {
    "gradient": lambda folder: {"gradient": {"axis": "x", "from": 0, "to": 180}},
    "expression": lambda folder: {"expression": "180*u"},
    "image": an_angle_picture,
    "vector volume": lambda folder: a_vector_volume(folder, lambda p: np.column_stack(list(directions_of(p).values()))),
    "tensor volume": lambda folder: a_vector_volume(folder, tensor),
    "vertex": lambda folder: {"vertex": ["nx", "ny", "nz"], "reads": "vector"},
    "mesh_data": lambda folder: {"mesh_data": results(folder, stress=tensor), "array": "stress", "principal": 1},
    "points": some_points,
    "per_body": lambda folder: {"per_body": {"1": an_angle_picture(folder)}},
    "blur": lambda folder: {"blur": {"field": an_angle_picture(folder), "mm": 0.1}},
}  # fmt: skip


@pytest.mark.parametrize("way", DIRECTIONS)
def test_a_turning_direction_is_printed(tmp_path: Path, way: str) -> None:
    """The middle layer, measured: within 4° of the painted normal, on average and in its median."""
    vertices, _ = grid_box()
    part = write_part(tmp_path, **directions_of(vertices))
    job = parts.job(
        part, printer={"pitch_um": 30, "layer_um": 500}, ratio=0.5, orientation=DIRECTIONS[way](tmp_path), period=0.4,
        alignment=5,
    )  # fmt: skip
    labels = parts.labels(job, 2, 3)[0]
    pitch = (0.03, 0.03)
    found = analysis.directions(analysis.signed(labels), pitch, 0.4)
    x, _ = parts.centres((labels.shape[0], labels.shape[1]), pitch)
    inner = analysis.inner((labels.shape[0], labels.shape[1]), pitch, 0.8)
    error = np.abs((found - 180 * x / WIDTH + 90) % 180 - 90)[inner]
    print(f"direction by {way}: mean {error.mean():.2f}°, median {np.median(error):.2f}°")
    assert np.median(error) < 4
    assert error.mean() < 4


# Frames: the examples, turned and scaled and moved

EXAMPLES = Path(__file__).parents[1] / "configs" / "examples"
PLACED = {"rotate": [90, 0, 90], "scale": 2.0}  # exact: x, y, z of the file are y, z, x of the printer's


def of_example(file: Path, folder: Path, settings: dict[str, Any], shift: float = 0.0) -> Any:
    from test_examples import part_of

    part = part_of(file, folder)
    job = amslicer.load_job(file, part=part, overrides={"part": settings, "pattern.dimensions": 3})
    return prepare(job)


def sources_of(file: Path) -> set[str]:
    text = file.read_text()
    return {name for name in SOURCES if f"{name}:" in text}


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.yaml")), ids=lambda file: file.stem)
def test_every_field_follows_its_part(tmp_path: Path, file: Path) -> None:
    """At the same place of the part there is the same ratio and isotropy, and the normal turned as the part is."""
    if "displacement" in file.read_text():
        pytest.skip("its box is the displaced part's: tests/test_relief.py")
    plain, placed = (of_example(file, tmp_path, settings) for settings in ({}, PLACED))
    share = np.random.default_rng(1).uniform(0.02, 0.98, (400, 3))
    places = share * plain.placement.size_mm
    there = places @ placed.placement.rotation.T * 2 - placed.placement.low_mm
    for a, b in zip(plain.painted.ratios, placed.painted.ratios, strict=True):
        if a is not None:
            assert b is not None
            x, y = (
                np.broadcast_to(s.scalar(*ready.placement.to_field(*p.T)), 400)
                for s, ready, p in ((a, plain, places), (b, placed, there))
            )
            np.testing.assert_allclose(x, y, atol=1e-6)
    np.testing.assert_allclose(plain.painted.isotropies(places), placed.painted.isotropies(there), atol=1e-6)
    before, after = plain.painted.normals(places) @ placed.placement.rotation.T, placed.painted.normals(there)
    assert np.abs((before * after).sum(axis=1)).min() > 1 - 1e-6


def test_every_source_has_an_example() -> None:
    assert set(SOURCES) <= set().union(*(sources_of(file) for file in EXAMPLES.glob("*.yaml"))) | {"gradient", "image"}


def test_in_bed_coordinates_a_field_stays_where_it_is(tmp_path: Path) -> None:
    """Height above the bed, whichever way up the part is printed."""
    part = parts.stl(tmp_path, meshes.box((3.0, 4.0, 6.0), (1.0, 2.0, 3.0)))
    for rotate, height in (([0, 0, 0], 6.0), ([90, 0, 0], 4.0), ([0, 90, 0], 3.0), ([180, 0, 0], 6.0)):
        up = {"gradient": {"axis": "z", "from": 0.1, "to": 0.9}, "frame": "bed"}
        ready = prepare(parts.job(part, ratio=up, settings={"rotate": rotate}, printer=PRINTER, dimensions=3))
        middle = ready.painted.ratio_map(ready.grid, ready.grid.layers // 2)
        z = ready.grid.z_mm(ready.grid.layers // 2) / height
        np.testing.assert_allclose(middle, 0.1 + 0.8 * z, atol=1e-6)
        angle_field = {"expression": "30", "frame": "bed"}
        turned = prepare(parts.job(part, orientation=angle_field, settings={"rotate": rotate}, printer=PRINTER))
        normal = turned.painted.normals(np.ones((1, 3)))[0]
        assert normal @ [np.cos(np.pi / 6), 0.5, 0] == pytest.approx(1)


def test_a_written_job_runs_again_from_its_own_folder(tmp_path: Path) -> None:
    """job.yaml of a stack names its copies of the files."""
    vertices, _ = grid_box()
    part = write_part(tmp_path, share=ratio(vertices))
    field = {"mix": {"a": an_image(tmp_path), "b": a_volume(tmp_path), "by": {"vertex": "share"}}}
    job = parts.job(part, printer=PRINTER, ratio=field, dimensions=3)
    out = tmp_path / "out"
    amslicer.slice_job(job, out, run=amslicer.Run(layers=(3, 5)))
    assert {f.name for f in (out / "inputs").iterdir()} == {"ramp.png", "ramp.npy", "part.ply"}
    moved = tmp_path / "elsewhere"
    out.rename(moved)
    again = amslicer.load_job(moved / "job.yaml", part=moved / "inputs" / "part.ply")
    for a, b in zip(amslicer.layers(again, amslicer.Run(layers=(3, 5))), amslicer.open_stack(moved), strict=True):
        assert np.array_equal(a.labels, b.labels)
    assert amslicer.verify(moved).ok
    assert json.loads((moved / "manifest.json").read_text())["part"]["copy"] == "inputs/part.ply"
