"""Fields painted with a brush: distances, compositing, combed directions."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from amslicer import JobError
from amslicer.fields import FieldSpec, Frame, Inputs, open_field, open_orientation
from amslicer.fields.brush import Brush, Painting

Floats = NDArray[np.float64]

MINIMUM, SIZE = np.array([10.0, -5.0, 3.0]), np.array([20.0, 14.0, 9.0])
FRAME = Frame(MINIMUM, SIZE)
ASKED = np.random.default_rng(1).uniform(0, 1, (3000, 3)) * SIZE
FILE = ASKED + MINIMUM
A, B = np.array([13.0, -2.0, 5.0]), np.array([26.0, 6.0, 9.0])


def opened(strokes: Any, frame: Frame = FRAME, content: str = "", direction: bool = False, **keys: Any) -> Any:
    source: Any = TypeAdapter(FieldSpec).validate_python({"strokes": strokes, **keys})
    inputs = Inputs(Path("nowhere"), {"s.csv": content.encode()})
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


def distance(points: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """To a segment, and where on it."""
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1), t


def share(distance_mm: Floats, radius: float, falloff: float) -> Floats:
    """How much of a stroke, by the definition of smoothstep."""
    if falloff == 0:
        return (distance_mm <= radius).astype(float)
    t = np.clip((radius - distance_mm) / (falloff * radius), 0, 1)
    return 3 * t**2 - 2 * t**3


def brush(places: Any, radius: float, falloff: float, flat: bool = False) -> Brush:
    array = np.array(places, float)
    return Brush("stroke 1", array, flat, np.full(len(array), radius), falloff, None)


@pytest.mark.parametrize("falloff", [0, 0.25, 0.5, "smooth"])
@pytest.mark.parametrize("flat", [True, False])
def test_a_straight_stroke(falloff: Any, flat: bool) -> None:
    axes = 2 if flat else 3
    d, _ = distance(FILE[:, :axes], A[:axes], B[:axes])
    number = 1.0 if falloff == "smooth" else falloff
    expected = 0.2 + 0.7 * share(d, 3.0, number)
    path = np.array([A[:axes], B[:axes]])
    three = np.column_stack([path, np.zeros(2)]) if flat else path
    exact = Painting([brush(three, 3.0, number, flat)], [np.full((2, 1), 0.9)], np.array([0.2])).at(FILE)
    np.testing.assert_allclose(exact[:, 0], expected, rtol=0, atol=1e-12)
    field = opened([{"path": path.tolist(), "radius": 3, "falloff": falloff, "value": 0.9}], base=0.2)
    assert field.varies == (True, True, not flat)
    assert field.bounds == (0.2, 0.9)
    error = np.abs(values(field) - expected)
    print(f"falloff {falloff}: nodes {field.nodes.shape}, off by up to {error.max():.4f}")
    if falloff:  # straight pieces of h = L/4: h²/8 times the smoothstep's largest second derivative, 6/L²
        assert error.max() < 0.7 * 6 / 128
    else:  # its edge is as wide as the nodes are apart
        assert (error > 0.01).mean() < 0.06
        assert values(field)[d < 2.7].min() == pytest.approx(0.9)
        assert values(field)[d > 3.3].max() == pytest.approx(0.2)


def test_values_and_radii_along_the_path() -> None:
    d, t = distance(FILE, A, B)
    inner = d < 1
    field = opened([{"path": [A.tolist(), B.tolist()], "radius": [4, 2], "value": [0.1, 0.9]}], base=0.1)
    np.testing.assert_allclose(values(field)[inner], (0.1 + 0.8 * t)[inner], rtol=0, atol=0.02)
    u = d / (4 - 2 * t)
    expected = 0.1 + 0.8 * t * share(u, 1, 0.5)
    np.testing.assert_allclose(values(field), expected, rtol=0, atol=6 / 128)


def test_later_strokes_are_over_earlier_ones() -> None:
    strokes = [
        {"path": [[10, 2], [30, 2]], "radius": 4, "value": 0.9},
        {"path": [[20, -5], [20, 9]], "radius": 3, "value": 0.1, "falloff": 1},
    ]
    first = share(np.abs(FILE[:, 1] - 2), 4, 0.5)
    second = share(np.abs(FILE[:, 0] - 20), 3, 1)
    for order in (strokes, strokes[::-1]):
        a, b = ((0.9, first), (0.1, second))[:: 1 if order is strokes else -1]
        below = 0.5 + a[1] * (a[0] - 0.5)
        expected = below + b[1] * (b[0] - below)
        np.testing.assert_allclose(values(opened(order, base=0.5)), expected, rtol=0, atol=6 / 128)


def test_a_dab_and_segments_without_length() -> None:
    d = np.linalg.norm(FILE - [20, 2, 7], axis=1)
    for path in ([[20, 2, 7]], [[20, 2, 7]] * 5):
        field = opened([{"path": path, "radius": 5, "value": 1}], base=0)
        np.testing.assert_allclose(values(field), share(d, 5, 0.5), rtol=0, atol=6 / 128)


def test_a_scribble_is_its_polyline() -> None:
    """Against the smallest distance to any of its segments; drawn with fewer places it is off by 1/1000 radius."""
    t = np.linspace(0, 1, 500)
    path = np.column_stack([12 + 16 * t, 2 + 4 * np.sin(9 * t), 6 + 2 * np.cos(5 * t)])
    d = np.min([distance(FILE, a, b)[0] for a, b in pairwise(path)], axis=0)
    one = brush(path, 1.5, 0.5)
    for drawn, tolerance in ((one, 1e-12), (one.simpler(), 0.005)):
        found = Painting([drawn], [np.ones((len(drawn.places), 1))], np.zeros(1)).at(FILE)[:, 0]
        np.testing.assert_allclose(found, share(d, 1.5, 0.5), rtol=0, atol=tolerance)
    print(f"{len(path)} places drawn with {len(one.simpler().places)}")
    assert len(one.simpler().places) < 300


def test_how_places_are_asked_together_does_not_matter() -> None:
    painting = Painting([brush([A, B, A + 3], 3, 0.5)], [np.array([[0.1], [0.7], [0.3]])], np.array([0.2]))
    combed = Painting([brush([A, B, A + 3], 3, 0.5)], [np.zeros((3, 6))], np.array([1.0, 0, 0, 0, 0, 0]), "along")
    for each in (painting, combed):
        whole = each.at(ASKED)
        np.testing.assert_array_equal(whole, np.concatenate([each.at(ASKED[:7]), each.at(ASKED[7:])]))
        np.testing.assert_array_equal(whole, each.at(ASKED[::-1])[::-1])


def test_a_stroke_over_the_part_is_a_constant() -> None:
    cover = {"path": [[20, 2, 7], [21, 2, 7]], "radius": 40, "value": 0.3}
    under = {"path": [[20, 2]], "radius": 3, "value": 0.9}
    for strokes in ([cover], [under, cover]):
        field = opened(strokes, base=0.7)
        assert field.bounds == (0.3, 0.3)
        assert field.varies == (False, False, False)
        assert np.all(values(field) == 0.3)
        lines = opened(strokes, base=0.7, direction=True)
        expected = open_orientation(0.3, FRAME, Inputs(Path())).normals(*ASKED.T)
        np.testing.assert_array_equal(lines.normals(*ASKED.T), expected)
    beside = opened([{"path": [[100, 100]], "radius": 3, "value": 0.9}], base=0.7)
    assert beside.bounds == (0.7, 0.7)
    alike = opened([{"path": [[20, 2]], "radius": 3, "value": 0.7}], base=0.7)
    assert np.all(values(alike) == 0.7)
    over = opened([cover, under], base=0.7)
    assert over.bounds == (0.3, 0.9)


@pytest.mark.parametrize("comb", ["along", "across"])
@pytest.mark.parametrize("places", [25, 1000])
def test_a_circle_is_combed_around(comb: str, places: int) -> None:
    turn = np.linspace(0, 2 * np.pi, places)
    middle, radius = np.array([20.0, 2.0]), 4.5
    path = middle + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    field = opened([{"path": path.tolist(), "radius": 2, "falloff": 0.2}], comb=comb, direction=True)
    away = FILE[:, :2] - middle
    inside = np.abs(np.linalg.norm(away, axis=1) - radius) < 1.6
    around = np.rad2deg(np.arctan2(away[:, 1], away[:, 0])) + (90 if comb == "along" else 0)
    off = apart(degrees(field), around)[inside]
    print(f"{places} places, {comb}: off by up to {off.max():.2f}°")
    assert off.max() < 4
    assert field.varies == (True, True, False)
    far = np.linalg.norm(away, axis=1) > 7
    assert apart(degrees(field), 0)[far].max() < 1e-3


def test_a_corner_is_combed_without_a_jump() -> None:
    field = opened([{"path": [[12, -3], [24, -3], [24, 8]], "radius": 3, "falloff": 0.1}], direction=True, grid_mm=0.1)
    turn = np.linspace(-0.5 * np.pi, np.pi, 400)
    for radius in (0.5, 1.0, 2.0):
        around = np.column_stack([24 + radius * np.cos(turn), -3 + radius * np.sin(turn), np.full(400, 5.0)])
        line = degrees(field, around - MINIMUM)
        steps = apart(line[1:], line[:-1])
        print(f"{radius} mm from the corner: steps up to {steps.max():.1f}°")
        assert steps.max() < 20
    along = np.array([[14.0, -3, 5], [24, 6, 5]]) - MINIMUM
    np.testing.assert_allclose(apart(degrees(field, along), [0, 90]), 0, atol=0.1)


def test_in_space_and_across() -> None:
    path = [A.tolist(), B.tolist()]
    near = distance(FILE, A, B)[0] < 1
    for comb, expected in (("along", B - A), ("across", [-(B - A)[1], (B - A)[0], 0])):
        found = opened([{"path": path, "radius": 3, "falloff": 0.2}], comb=comb, direction=True).normals(*ASKED[near].T)
        np.testing.assert_allclose(np.abs(found @ (expected / np.linalg.norm(expected))), 1, atol=1e-6)


def test_lines_next_to_0_do_not_blend_to_90() -> None:
    stroke = {"path": [[10, 2], [30, 2]], "radius": 6, "falloff": 1}
    found = degrees(opened([{**stroke, "value": 179}], base=1, direction=True))
    assert apart(found, 0).max() < 1.01
    found = degrees(opened([{**stroke, "value": [1, 179]}], base=1, direction=True))
    assert apart(found, 0).max() < 1.01
    tilted = [[10, 2], [30, 2 - 20 * np.tan(np.deg2rad(1))]]
    found = degrees(opened([{**stroke, "path": tilted}], base=1, direction=True))
    assert apart(found, 0).max() < 1.01


def test_it_follows_the_part_in_its_file() -> None:
    shift = np.array([100.0, -250.0, 40.0])
    for direction in (False, True):
        here, there = (
            opened(
                [{"path": [(A + s).tolist(), (B + s).tolist()], "radius": 3, **({} if direction else {"value": 0.9})}],
                Frame(MINIMUM + s, SIZE), base=0.2, direction=direction,
            )
            for s in (np.zeros(3), shift)
        )  # fmt: skip
        if direction:
            dot = np.abs((here.normals(*ASKED.T) * there.normals(*ASKED.T)).sum(axis=1))
            np.testing.assert_allclose(dot, 1, atol=1e-6)
        else:
            np.testing.assert_allclose(values(there), values(here), atol=1e-6)


def test_it_is_turned_and_scaled_with_the_part(tmp_path: Path) -> None:
    """A hard stroke along the left side of a plate is the first material, wherever the plate is turned."""
    printer = {"pitch_um": 100, "layer_um": 500}
    strokes = [{"path": [[0, -9], [0, 15]], "radius": 2.05, "falloff": 0, "value": 1}]
    for turn, scale, full, none in (
        (0, 1, np.s_[:, :19], np.s_[:, 22:]),
        (90, 1, np.s_[-19:, :], np.s_[:-22, :]),
        (0, 2, np.s_[:, :38], np.s_[:, 44:]),
    ):
        part = parts.stl(tmp_path, meshes.box((6.0, 6.0, 0.5)))
        settings = {"rotate": [0, 0, turn], "scale": scale}
        bitmap = parts.bitmap(
            parts.job(part, ratio={"strokes": strokes, "base": 0}, printer=printer, settings=settings)
        )
        assert np.all(bitmap[full] == 1)
        assert np.all(bitmap[none] == 2)


def test_a_table_is_the_list() -> None:
    content = "stroke,x,y,z,value,radius\n1,13,-2,5,0.1,3\n1,26,6,9,0.9,3\n7,20,2,7,0.4,2\n"
    strokes = [
        {"path": [[13, -2, 5], [26, 6, 9]], "radius": 3, "value": [0.1, 0.9]},
        {"path": [[20, 2, 7]], "radius": 2, "value": 0.4},
    ]
    np.testing.assert_array_equal(values(opened("s.csv", content=content, base=0.2)), values(opened(strokes, base=0.2)))
    content = "stroke;x;y\n1;13;-2\n1;26;6\n"
    table = opened("s.csv", content=content, radius=3, falloff="smooth", direction=True)
    inline = opened([{"path": [[13, -2], [26, 6]], "radius": 3, "falloff": "smooth"}], direction=True)
    np.testing.assert_array_equal(table.normals(*ASKED.T), inline.normals(*ASKED.T))


@pytest.mark.parametrize(
    ("content", "keys", "said"),
    [
        ("x,y,value,radius\n1,2,3,4\n", {}, "no column 'stroke'"),
        ("stroke,x,y,value\n1,2,3,4\n", {}, "no column 'radius'"),
        ("stroke,x,y,value,radius\n1,2,3,4,5\n", {"radius": 2}, "radius, and the table"),
        ("stroke,x,y,value,radius\n1,2,3,4,0\n", {}, "line 2: radius is 0 mm"),
        ("stroke,x,y,value,radius\n1,2,3,4,1\n2,2,3,4,1\n1,2,3,4,1\n", {}, "returns to stroke 1 in line 4"),
        ("stroke,x,y,radius\n1,2,3,4\n", {}, "stroke 1 of the table 's.csv' .line 2. has no value"),
        ("stroke,x,y,size\n1,2,3,4\n", {}, "unknown column 'size'"),
    ],
)
def test_tables_that_are_refused(content: str, keys: Any, said: str) -> None:
    with pytest.raises(JobError, match=said):
        opened("s.csv", content=content, base=0, **keys)


STROKE = {"path": [[12, 2], [20, 2]], "radius": 3, "value": 0.9}
BARE = {"path": [[12, 2], [20, 2]], "radius": 3}


@pytest.mark.parametrize(
    ("strokes", "keys", "direction", "said"),
    [
        ([BARE], {"comb": "along", "base": 0}, False, "comb: along are directions"),
        ([BARE], {"base": 0}, False, "stroke 1 has no value"),
        ([STROKE], {}, False, "no base"),
        ([STROKE], {"comb": "along"}, True, "stroke 1 has a value, an angle, and comb: along"),
        ([STROKE, BARE], {}, True, "stroke 1 has a value, an angle, and stroke 2 is combed"),
        ([{"path": [[1, 2]], "radius": 3}], {}, True, "stroke 1 has no length"),
        ([{"path": [[1, 2, 3], [1, 2, 5]], "radius": 3}], {"comb": "across"}, True, "stroke 1 is upright"),
        ([STROKE], {"base": 0, "radius": 3}, False, "radius stands beside a list"),
        ([STROKE], {"base": 0, "grid_mm": 1e-4}, False, "at most 20000000"),
    ],
)
def test_what_is_refused_when_it_is_opened(strokes: Any, keys: Any, direction: bool, said: str) -> None:
    with pytest.raises(JobError, match=said) as caught:
        opened(strokes, direction=direction, **keys)
    assert caught.value.hint


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"radius": 0}, "greater"),
        ({"radius": -1}, "greater"),
        ({"radius": [1, 2, 3]}, "3 numbers for a path of 2 places"),
        ({"value": [1]}, "1 numbers for a path of 2 places"),
        ({"value": "0.5"}, "number"),
        ({"value": float("nan")}, "finite"),
        ({"path": []}, "at least 1"),
        ({"path": [[1]]}, "at least 2"),
        ({"path": [[1, 2], [1, 2, 3]]}, "place 2 has 3 coordinates"),
        ({"path": [[1, 2], [1, float("inf")]]}, "finite"),
        ({"path": [[1, 2], [1, 1e9]]}, "place 2: y is 1e.09 mm"),
        ({"falloff": 1.5}, "less"),
        ({"falloff": "soft"}, "smooth"),
        ({"colour": 1}, "not permitted"),
    ],
)
def test_strokes_that_are_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        TypeAdapter(FieldSpec).validate_python({"strokes": [{**STROKE, **keys}], "base": 0})


def test_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValidationError, match="at most 10000"):
        TypeAdapter(FieldSpec).validate_python({"strokes": [STROKE] * 10_001, "base": 0})
    long = {**BARE, "path": [[1, 2]] * 50_001}
    with pytest.raises(ValidationError, match="100002 places"):
        TypeAdapter(FieldSpec).validate_python({"strokes": [long, long], "base": 0})


def test_its_file_is_named_and_can_be_renamed() -> None:
    source: Any = TypeAdapter(FieldSpec).validate_python({"strokes": "a/s.csv", "base": 0})
    assert source.paths() == ("a/s.csv",)
    assert source.with_paths({"a/s.csv": "1.csv"}).strokes == "1.csv"


def scribble(count: int, flat: bool, radius: float) -> dict[str, Any]:
    random = np.random.default_rng(0)
    path = np.cumsum(random.normal(0, 3, (count, 3)), axis=0) % (100, 80, 50)
    return {"path": path[:, : 2 if flat else 3].round(3).tolist(), "radius": radius, "value": 0.3}


LARGE = Frame(np.zeros(3), np.array([100.0, 80.0, 50.0]))


def test_long_work_is_done_on_coarser_nodes_or_refused() -> None:
    def nodes(*strokes: dict[str, Any], **keys: Any) -> Any:
        spec: Any = TypeAdapter(FieldSpec).validate_python({"strokes": list(strokes), "base": 0.5, **keys})
        return spec.open(LARGE, Inputs(Path("nowhere"))).nodes

    short, long = nodes(scribble(20, False, 2)), nodes(scribble(9000, False, 9))
    assert 1.2 * short.spacing_mm < long.spacing_mm <= 9 / 2
    with pytest.raises(JobError, match=r"segments take about \d+ s to paint on nodes 0.3 mm apart") as caught:
        nodes(scribble(9000, False, 9), grid_mm=0.3)
    assert "larger grid_mm than 0.3" in str(caught.value.hint)
    with pytest.raises(JobError, match="segments take about") as caught:
        nodes(scribble(60_000, False, 30))
    assert "fewer places" in str(caught.value.hint)


@pytest.mark.parametrize(("name", "said"), [("MOST_PLACES", "4 places; at most 3"), ("MOST_STROKES", "4 strokes")])
def test_tables_of_too_many_have_a_hint(name: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("amslicer.fields.strokes." + name, 3)
    with pytest.raises(JobError, match=said) as caught:
        opened("s.csv", content="stroke,x,y,value,radius\n1,2,3,4,1\n2,2,3,4,1\n3,1,3,4,1\n4,1,3,4,1\n", base=0)
    assert caught.value.hint
