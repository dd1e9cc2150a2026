"""G on a lattice: it is band-limited, so few nodes per tile give all its pixels.

Each tile has nodes of its own, some beyond its sides, and is interpolated from them alone: one sign rule per tile, and
no neighbour that could change a bit. Along each axis a pixel takes TAPS nodes around it with the weights that least
squares gives for the noise's covariance, R w = r (kriging). Along an axis whose pixels are coarse there is a
node at each of them instead: a lattice is never finer than the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.evaluator import work_shape
from amslicer.tiles import Nodes, Tiling, pixel_nodes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.grid import Grid
    from amslicer.noise.bands import Band, TabledBand

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

NODES = 16  # per tile, along x and y: one or two vectors
TAPS = 6
OUTSIDE = 0.75  # steps that the nodes reach beyond a tile's sides; pixels near by take lopsided taps
# Relative rms error of G along one axis, for waves along it: the worst direction. About a third of it is the share of
# pixels that change.
ERROR = 1e-3
MAX_PIXELS, MAX_LAYERS, MAX_PLANES = 128, 128, 16  # of a tile
STEP_PIXELS = 16  # tiles are whole vectors
# G of a whole layer of tiles, at most; per pixel of very large layers, whose ratios and bitmaps take as much.
SLAB_BYTES, SLAB_BYTES_PER_PIXEL = 192 << 20, 16
FLAT_BYTES = 512 << 20  # of the flattest blocks
BLOCK_ROWS = 1 << 20  # rows of pixels of all layers of a block: their runs are kept
WORTH = 0.5  # nodes per pixel: beyond, evaluating the pixels is as fast
DIRECTIONS = np.linspace(0.0, 1.0, 5)  # cosines between axis and wave that the covariance averages over
RIDGE = 1e-10  # float32's share in the covariance


@dataclass(frozen=True, eq=False)
class Taps:
    """How the pixels (or layers) of a tile along one axis come from its nodes.

    Attributes:
        first: (pixels,) the first node of each.
        weights: (pixels, K) of it and those after it.
    """

    first: NDArray[np.int32]
    weights: NDArray[np.float32]

    @property
    def count(self) -> int:
        """K."""
        return int(self.weights.shape[1])

    def by_vector(self, width: int) -> Taps:
        """The same for vectors of so many neighbouring pixels: (pixels / width,) and (pixels / width, K', width)."""
        vectors = self.first.reshape(-1, width)
        span = int((vectors.max(axis=1) - vectors.min(axis=1)).max()) + self.count
        first = np.minimum(vectors.min(axis=1), self.nodes_end - span)
        weights = np.zeros((len(vectors), span, width), np.float32)
        shift = vectors - first[:, None]
        vector, lane = np.indices(vectors.shape)
        for k in range(self.count):
            weights[vector, shift + k, lane] = self.weights.reshape(len(vectors), width, -1)[:, :, k]
        return Taps(first.astype(np.int32), weights)

    @property
    def nodes_end(self) -> int:
        """One after the last node that any pixel takes."""
        return int(self.first.max()) + self.count


@dataclass(frozen=True, eq=False)
class Lattice:
    """Tiles with their nodes, and the taps along x, y and z."""

    tiling: Tiling
    taps: tuple[Taps, Taps, Taps]

    def by_vector(self, device: Device) -> tuple[Taps, Taps, Taps]:
        """The taps as cl/interpolate.cl takes them: those along x for whole vectors of the device."""
        x, y, z = self.taps
        return x.by_vector(work_shape(device, NODES)["VECTOR"]), y, z


def choose_lattice(
    grid: Grid, band: Band | TabledBand, period_mm: float, *, tile_periods: float, planar: bool
) -> Lattice | None:
    """The largest tiles whose nodes give G within ERROR, or None where that saves nothing.

    Args:
        band: the noise's frequencies.
        period_mm: the finest of the job.
        tile_periods: no side of a tile is longer, in the finest period.
        planar: 2D: the same pattern in every layer.
    """
    largest = tile_periods * period_mm
    x, y = (_along_pixels(pitch, largest, band) for pitch in grid.pitch_mm)
    if x is None or y is None:
        return None
    z = _one_plane(grid, largest) if planar else _along_layers(grid, largest, band, x, y)
    if z is None:
        return None
    tiling = Tiling((len(x[1].first), len(y[1].first)), len(z[1].first), (x[0], y[0], z[0]))
    nodes, pixels = NODES**2 * z[0].count, tiling.pixels[0] * tiling.pixels[1] * (1 if planar else tiling.layers)
    return Lattice(tiling, (x[1], y[1], z[1])) if nodes <= WORTH * pixels else None


def _along_pixels(pitch_mm: float, largest_mm: float, band: Band | TabledBand) -> _Axis | None:
    most = min(MAX_PIXELS, int(largest_mm / pitch_mm))
    for pixels in range(most // STEP_PIXELS * STEP_PIXELS, NODES, -STEP_PIXELS):
        axis = _spread(pixels, pitch_mm, NODES, band)
        if axis is not None:
            return axis
    return _each(NODES, pitch_mm) if most >= NODES else None


def _along_layers(grid: Grid, largest_mm: float, band: Band | TabledBand, x: _Axis, y: _Axis) -> _Axis | None:
    """None where the nodes take too much memory: small tiles of a large layer."""
    tiles = -(-grid.columns // len(x[1].first)) * -(-grid.rows // len(y[1].first))
    memory = max(SLAB_BYTES, SLAB_BYTES_PER_PIXEL * grid.columns * grid.rows)
    plane = tiles * NODES**2 * 8
    planes = min(MAX_PLANES, memory // plane)
    if planes <= TAPS:
        planes = TAPS + 1
        if planes * plane > FLAT_BYTES:
            return None
    pixels = len(x[1].first) * len(y[1].first)
    most = max(1, min(MAX_LAYERS, int(largest_mm / grid.layer_mm), BLOCK_ROWS // grid.rows))
    for layers in range(most, TAPS, -1):
        if _spread(layers, grid.layer_mm, min(planes, layers - 1), band) is None:
            continue  # nor do fewer planes
        for count in range(TAPS + 1, min(planes, layers - 1) + 1):
            axis = _spread(layers, grid.layer_mm, count, band)
            if axis is not None and count * NODES**2 <= WORTH * layers * pixels:
                return axis
    return _each(min(most, planes), grid.layer_mm)


def _one_plane(grid: Grid, largest_mm: float) -> _Axis:
    """Of a 2D pattern; a block of layers is only what is sliced at a time."""
    layers = max(1, min(MAX_PLANES, int(largest_mm / grid.layer_mm)))
    taps = Taps(np.zeros(layers, np.int32), np.ones((layers, 1), np.float32))
    return Nodes(1, grid.layer_mm, grid.layer_mm / 2, layers * grid.layer_mm), taps


def _each(count: int, pitch_mm: float) -> _Axis:
    """A node at each pixel."""
    return pixel_nodes(count, pitch_mm), Taps(np.arange(count, dtype=np.int32), np.ones((count, 1), np.float32))


def _spread(pixels: int, pitch_mm: float, count: int, band: Band | TabledBand) -> _Axis | None:
    """Nodes evenly over a tile's side and a little beyond, if they give G within ERROR and are coarser than pixels."""
    side = pixels * pitch_mm
    step = side / (count - 1 - 2 * OUTSIDE)
    if step <= pitch_mm:
        return None
    nodes = Nodes(count, step, -OUTSIDE * step, side)
    taps, error = _fit(pitch_mm * (np.arange(pixels, dtype=np.float64) + 0.5), nodes, band)
    return (nodes, taps) if error <= ERROR else None


def _fit(places_mm: Floats, nodes: Nodes, band: Band | TabledBand) -> tuple[Taps, float]:
    """The taps of some places, and their largest relative rms error for waves along the axis, of the finest period."""
    at = nodes.start_mm + nodes.step_mm * np.arange(nodes.count)
    before = np.floor((places_mm - nodes.start_mm) / nodes.step_mm).astype(np.int64)
    first = np.clip(before - TAPS // 2 + 1, 0, nodes.count - TAPS)
    near = at[first[:, None] + np.arange(TAPS)]
    among, to = near[:, :, None] - near[:, None, :], near - places_mm[:, None]
    matrix = band.covariance(among, DIRECTIONS) + RIDGE * np.eye(TAPS)
    weights = np.linalg.solve(matrix, band.covariance(to, DIRECTIONS)[..., None])[..., 0]
    along = np.ones(1)
    error = (
        1.0
        - 2 * np.sum(weights * band.covariance(to, along, finest=True), axis=-1)
        + np.einsum("pi,pij,pj->p", weights, band.covariance(among, along, finest=True), weights)
    )
    taps = Taps(first.astype(np.int32), weights.astype(np.float32))
    return taps, float(np.sqrt(np.max(np.maximum(error, 0.0))))


_Axis = tuple[Nodes, Taps]
