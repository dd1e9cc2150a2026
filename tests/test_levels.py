"""Periods graded by more than an octave: levels of kernels that meet without a seam, and steps that stay steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import amslicer
from amslicer import analysis, envelope
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]

SIDE, PITCH = 60.0, 0.05  # mm
SHORTEST, LONGEST = 0.3, 6.0
GRADED = {"gradient": {"axis": "x", "from": SHORTEST, "to": LONGEST}}
STEP = {"expression": "where(x < 30, 0.3, 6)"}
BAND = 5.0
SEAMS = SHORTEST * 2.0 ** np.arange(1, 5)  # periods where levels meet
SEEDS = range(1, 7)


def plate(folder: Path, period: object, seed: int, angle: float) -> amslicer.Job:
    return parts.job(
        parts.plate(folder, SIDE, SIDE), ratio=0.3, orientation=angle, period=period, seed=seed,
        printer={"pitch_um": 1000 * PITCH, "layer_um": 50},
    )  # fmt: skip


def period_at(x: Floats) -> Floats:
    return SHORTEST + (LONGEST - SHORTEST) * x / SIDE


def test_the_local_period_is_the_painted_one(tmp_path: Path) -> None:
    """0.3 to 6 mm over 60 mm: |k| from how far G turns between neighbouring pixels, in bands of 5 mm, 2 % at most off.

    Each band holds 60 × 5 mm: more than 40 windows of a few periods in all seeds together, but for the last.
    """
    starts = np.arange(0, SIDE, BAND)
    found = []
    for seed in SEEDS:
        g = amslicer.field(plate(tmp_path, GRADED, seed, 27), 0)
        bands = np.split(g, len(starts), axis=1)
        turns = [(np.sum(b[:, 1:] * b[:, :-1].conj()), np.sum(b[:-1] * b[1:].conj())) for b in bands]
        found.append([np.hypot(np.angle(x), np.angle(y)) / (2 * np.pi * PITCH) for x, y in turns])
    asked = np.log(period_at(starts + BAND) / period_at(starts)) / (period_at(starts + BAND) - period_at(starts))
    error = asked / np.mean(found, axis=0) - 1
    print("period off by % " + ", ".join(f"{100 * e:+.1f}" for e in error))
    assert np.all(np.abs(error[:-1]) <= 0.03)
    assert abs(error[-1]) <= 0.06  # 0.8 periods wide, at the edge


def windings(g: NDArray[np.complex64]) -> Floats:
    """Per column, how many pixel squares to its right arg G turns around; 0 for the last."""
    return np.array([*(analysis.singularities(g[:, c : c + 2]) for c in range(g.shape[1] - 1)), 0], float)


def components(labels: NDArray[np.uint8]) -> Floats:
    """Per column, how many pieces of material 1 have their centre there."""
    pieces, count = ndimage.label(labels == 1)
    centres = np.array(ndimage.center_of_mass(labels == 1, pieces, np.arange(1, count + 1)))[:, 1]
    return np.bincount(np.rint(centres).astype(int), minlength=labels.shape[1]).astype(float)


def waves(g: NDArray[np.complex64], p: Floats) -> Floats:
    """Per column, the wave number that G turns by between neighbouring rows and columns, times the painted period."""
    across = np.sum(g[:, 1:] * g[:, :-1].conj(), axis=0)
    down = np.sum(g[:-1] * g[1:].conj(), axis=0)[:-1]
    return np.append(np.hypot(np.angle(across), np.angle(down)) / (2 * np.pi * PITCH), np.nan) * p


def test_levels_meet_without_a_seam(tmp_path: Path) -> None:
    """Singularities and pieces per period², period and |G|² beside the seams (to a fifth of an octave) as elsewhere."""
    x = (np.arange(round(SIDE / PITCH)) + 0.5) * PITCH
    p = period_at(x)
    beside = np.min(np.abs(np.log2(p[:, None] / SEAMS)), axis=1) < 0.2
    inner = (p > 1.2 * SHORTEST) & (p < LONGEST / 1.2)
    places = beside & inner, ~beside & inner
    measured: dict[str, list[list[float]]] = {}
    for seed in SEEDS:
        job = plate(tmp_path, GRADED, seed, 27)
        g = amslicer.field(job, 0)
        columns = {
            "singularities per period²": windings(g) * p**2 / (PITCH * SIDE),
            "pieces per period²": components(parts.bitmap(job)) * p**2 / (PITCH * SIDE),
            "wave number": waves(g, p),
            "|G|²": np.mean(np.abs(g) ** 2, axis=0),
        }
        for name, values in columns.items():
            measured.setdefault(name, []).append([float(np.nanmean(values[some])) for some in places])
    for name, found in measured.items():
        at, off = np.mean(found, axis=0)
        scatter = np.std(found, axis=0, ddof=1).max() / np.sqrt(len(SEEDS))
        print(f"{name}: beside seams {at:.4f}, elsewhere {off:.4f}, ± {scatter:.4f}")
        assert abs(at - off) <= 4 * scatter
        assert at / off == pytest.approx(1, abs=0.02 if name == "wave number" else 0.35)


def fine_share(folder: Path, seed: int) -> float:
    """Of the energy 1.5 to 3.5 mm inside the fine half, what has the fine period."""
    g = amslicer.field(plate(folder, STEP, seed, 90), 0)
    inside = g[:, round(26.5 / PITCH) : round(28.5 / PITCH)]
    power = np.abs(np.fft.fft(inside * np.hanning(len(inside))[:, None], axis=0)) ** 2
    return float(power[np.abs(np.fft.fftfreq(len(inside), PITCH)) > 0.5 / SHORTEST].sum() / power.sum())


def test_fine_sheets_stay_fine_beside_coarse_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = np.mean([fine_share(tmp_path, seed) for seed in SEEDS])
    monkeypatch.setattr(envelope, "SLOPE", 1e6)
    free = np.mean([fine_share(tmp_path, seed) for seed in SEEDS])
    print(f"fine energy 1.5 mm beside a step from 0.3 to 6 mm: {held:.4f}; with free envelopes {free:.2f}")
    assert held >= 0.9
    assert free < 0.9


def test_envelopes_are_held_back_by_distance_alone(tmp_path: Path) -> None:
    """Beside a step the envelope's period grows by 0.2 mm per mm; a gentle gradient keeps its own to the bit."""
    points = np.column_stack([np.linspace(0.5, 59.5, 60), np.full(60, 30.0), np.full(60, 0.02)])
    painted = prepare(plate(tmp_path, STEP, 1, 0)).painted
    periods = painted.periods(points)
    found = painted.envelope_periods(points, periods)
    expected = np.minimum(periods, 0.3 + 0.2 * np.maximum(points[:, 0] - 30, 0))
    np.testing.assert_allclose(found, expected, atol=0.05)
    gentle = prepare(plate(tmp_path, GRADED, 1, 0)).painted
    periods = gentle.periods(points)
    np.testing.assert_array_equal(gentle.envelope_periods(points, periods), periods)


def test_a_solid_laminate_of_a_graded_period(tmp_path: Path) -> None:
    """Ratio and cuts of a block whose period goes from 0.4 to 4 mm along x."""
    job = parts.job(
        parts.box(tmp_path, (30.0, 12.0, 6.0)), ratio=0.3, orientation={"azimuth": 60, "elevation": 20}, dimensions=3,
        period={"gradient": {"axis": "x", "from": 0.4, "to": 4}}, printer={"pitch_um": 60, "layer_um": 60},
    )  # fmt: skip
    labels = parts.labels(job)
    np.testing.assert_array_equal(parts.labels(job, 37, 39), labels[37:39])
    single = np.stack([layer.labels for layer in amslicer.layers(job, amslicer.Run(jobs=1))])
    np.testing.assert_array_equal(single, labels)
    fine = labels[:, :, :200]
    assert np.mean(fine[fine > 0] == 1) == pytest.approx(0.3, abs=0.005)
