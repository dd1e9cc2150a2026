"""Proof: sheets in step with the pixels lose their ratio by rounding; dithered edges do not, and sharp ones are told.

Straight sheets along the pixel rows (bandwidth 0.005), as an exact plane wave at 50 phases through the kernel of the
profile, and as whole jobs. What is asked is the ratio itself: the plate holds a whole number of periods.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from test_kernels import device_labels

import amslicer
from amslicer.device import Device
from amslicer.pipeline import prepare

PHASES = 50
PERIODS_PX = (10.0, 8.0, 7.5, 12.5, 6.0)
RATIOS = (0.25, 0.1, 0.5)
ROWS, COLUMNS = 1200, 320  # 120, 150, 160, 96 and 200 periods
LIMIT, NOTED = 0.005, 0.01


def worst_error(device: Device, period_px: float, ratio: float, *, dithered: bool) -> float:
    """Over 50 phases, of a perfect grating along the rows."""
    rows = np.arange(ROWS)
    padded = -(-ROWS // 32) * 32
    worst = 0.0
    for number in range(PHASES):
        phase = (
            2 * np.pi * ((np.arange(padded) + 0.5) / period_px + (number + 0.377) / PHASES)
        )  # no edge on a pixel's centre
        g = np.broadcast_to(np.exp(1j * phase)[None, :, None], (1, padded, COLUMNS)).astype(np.complex64)
        wave = np.array([0.0, 2 * np.pi / period_px, 0.0]) if dithered else None
        labels = device_labels(
            device, g, np.full((1, 1, 1), ratio), np.ones(g.shape, np.uint8), wave=wave, seed=number
        )  # fmt: skip
        worst = max(worst, abs(float(np.mean(labels[:, rows] == 1)) - ratio))
    return worst


@pytest.mark.parametrize("period_px", PERIODS_PX)
def test_dithered_edges_keep_the_ratio_at_every_phase(device: Device, period_px: float) -> None:
    for ratio in RATIOS:
        sharp, dithered = (worst_error(device, period_px, ratio, dithered=d) for d in (False, True))
        print(f"{period_px:4} px, ratio {ratio}: worst of {PHASES} phases {sharp:.4f} sharp, {dithered:.4f} dithered")
        assert dithered <= LIMIT
        if period_px == 10 and ratio == 0.25:  # 2 or 3 of 10 pixels
            assert sharp == pytest.approx(0.05, abs=0.001)


def straight(folder: Path, period_px: float, ratio: float, **pattern: Any) -> amslicer.Job:
    """A plate of 24 mm whose sheets run along the rows, a pixel being 1/10 mm."""
    return parts.job(
        parts.plate(folder, 24, 24), ratio=ratio, orientation=90, printer={"pitch_um": 100, "layer_um": 100},
        period=period_px / 10, **{"bandwidth": 0.005, **pattern},
    )  # fmt: skip


def locked(job: amslicer.Job) -> list[str]:
    return [note for note in prepare(job).notes() if "in step with the grid" in note]


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("period_px", PERIODS_PX)
def test_a_job_that_loses_its_ratio_is_told(tmp_path: Path, device: Device, period_px: float, ratio: float) -> None:
    """No sharp grating that is off by more than 1 % goes without a note."""
    error = worst_error(device, period_px, ratio, dithered=False)
    notes = locked(straight(tmp_path, period_px, ratio))
    print(f"{period_px} px, ratio {ratio}: off by up to {100 * error:.1f} %: {notes}")
    if error > NOTED:
        assert len(notes) == 1
        assert f"{period_px:.2f} pixels along y" in notes[0]
        assert "pattern.edges" in notes[0]
    assert locked(straight(tmp_path, period_px, ratio, edges="dithered")) == []


@pytest.mark.parametrize("edges", ["sharp", "dithered"])
def test_whole_jobs(tmp_path: Path, edges: str) -> None:
    """Eight seeds of a real, almost regular laminate of 10 pixels: the worst is off by percents, or by hardly any."""
    errors = [
        np.mean(parts.bitmap(straight(tmp_path, 10.0, 0.25, edges=edges, seed=seed)) == 1) - 0.25
        for seed in range(1, 9)
    ]
    print(f"{edges}: " + ", ".join(f"{100 * error:+.2f} %" for error in errors))
    if edges == "sharp":
        assert np.abs(errors).max() > 0.03
    else:
        assert np.abs(errors).max() <= LIMIT


@pytest.mark.parametrize("name", ["cross_plate", "insole"])
def test_samples_are_not_in_step(name: str) -> None:
    folder = Path(__file__).resolve().parents[1] / "samples" / name
    assert locked(amslicer.load_job(folder / "fields.yaml", part=folder / f"{name}.stl")) == []


@pytest.mark.parametrize("change", [{"bandwidth": 0.5}, {"period": 1.037}])
def test_ordinary_laminates_are_not_in_step(tmp_path: Path, change: dict[str, Any]) -> None:
    """The default bandwidth wanders; 10.37 pixels meet the grid anew in every sheet."""
    part = parts.plate(tmp_path, 40, 40)
    printer = {"pitch_um": 100, "layer_um": 100}
    settings = {"bandwidth": 0.02, "period": 1.0, **change}
    assert locked(parts.job(part, ratio=0.25, orientation=90, printer=printer, **settings)) == []


@pytest.mark.parametrize("dimensions", [2, 3])
def test_dithered_stacks_are_the_same_however_cut(tmp_path: Path, dimensions: int) -> None:
    part = parts.box(tmp_path, (9.0, 7.2, 3.0))
    job = parts.job(part, ratio=0.3, orientation=20, dimensions=dimensions, edges="dithered", printer={
        "pitch_um": 120, "layer_um": 120,
    })  # fmt: skip
    whole = parts.labels(job)
    assert np.array_equal(parts.labels(job, 5, 17), whole[5:17])
    one = np.stack([layer.labels for layer in amslicer.layers(job, amslicer.Run(jobs=1))])
    assert np.array_equal(one, whole)
    assert set(np.unique(whole)) == {1, 2}  # every pixel of a box has one material
    same = all(np.array_equal(layer, whole[0]) for layer in whole)
    assert same == (dimensions == 2)
