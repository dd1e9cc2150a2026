"""Proof: a painted period is met everywhere, by kernels whose density follows it, and leaves the ratio alone.

1 to 3 mm along 60 mm, judged in bands of 10 mm that hold 10 to 3 periods; one plate scatters by some percent there, so
that figures are means of several seeds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import parts
import pytest
from numpy.typing import NDArray

import amslicer
from amslicer.noise.phasor import Phasor
from amslicer.reference import cell_words

Floats = NDArray[np.float64]

LENGTH, DEPTH, BAND = 60.0, 120.0, 10.0  # mm
SHORTEST, LONGEST = 1.0, 3.0
PERIOD = {"gradient": {"axis": "x", "from": SHORTEST, "to": LONGEST}}
LIMIT = 0.03
PRINTER = {"pitch_um": 97, "layer_um": 97}
PITCH = 0.097
BANDWIDTH = 0.5
STARTS = np.arange(0, LENGTH, BAND)


def period_at(x: Floats) -> Floats:
    return SHORTEST + (LONGEST - SHORTEST) * x / LENGTH


def mean_power(power: int) -> Floats:
    """Mean of p^-power over each band, by Simpson's rule on the formula."""
    x = STARTS[:, None] + np.linspace(0, BAND, 1001)[None, :]
    weights = np.ones(1001)
    weights[1:-1:2], weights[2:-1:2] = 4, 2
    return np.asarray((period_at(x) ** -power * weights).sum(axis=1) / weights.sum())


def share(band: NDArray[np.generic]) -> float:
    """Of the first material in what is solid: rows whose centres lie beyond the part are empty."""
    return np.count_nonzero(band == 1) / np.count_nonzero(band)


def bands(values: NDArray[np.generic]) -> list[NDArray[np.generic]]:
    """Columns of each band."""
    x = (np.arange(values.shape[1]) + 0.5) * PITCH
    return [values[:, (x >= start) & (x < start + BAND)] for start in STARTS]


def assert_periods(name: str, wave_numbers: list[list[float]]) -> None:
    """Judges mean wave numbers (cycles per mm) of each band, of several seeds."""
    measured, expected = np.mean(wave_numbers, axis=0), mean_power(1)
    scatter = np.std(wave_numbers, axis=0, ddof=1) / np.mean(wave_numbers, axis=0)
    for start, got, asked, one in zip(STARTS, measured, expected, scatter, strict=True):
        print(
            f"{name}: x {start:2.0f} to {start + BAND:2.0f} mm painted {1 / asked:.3f} mm, measured {1 / got:.3f} mm "
            f"({100 * (asked / got - 1):+.2f} %, one plate ± {100 * one:.1f} %)"
        )
    np.testing.assert_allclose(1 / measured, 1 / expected, rtol=LIMIT)


def crossings(labels: NDArray[np.uint8]) -> list[float]:
    """Cycles per mm of each band from the changes of material along y, the normal.

    The two phases where materials meet are passed at the rate √(k² + σ²)/2π each (Rice 1944), σ² = πb².
    """
    per_mm = [np.mean(np.diff(band, axis=0) != 0) / PITCH for band in bands(labels[labels.any(axis=1)])]
    return [rate / (2 * np.sqrt(1 + BANDWIDTH**2 / (4 * np.pi))) for rate in per_mm]


def plate(folder: Path, seed: int, orientation: float, period: object = PERIOD) -> amslicer.Job:
    return parts.job(
        parts.plate(folder, LENGTH, DEPTH), ratio=0.3, orientation=orientation, period=period, seed=seed,
        printer=PRINTER,
    )  # fmt: skip


def check_labels(folder: Path, seeds: range, period: object = PERIOD) -> None:
    assert_periods("labels", [crossings(parts.bitmap(plate(folder, seed, 90, period))) for seed in seeds])


def test_local_period(tmp_path: Path) -> None:
    check_labels(tmp_path, range(1, 13))


@pytest.mark.slow
def test_local_period_of_many_seeds(tmp_path: Path) -> None:
    check_labels(tmp_path, range(21, 85))


def test_limits_notice_a_period_that_is_off(tmp_path: Path) -> None:
    with pytest.raises(AssertionError):
        check_labels(tmp_path, range(1, 4), {"gradient": {"axis": "x", "from": 1.05 * SHORTEST, "to": LONGEST}})


@pytest.mark.slow
def test_local_wave(tmp_path: Path) -> None:
    """|k| of an oblique laminate, from how far G turns between neighbouring pixels along x and y."""
    found = []
    for seed in range(1, 25):
        waves = []
        for band in bands(amslicer.field(plate(tmp_path, seed, 27), 0)):
            along_x, along_y = np.sum(band[:, 1:] * band[:, :-1].conj()), np.sum(band[:-1] * band[1:].conj())
            waves.append(float(np.hypot(np.angle(along_x), np.angle(along_y)) / (2 * np.pi * PITCH)))
        found.append(waves)
    assert_periods("wave of G", found)


