"""Which pixels of a layer are solid: every crossing of the mesh with planes and pixel rows, then a running sum.

Half-open rules make this exact without special cases: an edge crosses the plane of a layer iff
z0 <= z < z1, a segment crosses a pixel row iff y0 <= y < y1. An edge's crossing is computed from its ends
ordered by z (never equal for an edge that crosses), so both triangles that share it get the same bits. Each
crossing adds +1 or -1 at the first pixel centre to its right; the running sum along the row is the winding
number, and a row whose sum does not return to 0 proves that the mesh leaks there. What is solid is kept as
runs of pixels: a device fills them in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import PartError
from amslicer.grid import Grid, centre_mm, first_centre

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.holes import Holes

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Runs:
    """The solid pixels of some layers: columns start … stop - 1 of a row, in order of layer, row and start.

    Attributes:
        layers: how many layers; the first is number 0 here.
        row: (N,) layer number × grid rows + row (0 = lowest y).
        start, stop: (N,) columns.
        overlap_px: (layers,) what bodies that overlap have in common: winding numbers above 1, summed over the pixels;
            None where it was not counted.
    """

    layers: int
    grid: Grid
    row: Ints
    start: Ints
    stop: Ints
    overlap_px: Ints | None = None

    @property
    def pixels(self) -> Ints:
        """(layers,) solid pixels per layer."""
        lengths = self.stop - self.start
        return np.bincount(self.row // self.grid.rows, lengths, minlength=self.layers).astype(np.int64)

    def part(self, first: int, end: int) -> Runs:
        """Only the layers first … end - 1 of these."""
        low, high = np.searchsorted(self.row, [first * self.grid.rows, end * self.grid.rows])
        overlap = None if self.overlap_px is None else self.overlap_px[first:end]
        row, start, stop = (a[low:high] for a in (self.row, self.start, self.stop))
        return Runs(end - first, self.grid, row - first * self.grid.rows, start, stop, overlap)

    def solid(self) -> NDArray[np.bool_]:
        """(layers, rows, columns) pixels whose centre the mesh winds around, row 0 = lowest y."""
        change = np.zeros((self.layers * self.grid.rows, self.grid.columns + 1), np.int8)
        np.add.at(change, (self.row, self.start), 1)
        np.add.at(change, (self.row, self.stop), -1)
        inside = np.cumsum(change, axis=1, dtype=np.int8)[:, :-1] > 0
        return inside.reshape(self.layers, self.grid.rows, self.grid.columns)


@dataclass(frozen=True)
class Slicer:
    """A mesh made ready for slicing.

    Attributes:
        corners: (T, 3, 3) triangle corners in the pattern frame, mm.
        first_layer, end_layer: (T,) layers whose planes each triangle can cross (half-open).
        holes: of a mesh that may be open; rows through them stay empty.
    """

    corners: Floats
    first_layer: Ints
    end_layer: Ints
    grid: Grid
    holes: Holes | None = None

    def runs(self, first: int, end: int) -> Runs:
        """The solid pixels of the layers first … end - 1.

        Raises:
            PartError: the winding number does not return to 0 at the end of a row: the mesh leaks.
        """
        grid = self.grid
        triangle, layer = self._crossings(first, end)
        start, stop = _segments(self.corners[triangle], layer, grid.layer_mm)
        segment, row, column, sign = _row_crossings(start, stop, grid)
        row += (layer[segment] - first) * grid.rows
        if self.holes:
            row, column, sign = _outside(self.holes.spans(first, end), row, column, sign)
        order = np.argsort(row * (grid.columns + 1) + column, kind="stable")
        row, column, winding = row[order], column[order], np.cumsum(sign[order])
        ends = np.flatnonzero(np.append(row[1:] != row[:-1], True)[: len(row)])
        self._refuse_leaks(row[ends[np.diff(winding[ends], prepend=0) != 0]], first)
        inside = np.flatnonzero((winding > 0)[:-1] & (column[1:] > column[:-1]))
        more = (winding[inside] - 1) * (column[inside + 1] - column[inside])
        overlap = np.bincount(row[inside] // grid.rows, more, minlength=end - first).astype(np.int64)
        return Runs(end - first, grid, row[inside], column[inside], column[inside + 1], overlap)

    def _crossings(self, first: int, end: int) -> tuple[Ints, Ints]:
        """Every (triangle, layer) pair of the layers first … end - 1 where the one crosses the other."""
        low = np.maximum(self.first_layer, first)
        count = np.minimum(self.end_layer, end) - low
        triangle = np.flatnonzero(count > 0)
        return expand(triangle, low[triangle], count[triangle])

    def _refuse_leaks(self, rows: Ints, first: int) -> None:
        if len(rows):
            layer, row = first + int(rows[0]) // self.grid.rows, int(rows[0]) % self.grid.rows
            raise PartError(
                f"the mesh leaks in layer {layer} (z = {self.grid.z_mm(layer):.4f} mm above the part's lowest "
                f"point): {len(rows)} pixel rows do not close, the first at "
                f"y = {self.grid.y_mm()[row]:.4f} mm",
                hint="repair the mesh (for example with Blender's 3D Print toolbox or admesh) so that it is closed",
            )


def make_slicer(vertices: Floats, triangles: Ints, grid: Grid, holes: Holes | None = None) -> Slicer:
    """Sorts triangles by the layers that they reach.

    Args:
        vertices: (V, 3) pattern frame, mm.
        triangles: (T, 3) vertex indices, outward.
        holes: of these vertices, where the mesh may be open.
    """
    corners = vertices[triangles]
    layer_of_corner = first_centre(corners[:, :, 2], grid.layer_mm)
    return Slicer(corners, layer_of_corner.min(axis=1), layer_of_corner.max(axis=1), grid, holes)


def all_solid(grid: Grid) -> Runs:
    """One layer whose pixels are all solid."""
    row = np.arange(grid.rows)
    return Runs(1, grid, row, np.zeros_like(row), np.full_like(row, grid.columns))


def join_runs(parts: Sequence[Runs]) -> Runs:
    """Consecutive layers' runs as one."""
    layers = np.cumsum([0] + [part.layers for part in parts])
    rows = [part.row + before * part.grid.rows for part, before in zip(parts, layers[:-1], strict=True)]
    start, stop = (np.concatenate([getattr(part, name) for part in parts]) for name in ("start", "stop"))
    overlaps = [np.zeros(part.layers, np.int64) if part.overlap_px is None else part.overlap_px for part in parts]
    return Runs(int(layers[-1]), parts[0].grid, np.concatenate(rows), start, stop, np.concatenate(overlaps))


