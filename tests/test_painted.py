"""Shares of several materials, vectors, isotropy and period: what a job may say of them, and what is read at places."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import amslicer
from amslicer import Job, JobError
from amslicer.fields.constant import ConstantSampler
from amslicer.fields.orientation import Vector
from amslicer.painted import Painted
from amslicer.pipeline import Prepared, prepare

SIZE_MM = (8.0, 4.0, 2.0)
PRINTER = {"pitch_um": 200, "layer_um": 200}
GRADIENT = {"gradient": {"axis": "x", "from": 0.1, "to": 0.5}}


def job(folder: Path, materials: list[str], fields: dict[str, Any], **pattern: Any) -> Job:
    content = {"printer": PRINTER, "materials": materials, "pattern": pattern, "fields": {"ratio": 0.3, **fields}}
    return amslicer.load_job(content, part=parts.box(folder, SIZE_MM))


def prepared(folder: Path, materials: list[str], fields: dict[str, Any], **pattern: Any) -> Prepared:
    return prepare(job(folder, materials, fields, **pattern))


def x_mm(count: int = 40) -> parts.Floats:
    return (np.arange(count) + 0.5) * 0.2


# --- shares -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ratio", "expected"),
    [
        ({"a": GRADIENT, "b": 0.2, "c": "rest"}, lambda t: [t, t + 0.2]),
        ({"a": GRADIENT, "c": 0.2, "b": "rest"}, lambda t: [t, 0 * t + 0.8]),
        ({"a": "rest", "b": 0.2, "c": GRADIENT}, lambda t: [0.8 - t, 1 - t]),
        ({"a": 0.25, "b": 0.25, "c": 0.5}, lambda t: [0 * t + 0.25, 0 * t + 0.5]),
        ({"a": GRADIENT, "b": {"expression": "0.7 - 0.4*u"}, "c": 0.2}, lambda t: [t, 0 * t + 0.8]),
        ({"a": 0.0, "b": 1.0, "c": "rest"}, lambda t: [0 * t, 0 * t + 1]),
    ],
)
def test_cumulative_ratios(tmp_path: Path, ratio: dict[str, Any], expected: Any) -> None:
    ready = prepared(tmp_path, ["a", "b", "c"], {"ratio": ratio})
    found = ready.painted.ratio_map(ready.grid, 3)
    assert found.shape == (2, 20, 40)
    t = 0.1 + 0.4 * x_mm() / 8
    for plane, line in zip(found, expected(t), strict=True):
        np.testing.assert_allclose(plane, np.tile(line, (20, 1)), atol=1e-6)


def test_a_ratio_of_two_is_the_first_and_the_rest(tmp_path: Path) -> None:
    one = prepared(tmp_path, ["a", "b"], {"ratio": GRADIENT})
    named = prepared(tmp_path, ["a", "b"], {"ratio": {"b": "rest", "a": GRADIENT}})
    assert np.array_equal(one.painted.ratio_map(one.grid, 0), named.painted.ratio_map(named.grid, 0))
    assert np.array_equal(parts.labels(one.job, 2, 4), parts.labels(named.job, 2, 4))


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        ({"a": 0.3, "b": 0.3, "c": 0.3}, "sum to 0.9 instead of 1 at x = 0.10, y = 0.10, z = 0.10 mm"),
        ({"a": 0.6, "b": 0.6, "c": "rest"}, "sum to 1.2 at x = 0.10, y = 0.10, z = 0.10 mm"),
        # 0.1 + 0.4 x/8 + 0.8 passes 1 at x = 2, between the pixel centres 1.9 and 2.1: 0.1 + 0.105 + 0.8 = 1.005.
        ({"a": GRADIENT, "b": "rest", "c": 0.8}, "sum to 1.005 at x = 2.10, y = 0.10"),
        ({"a": {"expression": "-0.1 + 0*x"}, "b": 0.3, "c": "rest"}, "fields.ratio.a is -0.1 at"),
        ({"a": 0.3, "b": {"expression": "1.5*v"}, "c": "rest"}, "fields.ratio.b is 1.01"),
        ({"a": {"expression": "0.2 + 0*x"}, "b": 0.3, "c": 0.4}, "(off by -0.1)"),
    ],
)
def test_shares_that_are_none_are_refused_with_place_and_amount(
    tmp_path: Path, ratio: dict[str, Any], said: str
) -> None:
    with pytest.raises(JobError) as caught:
        amslicer.slice_job(job(tmp_path, ["a", "b", "c"], {"ratio": ratio}), tmp_path / "out")
    assert "fields.ratio" in caught.value.message
    assert said in caught.value.message
    assert caught.value.hint
    assert not (tmp_path / "out").exists()  # found before anything is written


@pytest.mark.parametrize(
    ("materials", "ratio", "said", "hint"),
    [
        ("abc", 0.3, "is one field, but there are 3 materials", "{a: …, b: …, c: rest}"),
        ("abc", {"a": 0.3, "b": "rest"}, "has no ratio for 'c'", "c: rest"),
        ("ab", {"a": "rest", "b": "rest"}, "a and b are both rest", None),
        ("ab", {"a": 0.3, "bb": "rest"}, "there is no material 'bb'", "did you mean b?"),
        ("ab", {"a": 1.3, "b": "rest"}, "fields.ratio.a: must be between 0 and 1, but it is 1.3", None),
    ],
)
def test_which_material_gets_what(tmp_path: Path, materials: str, ratio: Any, said: str, hint: str | None) -> None:
    with pytest.raises(JobError) as caught:
        job(tmp_path, list(materials), {"ratio": ratio})
    assert "fields.ratio" in caught.value.message
    assert said in caught.value.message
    if hint:
        assert hint in str(caught.value.hint)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=2, max_size=8), st.data())
def test_shares_of_any_number_of_materials_add_up(weights: list[float], data: st.DataObject) -> None:
    """Whichever takes the rest, the cumulative ratios are the running sum, and never fall."""
    total = sum(weights)
    shares = [w / total for w in weights] if total > 0 else [1.0, *[0.0] * (len(weights) - 1)]
    rest = data.draw(st.integers(0, len(shares) - 1))
    painted = of_shares([None if m == rest else share for m, share in enumerate(shares)])
    found = painted.ratio_map(GRID, 0)[:, 0, 0]
    np.testing.assert_allclose(found, np.cumsum(shares)[:-1], atol=1e-6)
    assert np.all(np.diff(np.concatenate([[0], found, [1]])) >= 0)


def of_shares(shares: list[float | None]) -> Painted:
    from amslicer.fields.orientation import Angles

    zero = ConstantSampler(0.0)
    samplers = tuple(None if share is None else ConstantSampler(share) for share in shares)
    names = tuple("abcdefgh"[: len(shares)])
    return Painted(names, samplers, Angles(zero), zero, ConstantSampler(1.0), PLACEMENT, 0.0, 2)


# --- directions as vectors ----------------------------------------------------------------------------------


def vector(*components: float) -> Vector:
    x, y, z = (ConstantSampler(c) for c in components)
    return Vector((x, y, z))


@pytest.mark.parametrize(
    ("components", "expected"),
    [
        ((3, 0, 4), (0.6, 0, 0.8)),
        ((0, -2e-300, 0), (0, -1, 0)),
        ((1e300, 1e300, 0), (np.sqrt(0.5), np.sqrt(0.5), 0)),
        ((0, 0, 0), (1, 0, 0)),
    ],
)
def test_vectors_are_normalised(components: tuple[float, float, float], expected: tuple[float, ...]) -> None:
    places = np.zeros((3, 2))
    found = vector(*components).normals(*places)
    np.testing.assert_allclose(found, np.tile(expected, (2, 1)), atol=1e-15)


def test_a_vector_field_around_a_centre_is_radial(tmp_path: Path) -> None:
    components = [{"expression": "x - 4"}, {"expression": "y - 2"}, 0]
    painted = prepared(tmp_path, ["a", "b"], {"orientation": {"vector": components}}, dimensions=2).painted
    points = np.random.default_rng(1).uniform((0, 0, 0), SIZE_MM, (50, 3))
    expected = (points - (4, 2, 0)) * (1, 1, 0)
    np.testing.assert_allclose(
        painted.normals(points), expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-12
    )


def test_vectors_and_angles_give_the_same_laminate(tmp_path: Path) -> None:
    azimuth, elevation = np.deg2rad(30), np.deg2rad(40)
    components = [
        float(np.cos(elevation) * np.cos(azimuth)), float(np.cos(elevation) * np.sin(azimuth)), float(np.sin(elevation))
    ]  # fmt: skip
    one = parts.labels(job(tmp_path, ["a", "b"], {"orientation": {"azimuth": 30, "elevation": 40}}), 0, 4)
    other = parts.labels(job(tmp_path, ["a", "b"], {"orientation": {"vector": components}}), 0, 4)
    assert np.count_nonzero(one != other) <= 2  # components are rounded once more than angles


@pytest.mark.parametrize(
    ("orientation", "dimensions", "said"),
    [
        ({"vector": [1, 0, 0.5]}, 2, "has a z component"),
        ({"azimuth": 3, "elevation": 4}, 2, "has an elevation"),
        ({"vector": [1, 0]}, 3, "fields.orientation.vector"),
        ({"vector": "x"}, 3, "fields.orientation.vector"),
    ],
)
def test_vectors_that_are_refused(tmp_path: Path, orientation: Any, dimensions: int, said: str) -> None:
    with pytest.raises(JobError, match=said):
        job(tmp_path, ["a", "b"], {"orientation": orientation}, dimensions=dimensions)


# --- isotropy and period ------------------------------------------------------------------------------------


def test_isotropy_and_period_are_read_where_the_kernels_are(tmp_path: Path) -> None:
    isotropy = {"gradient": {"axis": "x", "from": 0.0, "to": 1.0}}
    period = {"gradient": {"axis": "y", "from": 1.0, "to": 2.0}}
    painted = prepared(tmp_path, ["a", "b"], {"isotropy": isotropy}, period=period).painted
    points = np.random.default_rng(2).uniform((0, 0, 0), SIZE_MM, (50, 3))
    np.testing.assert_allclose(painted.isotropies(points), points[:, 0] / 8, atol=1e-12)
    np.testing.assert_allclose(painted.periods(points), 1 + points[:, 1] / 4, atol=1e-12)
    assert painted.period_bounds_mm == (1.0, 2.0)


def test_the_period_stays_in_printed_mm_under_scale(tmp_path: Path) -> None:
    content = {
        "printer": PRINTER, "materials": ["a", "b"], "part": {"scale": 3.0},
        "pattern": {"period": {"gradient": {"axis": "x", "from": 1.0, "to": 2.0}}}, "fields": {"ratio": 0.3},
    }  # fmt: skip
    painted = prepare(amslicer.load_job(content, part=parts.box(tmp_path, SIZE_MM))).painted
    assert painted.periods(np.array([[12.0, 1, 1]]))[0] == pytest.approx(1.5)  # in the middle of 24 mm


@pytest.mark.parametrize(
    ("fields", "pattern", "said"),
    [
        ({"isotropy": 1.5}, {}, "fields.isotropy: must be between 0 and 1, but it is 1.5"),
        ({"isotropy": {"gradient": {"axis": "x", "from": 0.5, "to": 1.2}}}, {}, "fields.isotropy is 1."),
        ({}, {"period": 0}, "pattern.period: must be greater than 0 mm"),
        ({}, {"period": {"gradient": {"axis": "x", "from": 0, "to": 2}}}, "falls to 0 mm"),
        ({}, {"period": {"gradient": {"axis": "x", "from": 0.05, "to": 6}}}, "from 0.05 to 6 mm, a factor of 120"),
    ],
)
def test_isotropies_and_periods_that_are_refused(
    tmp_path: Path, fields: dict[str, Any], pattern: dict[str, Any], said: str
) -> None:
    with pytest.raises(JobError) as caught:
        amslicer.slice_job(job(tmp_path, ["a", "b"], fields, **pattern), tmp_path / "out")
    assert said in caught.value.message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_same_value_however_written_gives_the_same_bytes(tmp_path: Path, dimensions: int) -> None:
    """Isotropy 0.2 and period 1.25 as a number, a gradient to itself, a picture and an expression."""
    grey = parts.paint(tmp_path, np.full((3, 5), 51, np.uint8))
    ways = [
        (lambda v: v), (lambda v: {"gradient": {"axis": "y", "from": v, "to": v}}),
        (lambda v: {"image": grey, "range": [0.0, 5 * v]}), (lambda v: {"expression": str(v)}),
    ]  # fmt: skip
    stacks = []
    for way in ways:
        content = {
            "printer": PRINTER, "materials": ["a", "b"], "pattern": {"dimensions": dimensions, "period": way(1.25)},
            "fields": {"ratio": 0.3, "isotropy": way(0.2), "orientation": 20},
        }  # fmt: skip
        file = tmp_path / "job.yaml"
        file.write_text(json.dumps(content))
        stacks.append(parts.labels(amslicer.load_job(file, part=parts.box(tmp_path, SIZE_MM))))
    for stack in stacks[1:]:
        assert np.array_equal(stack, stacks[0])


def _frame() -> Any:
    from amslicer.placement import Placement

    zero = np.zeros(3)
    return Placement(np.eye(3), 1.0, zero, np.ones(3), zero, zero, 0.0)


def _grid() -> Any:
    from amslicer.grid import Grid

    return Grid(2, 2, 1, (0.5, 0.5), 1.0)


PLACEMENT, GRID = _frame(), _grid()
