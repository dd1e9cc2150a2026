"""Fields by scattered points: thin plates, nearest and linear, as numbers and as lines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.interpolate import RBFInterpolator

from amslicer import JobError
from amslicer.fields import FieldSpec, Frame, Inputs, open_field, open_orientation
from amslicer.fields.scattered import LocalThinPlates, interpolate

Floats = NDArray[np.float64]

MINIMUM, SIZE = np.array([10.0, -5.0, 3.0]), np.array([20.0, 14.0, 9.0])
FRAME = Frame(MINIMUM, SIZE)
ASKED = np.random.default_rng(1).uniform(0, 1, (400, 3)) * SIZE
SLOPE = np.array([0.02, -0.01, 0.03])


def opened(points: Any, frame: Frame = FRAME, content: str = "", direction: bool = False, **keys: Any) -> Any:
    source: Any = TypeAdapter(FieldSpec).validate_python({"points": points, **keys})
    inputs = Inputs(Path("nowhere"), {"p.csv": content.encode()})
    return (open_orientation if direction else open_field)(source, frame, inputs)


def values(field: Any, asked: Floats = ASKED) -> Floats:
    return np.broadcast_to(field.scalar(*asked.T), len(asked))


def degrees(field: Any, asked: Floats = ASKED) -> Floats:
    normals = field.normals(*asked.T)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    return np.rad2deg(np.arctan2(normals[:, 1], normals[:, 0])) % 180


def apart(a: Any, b: Any) -> Floats:
    """Degrees between lines."""
    return np.abs((np.asarray(a) - b + 90) % 180 - 90)


def scattered(count: int, seed: int = 0) -> Floats:
    """(N, 3) file coordinates, over the part and a little beyond."""
    return MINIMUM + np.random.default_rng(seed).uniform(-0.1, 1.1, (count, 3)) * SIZE


def linear(file_places: Floats) -> Floats:
    return 0.4 + file_places @ SLOPE


@pytest.mark.parametrize("count", [4, 30, 1500])
@pytest.mark.parametrize("method", ["thin-plate", "linear"])
def test_linear_functions_are_reproduced(count: int, method: str) -> None:
    places = scattered(count)
    function, _ = interpolate(places, linear(places)[:, None], method)
    asked = MINIMUM + ASKED
    if method == "linear":  # within the hull
        asked = places.mean(axis=0) + 0.3 * (places[:40] - places.mean(axis=0))
    np.testing.assert_allclose(function(asked)[:, 0], linear(asked), rtol=0, atol=1e-9)
    if method == "thin-plate":
        field = opened(np.column_stack([places, linear(places)]).tolist(), grid_mm=1.5)
        np.testing.assert_allclose(values(field), linear(MINIMUM + ASKED), rtol=0, atol=2e-7)  # single precision
        assert field.bounds[0] <= values(field).min() <= values(field).max() <= field.bounds[1]


@pytest.mark.parametrize("method", ["thin-plate", "linear"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 50, 1300])
def test_it_goes_through_the_points(count: int, method: str) -> None:
    places, given = scattered(count), np.random.default_rng(9).uniform(size=(count, 2))
    function, _ = interpolate(places, given, method)
    np.testing.assert_allclose(function(places), given, rtol=0, atol=1e-7)


def test_many_points_by_neighbours_are_scipys() -> None:
    places, given = scattered(1200), np.random.default_rng(9).uniform(size=(1200, 1))
    for smoothing in (0.0, 0.3):
        found = LocalThinPlates(places, given, smoothing, 20).at(MINIMUM + ASKED)
        expected = RBFInterpolator(places, given, neighbors=20, smoothing=smoothing)(MINIMUM + ASKED)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_neighbours_on_a_face_are_no_trouble() -> None:
    """Points on a box's surface: all neighbours of one lie on a plane."""
    places = scattered(2000)
    axis = np.arange(2000) % 3
    places[np.arange(2000), axis] = (MINIMUM + SIZE)[axis]
    field = opened(np.column_stack([places, linear(places)]).tolist(), grid_mm=2.0)
    at = places - MINIMUM
    at = at[np.all((at >= 0) & (at <= SIZE), axis=1)]
    assert np.abs(values(field, at) - linear(at + MINIMUM)).max() < 0.1


