"""Proof: the ratio that comes out is the ratio that was asked for.

The laminate is oblique (azimuth 27°, in space elevation 35°), so that no face of the part and no row of pixels runs
along its sheets: a plate whose sides lie along them gains or loses up to one sheet, which says nothing about the
noise. 12.05 pixels per period: a whole number would show every period to the same pixels.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import parts
import pytest

RATIOS = (0.10, 0.25, 0.50, 0.75)
BANDWIDTHS = (0.25, 0.5, 1.0)
LIMIT = 0.005
PLATE_MM = (52.0, 52.0)  # periods of 1 mm: 2704 periods²
BLOCK_MM = (20.0, 20.0, 5.0)  # 400 periods², 5 periods high
SEEDS = range(2, 10)


def got(folder: Path, dimensions: int, ratio: float, bandwidth: float, seed: int) -> float:
    if dimensions == 2:
        job = parts.job(parts.plate(folder, *PLATE_MM), ratio=ratio, orientation=27, bandwidth=bandwidth, seed=seed)
        labels = parts.bitmap(job)[None]
    else:
        job = parts.job(
            parts.box(folder, BLOCK_MM), ratio=ratio, orientation={"azimuth": 27, "elevation": 35},
            dimensions=3, bandwidth=bandwidth, seed=seed,
        )  # fmt: skip
        labels = parts.labels(job)
    return np.count_nonzero(labels == 1) / np.count_nonzero(labels)


def deviation(dimensions: int, ratio: float, bandwidth: float) -> float:
    """Standard deviation of one plate's ratio, 0.075 B sin(πρ) / √(periods²); a block has at most its one layer's."""
    area = PLATE_MM[0] * PLATE_MM[1] if dimensions == 2 else BLOCK_MM[0] * BLOCK_MM[1]
    return float(0.075 * bandwidth * np.sin(np.pi * ratio) / np.sqrt(area))


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("bandwidth", BANDWIDTHS)
@pytest.mark.parametrize("ratio", RATIOS)
def test_ratio(tmp_path: Path, ratio: float, bandwidth: float, dimensions: int) -> None:
    measured = got(tmp_path, dimensions, ratio, bandwidth, seed=1)
    print(f"{dimensions}D bandwidth {bandwidth:4} asked {ratio:.2f} got {measured:.4f}")
    assert abs(measured - ratio) <= LIMIT


@pytest.mark.slow
@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("bandwidth", BANDWIDTHS)
@pytest.mark.parametrize("ratio", RATIOS)
def test_ratio_has_no_bias(tmp_path: Path, ratio: float, bandwidth: float, dimensions: int) -> None:
    """Eight seeds: their mean within 4 standard errors, each within 0.5 % or 4 standard deviations."""
    measured = np.array([got(tmp_path, dimensions, ratio, bandwidth, seed) for seed in SEEDS])
    sigma = deviation(dimensions, ratio, bandwidth)
    print(
        f"{dimensions}D bandwidth {bandwidth:4} asked {ratio:.2f} got {measured.mean():.4f}, "
        f"one seed ± {measured.std(ddof=1):.4f} (theory {'' if dimensions == 2 else '<= '}{sigma:.4f})"
    )
    assert abs(measured.mean() - ratio) <= 4 * sigma / np.sqrt(len(SEEDS))
    assert np.abs(measured - ratio).max() <= max(LIMIT, 4 * sigma)


@pytest.mark.parametrize("painted", ["gradient", "picture"])
def test_graded_ratio(tmp_path: Path, painted: str) -> None:
    """0.1 to 0.9 along a plate: each sixth of 10 x 52 periods² has the ratio painted there, within 4σ."""
    part = parts.plate(tmp_path, 60, 52)
    ratio = {"gradient": {"axis": "x", "from": 0.1, "to": 0.9}}
    if painted == "picture":
        grey = np.tile(np.arange(256, dtype=np.uint8), (4, 1))
        ratio = {"image": parts.paint(tmp_path, grey), "range": [0.1, 0.9]}
    labels = parts.bitmap(parts.job(part, ratio=ratio, orientation=27))
    x, _ = parts.centres(labels.shape, parts.pitch_mm(parts.SQUARE))
    sigma = 0.075 * 0.5 / np.sqrt(520)
    for start in range(0, 60, 10):
        strip = labels[:, (x[0] >= start) & (x[0] < start + 10)]
        asked = 0.1 + 0.8 * (start + 5) / 60
        measured = np.count_nonzero(strip == 1) / np.count_nonzero(strip)
        print(f"{painted}: x {start:2} to {start + 10} mm asked {asked:.3f} got {measured:.4f}")
        assert abs(measured - asked) <= 4 * sigma
