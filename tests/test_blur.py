"""Fields smoothed by a Gaussian: analytic steps, waves and slopes; directions as lines; bounded size."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter
from scipy.special import erf

from amslicer import JobError
from amslicer.fields import FieldSpec, Frame, Inputs, open_field, open_orientation
from amslicer.fields import blur as module
from amslicer.fields.nodes import Nodes

Floats = NDArray[np.float64]

MINIMUM, SIZE = np.array([10.0, -5.0, 3.0]), np.array([20.0, 14.0, 9.0])
FRAME = Frame(MINIMUM, SIZE)
POINTS = np.random.default_rng(1).uniform(0, 1, (2000, 3)) * SIZE
X, Y, Z = POINTS.T


def blur(field: Any, mm: float) -> Any:
    return TypeAdapter(FieldSpec).validate_python({"blur": {"field": field, "mm": mm}})


def sampler(field: Any, mm: float, frame: Frame = FRAME) -> Any:
    return open_field(blur(field, mm), frame, Inputs(Path("nowhere")))


def lines(field: Any, mm: float) -> Any:
    return open_orientation(blur(field, mm), FRAME, Inputs(Path("nowhere")))


def step(axis: str, at_mm: float) -> dict[str, Any]:
    """0 below a place (file coordinates) and 1 above."""
    return {"where": {"mask": {"expression": axis}, "above": at_mm, "then": 1, "else": 0}}


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("axis", "place"), [("x", 19.3), ("y", 2.1), ("z", 7.7)])
def test_a_step_becomes_an_error_function(axis: str, place: float, sigma: float) -> None:
    """A step is placed to half a node, which is σ/64."""
    i = "xyz".index(axis)
    field = sampler(step(axis, place), sigma)
    distance = POINTS[:, i] + MINIMUM[i] - place
    found = np.broadcast_to(field.scalar(X, Y, Z), len(POINTS))
    # Beyond the box the step stays 0 and 1: the error function holds up to the sides.
    off = np.abs(found - 0.5 * (1 + erf(distance / sigma / np.sqrt(2))))
    print(f"step along {axis}, σ {sigma}: off by up to {off.max():.4f}")
    assert off.max() < 0.4 / 64 + 1e-3
    assert field.bounds == (0.0, 1.0)
    assert field.varies == tuple(k == i for k in range(3))


def test_a_wave_loses_what_a_gaussian_takes() -> None:
    """sin(kx) times exp(-k²σ²/2), away from the sides, where waves are cut."""
    sigma, k = 1.0, 2 * np.pi / 6
    field = sampler({"expression": "sin(2*pi*x/6) + cos(2*pi*y/6)"}, sigma)
    inside = (np.abs(POINTS - SIZE / 2) < SIZE / 2 - 4.2 * sigma)[:, :2].all(axis=1)
    assert inside.sum() > 100
    x, y = (X + MINIMUM[0])[inside], (Y + MINIMUM[1])[inside]
    expected = np.exp(-((k * sigma) ** 2) / 2) * (np.sin(k * x) + np.cos(k * y))
    off = np.abs(np.broadcast_to(field.scalar(X, Y, Z), len(POINTS))[inside] - expected)
    print(f"wave: off by up to {off.max():.2g} of {np.abs(expected).max():.2g}")
    assert off.max() < 2e-3


def test_in_space_a_step_is_as_good_as_the_nodes_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plane aslant: nodes a quarter of σ apart."""
    monkeypatch.setattr(module, "WANTED_VALUES", 200_000)
    sigma = 2.0
    field = sampler({"where": {"mask": {"expression": "x + y + z"}, "above": 26.0, "then": 1, "else": 0}}, sigma)
    distance = ((POINTS + MINIMUM).sum(axis=1) - 26.0) / np.sqrt(3)
    inside = (np.abs(POINTS - SIZE / 2) < SIZE / 2 - 1.5 * sigma).all(axis=1)
    assert inside.sum() > 30
    off = np.abs(field.scalar(X, Y, Z) - 0.5 * (1 + erf(distance / sigma / np.sqrt(2))))[inside]
    near = np.abs(distance[inside]) < 4
    print(f"aslant: off by up to {off[near].max():.4f}")
    assert off.max() < 0.06


@pytest.mark.parametrize("mm", [0.01, 1.0, 1e6])
def test_a_constant_is_that_constant(mm: float) -> None:
    assert sampler(0.3, mm).scalar(X, Y, Z) == 0.3
    assert sampler(0.3, mm).varies == (False, False, False)


def test_equal_values_are_kept_to_the_last_bit() -> None:
    for flat in ({"gradient": {"axis": "x", "from": 0.2, "to": 0.2}}, {"expression": "0.2 + 0*x"}):
        assert (np.broadcast_to(sampler(flat, 1.0).scalar(X, Y, Z), 2000) == 0.2).all()


def test_a_slope_stays_away_from_its_ends() -> None:
    field = sampler({"gradient": {"axis": "x", "from": 0, "to": 1}}, 1.0)
    inside = (X > 4) & (X < 16)
    np.testing.assert_allclose(field.scalar(X, Y, Z)[inside], X[inside] / 20, atol=1e-5)
    low, high = field.scalar(np.array([0.0, 20.0]), *np.zeros((2, 2)))
    # The mean of max(0, N(0, 1)) is 1/√(2π) of σ, one twentieth of the slope.
    assert (low, high) == pytest.approx((0.39894 / 20, 1 - 0.39894 / 20), abs=1e-4)


