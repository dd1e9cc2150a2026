"""Proof: the period is the one asked for, and the pattern is a noise, not a grating."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest

import amslicer
from amslicer import analysis

PERIOD_LIMIT = 0.04
ACROSS = 44  # periods
OBLIQUE_DEG = 27
# Ordinary printers; 0.5 mm is 11.8 x 5.9 pixels, 1 mm 11.8 and 3 mm 35.4.
PERIODS: list[tuple[float, Mapping[str, Any]]] = [
    (0.5, {"dpi": [600, 300], "layer_mm": 0.05}),
    (1.0, {"dpi": 300, "layer_mm": 0.05}),
    (3.0, {"dpi": 300, "layer_mm": 0.05}),
]


def measured_period(folder: Path, period: float, printer: Mapping[str, Any], seed: int, **pattern: Any) -> float:
    """Period of the labels of a plate 44 periods wide and deep, mm."""
    side = ACROSS * period
    job = parts.job(
        parts.plate(folder, side, side), orientation=OBLIQUE_DEG, printer=printer, period=period, seed=seed, **pattern
    )
    return analysis.measured_period(analysis.signed(parts.bitmap(job)), parts.pitch_mm(printer)[:2], period)


@pytest.mark.parametrize(("period", "printer"), PERIODS)
def test_period(tmp_path: Path, period: float, printer: Mapping[str, Any]) -> None:
    """The mean of two seeds: one alone scatters by about 1 %."""
    measured = [measured_period(tmp_path, period, printer, seed) for seed in (1, 2)]
    print(f"period {period} mm: measured {', '.join(f'{m:.4f}' for m in measured)} mm")
    assert np.mean(measured) == pytest.approx(period, rel=PERIOD_LIMIT)


@pytest.mark.slow
@pytest.mark.parametrize("bandwidth", [0.25, 0.5])
@pytest.mark.parametrize(("period", "printer"), PERIODS)
def test_period_of_many_seeds(tmp_path: Path, period: float, printer: Mapping[str, Any], bandwidth: float) -> None:
    """Each of eight seeds, wider bandwidths left out: their lobe reaches beyond 0.6 to 1.4 carriers."""
    measured = np.array([measured_period(tmp_path, period, printer, seed, bandwidth=bandwidth) for seed in range(1, 9)])
    print(
        f"period {period} mm, bandwidth {bandwidth}: mean {measured.mean():.4f}, "
        f"from {measured.min():.4f} to {measured.max():.4f} mm"
    )
    np.testing.assert_allclose(measured, period, rtol=PERIOD_LIMIT)


def test_period_along_a_leaning_normal(tmp_path: Path) -> None:
    """The period is measured along the normal: a layer cuts sheets that lean by 35° 1 / cos 35° apart."""
    elevation, in_layer = 35, 1 / np.cos(np.deg2rad(35))
    side = ACROSS * in_layer
    measured = []
    for seed in (1, 2):
        job = parts.job(
            parts.plate(tmp_path, side, side), dimensions=3, seed=seed,
            orientation={"azimuth": OBLIQUE_DEG, "elevation": elevation},
        )  # fmt: skip
        field = analysis.signed(parts.bitmap(job))
        measured.append(analysis.measured_period(field, parts.pitch_mm(parts.SQUARE)[:2], in_layer))
    print(f"leaning by {elevation}°: expected {in_layer:.4f} mm, measured {', '.join(f'{m:.4f}' for m in measured)} mm")
    assert np.mean(measured) == pytest.approx(in_layer, rel=PERIOD_LIMIT)


def fields(folder: Path, dimensions: int, seeds: range) -> list[np.ndarray[Any, np.dtype[np.complex64]]]:
    orientation = OBLIQUE_DEG if dimensions == 2 else {"azimuth": OBLIQUE_DEG, "elevation": 0}
    part = parts.plate(folder, ACROSS, ACROSS)
    return [
        amslicer.field(parts.job(part, orientation=orientation, dimensions=dimensions, seed=seed), 0) for seed in seeds
    ]


def assert_noise(name: str, g: np.ndarray[Any, np.dtype[np.complex64]]) -> None:
    """The figures of phasor noise at bandwidth 0.5: its intensity varies, the variance of its sine does not."""
    pitch = parts.pitch_mm(parts.SQUARE)[:2]
    contrast = analysis.contrast(g)
    phasor = analysis.low_variance_share(analysis.phase_sine(g), pitch, 1.0)
    plain = analysis.low_variance_share(g.real, pitch, 1.0)
    per_area = analysis.singularities(g) / (g.size * pitch[0] * pitch[1])
    print(
        f"{name}: contrast {contrast:.3f}, spectrum of variance of the sine {phasor:.4f}, of Re G {plain:.3f}, "
        f"singularities per period² {per_area:.3f}"
    )
    assert contrast == pytest.approx(0.55, abs=0.07)
    assert phasor <= 0.01
    assert plain >= 0.3
    # B²/2 = 0.125 for many impulses (a complex Gaussian field); so many dislocations make it a noise.
    assert per_area == pytest.approx(0.125, rel=0.25)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_noise_not_grating(tmp_path: Path, dimensions: int) -> None:
    for seed, g in enumerate(fields(tmp_path, dimensions, range(1, 3)), 1):
        assert_noise(f"{dimensions}D, seed {seed}", g)


@pytest.mark.slow
@pytest.mark.parametrize("dimensions", [2, 3])
def test_noise_of_many_seeds(tmp_path: Path, dimensions: int) -> None:
    for seed, g in enumerate(fields(tmp_path, dimensions, range(3, 11)), 3):
        assert_noise(f"{dimensions}D, seed {seed}", g)


def test_limits_notice_a_grating() -> None:
    grating = np.exp(2j * np.pi * 0.083 * np.arange(530))[None, :] * np.ones((530, 1))
    with pytest.raises(AssertionError):
        assert_noise("grating", grating.astype(np.complex64))


def test_phase_is_uniform(tmp_path: Path) -> None:
    """Each eighth of the circle holds an eighth of the pixels: what makes the ratio right for every profile."""
    turns = np.concatenate([np.angle(g).ravel() for g in fields(tmp_path, 2, range(1, 3))])
    shares = np.histogram(turns, bins=8, range=(-np.pi, np.pi))[0] / turns.size
    print("share of each eighth of the circle:", np.round(shares, 4))
    # An interval of 1/8 of the circle is a ratio of 0.125 of some profile: 4 σ of two plates of 1936 periods².
    sigma = 0.075 * 0.5 * np.sin(np.pi / 8) / np.sqrt(2 * ACROSS**2)
    np.testing.assert_allclose(shares, 1 / 8, atol=4 * sigma * np.sqrt(2))
