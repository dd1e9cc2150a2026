"""Proof: a window's share scatters about the ratio as `spread` says, and never beyond its limit.

(got - asked)/σ of many windows has a root mean square of 1 if σ is right. σ joins the noise's own spread and what
sampling adds, for the laminate's normal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from scipy import integrate, special

import amslicer
from amslicer.locking import locked_deviation
from amslicer.profiles import PROFILES
from amslicer.reference import symmetric_labels
from amslicer.spread import harmonic_variance, pixel_deviation, share_deviation, share_limit

Floats = NDArray[np.float64]
PITCH = parts.SQUARE["pitch_um"] / 1000  # periods of 1 mm
TWO = ((0.0, 0.15), (0.0, 0.3), (0.0, 0.5))
THREE = ((0.0, 0.2), (0.2, 0.7), (0.7, 1.0))
SMALLEST, LARGEST = 0.8, 1.05


# --- theory against numerical integrals and limits ---------------------------------------------------------


def coherence(order: int, r: Floats | float) -> Floats:
    h = order
    scale = special.gamma(1 + h / 2) ** 2 / special.gamma(1 + h)
    return np.asarray(r**h * scale * special.hyp2f1(h / 2, h / 2, h + 1, np.square(r)))


@pytest.mark.parametrize("order", [1, 2, 5])
@pytest.mark.parametrize("bandwidth", [0.25, 1.0])
def test_harmonic_variance_is_the_double_integral(order: int, bandwidth: float) -> None:
    sides, normal = np.array([2.3, 1.7]), np.array([np.cos(0.4), np.sin(0.4)])

    def covariance(y: float, x: float) -> float:
        r = math.exp(-math.pi * bandwidth**2 * (x * x + y * y) / 2)
        overlap = (1 - abs(x) / sides[0]) * (1 - abs(y) / sides[1]) / (sides[0] * sides[1])
        waves = math.cos(2 * math.pi * order * normal[0] * x) * math.cos(2 * math.pi * order * normal[1] * y)
        return float(4 * overlap * coherence(order, min(r, 1 - 1e-12)) * waves)

    expected, _ = integrate.dblquad(covariance, 0, sides[0], 0, sides[1], epsabs=2e-7, epsrel=1e-4)
    assert harmonic_variance(order, sides, order * normal, bandwidth) == pytest.approx(expected, rel=0.01, abs=1e-6)


def test_without_bandwidth_it_is_a_grating() -> None:
    """The mean of cos(hk·x) over a box is Π sinc(h n_i L_i), at a random phase."""
    sides, normal = np.array([2.3, 1.7]), np.array([np.cos(0.4), np.sin(0.4)])
    for order in (1, 2, 3, 7):
        expected = np.prod(np.sinc(order * normal * sides)) ** 2
        assert harmonic_variance(order, sides, order * normal, 1e-9) == pytest.approx(expected, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("profile", ["symmetric", "cyclic"])
@pytest.mark.parametrize(("low", "high"), [(0.0, 0.25), (0.2, 0.7), (0.7, 1.0)])
def test_amplitudes_are_those_of_the_indicator(low: float, high: float, profile: str) -> None:
    phase = (np.arange(100_000) + 0.5) / 100_000 * 2 * np.pi - np.pi
    share = np.abs(phase) / np.pi if profile == "symmetric" else phase / (2 * np.pi) % 1
    inside = (share >= low) & (share < high)
    measured = [2 * abs(np.mean(inside * np.exp(1j * h * phase))) for h in range(1, 13)]
    np.testing.assert_allclose(np.abs(PROFILES[profile].amplitudes(low, high, 12)), measured, atol=1e-4)


def test_a_point_is_one_material_or_another() -> None:
    for low, high in (*TWO, *THREE):
        share = high - low
        got = share_deviation(
            low, high, profile=PROFILES["pwm"], bandwidth=0.5, dimensions=2, window_periods=(1e-3, 1e-3)
        )
        assert got == pytest.approx(math.sqrt(share * (1 - share)), rel=0.02)


def test_windows_broadcast() -> None:
    high = np.linspace(0.1, 0.9, 9)[:, None]
    windows = np.array([(2.0, 3.0), (4.0, 4.0)])
    got = share_deviation(
        0, high, profile=PROFILES["pwm"], bandwidth=0.5, dimensions=2, window_periods=windows, filled=[1, 0.4]
    )
    assert got.shape == (9, 2)
    np.testing.assert_allclose(got, got[::-1], rtol=1e-9)  # a share and its complement scatter alike
    one = share_deviation(
        0, 0.3, profile=PROFILES["pwm"], bandwidth=0.5, dimensions=2, window_periods=(4.0, 4.0), filled=0.4
    )
    assert got[2, 1] == pytest.approx(float(one))


def test_a_thinner_filling_scatters_more() -> None:
    filled = np.linspace(0.05, 1, 40)
    got = share_deviation(
        0, 0.3, profile=PROFILES["pwm"], bandwidth=0.5, dimensions=2, window_periods=(4.0, 4.0), filled=filled
    )
    assert np.all(np.diff(got) <= 1e-9)
    assert got[-1] == share_deviation(
        0, 0.3, profile=PROFILES["pwm"], bandwidth=0.5, dimensions=2, window_periods=(4.0, 4.0)
    )


# --- theory against the engine -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Labels by |arg G|/π, (rows, columns) or (layers, rows, columns), and the laminate that made them."""

    phase: NDArray[np.float32]
    normal: Floats
    bandwidth: float
    dimensions: int


