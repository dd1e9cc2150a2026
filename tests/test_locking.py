"""Proof: what sampling by pixels does to a straight laminate's ratio is what `locking` says.

The laminates are exact gratings, or complex Gaussian fields with phasor noise's spectrum made without the package:
white noise on a coarse lattice times a Gaussian, times a plane wave. The error is the share at the pixels' centres
less the exact mean of the grating over the box, or that of the same field on a grid several times as fine, whose step
is in no simple proportion to the pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from amslicer.locking import locked_deviation, locking_error
from amslicer.notes import LOCKED_SHARE
from amslicer.profiles import PROFILES

Floats = NDArray[np.float64]
RATIOS = (0.25, 0.1, 0.5)
PHASES = 50
LARGE = 0.01  # an error that must not pass in silence
SERIES = np.arange(1, 20_001)  # harmonics of the exact mean
LATTICE, REACH = 0.5, 1.6  # of 1/b: step of the white noise, and how far a Gaussian is summed
PERIODS_PX = (10.0, 8.0, 7.5, 12.5, 6.37)
AZIMUTHS = (0.0, 90.0, 45.0, float(np.rad2deg(np.arctan(0.5))), 7.0)


def fine_steps(count: int, least: float) -> int:
    """A number of samples across a side that shares no factor with its pixels nor, nearly, with its periods."""
    return int(count * least * 1.6180339887) | 1


def fields(
    extents: tuple[int, int], wave: Floats, width: float, fine: float, seed: int
) -> Iterator[tuple[NDArray[np.complex64], NDArray[np.complex64]]]:
    """G at the pixels' centres and on the fine grid, PHASES times; `width` is b in 1/pixels, 0 for a grating."""
    rng = np.random.default_rng(seed)
    coarse = [np.arange(n) + 0.5 for n in extents]
    finer = [(np.arange(fine_steps(n, fine)) + 0.5) * n / fine_steps(n, fine) for n in extents]
    nodes = [np.arange(-REACH / width, n + REACH / width, LATTICE / width) if width else np.zeros(1) for n in extents]
    factors = [
        [
            (np.exp(-np.pi * (width * (at[:, None] - node)) ** 2 + 2j * np.pi * w * at[:, None])).astype(np.complex64)
            for at, node, w in zip(grid, nodes, wave, strict=True)
        ]
        for grid in (coarse, finer)
    ]
    for _ in range(PHASES):
        if width:
            shape = (len(nodes[1]), len(nodes[0]))
            noise = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
        else:
            noise = np.exp(2j * np.pi * rng.uniform(size=(1, 1))).astype(np.complex64)
        at, finely = (y @ noise @ x.T for x, y in factors)
        yield at, finely


def share(g: NDArray[np.complex64], ratio: float) -> float:
    return float(np.mean(g.real > np.cos(np.pi * ratio) * np.abs(g)))


def grating_errors(extents: tuple[int, int], wave: Floats, ratios: tuple[float, ...] = RATIOS) -> Floats:
    """(PHASES, ratios) share of a perfect grating at the pixels less its exact mean over the box, a Fourier series."""
    rng = np.random.default_rng(7)
    x, y = np.arange(extents[0]) + 0.5, np.arange(extents[1])[:, None] + 0.5
    amplitude = [2 * np.sin(np.pi * SERIES * r) / (np.pi * SERIES) for r in ratios]
    damping = np.prod([np.sinc(SERIES * w * n) for w, n in zip(wave, extents, strict=True)], axis=0)
    found = []
    for turn in rng.uniform(size=PHASES):
        distance = 2 * np.abs((wave[0] * x + wave[1] * y + turn + 0.5) % 1 - 0.5)
        waves = damping * np.cos(2 * np.pi * SERIES * (np.dot(wave, extents) / 2 + turn))
        found.append([np.mean(distance < r) - r - a @ waves for r, a in zip(ratios, amplitude, strict=True)])
    return np.array(found)


def errors(
    extents: tuple[int, int], wave: Floats, width: float, *, fine: float = 3.0, ratios: tuple[float, ...] = RATIOS
) -> Floats:
    """(PHASES, ratios) share at the pixels less the share on the fine grid, or exactly for a grating."""
    if not width:
        return grating_errors(extents, wave, ratios)
    return np.array(
        [[share(at, r) - share(finely, r) for r in ratios] for at, finely in fields(extents, wave, width, fine, seed=7)]
    )


def wave_of(period_px: float, azimuth: float) -> Floats:
    angle = np.deg2rad(azimuth)
    return np.array([np.cos(angle), np.sin(angle)]) / period_px


def predicted(extents: tuple[int, int], wave: Floats, width: float) -> Floats:
    return np.array(
        [
            locking_error(
                [r], profile=PROFILES["pwm"], cycles_per_pixel=wave, extents_px=extents, width_per_pixel=width
            )[0]
            for r in RATIOS
        ]
    )


def assert_no_missed_warning(extents: tuple[int, int], period_px: float, azimuth: float, bandwidth: float) -> None:
    wave, width = wave_of(period_px, azimuth), bandwidth / period_px
    worst = np.abs(errors(extents, wave, width, fine=3.0 if min(extents) > 100 else 5.0)).max(axis=0)
    said = predicted(extents, wave, width)
    print(
        f"{extents} px, {period_px} px, {azimuth:.1f}°, bandwidth {bandwidth}: worst {worst.round(4)}, {said.round(4)}"
    )
    assert np.all((worst <= LARGE) | (said > LOCKED_SHARE))