def check_ratio(folder: Path, seeds: range) -> None:
    """The mean of some seeds, each band within 4σ: 0.075 B sin(πρ) / √(periods²) of one."""
    shares = np.array([[share(band) for band in bands(parts.bitmap(plate(folder, seed, 27)))] for seed in seeds])
    sigma = 0.075 * BANDWIDTH * np.sin(0.3 * np.pi) / np.sqrt(mean_power(2) * BAND * DEPTH)
    print(
        "ratio 0.3 asked, got " + ", ".join(f"{s:.4f} (σ {d:.4f})" for s, d in zip(shares.mean(0), sigma, strict=True))
    )
    print("scatter of one plate over theory: " + ", ".join(f"{r:.2f}" for r in shares.std(axis=0, ddof=1) / sigma))
    assert np.all(np.abs(shares.mean(axis=0) - 0.3) <= 4 * sigma / np.sqrt(len(seeds)))


def test_ratio(tmp_path: Path) -> None:
    check_ratio(tmp_path, range(1, 5))


@pytest.mark.slow
def test_ratio_of_many_seeds(tmp_path: Path) -> None:
    check_ratio(tmp_path, range(11, 43))


@pytest.mark.slow
def test_ratio_in_space(tmp_path: Path) -> None:
    """Blocks 10 mm high: each band's mean of 8 seeds within 4σ of the plane's law, which is the larger one."""
    shares = []
    for seed in range(1, 9):
        job = parts.job(
            parts.box(tmp_path, (LENGTH, 20, 10)), ratio=0.3, orientation={"azimuth": 27, "elevation": 35},
            period=PERIOD, dimensions=3, seed=seed, printer={"pitch_um": 97, "layer_um": 194},
        )  # fmt: skip
        labels = parts.labels(job)
        shares.append([share(band) for band in bands(labels.reshape(-1, labels.shape[-1]))])
    sigma = 0.075 * BANDWIDTH * np.sin(0.3 * np.pi) / np.sqrt(mean_power(2) * BAND * 20 * len(shares))
    error = np.mean(shares, axis=0) - 0.3
    print("in space: " + ", ".join(f"{e:+.4f} (σ {s:.4f})" for e, s in zip(error, sigma, strict=True)))
    assert np.all(np.abs(error) <= 4 * sigma)


# --- kernels -----------------------------------------------------------------------------------------------


class Twin:
    """The reference as a generator of random words."""

    def words(
        self, first: tuple[int, int, int], count: tuple[int, int, int], per_cell: int, seed: int, number: int
    ) -> NDArray[np.uint32]:
        z, y, x = np.meshgrid(*(first[a] + np.arange(count[a]) for a in (2, 1, 0)), indexing="ij")
        return cell_words(np.stack([x, y, z], axis=-1), per_cell, seed, number)

    def normal_fields(self, *_: object) -> NDArray[np.float32]:
        raise AssertionError("a laminate's directions are not turned")


class Graded:
    """A straight laminate whose period is the formula's."""

    is_laminate = True
    period_bounds_mm = (SHORTEST, LONGEST)

    def normals(self, points_mm: Floats) -> Floats:
        return np.broadcast_to([0.6, 0.8, 0.0], points_mm.shape)

    def isotropies(self, points_mm: Floats) -> Floats:
        return np.zeros(len(points_mm))

    def envelope_periods(self, points_mm: Floats, periods_mm: Floats) -> Floats:
        return periods_mm

    def periods(self, points_mm: Floats) -> Floats:
        return period_at(np.clip(points_mm[:, 0], 0, LENGTH))


@pytest.mark.parametrize("impulses", [4.0, 2.5])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_density_of_kernels(dimensions: int, impulses: float) -> None:
    """Λ (B/p)^d per mm^d in every band, within 4 standard deviations of counts; none without its own wave."""
    noise = Phasor((SHORTEST, LONGEST), BANDWIDTH, dimensions, seed=3, impulses=impulses)
    depth, height = (DEPTH, 1.0) if dimensions == 2 else (60.0, 12.0)
    corners = np.zeros(2), np.array([LENGTH, depth])
    counts = np.zeros(len(STARTS))
    for number in noise.cell_layers(0, height):
        kernels = noise.kernels(Twin(), number, *corners, Graded())
        x, y, z = kernels.centre_mm.T
        inside = (x >= 0) & (x < LENGTH) & (y >= 0) & (y < depth) & (z >= 0) & (z < height)
        counts += np.histogram(x[inside], bins=[*STARTS, LENGTH])[0]
        wave, width = np.linalg.norm(kernels.wave, axis=1), np.sqrt(kernels.decay / np.pi)
        painted = period_at(np.clip(x, 0, LENGTH))
        np.testing.assert_allclose(wave * painted, 2 * np.pi, rtol=1e-12)
        np.testing.assert_allclose(width * painted, BANDWIDTH, rtol=1e-12)
    expected = impulses * BANDWIDTH**dimensions * mean_power(dimensions) * BAND * depth * height
    print(f"{dimensions}D, Λ {impulses}: kernels {counts.astype(int).tolist()}, expected {np.round(expected, 1)}")
    assert np.all(np.abs(counts - expected) <= 4 * np.sqrt(expected))
    assert np.any(np.abs(counts - expected[::-1]) > 4 * np.sqrt(expected))
