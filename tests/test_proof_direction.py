"""Proof: the laminate's normal is the one that was painted, in the plane.

Measured on the labels, ratio ½, by a structure tensor with a Gaussian window of 1.5 periods, a border of 4 periods
left out. The plates are 48 periods wide and more; a picture is read here by SciPy's interpolation, not the package's.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from PIL import Image

from amslicer import analysis

DATA = os.environ.get("AMSLICER_TEST_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="AMSLICER_TEST_DATA is not set")

MEAN_DEG, P90_DEG = 3.5, 7.0
BORDER = 4  # periods
WIDTH, DEPTH = 48.0, 30.0  # mm, periods of 1 mm
PRINTERS = {"square": parts.SQUARE, "600x300": parts.OBLONG}


def assert_direction(
    name: str, labels: NDArray[np.uint8], painted_deg: parts.Floats, printer: Mapping[str, Any],
    chosen: NDArray[np.bool_] | None = None,
) -> None:  # fmt: skip
    """Compares measured and painted directions, border (and what is not chosen) left out."""
    pitch = parts.pitch_mm(printer)[:2]
    part = analysis.inner(labels.shape, pitch, BORDER)
    error = analysis.line_error(analysis.directions(analysis.signed(labels), pitch, 1.0), painted_deg)[part]
    if chosen is not None:
        error = error[chosen[part]]
    mean, p90 = error.mean(), np.percentile(error, 90)
    print(f"{name}: {error.size} pixels, mean error {mean:.2f}°, 90th percentile {p90:.2f}°")
    assert mean <= MEAN_DEG
    assert p90 <= P90_DEG


def swirl() -> NDArray[np.uint8]:
    """0 to 180° from left to right, 30° to and fro from bottom to top: wraps from white to black along two curves."""
    u, v = (np.arange(240)[None, :] + 0.5) / 240, 1 - (np.arange(150)[:, None] + 0.5) / 150
    return np.round((180 * u + 30 * np.sin(2 * np.pi * v)) % 180 / 180 * 255).astype(np.uint8)


@pytest.mark.parametrize("printer", PRINTERS)
@pytest.mark.parametrize("bandwidth", [0.25, 0.5, 1.0])
def test_gradient_of_directions(tmp_path: Path, bandwidth: float, printer: str) -> None:
    orientation = {"gradient": {"axis": "x", "from": 0, "to": 180}}
    job = parts.job(
        parts.plate(tmp_path, WIDTH, DEPTH), orientation=orientation, bandwidth=bandwidth,
        printer=PRINTERS[printer],
    )  # fmt: skip
    labels = parts.bitmap(job)
    x, _ = parts.centres(labels.shape, parts.pitch_mm(PRINTERS[printer]))
    assert_direction(f"gradient, {printer}, bandwidth {bandwidth}", labels, 180 * x / WIDTH, PRINTERS[printer])


@pytest.mark.parametrize("printer", PRINTERS)
def test_picture_of_directions(tmp_path: Path, printer: str) -> None:
    grey = swirl()
    orientation = {"image": parts.paint(tmp_path, grey), "range": [0, 180]}
    job = parts.job(parts.plate(tmp_path, WIDTH, DEPTH), orientation=orientation, printer=PRINTERS[printer])
    labels = parts.bitmap(job)
    x, y = parts.centres(labels.shape, parts.pitch_mm(PRINTERS[printer]))
    painted = parts.painted_line(grey, 0, 180, x / WIDTH, y / DEPTH)
    assert_direction(f"picture, {printer}", labels, painted, PRINTERS[printer])


def test_limits_notice_a_mirrored_picture(tmp_path: Path) -> None:
    grey = swirl()
    orientation = {"image": parts.paint(tmp_path, grey[::-1]), "range": [0, 180]}
    labels = parts.bitmap(parts.job(parts.plate(tmp_path, WIDTH, DEPTH), orientation=orientation))
    x, y = parts.centres(labels.shape, parts.pitch_mm(parts.SQUARE))
    with pytest.raises(AssertionError):
        assert_direction("mirrored", labels, parts.painted_line(grey, 0, 180, x / WIDTH, y / DEPTH), parts.SQUARE)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 4, 5])
@pytest.mark.parametrize("ratio", [0.2, 0.8])
def test_picture_of_directions_at_other_ratios(tmp_path: Path, ratio: float, seed: int) -> None:
    grey = swirl()
    orientation = {"image": parts.paint(tmp_path, grey), "range": [0, 180]}
    part = parts.plate(tmp_path, WIDTH, DEPTH)
    labels = parts.bitmap(parts.job(part, ratio=ratio, orientation=orientation, seed=seed))
    x, y = parts.centres(labels.shape, parts.pitch_mm(parts.SQUARE))
    painted = parts.painted_line(grey, 0, 180, x / WIDTH, y / DEPTH)
    assert_direction(f"picture, ratio {ratio}, seed {seed}", labels, painted, parts.SQUARE)


@needs_data
@pytest.mark.parametrize(
    ("file", "side_mm", "least_share"),
    [("gradient_line.png", 64.0, 0.7), ("tiles_line.png", 128.0, 0.25)],  # a tile is 16 periods wide
)
def test_painted_files(tmp_path: Path, file: str, side_mm: float, least_share: float) -> None:
    """Line fields that others painted; they jump, so places within 3 periods of a jump are left out."""
    grey = np.asarray(Image.open(Path(str(DATA)) / "fields" / file))
    printer = {"pitch_um": 97, "layer_um": 50}
    orientation = {"image": parts.paint(tmp_path, grey), "range": [-90, 90]}
    labels = parts.bitmap(parts.job(parts.plate(tmp_path, side_mm, side_mm), orientation=orientation, printer=printer))
    x, y = parts.centres(labels.shape, parts.pitch_mm(printer))
    painted = parts.painted_line(grey, -90, 90, x / side_mm, y / side_mm)
    texel_mm = side_mm / grey.shape[0]
    distance_mm = parts.distance_to_jumps(grey, -90, 90, jump_deg=15) * texel_mm
    row = np.clip((side_mm - y) / texel_mm, 0, grey.shape[0] - 1).astype(int)
    column = np.clip(x / texel_mm, 0, grey.shape[1] - 1).astype(int)
    far = distance_mm[row, column] > 3
    assert far.mean() > least_share
    assert_direction(file, labels, painted, printer, far)