def test_a_field_that_is_fine_is_near_what_it_stands_for() -> None:
    places = scattered(600)
    truth = lambda p: 0.5 + 0.3 * np.sin(p[:, 0] / 5) * np.cos(p[:, 1] / 6)  # noqa: E731
    field = opened(np.column_stack([places, truth(places)]).tolist())
    error = np.abs(values(field) - truth(MINIMUM + ASKED)).max()
    print(f"thin plate of 600 points: off by up to {error:.4f}")
    assert error < 0.03


@pytest.mark.parametrize("flat", [True, False])
def test_nearest_is_brute_force(flat: bool) -> None:
    places, given = scattered(150), np.arange(150.0)
    rows = np.column_stack([places[:, : 2 if flat else 3], given])
    field = opened(rows.tolist(), method="nearest")
    axes = 2 if flat else 3
    squares = (((MINIMUM + ASKED)[:, None, :axes] - places[None, :, :axes]) ** 2).sum(axis=2)
    np.testing.assert_array_equal(values(field), given[squares.argmin(axis=1)])
    assert field.varies == (True, True, not flat)
    assert field.bounds == (0, 149)
    x, y = np.linspace(0, 20, 7)[None, :], np.linspace(0, 14, 5)[:, None]
    raster = field.scalar(x, y, np.asarray(1.0))
    grid = np.stack([c.ravel() for c in np.broadcast_arrays(x, y, 1.0)], axis=1)
    np.testing.assert_array_equal(raster.ravel(), values(field, grid))


def test_of_points_as_near_the_first_is_taken() -> None:
    for order in ([0, 1, 2, 3], [3, 1, 0, 2]):
        rows = np.array([[9, -6, 0.1], [11, -6, 0.2], [9, -4, 0.3], [11, -4, 0.4]])[order]
        field = opened(rows.tolist(), Frame(np.array([10.0, -5, 3]), SIZE), method="nearest")
        assert values(field, np.zeros((1, 3)))[0] == rows[0, 2]


@pytest.mark.parametrize(
    ("rows", "varies"),
    [
        ([[10, -5, 5, 0.2], [30, -5, 5, 0.8]], (True, False, False)),
        ([[10, -5, 5, 0.2], [30, -5, 5, 0.8], [20, -5, 5, 0.5]], (True, False, False)),
        ([[10, -5, 0.2], [30, -5, 0.8], [10, 9, 0.2]], (True, True, False)),
        ([[10, -5, 3, 0.2], [30, -5, 3, 0.8], [10, 9, 3, 0.2], [30, 9, 3, 0.8]], (True, True, False)),
    ],
)
@pytest.mark.parametrize("method", ["thin-plate", "linear"])
def test_few_points_and_flat_ones(rows: Any, varies: Any, method: str) -> None:
    """They have one plane through them: a gradient along x."""
    field = opened(rows, method=method)
    assert field.varies == varies
    inside = ASKED[ASKED[:, 0] / 20 + ASKED[:, 1] / 14 < 0.9] if len(rows) == 3 else ASKED  # of three, a triangle
    np.testing.assert_allclose(values(field, inside), 0.2 + 0.6 * inside[:, 0] / 20, rtol=0, atol=1e-6)


def test_outside_its_points_a_linear_field_is_as_at_their_hull() -> None:
    rows = [[15, 0, 0.2], [25, 0, 0.8], [15, 5, 0.2], [25, 5, 0.8]]
    field = opened(rows, method="linear", grid_mm=0.25)
    assert field.bounds == (0.2, 0.8)
    at = np.array([[0, 7.5, 0], [5, 7.5, 0], [10, 7.5, 0], [10, 13, 1], [15, 7.5, 0], [20, 7.5, 2]])
    np.testing.assert_allclose(values(field, at), [0.2, 0.2, 0.5, 0.5, 0.8, 0.8], atol=1e-6)


@pytest.mark.parametrize("method", ["thin-plate", "linear", "nearest"])
@pytest.mark.parametrize("count", [1, 2, 60])
def test_a_constant_is_a_constant(method: str, count: int) -> None:
    rows = np.column_stack([scattered(count), np.full(count, 0.3)]).tolist()
    field = opened(rows, method=method)
    assert field.bounds == (0.3, 0.3)
    assert field.varies == (False, False, False)
    assert np.all(values(field) == 0.3)
    lines = opened(rows, method=method, direction=True)
    np.testing.assert_array_equal(
        lines.normals(*ASKED.T), open_orientation(0.3, FRAME, Inputs(Path())).normals(*ASKED.T)
    )


