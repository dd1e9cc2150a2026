"""Windows of patterns of which only is known how alike places are: neither too wide nor too narrow limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray

from amslicer.likeness import of_distance, of_lines, of_map, share_deviation
from amslicer.pattern import make_noise
from amslicer.pipeline import prepare
from amslicer.verification import verify_stack
from amslicer.windows import RatioWindows

Floats = NDArray[np.float64]

CASES: dict[str, dict[str, Any]] = {
    "white": {"noise": "wave", "spectrum": "white", "isotropy": 1.0, "reads": "real", "bandwidth": 0.5},
    "modulus": {"noise": "wave", "reads": "modulus"},
    "web": {"noise": "wave", "spectrum": "web"},
    "crystal": {"noise": "wave", "spectrum": "crystal"},
    "cellular": {"noise": "wave-cellular"},
    "polytope": {"noise": "wave-polytope"},
    "stit": {"noise": "wave-stit"},
    "random-phase": {"noise": "random-phase"},
    "asymptotic-spot": {"noise": "asymptotic-spot"},
}


@pytest.mark.parametrize("name", CASES)
def test_windows_scatter_as_foretold(tmp_path: Path, name: str) -> None:
    """The rms error of windows of some periods over what is foretold: a bound, and no more than four times too wide."""
    squares = []
    for seed in (1, 2, 3):
        job = parts.job(
            parts.box(tmp_path, (60, 40, 0.1)), printer={"pitch_um": 100, "layer_um": 100}, ratio=0.3, seed=seed,
            **CASES[name],
        )  # fmt: skip
        prepared = prepare(job)
        windows = RatioWindows(prepared.painted, prepared.grid)
        windows.add(0, *windows.count(parts.bitmap(job)[::-1], prepared.painted.ratio_map(prepared.grid, 0)))
        likeness = make_noise(job, prepared.painted).likeness
        assert likeness is not None
        level = next(iter(windows.levels(0.5, None, likeness=likeness)))  # type: ignore[arg-type]
        squares.append(np.mean(level.z**2))
        assert np.abs(level.got - level.asked).max() <= level.limit.max()
    rms = float(np.sqrt(np.mean(squares)))
    print(f"{name}: {rms:.2f} of what is foretold")
    assert 0.25 <= rms <= 1.25


def test_a_wrong_ratio_is_found(tmp_path: Path) -> None:
    """A stack of white waves at 0.5, held against a job that asks for 0.42."""
    import amslicer

    box = parts.box(tmp_path, (60, 40, 0.1))
    keys: dict[str, Any] = {**CASES["white"], "printer": {"pitch_um": 100, "layer_um": 100}}
    amslicer.slice_job(parts.job(box, ratio=0.5, **keys), tmp_path / "out")
    assert verify_stack(tmp_path / "out").ok
    parts.job(box, ratio=0.42, **keys)
    assert not verify_stack(tmp_path / "out", box.with_suffix(".yaml")).ok


def test_lines_against_a_plain_sum() -> None:
    """Means of γ and γ² over pairs of random places in a box."""
    rng = np.random.default_rng(1)
    waves, power = rng.normal(size=(7, 3)), rng.random(7)
    power /= power.sum()
    sides = np.array([1.3, 0.7])
    d = (rng.random((400_000, 2)) - rng.random((400_000, 2))) * sides
    gamma = np.exp(2j * np.pi * d @ waves[:, :2].T) @ power
    for modulus, expected in (
        (False, (gamma.real.mean(), (gamma.real**2).mean())),
        (True, ((np.abs(gamma) ** 2).mean(),) * 2),
    ):
        np.testing.assert_allclose(of_lines(waves, power, modulus=modulus)(sides), expected, atol=2e-3)


def test_distances_and_maps_against_a_plain_sum() -> None:
    rng = np.random.default_rng(2)
    sides = np.array([3.0, 5.0])
    d = (rng.random((400_000, 2)) - rng.random((400_000, 2))) * sides
    distance = np.hypot(*d.T)
    expected = float(np.exp(-distance).mean())
    assert of_distance(lambda r: np.exp(-r))(sides)[0] == pytest.approx(expected, rel=0.01)
    at = (np.arange(400) + 200) % 400 - 200.0
    covariance = np.exp(-np.hypot(at[:, None], at) * 0.05)
    assert of_map(covariance, 0.05, 1.0)(sides)[0] == pytest.approx(expected, rel=0.03)


def test_a_likeness_that_is_no_number_is_no_limit() -> None:
    with pytest.raises(ValueError, match="no number"):
        share_deviation(np.zeros((1, 1)), np.full((1, 1), 0.5), np.ones((1, 2)), lambda _: (float("nan"), 0.0))
