"""Tiles of pixels, and which kernels reach each: the work layout of the evaluation.

Tiles are square in pixels and some layers high, counted from the part's corner, so that nothing about how
a job is cut up can change them. Each tile has a reference normal: a kernel whose painted normal points
against it is taken with the opposite sign, -n and -φ, so that all kernels of a tile agree (a laminate's normal
is a line; the sign would otherwise show in Im G).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array

from amslicer.mask import expand

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.mask import Runs
    from amslicer.noise import Kernels

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

TILE_PIXELS = (32, 16, 8)  # sides of a tile, in whole vectors; larger ones load a kernel's factors less often
TILE_LAYERS = (16, 8, 4, 2, 1)  # layers that share a list of kernels
TILE_PERIODS = 1.5  # a larger tile reaches many kernels that most of its pixels do not, and its one normal is far off
SIGN_BIT = np.uint32(0x80000000)  # cl/tile.h: the kernel is taken with the opposite sign


@dataclass(frozen=True)
class Tiling:
    """The size of a job's tiles.

    Attributes:
        pixels: side in pixels, along x and y.
        layers: height in layers.
    """

    pixels: int
    layers: int

    def block_middle_mm(self, layer: int, layer_mm: float) -> float:
        """Mid-height of the tiles that hold a layer."""
        return (layer // self.layers + 0.5) * self.layers * layer_mm


def choose_tiling(grid: Grid, period_mm: float) -> Tiling:
    """The largest tiles of at most TILE_PERIODS periods (or the smallest there are).

    Args:
        period_mm: the finest period of the job.
    """
    largest = TILE_PERIODS * period_mm
    pixels = next((n for n in TILE_PIXELS if n * max(grid.pitch_mm) <= largest), TILE_PIXELS[-1])
    layers = next((n for n in TILE_LAYERS if n * grid.layer_mm <= largest), TILE_LAYERS[-1])
    return Tiling(pixels, layers)


@dataclass(frozen=True)
class TileLists:
    """The kernels of each listed tile, in kernel order.

    Attributes:
        tiles: (T, 2) int32 column and row of each tile.
        starts: (T + 1,) uint32 where each tile's entries start.
        entries: uint32 kernel indices, with SIGN_BIT where the sign is turned.
    """

    tiles: NDArray[np.int32]
    starts: NDArray[np.uint32]
    entries: NDArray[np.uint32]


@dataclass(frozen=True)
class Reach:
    """The tiles that each kernel reaches along one pixel axis.

    Attributes:
        first: (N,) int64 first tile.
        last: (N,) int64 last tile.
        offset_mm: (N,) the kernel's centre from the corner of its first tile.
    """

    first: Ints
    last: Ints
    offset_mm: Floats

    @property
    def tables(self) -> Ints:
        """(N + 1,) how many tiles all kernels before each one reach, and all of them."""
        return np.concatenate([[0], np.cumsum(self.last - self.first + 1)])


def reach(kernels: Kernels, axis: int, side: float) -> Reach:
    """Which tiles along x (0) or y (1), `side` mm long, the kernels reach."""
    centre = kernels.centre_mm[:, axis]
    first = np.floor((centre - kernels.radius_mm) / side).astype(np.int64)
    last = np.floor((centre + kernels.radius_mm) / side).astype(np.int64)
    return Reach(first, last, centre - first * side)


def tile_lists(
    kernels: Kernels, along_x: Reach, along_y: Reach, tiles: NDArray[np.int32], tile_normals: Floats
) -> TileLists:
    """Lists the kernels that reach each of the given tiles.

    Args:
        tiles: (T, 2) column and row, any order without repeats.
        tile_normals: (T, 3) reference normals.
    """
    if len(tiles) == 0 or len(kernels) == 0:
        return TileLists(tiles, np.zeros(len(tiles) + 1, np.uint32), np.zeros(0, np.uint32))
    # Tiles sorted by row, then column: those that a kernel reaches in one row lie side by side.
    left, right = int(tiles[:, 0].min()), int(tiles[:, 0].max())
    columns = right - left + 1
    key = tiles[:, 1].astype(np.int64) * columns + (tiles[:, 0] - left)
    order = np.argsort(key)
    key = key[order]
    first_y = np.maximum(along_y.first, tiles[:, 1].min())
    last_y = np.minimum(along_y.last, tiles[:, 1].max())
    kernel, row = expand(np.arange(len(kernels)), first_y, np.maximum(last_y - first_y + 1, 0))
    first_x = np.maximum(along_x.first, left)[kernel]
    last_x = np.minimum(along_x.last, right)[kernel]
    begin = np.searchsorted(key, row * columns + first_x - left)
    end = np.searchsorted(key, row * columns + last_x - left, side="right")
    kernel, place = expand(kernel, begin, np.maximum(end - begin, 0))
    tile = order[place]

    against = np.einsum("ni,ni->n", kernels.normal[kernel], tile_normals[tile]) < 0
    entry = kernel.astype(np.uint32) | np.where(against, SIGN_BIT, np.uint32(0))
    # Rows of a CSR matrix keep the order in which their entries are given: by kernel.
    matrix = coo_array((entry, (tile, kernel)), shape=(len(tiles), len(kernels))).tocsr()
    return TileLists(tiles, matrix.indptr.astype(np.uint32), matrix.data.astype(np.uint32))


def needed_tiles(runs: Runs, tile: int, rows: int) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """The tiles with at least one solid pixel, and which of their rows are needed in each layer.

    Args:
        tile: side of a tile in pixels, at most 8 × rows.
        rows: pixel rows that one bit stands for.

    Returns:
        (T, 2) column and row of the tiles, by rows; (T, layers) bits, the lowest for a tile's first rows.
    """
    down, across = tiles_over(runs.grid, tile)
    groups = tile // rows
    change = np.zeros((runs.layers, down * groups, across + 1), np.int32)
    layer, row = np.divmod(runs.row, runs.grid.rows)
    np.add.at(change, (layer, row // rows, runs.start // tile), 1)
    np.add.at(change, (layer, row // rows, (runs.stop - 1) // tile + 1), -1)
    solid = (np.cumsum(change, axis=2)[:, :, :-1] > 0).reshape(runs.layers, down, groups, across)
    bits = (solid << np.arange(groups, dtype=np.uint8)[:, None]).sum(axis=2, dtype=np.uint8)
    tiles = np.argwhere(bits.any(axis=0))
    return tiles[:, ::-1].astype(np.int32), np.ascontiguousarray(bits[:, tiles[:, 0], tiles[:, 1]].T)


def all_tiles(first: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int32]:
    """(T, 2) column and row of every tile from first up to, not including, end (column, row), by rows."""
    columns, rows = np.arange(first[0], end[0]), np.arange(first[1], end[1])
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.int32)


def tiles_over(grid: Grid, tile: int) -> tuple[int, int]:
    """Rows and columns of tiles that cover the part."""
    return -(-grid.rows // tile), -(-grid.columns // tile)