def test_bounds_are_true_and_within_makes_them() -> None:
    rows = [[10, -5, 0], [14, -5, 1], [18, -5, 0], [22, -4, 1], [10, 9, 0], [30, 9, 1]]
    field = opened(rows)
    assert field.bounds[0] < 0 < 1 < field.bounds[1]  # it overshoots
    assert field.bounds[0] <= values(field).min() <= values(field).max() <= field.bounds[1]
    clipped = opened(rows, within=[0, 1])
    assert clipped.bounds == (0, 1)
    np.testing.assert_allclose(values(clipped), np.clip(values(field), 0, 1), atol=1e-12)
    smooth = opened(rows, smoothing=1e6)
    assert np.ptp(smooth.bounds) < np.ptp(field.bounds)


@pytest.mark.parametrize("method", ["thin-plate", "linear", "nearest"])
def test_lines_next_to_0_do_not_average_to_90(method: str) -> None:
    for columns, ends in (("angle", (1, 179)), ("value", (1, 179)), ("azimuth,elevation", ("1,0", "179,0"))):
        content = f"x,y,{columns}\n10,-5,{ends[0]}\n30,-5,{ends[1]}\n10,9,{ends[0]}\n30,9,{ends[1]}\n"
        found = degrees(opened("p.csv", content=content, direction=True, method=method))
        assert apart(found, 0).max() < 1.2
    middle = np.array([[10.0, 7, 1]])
    if method != "nearest":
        assert apart(degrees(opened("p.csv", content=content, direction=True, method=method), middle), 0)[0] < 0.01


def test_a_normals_length_and_sign_do_not_matter() -> None:
    content = "x,y,z,nx,ny,nz\n10,-5,3,0,1,1\n30,9,12,0,-3,-3\n30,-5,3,0,2,2\n10,9,5,0,1,1\n"
    found = opened("p.csv", content=content, direction=True).normals(*ASKED.T)
    np.testing.assert_allclose(np.abs(found @ [0, 1, 1]) / np.sqrt(2), 1, atol=1e-12)


@pytest.mark.parametrize("method", ["thin-plate", "linear"])
def test_a_turning_direction_is_followed(method: str) -> None:
    """θ = 9° per mm along x, over a whole turn of lines: 180° in 20 mm."""
    x = np.repeat(np.linspace(10, 30, 21), 5)
    y = np.tile(np.linspace(-5, 9, 5), 21)
    rows = np.column_stack([x, y, (9 * (x - 10)) % 180])
    found = degrees(opened(rows.tolist(), direction=True, method=method))
    off = apart(found, 9 * ASKED[:, 0]).max()
    print(f"{method}: off by up to {off:.2f}°")
    assert off < 4


def test_it_follows_the_part_in_its_file() -> None:
    places, shift = scattered(40), np.array([100.0, -250.0, 40.0])
    for method in ("thin-plate", "linear", "nearest"):
        here = opened(np.column_stack([places, np.arange(40.0)]).tolist(), method=method)
        there = opened(
            np.column_stack([places + shift, np.arange(40.0)]).tolist(), Frame(MINIMUM + shift, SIZE), method=method
        )
        np.testing.assert_allclose(values(there), values(here), rtol=0, atol=1e-4)


def test_it_is_turned_and_scaled_with_the_part(tmp_path: Path) -> None:
    """Half of a cube is the first material; wherever it is turned, the half goes with it."""
    printer = {"pitch_um": 100, "layer_um": 500}
    rows = [[1.5, 3, 1], [4.5, 3, 0]]  # x < 3
    for turn, scale, half in ((0, 1, np.s_[:, :30]), (90, 1, np.s_[30:, :]), (0, 2, np.s_[:, :60])):
        part = parts.stl(tmp_path, meshes.box((6.0, 6.0, 0.5)))
        settings = {"rotate": [0, 0, turn], "scale": scale}
        ratio = {"points": rows, "method": "nearest"}
        bitmap = parts.bitmap(parts.job(part, ratio=ratio, printer=printer, settings=settings))
        expected = np.full(bitmap.shape, 2)
        expected[half] = 1
        np.testing.assert_array_equal(bitmap, expected)


