"""Proof: in space, the sheets' normal is the one that was painted, within 6 degrees, at every place looked at.

Two ways to measure a place: the 3-D structure tensor of a block of layers under a Gaussian window of 1.5 periods, and
three orthogonal cuts through it, as one would section a print.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage
from scipy.spatial.transform import Rotation

import amslicer
from amslicer import analysis

LIMIT_DEG = 6.0
WINDOW = 1.5  # periods, σ
THIN_WINDOW = 2.0  # periods: in a part 3 to 8 periods thick, whose windows are cut off above and below
PRINTER = {"pitch_um": 103, "layer_um": 103}
PITCH = parts.pitch_mm(PRINTER)
SAMPLE = Path(__file__).parent.parent / "samples" / "insole"


def window(
    shape: tuple[int, ...], pitch: tuple[float, ...], centre_mm: tuple[float, ...], sigma_mm: float
) -> parts.Floats:
    """Gaussian weights of a block around a place, (z, y, x) mm from the block's first voxel."""
    axes = [np.arange(n) * p - c for n, p, c in zip(shape, pitch[::-1], centre_mm, strict=True)]
    each = [np.exp(-0.5 * (a / sigma_mm) ** 2) for a in axes]
    return each[0][:, None, None] * each[1][None, :, None] * each[2][None, None, :]


def report(name: str, errors: list[float]) -> None:
    e = np.array(errors)
    print(f"{name}: {len(e)} places, mean {e.mean():.2f}°, p90 {np.percentile(e, 90):.2f}°, largest {e.max():.2f}°")


@pytest.mark.parametrize("ratio", [0.25, 0.5])
@pytest.mark.parametrize(("azimuth", "elevation"), [(27, 35), (110, 65), (150, 10)])
def test_constant_normal(tmp_path: Path, azimuth: float, elevation: float, ratio: float) -> None:
    labels = parts.labels(
        parts.job(
            parts.box(tmp_path, (16, 14, 8)), ratio=ratio, dimensions=3, printer=PRINTER,
            orientation={"azimuth": azimuth, "elevation": elevation},
        )
    )  # fmt: skip
    field, painted = analysis.signed(labels), analysis.normal(azimuth, elevation)
    weights = np.zeros(field.shape, np.float32)
    weights[8:-8, 8:-8, 8:-8] = 1
    block = analysis.normal_error(analysis.normal_of_block(field, weights, PITCH, 1.0), painted)
    cuts = analysis.normal_error(analysis.normal_from_cuts(field, PITCH, 1.0), painted)
    print(f"azimuth {azimuth}, elevation {elevation}, ratio {ratio}: block {block:.2f}°, cuts {cuts:.2f}°")
    assert block <= LIMIT_DEG
    assert cuts <= LIMIT_DEG


def test_graded_normal(tmp_path: Path) -> None:
    """Azimuth -60 to 60° along x, elevation 10 to 70° along y, looked at every 4 mm."""
    size, reach = (36.0, 24.0, 9.0), 4.0
    labels = parts.labels(
        parts.job(
            parts.box(tmp_path, size), dimensions=3, printer=PRINTER,
            orientation={
                "azimuth": {"gradient": {"axis": "x", "from": -60, "to": 60}},
                "elevation": {"gradient": {"axis": "y", "from": 10, "to": 70}},
            },
        )
    )  # fmt: skip
    field = analysis.signed(labels)
    half, rows = round(reach / PITCH[0]), field.shape[1]
    by_block, by_cuts = [], []
    for x in np.arange(reach, size[0] - reach + 1, 4):
        for y in np.arange(reach, size[1] - reach + 1, 4):
            column, row = round(x / PITCH[0]), round(rows - y / PITCH[1])
            block = field[:, max(row - half, 0) : row + half, max(column - half, 0) : column + half]
            weights = window(block.shape, PITCH, tuple((n - 1) / 2 * PITCH[0] for n in block.shape), WINDOW)
            weights[:4] = weights[-5:] = 0
            painted = analysis.normal(-60 + 120 * x / size[0], 10 + 60 * y / size[1])
            measured = analysis.normal_of_block(block, weights, PITCH, 1.0)
            by_block.append(float(analysis.normal_error(measured, painted)))
            by_cuts.append(float(analysis.normal_error(analysis.normal_from_cuts(block, PITCH, 1.0), painted)))
    report("graded block, structure tensor", by_block)
    report("graded block, three cuts", by_cuts)
    assert max(by_block) <= LIMIT_DEG
    assert max(by_cuts) <= LIMIT_DEG