def flat(folder: Path, bandwidth: float, azimuth: float, seed: int, size_mm: float) -> Case:
    job = parts.job(parts.plate(folder, size_mm, size_mm), orientation=azimuth, bandwidth=bandwidth, seed=seed)
    angle = np.deg2rad(azimuth)
    return Case(phases(amslicer.field(job, 0)), np.array([np.cos(angle), np.sin(angle), 0]), bandwidth, 2)


def solid(
    folder: Path, bandwidth: float, azimuth: float, elevation: float, size_mm: tuple[float, float, float]
) -> Case:
    job = parts.job(
        parts.box(folder, size_mm), orientation={"azimuth": azimuth, "elevation": elevation}, dimensions=3,
        bandwidth=bandwidth, seed=3,
    )  # fmt: skip
    layers = int(size_mm[2] / PITCH)
    a, e = np.deg2rad((azimuth, elevation))
    normal = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    return Case(np.stack([phases(amslicer.field(job, i)) for i in range(layers)]), normal, bandwidth, 3)


def phases(g: NDArray[np.complex64]) -> NDArray[np.float32]:
    return (np.abs(np.angle(g)) / np.pi).astype(np.float32)


def means(values: NDArray[np.generic], window_px: tuple[int, ...]) -> Floats:
    """Means of all whole windows, axes in the array's order."""
    counts = [n // w for n, w in zip(values.shape, window_px, strict=True)]
    cut = values[tuple(slice(0, c * w) for c, w in zip(counts, window_px, strict=True))]
    split = cut.reshape([n for pair in zip(counts, window_px, strict=True) for n in pair])
    return np.asarray(split.mean(axis=tuple(range(1, 2 * values.ndim, 2)), dtype=np.float64)).ravel()


def scores(case: Case, periods: float | tuple[float, float, float]) -> Iterator[tuple[Floats, Floats]]:
    """(got - asked)/σ and |got - asked|/limit of all windows, material by material."""
    lengths = periods if isinstance(periods, tuple) else (periods,) * 2
    window = tuple(round(n / PITCH) for n in lengths)  # x, y (, z)
    sides = np.array(window) * PITCH
    axes = len(window)
    for low, high in (*TWO, *THREE):
        inside = (case.phase >= low) & (case.phase < high)
        error = means(inside, window[::-1]) - (high - low)
        sampling = locked_deviation(
            low, high, profile=PROFILES["symmetric"], cycles_per_pixel=case.normal[:axes] * PITCH, extents_px=window,
            width_per_pixel=case.bandwidth * PITCH,
        )  # fmt: skip
        sigma = share_deviation(
            low, high, profile=PROFILES["symmetric"], bandwidth=case.bandwidth, dimensions=case.dimensions,
            window_periods=sides, normal=case.normal,
        )  # fmt: skip
        limit = share_limit(
            low, high, profile=PROFILES["symmetric"], bandwidth=case.bandwidth, dimensions=case.dimensions,
            window_periods=sides, normal=case.normal, pixels=sampling,
        )  # fmt: skip
        yield error / np.hypot(sigma, sampling), np.abs(error) / limit


def rms(z: Floats) -> float:
    return float(np.sqrt(np.mean(z**2)))


def chance(z: Floats) -> float:
    """Standard error of the rms, from the sample's own fourth moment: shares of few periods are not Gaussian."""
    return float(np.std(z**2) / math.sqrt(len(z)) / (2 * rms(z)))


def assert_unit(z: Floats, name: str) -> None:
    assert SMALLEST - 3 * chance(z) <= rms(z) <= LARGEST + 3 * chance(z), name


@pytest.mark.parametrize("azimuth", [0, 27, 45])
def test_windows_of_a_plate(tmp_path: Path, azimuth: float) -> None:
    case = flat(tmp_path, 0.5, azimuth, 1, 80)
    for periods in (2.0, 3.0, 5.0):
        for z, beyond in scores(case, periods):
            print(
                f"{azimuth}° {periods} periods, {len(z)} windows: rms {rms(z):.2f}, at most {beyond.max():.2f} limits"
            )
            assert SMALLEST <= rms(z) <= LARGEST + 2 / math.sqrt(2 * len(z))
            assert beyond.max() <= 1


def test_windows_of_a_block(tmp_path: Path) -> None:
    for z, beyond in scores(solid(tmp_path, 0.5, 27, 35, (20, 20, 6)), (2.0, 2.0, 2.0)):
        name = f"{len(z)} windows: rms {rms(z):.2f} ± {chance(z):.2f}"
        print(f"{name}, at most {beyond.max():.2f} limits")
        assert_unit(z, name)
        assert beyond.max() <= 1


def test_three_materials_are_those_of_the_symmetric_profile(tmp_path: Path) -> None:
    job = parts.job(parts.plate(tmp_path, 20, 20), orientation=27)
    g = amslicer.field(job, 0)
    labels = symmetric_labels(g, np.array([0.2, 0.7])[:, None, None])
    phase = phases(g)
    for material, (low, high) in enumerate(THREE, 1):
        assert np.mean((labels == material) != ((phase >= low) & (phase < high))) < 1e-5


def test_a_wrong_spread_shows(tmp_path: Path) -> None:
    """The measure can fail: σ of another bandwidth, or of another direction, is seen at once."""
    case = flat(tmp_path, 0.5, 27, 1, 80)
    for other in (Case(case.phase, case.normal, 1.0, 2), Case(case.phase, np.array([1.0, 0, 0]), 0.5, 2)):
        for z, _ in scores(other, 3.0):
            with pytest.raises(AssertionError):
                assert_unit(z, "wrong")


Mask = Callable[[Floats, Floats], NDArray[np.bool_]]
# Parts that fill windows of 3 periods in part, at x, y in periods.
MASKS: dict[str, Mask] = {
    "discs": lambda x, y: np.hypot(x % 12.7 - 6.35, y % 12.7 - 6.35) < 5.1,
    "small discs": lambda x, y: np.hypot(x % 3.1 - 1.55, y % 3.1 - 1.55) < 0.9,
    "rings": lambda x, y: np.abs(np.hypot(x % 17.3 - 8.65, y % 17.3 - 8.65) - 6.1) < 0.6,
    "halves": lambda x, y: (x % 7.1 < 3.4) & (y == y),
    "walls": lambda x, y: (y % 4.3 < 0.6) & (x == x),
}


@pytest.mark.parametrize("masked", MASKS)
@pytest.mark.parametrize("azimuth", [0, 27])
def test_windows_filled_in_part(tmp_path: Path, azimuth: float, masked: str) -> None:
    """σ is never too small there, and no window is beyond its limit."""
    check_filled(flat(tmp_path, 0.5, azimuth, 1, 80), masked, 3.0)


def check_filled(case: Case, masked: str, periods: float) -> None:
    window = (round(periods / PITCH),) * 2
    x, y = parts.centres(case.phase.shape, (PITCH, PITCH))
    mask = MASKS[masked](x, y)
    filled = means(mask, window)
    kept = (filled > 0.03) & (filled < 1)
    filled = filled[kept]
    for low, high in (*TWO, *THREE[1:2]):
        got = means(mask & (case.phase >= low) & (case.phase < high), window)[kept] / filled
        sampling = pixel_deviation(
            low, high, dimensions=2, pixels_per_period=1 / PITCH, pixels=filled * math.prod(window)
        )
        sigma = share_deviation(
            low, high, profile=PROFILES["symmetric"], bandwidth=case.bandwidth, dimensions=2,
            window_periods=np.array(window) * PITCH, filled=filled, normal=case.normal,
        )  # fmt: skip
        limit = share_limit(
            low, high, profile=PROFILES["symmetric"], bandwidth=case.bandwidth, dimensions=2,
            window_periods=np.array(window) * PITCH, filled=filled, normal=case.normal, pixels=sampling,
        )  # fmt: skip
        error = got - (high - low)
        z = error / np.hypot(sigma, sampling)
        print(f"{masked} {low} {high}: {len(z)} windows, rms {rms(z):.2f}, {np.max(np.abs(error) / limit):.2f} limits")
        assert rms(z) <= 1
        assert np.all(np.abs(error) <= limit + 1e-9)


# --- the long proofs ---------------------------------------------------------------------------------------


def assert_spread(found: list[tuple[str, Floats, Floats]]) -> None:
    """Each set's rms is 1 within its bounds; of all windows 95 % are within 2σ, and none is beyond its limit."""
    for name, z, beyond in found:
        inside = np.mean(np.abs(z) < 2)
        print(
            f"{name}: {len(z)} shares, rms {rms(z):.2f} ± {chance(z):.2f}, {inside:.3f} within 2σ, at most "
            f"{np.abs(z).max():.1f}σ and {beyond.max():.2f} limits"
        )
    z = np.concatenate([z for _, z, _ in found])
    print(f"{len(z)} in all, rms {rms(z):.3f}, {np.mean(np.abs(z) < 2):.4f} within 2σ")
    assert len(z) >= 10_000
    assert np.mean(np.abs(z) < 2) >= 0.95
    assert max(beyond.max() for *_, beyond in found) <= 1
    for name, z, _ in found:
        assert_unit(z, name)


@pytest.mark.slow
@pytest.mark.parametrize("bandwidth", [0.25, 0.5, 1.0])
def test_many_plates(tmp_path: Path, bandwidth: float) -> None:
    found = []
    for azimuth in (0, 10, 20, 27, 45):
        cases = [flat(tmp_path, bandwidth, azimuth, seed, 100) for seed in (1, 2, 3)]
        for periods in (2.0, 2.5, 3.0, 5.0, 10.0):
            results = [list(scores(case, periods)) for case in cases]
            for i, (low, high) in enumerate((*TWO, *THREE)):
                z, beyond = (np.concatenate([r[i][k] for r in results]) for k in (0, 1))
                found.append((f"B {bandwidth} {azimuth}° {periods} periods {low} to {high}", z, beyond))
    assert_spread(found)


@pytest.mark.slow
@pytest.mark.parametrize("bandwidth", [0.25, 0.5, 1.0])
def test_many_blocks(tmp_path: Path, bandwidth: float) -> None:
    found = []
    for azimuth, elevation in ((27, 35), (0, 0), (0, 90), (70, 10)):
        case = solid(tmp_path, bandwidth, azimuth, elevation, (30, 30, 12))
        for periods in ((2.0, 2.0, 2.0), (3.0, 3.0, 2.0)):
            found += [
                (f"B {bandwidth} {azimuth}° {elevation}° {periods} material {i}", z, beyond)
                for i, (z, beyond) in enumerate(scores(case, periods))
            ]
    assert_spread(found)


@pytest.mark.slow
@pytest.mark.parametrize("masked", MASKS)
@pytest.mark.parametrize("bandwidth", [0.25, 0.5, 1.0])
def test_many_windows_filled_in_part(tmp_path: Path, bandwidth: float, masked: str) -> None:
    for azimuth in (0, 10, 27, 45):
        for seed in (1, 2):
            case = flat(tmp_path, bandwidth, azimuth, seed, 100)
            for periods in (2.0, 3.0, 5.0):
                check_filled(case, masked, periods)