def test_only_axes_that_vary_have_nodes() -> None:
    field = sampler({"expression": "sin(x) * z"}, 1.0)
    assert field.varies == (True, False, True)
    assert field.nodes.shape[1] == 1
    moved = Y * 0 + 3.0
    np.testing.assert_array_equal(field.scalar(X, Y, Z), field.scalar(X, moved, Z))


def test_a_raster_is_its_points_and_groups_do_not_matter() -> None:
    field = sampler({"expression": "sin(x) * cos(y) + z"}, 1.0)
    x, y, z = np.linspace(0, 20, 31)[None, :], np.linspace(0, 14, 17)[:, None], np.asarray(2.2)
    raster = field.scalar(x, y, z)
    points = field.scalar(*(np.ravel(c) for c in np.broadcast_arrays(x, y, z)))
    np.testing.assert_allclose(raster.ravel(), points, atol=1e-6)
    np.testing.assert_array_equal(field.scalar(X[5:8], Y[5:8], Z[5:8]), field.scalar(X, Y, Z)[5:8])


def test_it_follows_the_part() -> None:
    plain = sampler({"gradient": {"axis": "x", "from": 0, "to": 1}}, 2.0).scalar(X, Y, Z)
    moved = Frame(MINIMUM + np.array([100.0, -7.0, 3.5]), SIZE)
    found = sampler({"gradient": {"axis": "x", "from": 0, "to": 1}}, 2.0, moved).scalar(X, Y, Z)
    np.testing.assert_array_equal(found, plain)


# Directions


def test_1_and_179_degrees_never_give_90() -> None:
    step_of_lines = {"where": {"mask": {"expression": "x"}, "above": 20.0, "then": 1, "else": 179}}
    normals = lines(step_of_lines, 2.0).normals(X, Y, Z)
    angle = np.rad2deg(np.arctan2(normals[:, 1], normals[:, 0])) % 180
    assert (np.minimum(angle, 180 - angle) <= 1 + 1e-3).all()
    middle = np.abs(X + MINIMUM[0] - 20.0) < 0.1
    assert np.minimum(angle, 180 - angle)[middle].max() < 0.1


def test_directions_are_smoothed_through_their_tensors() -> None:
    """Between 0° and 60° with shares 1 - w and w: tan 2θ = w sin 120° / (1 - w + w cos 120°)."""
    sigma = 2.0
    normals = lines({"where": {"mask": {"expression": "x"}, "above": 20.0, "then": 60, "else": 0}}, sigma).normals(
        X, Y, Z
    )
    w = 0.5 * (1 + erf((X + MINIMUM[0] - 20.0) / sigma / np.sqrt(2)))
    expected = 0.5 * np.arctan2(w * np.sin(2 * np.pi / 3), 1 - w + w * np.cos(2 * np.pi / 3))
    off = np.abs(normals[:, 0] * np.sin(expected) - normals[:, 1] * np.cos(expected))
    print(f"directions are off by up to {np.rad2deg(off.max()):.2f}°")
    assert np.rad2deg(off.max()) < 1.0
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)


def test_one_direction_is_kept() -> None:
    plain = open_orientation(137.0, FRAME, Inputs(Path())).normals(X, Y, Z)
    found = lines(137.0, 1.0)
    assert not found.turns
    np.testing.assert_array_equal(found.normals(X, Y, Z), plain)


# Size


def test_too_many_nodes_are_refused_with_a_width_that_works() -> None:
    wavy = {"expression": "sin(x) + y*z"}
    with pytest.raises(JobError, match=r"a blur of 0\.01 mm over 20 × 14 × 9 mm needs .* nodes; at most 24000000") as e:
        sampler(wavy, 0.01)
    hint = str(e.value.hint)
    assert "larger mm" in hint
    width = float(hint.split("larger mm, ")[1].split()[0])
    assert 0.01 < width < 0.2
    shape = Nodes(lambda places: places, SIZE, width / module.LEAST_PER_SIGMA).shape
    assert np.prod([float(n) for n in shape]) <= module.MOST_VALUES


def test_nodes_are_as_close_as_the_size_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    assert sampler({"expression": "sin(x)"}, 1.0).nodes.spacing_mm == 1 / module.MOST_PER_SIGMA
    assert sampler({"expression": "sin(x) + y*z"}, 1.0).nodes.spacing_mm < 1 / 6
    monkeypatch.setattr(module, "WANTED_VALUES", 1000)
    assert sampler({"expression": "sin(x) + y*z"}, 1.0).nodes.spacing_mm == 1 / module.LEAST_PER_SIGMA


def test_it_is_made_in_a_second() -> None:
    started = time.perf_counter()
    sampler({"expression": "sin(x) + y*z"}, 0.3)
    print(f"blur of 0.3 mm: {time.perf_counter() - started:.2f} s")
    assert time.perf_counter() - started < 15


@pytest.mark.parametrize("size", [(20.0, 14.0, 0.0), (0.0, 0.0, 0.0), (1e-6, 14.0, 9.0)])
def test_flat_boxes(size: tuple[float, float, float]) -> None:
    field = sampler({"expression": "x + y + z"}, 1.0, Frame(MINIMUM, np.array(size)))
    found = field.scalar(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    assert np.isfinite(found).all()