def expand(item: Ints, first: Ints, count: Ints) -> tuple[Ints, Ints]:
    """Each item repeated `count` times, beside the running numbers first, first + 1, …"""
    repeated = np.repeat(np.arange(len(item)), count)
    before = np.cumsum(count) - count
    return item[repeated], first[repeated] + (np.arange(len(repeated)) - before[repeated])


def _segments(corners: Floats, layer: Ints, layer_mm: float) -> tuple[Floats, Floats]:
    """Where triangles cross the planes of layers: directed segments (N, 2), the solid on their left."""
    plane = centre_mm(layer, layer_mm)
    above = first_centre(corners[:, :, 2], layer_mm) > layer[:, None]
    points = np.empty((len(corners), 3, 2))
    crosses = np.empty((len(corners), 3), bool)
    rises = np.empty((len(corners), 3), bool)
    for edge in range(3):
        a, b = corners[:, edge], corners[:, (edge + 1) % 3]
        a_above, b_above = above[:, edge], above[:, (edge + 1) % 3]
        crosses[:, edge] = a_above != b_above
        rises[:, edge] = b_above
        points[:, edge] = cut_edges(a, b, b_above, plane)
    # An outward triangle is entered from below along one edge and left along another: the segment runs from
    # the edge that falls through the plane to the edge that rises, with the solid on its left.
    row = np.arange(len(corners))
    falling = np.argmax(crosses & ~rises, axis=1)
    rising = np.argmax(crosses & rises, axis=1)
    return points[row, falling], points[row, rising]


def cut_edges(a: Floats, b: Floats, b_above: NDArray[np.bool_], plane: Floats) -> Floats:
    """(N, 2) x and y where edges a-b (N, 3) cross the planes z (N,); b_above: which end lies above."""
    low = np.where(b_above[:, None], a, b)
    high = np.where(b_above[:, None], b, a)
    height = high[:, 2] - low[:, 2]
    # Where the ends differ by rounding alone, the plane that they straddle may lie beyond both: unclipped, the
    # crossing would be far outside the part.
    share = np.clip((plane - low[:, 2]) / np.where(height == 0, 1.0, height), 0.0, 1.0)
    points: Floats = low[:, :2] + share[:, None] * (high[:, :2] - low[:, :2])
    return points


def _outside(spans: tuple[Ints, Ints], row: Ints, column: Ints, sign: Ints) -> tuple[Ints, Ints, Ints]:
    """The crossings whose rows are in none of the spans begin … stop - 1."""
    begin, stop = spans
    if not len(begin):
        return row, column, sign
    span = np.searchsorted(begin, row, side="right") - 1
    kept = (span < 0) | (row >= stop[span])
    return row[kept], column[kept], sign[kept]


def _row_crossings(start: Floats, stop: Floats, grid: Grid) -> tuple[Ints, Ints, Ints, Ints]:
    """Pixel rows that segments cross: (segment, row, first column to the right, ±1), clipped to the grid."""
    upwards = start[:, 1] < stop[:, 1]
    low = np.where(upwards[:, None], start, stop)
    high = np.where(upwards[:, None], stop, start)
    first = np.clip(first_centre(low[:, 1], grid.pitch_mm[1]), 0, grid.rows)
    end = np.clip(first_centre(high[:, 1], grid.pitch_mm[1]), 0, grid.rows)
    segment, row = expand(np.arange(len(first)), first, end - first)
    a, b = low[segment], high[segment]
    share = np.clip((centre_mm(row, grid.pitch_mm[1]) - a[:, 1]) / (b[:, 1] - a[:, 1]), 0.0, 1.0)
    x = a[:, 0] + share * (b[:, 0] - a[:, 0])
    column = np.clip(first_centre(x, grid.pitch_mm[0]), 0, grid.columns)
    # Solid lies on a segment's left: an upward one is where a row, read left to right, leaves the solid.
    return segment, row, column, np.where(upwards[segment], -1, 1)