def test_ten_pixels_a_period() -> None:
    """Of 10 pixels 2.5 are 2 or 3: exactly 5 % too few or too many; 1 and 5 pixels are always 1 and 5."""
    error = errors((200, 160), wave_of(10, 0), 0.0)
    np.testing.assert_allclose(np.abs(error[:, 0]), 0.05, atol=1e-4)
    np.testing.assert_allclose(error[:, 1:], 0, atol=1e-4)
    said = locking_error(
        [0.25], profile=PROFILES["pwm"], cycles_per_pixel=(0.1, 0), extents_px=(200, 160), width_per_pixel=0
    )
    assert said[0] == pytest.approx(said[1])  # what one material gains the other loses
    assert 0.05 <= said[0] <= 3 * 0.05 * 1.1  # three standard deviations of ± 5 %, and what few kernels add


def test_grating_out_of_step_is_silent() -> None:
    """10.37 pixels across the rows meet the grid anew in every sheet, so the part's ratio is right."""
    wave = wave_of(10.37, 0)
    assert np.abs(errors((1000, 20), wave, 0.0)).max() <= LARGE
    assert predicted((1000, 20), wave, 0.0).max() < LOCKED_SHARE


def test_layers_lock_like_rows() -> None:
    for cycles in ((0.1, 0.0, 0.0), (0.0, 0.0, 0.1)):
        said = locking_error(
            [0.25], profile=PROFILES["pwm"], cycles_per_pixel=cycles, extents_px=(100, 100, 100), width_per_pixel=1e-6
        )
        assert said.max() >= 0.05
    flat = locking_error(
        [0.25], profile=PROFILES["pwm"], cycles_per_pixel=(0, 0.1), extents_px=(100, 100), width_per_pixel=1e-6
    )
    assert said.max() == pytest.approx(flat.max(), rel=1e-3)


def test_each_material_has_its_own_error() -> None:
    """10 pixels a period, up to 0.25, 0.5 and 1: faces at 2.5 pixels lock, those at 5 do not."""
    said = locking_error(
        [0.25, 0.5],
        profile=PROFILES["symmetric"],
        cycles_per_pixel=(0.1, 0),
        extents_px=(200, 160),
        width_per_pixel=1e-6,
    )
    assert said[0] == pytest.approx(said[1], rel=0.01)
    assert said[0] > 0.05
    assert said[2] < 0.002


@pytest.mark.parametrize("bandwidth", [0.25, pytest.param(0.5, marks=pytest.mark.slow)])
def test_deviation_of_a_wandering_laminate(bandwidth: float) -> None:
    """Along the rows, the errors of 50 parts have the standard deviation predicted, within a third."""
    for period_px in (10.0, 8.0):
        wave, width = wave_of(period_px, 0), bandwidth / period_px
        measured = np.sqrt(np.mean(errors((200, 160), wave, width, ratios=(0.05, 0.25)) ** 2, axis=0))
        expected = locked_deviation(
            0,
            [0.05, 0.25],
            profile=PROFILES["pwm"],
            cycles_per_pixel=wave,
            extents_px=(200, 160),
            width_per_pixel=width,
        )
        print(f"bandwidth {bandwidth}, {period_px} px: measured {measured.round(4)}, predicted {expected.round(4)}")
        assert np.all(np.abs(measured / expected - 1) < 0.34)


@pytest.mark.parametrize("period_px", [10.0, 8.0])
@pytest.mark.parametrize(("azimuth", "bandwidth"), [(0.0, 0.0), (0.0, 0.05), (45.0, 0.0), (7.0, 0.0)])
def test_no_missed_warning(period_px: float, azimuth: float, bandwidth: float) -> None:
    assert_no_missed_warning((200, 160), period_px, azimuth, bandwidth)


@pytest.mark.parametrize("period_px", [p for p in PERIODS_PX if p >= 8])
@pytest.mark.parametrize("azimuth", AZIMUTHS)
@pytest.mark.parametrize("bandwidth", [0.25, *(pytest.param(b, marks=pytest.mark.slow) for b in (0.5, 1.0))])
def test_ordinary_jobs_are_silent(period_px: float, azimuth: float, bandwidth: float) -> None:
    """20 periods a side, at least 8 pixels each, and a bandwidth of at least 0.25."""
    side = round(20 * period_px)
    assert predicted((side, side), wave_of(period_px, azimuth), bandwidth / period_px).max() < LOCKED_SHARE


@pytest.mark.slow
@pytest.mark.parametrize("extents", [(200, 160), (90, 64)])
@pytest.mark.parametrize("bandwidth", [0.0, 0.02, 0.05, 0.1, 0.25, 0.5])
def test_never_a_missed_warning(extents: tuple[int, int], bandwidth: float) -> None:
    for period_px, azimuth in product(PERIODS_PX, AZIMUTHS):
        assert_no_missed_warning(extents, period_px, azimuth, bandwidth)
