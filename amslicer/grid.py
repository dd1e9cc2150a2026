"""The printer's pixels and layers over a part: the only place that converts between mm and px."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

MM_PER_INCH = 25.4
# A size within this share of a pixel above a whole number of pixels does not get one more (float noise of
# parts that were drawn to the pixel).
SIZE_SLACK_PX = 1e-3


@dataclass(frozen=True)
class Grid:
    """Pixels and layers over a part's bounding box, in the pattern frame (origin at the box's minimum).

    Columns count along x, rows along y **upwards**, layers along z, each from 0 at the part's corner; the
    margin is outside (pixel columns -margin_px … -1). Written bitmaps run top-down and include the margin.

    Attributes:
        columns, rows, layers: number of pixels and layers over the part, without margin.
        pitch_mm: pixel size along x and y.
        layer_mm: layer height.
        margin_px: empty pixels on each side, in x and y.
    """

    columns: int
    rows: int
    layers: int
    pitch_mm: tuple[float, float]
    layer_mm: float
    margin_px: int = 0

    @property
    def width_px(self) -> int:
        """Width of the bitmaps, margin included."""
        return self.columns + 2 * self.margin_px

    @property
    def height_px(self) -> int:
        """Height of the bitmaps, margin included."""
        return self.rows + 2 * self.margin_px

    @property
    def voxel_mm3(self) -> float:
        """Volume of one pixel of one layer."""
        return self.pitch_mm[0] * self.pitch_mm[1] * self.layer_mm

    def x_mm(self) -> NDArray[np.float64]:
        """(columns,) pixel centres along x."""
        return centre_mm(np.arange(self.columns), self.pitch_mm[0])

    def y_mm(self) -> NDArray[np.float64]:
        """(rows,) pixel centres along y, ascending."""
        return centre_mm(np.arange(self.rows), self.pitch_mm[1])

    def z_mm(self, layer: int) -> float:
        """Mid-height of a layer."""
        return (layer + 0.5) * self.layer_mm

    def corner_mm(self, origin_mm: Sequence[float]) -> tuple[float, float, float]:
        """The bitmaps' lower left corner (margin included), given the part's own."""
        x, y, z = (float(v) for v in origin_mm)
        return (x - self.margin_px * self.pitch_mm[0], y - self.margin_px * self.pitch_mm[1], z)


def cover(size_mm: Sequence[float], pitch_mm: tuple[float, float], layer_mm: float, margin_px: int = 0) -> Grid:
    """The grid over a bounding box of this size: ceil(size / pitch - 1e-3) pixels and layers, at least 1."""
    columns, rows, layers = (
        max(1, math.ceil(float(size) / pitch - SIZE_SLACK_PX))
        for size, pitch in zip(size_mm, (*pitch_mm, layer_mm), strict=True)
    )
    return Grid(columns, rows, layers, pitch_mm, layer_mm, margin_px)


def first_centre(position_mm: NDArray[np.float64], pitch_mm: float) -> NDArray[np.int64]:
    """Index of the first pixel (or layer) centre at or above each position: the half-open rule's only rounding.

    Monotone in the position, so two edges that share an end agree about it.
    """
    return np.ceil(position_mm / pitch_mm - 0.5).astype(np.int64)


def centre_mm(index: NDArray[np.int64], pitch_mm: float) -> NDArray[np.float64]:
    """Positions of pixel (or layer) centres."""
    return (index.astype(np.float64) + 0.5) * pitch_mm