def test_equal_points_are_merged_and_others_refused() -> None:
    field = opened([[10, -5, 0.1], [10, -5, 0.1], [30, -5, 0.5]])
    assert values(field, np.zeros((1, 3)))[0] == pytest.approx(0.1)
    with pytest.raises(JobError, match=r"two values at the same place .x = 1, y = 2 mm.: points 1 and 3"):
        opened([[1, 2, 0.1], [1, 3, 0.1], [1, 2, 0.2]])
    content = "x,y,z,value\n# again\n1,2,3,0.1\n1,2,3,0.2\n"
    with pytest.raises(JobError, match=r"'p.csv' has two values at the same place .*: lines 3 and 4"):
        opened("p.csv", content=content)
    same_line = "x,y,angle\n1,2,0\n1,2,180\n5,5,0\n"
    assert apart(degrees(opened("p.csv", content=same_line, direction=True)), 0).max() < 1e-6


@pytest.mark.parametrize(
    ("content", "direction", "said"),
    [
        ("x,y,angle\n1,2,3\n", False, "no column 'value'"),
        ("x,z,value\n1,2,3\n", False, "no column 'y'"),
        ("x,y,angle,nx,ny,nz\n1,2,3,1,0,0\n", True, "directions twice: by angle and by nx, ny, nz"),
        ("x,y,nx,ny\n1,2,3,1\n", True, "no column 'nz'"),
        ("x,y\n1,2\n", True, "no column 'value'"),
        ("x,y,temperature\n1,2,3\n", False, "unknown column 'temperature'"),
    ],
)
def test_tables_that_are_refused(content: str, direction: bool, said: str) -> None:
    with pytest.raises(JobError, match=said) as caught:
        opened("p.csv", content=content, direction=direction)
    assert caught.value.hint


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"points": []}, "at least 1"),
        ({"points": ""}, "at least 1"),
        ({"points": [[1, 2]]}, "at least 3"),
        ({"points": [[1, 2, 3, 4, 5]]}, "at most 4"),
        ({"points": [[1, 2, 3], [1, 2, 3, 4]]}, "point 2 has 4 numbers, and the first one 3"),
        ({"points": [[1, 2, float("nan")]]}, "finite"),
        ({"points": [[1, 2, "3"]]}, "number"),
        ({"points": [[1e7, 2, 3]]}, "point 1: x is 1e.07 mm"),
        ({"method": "cubic"}, "thin-plate"),
        ({"smoothing": -1}, "greater"),
        ({"neighbors": 2}, "greater"),
        ({"neighbors": 41}, "less than or equal to 40"),
        ({"neighbors": 20, "method": "linear"}, "neighbors goes with"),
        ({"grid_mm": 1.0, "method": "nearest"}, "grid_mm goes with"),
        ({"grid_mm": 0}, "greater"),
        ({"within": [1, 0]}, "low <= high"),
    ],
)
def test_settings_that_are_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        TypeAdapter(FieldSpec).validate_python({"points": [[1, 2, 3]], **keys})


@pytest.mark.parametrize("grid_mm", [1e-300, 5e-324])
def test_nodes_beyond_all_numbers_are_refused(grid_mm: float) -> None:
    with pytest.raises(JobError, match="nodes over the part; at most 20000000"):
        opened([[1, 2, 3, 4], [2, 2, 3, 5], [1, 3, 3, 6], [1, 2, 9, 7]], grid_mm=grid_mm)


def test_other_refusals() -> None:
    with pytest.raises(JobError, match="at most 20000000"):
        opened([[1, 2, 3, 4], [2, 2, 3, 5], [1, 3, 3, 6], [1, 2, 9, 7]], grid_mm=1e-3)
    with pytest.raises(JobError, match=r"within: .* that is a direction"):
        opened([[1, 2, 3], [2, 2, 4]], direction=True, within=[0, 1])


def test_more_neighbours_make_fewer_nodes() -> None:
    """A value among 40 takes twice as long as among 24."""
    random = np.random.default_rng(0).uniform(0, 10, (30_000, 4)).round(3).tolist()

    def nodes(neighbors: int | None) -> float:
        field: Any = opened(random, **({} if neighbors is None else {"neighbors": neighbors}))
        return float(np.prod(field.nodes.shape))

    assert nodes(40) < 0.5 * nodes(24)
    assert nodes(24) == nodes(None) == nodes(8)


def test_its_file_is_named_and_can_be_renamed() -> None:
    source: Any = TypeAdapter(FieldSpec).validate_python({"points": "a/p.csv", "method": "nearest"})
    assert source.paths() == ("a/p.csv",)
    assert source.with_paths({"a/p.csv": "1.csv"}).points == "1.csv"
    inline: Any = TypeAdapter(FieldSpec).validate_python({"points": [[1, 2, 3]]})
    assert inline.paths() == ()
    assert inline.with_paths({"a": "b"}) is inline
