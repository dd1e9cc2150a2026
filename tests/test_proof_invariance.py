"""Proof: what a seed changes, what scaling, turning and moving a part change, and what they do not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest

import amslicer
from amslicer import analysis

PITCH = parts.pitch_mm(parts.SQUARE)[:2]


def test_seeds(tmp_path: Path) -> None:
    """Unrelated patterns of ratio ½ differ on half of the pixels; the same seed gives the same bytes."""
    part = parts.plate(tmp_path, 30, 30)
    seeds = (0, 1, 2, 2**32, 2**63 + 1, 2**64 - 1)
    bitmaps = [parts.bitmap(parts.job(part, orientation=27, seed=seed)) for seed in seeds]
    for i, first in enumerate(bitmaps):
        for j in range(i):
            differing = np.mean(first != bitmaps[j])
            print(f"seeds {seeds[j]} and {seeds[i]}: {differing:.3f} of the pixels differ")
            assert 0.4 < differing < 0.6
    again = parts.bitmap(parts.job(part, orientation=27, seed=seeds[-1]))
    np.testing.assert_array_equal(again, bitmaps[-1])


def test_layers_of_a_solid_laminate_differ(tmp_path: Path) -> None:
    """Half a period up along an upright normal the materials are swapped, mostly; in 2D all layers are the same."""
    part = parts.box(tmp_path, (20, 20, 1))
    solid = parts.labels(parts.job(part, dimensions=3, orientation={"azimuth": 0, "elevation": 90}), 0, 7)
    print(f"0.5 mm up: {np.mean(solid[0] != solid[6]):.3f} of the pixels differ")
    assert np.mean(solid[0] != solid[6]) > 0.7
    flat = parts.labels(parts.job(part, orientation=27), 0, 7)
    assert all(np.array_equal(layer, flat[0]) for layer in flat)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_scale(tmp_path: Path, scale: float) -> None:
    """The part and its fields scale; the period stays 1 mm of the print."""
    part = parts.plate(tmp_path, 48 / scale, 44 / scale)
    orientation = {"gradient": {"axis": "x", "from": 10, "to": 70}}
    labels = parts.bitmap(
        parts.job(part, orientation=orientation, settings={"scale": scale}, printer={"pitch_um": 83, "layer_um": 40})
    )
    assert labels.shape == (531, 579)  # 44 and 48 mm of 83 um pixels, rounded up
    field = analysis.signed(labels)
    period = analysis.measured_period(field, PITCH, 1.0)
    x, _ = parts.centres(labels.shape, PITCH)
    error = analysis.line_error(analysis.directions(field, PITCH, 1.0), 10 + 60 * x / 48)[
        analysis.inner(labels.shape, PITCH, 4)
    ]
    print(f"scale {scale}: period {period:.4f} mm, direction {error.mean():.2f}°, p90 {np.percentile(error, 90):.2f}°")
    assert period == pytest.approx(1, rel=0.04)
    assert error.mean() <= 3.5
    assert np.percentile(error, 90) <= 7


@pytest.mark.parametrize("turn", [30, 90, 135])
def test_turning_keeps_the_statistics(tmp_path: Path, turn: float) -> None:
    """Ratio, period and contrast stay; the direction turns along. Measured 42 mm around the middle of a 60 mm plate."""
    part = parts.plate(tmp_path, 60, 60)
    job = parts.job(part, ratio=0.25, orientation=20, settings={"rotate": [0, 0, turn]})
    labels = parts.bitmap(job)
    ratio = np.count_nonzero(labels == 1) / np.count_nonzero(labels)
    half = round(21 / PITCH[0])
    middle = tuple(slice(n // 2 - half, n // 2 + half) for n in labels.shape)
    assert np.all(labels[middle] > 0)
    field = analysis.signed(labels[middle])
    period = analysis.measured_period(field, PITCH, 1.0)
    direction = analysis.mean_direction(field, PITCH, 1.0)
    contrast = analysis.contrast(amslicer.field(job, 0)[middle])
    print(
        f"turned by {turn}°: ratio {ratio:.4f}, period {period:.4f} mm, direction {direction:.1f}° "
        f"(painted {(20 + turn) % 180}°), contrast {contrast:.3f}"
    )
    assert abs(ratio - 0.25) <= 0.005
    assert period == pytest.approx(1, rel=0.04)
    assert analysis.line_error(direction, 20 + turn) <= 3.5
    assert contrast == pytest.approx(0.55, abs=0.07)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_moving_changes_no_byte(tmp_path: Path, dimensions: int) -> None:
    """A ball whose vertices are multiples of 1/256 mm, moved by whole millimetres: the file's float32 are exact."""
    vertices, triangles = meshes.sphere(4.0)
    rounded = np.round(vertices * 256) / 256
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
    orientation: Any = {"image": parts.paint(tmp_path, grey), "range": [0, 180]}
    if dimensions == 3:
        orientation = {"azimuth": orientation, "elevation": {"gradient": {"axis": "y", "from": 0, "to": 60}}}
    ratio = {"gradient": {"axis": "x", "from": 0.1, "to": 0.9}}
    stacks = []
    for number, (move, on_bed) in enumerate(
        (((0, 0, 0), True), ((512, -256, 64), True), ((-128, 32, -16), True), ((8, 8, 8), False))
    ):
        moved = rounded + np.array(move, np.float64)
        assert np.array_equal(moved.astype(np.float32), moved)
        part = parts.stl(tmp_path, (moved, triangles), f"part{number}.stl")
        job = parts.job(
            part, ratio=ratio, orientation=orientation, dimensions=dimensions, settings={"on_bed": on_bed},
            printer={"dpi": [300, 150], "layer_mm": 0.11},
        )  # fmt: skip
        stacks.append(parts.labels(job))
    assert set(np.unique(stacks[0])) == {0, 1, 2}
    for stack in stacks[1:]:
        np.testing.assert_array_equal(stack, stacks[0])