def test_normal_follows_a_turned_part(tmp_path: Path) -> None:
    """Turned about the file's x, then y, then z axis; SciPy turns the painted normal."""
    turn = (40.0, -25.0, 60.0)
    labels = parts.labels(
        parts.job(
            parts.box(tmp_path, (16, 14, 12)), dimensions=3, printer=PRINTER, settings={"rotate": turn},
            orientation={"azimuth": 20, "elevation": 30},
        ), 70, 140,
    )  # fmt: skip
    inside = ndimage.binary_erosion(labels > 0, iterations=5).astype(np.float32)
    assert inside.sum() > 100_000
    measured = analysis.normal_of_block(analysis.signed(labels), inside, PITCH, 1.0)
    turned = Rotation.from_euler("xyz", turn, degrees=True).apply(analysis.normal(20, 30))
    error = analysis.normal_error(measured, turned)
    print(f"turned by {turn}: {error:.2f}°")
    assert error <= LIMIT_DEG
    assert analysis.normal_error(measured, analysis.normal(20, 30)) > 30


def insole_normals(u: parts.Floats, v: parts.Floats, azimuth: NDArray[np.uint8]) -> parts.Floats:
    """What the sample's job file paints at shares u, v of its box; where a normal leans, azimuth + 180 is another."""
    angle = (parts.painted_line(azimuth, -90, 90, u, v) + 90) % 180 - 90
    return analysis.normal(angle, 20 + 50 * u)


@pytest.mark.slow
def test_insole(tmp_path: Path) -> None:
    """The sample part with its own fields, on coarser pixels, looked at every 6 mm wherever the window is mostly solid.

    Windows at the surface see the laminate on one side only, so what is measured is compared with the mean of what
    is painted on the very voxels that were looked at.
    """
    pitch = (0.12, 0.12, 0.12)
    job = amslicer.load_job(
        SAMPLE / "fields.yaml", part=SAMPLE / "insole.stl",
        overrides={"printer": {"pitch_um": 120, "layer_um": 120}},
    )  # fmt: skip
    labels = parts.labels(job)
    _, rows, columns = labels.shape
    azimuth = np.asarray(Image.open(SAMPLE / "azimuth.png"))
    size = columns * pitch[0], rows * pitch[1]
    half = round(5 / pitch[0])
    errors = []
    for x in np.arange(5, size[0] - 4, 6):
        for y in np.arange(5, size[1] - 4, 6):
            column, row = round(x / pitch[0]), round(rows - y / pitch[1])
            place = (slice(None), slice(max(row - half, 0), row + half), slice(max(column - half, 0), column + half))
            block = labels[place]
            inside = ndimage.binary_erosion(block > 0, iterations=3)
            solid = np.flatnonzero(inside[:, inside.shape[1] // 2, inside.shape[2] // 2])
            if len(solid) < 10:
                continue
            middle = (solid.mean() * pitch[2], (row - place[1].start) * pitch[1], (column - place[2].start) * pitch[0])
            full = window(block.shape, pitch, middle, THIN_WINDOW)
            weights = full * inside
            if weights.sum() < 0.5 * full.sum():
                continue
            measured = analysis.normal_of_block(analysis.signed(block), weights, pitch, 1.0)
            seen = np.argwhere(weights > 0.05)[::97]
            u = (place[2].start + seen[:, 2] + 0.5) / columns
            v = 1 - (place[1].start + seen[:, 1] + 0.5) / rows
            painted = analysis.line_mean(insole_normals(u, v, azimuth), weights[tuple(seen.T)])
            errors.append(float(analysis.normal_error(measured, painted)))
    report("insole", errors)
    assert len(errors) > 30
    assert np.mean(errors) <= LIMIT_DEG
    assert np.percentile(errors, 90) <= LIMIT_DEG
    assert max(errors) <= LIMIT_DEG
