"""Proof: dithered edges have the painted ratio in space too, also where sheets lie in step with the layers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import parts
import pytest

import amslicer

SHEET = {"azimuth": 0, "elevation": 90}


def share(job: amslicer.Job) -> float:
    labels = parts.labels(job)
    return np.count_nonzero(labels == 1) / np.count_nonzero(labels)


def errors_in_step(folder: Path, edges: str) -> parts.Floats:
    """Of four blocks of 10 layers per period, almost regular sheets in the layers: ¼ is 2 or 3 of 10 layers."""
    part = parts.box(folder, (4, 4, 10))
    jobs = [
        parts.job(
            part, ratio=0.25, orientation=SHEET, dimensions=3, bandwidth=0.02, seed=seed, edges=edges,
            printer={"pitch_um": 100, "layer_um": 100},
        )
        for seed in range(1, 5)
    ]  # fmt: skip
    return np.array([share(job) for job in jobs]) - 0.25


def test_sheets_in_step_with_the_layers(tmp_path: Path) -> None:
    errors = {edges: errors_in_step(tmp_path, edges) for edges in ("sharp", "dithered")}
    for edges, error in errors.items():
        print(f"{edges}: " + ", ".join(f"{100 * e:+.2f} %" for e in error))
    assert np.abs(errors["sharp"]).max() > 0.03
    assert np.abs(errors["dithered"]).max() <= 0.005


@pytest.mark.parametrize("bandwidth", [0.5, pytest.param(1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("ratio", [0.1, pytest.param(0.25, marks=pytest.mark.slow)])
def test_ratio_of_a_solid_laminate(tmp_path: Path, ratio: float, bandwidth: float) -> None:
    """Four seeds within 4σ of the ratio; 4 pixels per period, where sharp edges are coarse."""
    part, found = parts.box(tmp_path, (20, 20, 5)), []
    for seed in range(1, 5):
        job = parts.job(
            part, ratio=ratio, orientation={"azimuth": 27, "elevation": 35}, dimensions=3, bandwidth=bandwidth,
            seed=seed, edges="dithered", printer={"pitch_um": 230, "layer_um": 170},
        )  # fmt: skip
        found.append(share(job))
    sigma = 0.075 * bandwidth * np.sin(np.pi * ratio) / np.sqrt(400)
    print(f"bandwidth {bandwidth}: asked {ratio}, got {np.mean(found):.4f} (σ of one block at most {sigma:.4f})")
    assert abs(np.mean(found) - ratio) <= 4 * sigma / np.sqrt(len(found))
