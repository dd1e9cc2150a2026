"""Tiles of pixels, and which kernels reach each: the work layout of the evaluation.

Tiles are boxes of pixels and layers, counted from the part's corner, so that nothing about how a job is cut up can
change them. G is evaluated at the nodes of a tile. Each tile has a reference normal: a kernel whose painted normal
points against it is taken with the opposite sign, -n and -φ, so that all kernels of a tile agree (a laminate's normal
is a line; the sign would otherwise show in Im G).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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
# A tile where the painted direction turns little: by no more than CALM_DEG over the tile and its kernels' reach.
CALM_TILE_PERIODS, CALM_DEG = 2.25, 80.0
NEEDED_CELLS = 1 << 21  # groups of rows of tiles that are looked at a time: some 50 MB
SIGN_BIT = np.uint32(0x80000000)  # cl/tile.h: the kernel is taken with the opposite sign


@dataclass(frozen=True)
class Nodes:
    """Where G is evaluated along one axis of a tile: at its pixels (or layers), or on a lattice that covers them.

    Attributes:
        count: how many.
        step_mm: from one to the next.
        start_mm: the first one, from the tile's lower side.
        side_mm: of the tile.
    """

    count: int
    step_mm: float
    start_mm: float
    side_mm: float

    @property
    def end_mm(self) -> float:
        """The last one, from the tile's lower side."""
        return self.start_mm + (self.count - 1) * self.step_mm


def pixel_nodes(pixels: int, pitch_mm: float) -> Nodes:
    """The centres of a tile's pixels or layers."""
    return Nodes(pixels, pitch_mm, pitch_mm / 2, pixels * pitch_mm)


@dataclass(frozen=True)
class Tiling:
    """A job's tiles, and the nodes in them where G is evaluated.

    Attributes:
        pixels: sides along x and y in pixels.
        layers: height in layers: a block of layers is one layer of tiles.
        nodes: along x, y and z; as many along y as along x.
    """

    pixels: tuple[int, int]
    layers: int
    nodes: tuple[Nodes, Nodes, Nodes]

    @property
    def sides_mm(self) -> Floats:
        """(2,) along x and y."""
        return np.array([self.nodes[0].side_mm, self.nodes[1].side_mm])

    @property
    def outside_mm(self) -> float:
        """How far nodes lie outside their tile, in x or y."""
        return max(0.0, *(-nodes.start_mm for nodes in self.nodes[:2]))

    def over(self, grid: Grid) -> tuple[int, int]:
        """Rows and columns of tiles that cover the part."""
        return -(-grid.rows // self.pixels[1]), -(-grid.columns // self.pixels[0])


def choose_tiling(grid: Grid, period_mm: float) -> Tiling:
    """Square tiles with a node at each pixel: the largest of at most TILE_PERIODS periods (or the smallest there are).

    Args:
        period_mm: the finest period of the job.
    """
    largest = TILE_PERIODS * period_mm
    pixels = next((n for n in TILE_PIXELS if n * max(grid.pitch_mm) <= largest), TILE_PIXELS[-1])
    layers = next((n for n in TILE_LAYERS if n * grid.layer_mm <= largest), TILE_LAYERS[-1])
    x, y = (pixel_nodes(pixels, pitch) for pitch in grid.pitch_mm)
    return Tiling((pixels, pixels), layers, (x, y, pixel_nodes(layers, grid.layer_mm)))


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


def reach(kernels: Kernels, axis: int, nodes: Nodes) -> Reach:
    """Which tiles along x (0) or y (1) have nodes that the kernels reach; each kernel is given one at least."""
    centre = kernels.centre_mm[:, axis]
    first = np.ceil((centre - kernels.radius_mm - nodes.end_mm) / nodes.side_mm).astype(np.int64)
    last = np.floor((centre + kernels.radius_mm - nodes.start_mm) / nodes.side_mm).astype(np.int64)
    return Reach(first, np.maximum(first, last), centre - first * nodes.side_mm)


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
    # By tile, and within one as they are: by kernel. A stable sort of small integers takes no longer than counting.
    by_tile = np.argsort(tile.astype(np.min_scalar_type(len(tiles))), kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=len(tiles)))])
    return TileLists(tiles, starts.astype(np.uint32), entry[by_tile])


def needed_tiles(runs: Runs, tiling: Tiling, rows: int) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """The tiles with at least one solid pixel, and which of their rows are needed in each layer.

    Args:
        rows: pixel rows that one bit stands for; at most 8 bits make a tile.

    Returns:
        (T, 2) column and row of the tiles, by rows; (T, layers) bits, the lowest for a tile's first rows.
    """
    down, across = tiling.over(runs.grid)
    bits = np.empty((runs.layers, down, across), np.uint8)
    at_once = max(1, NEEDED_CELLS // (down * across * (tiling.pixels[1] // rows)))
    for first in range(0, runs.layers, at_once):
        some = runs.part(first, min(runs.layers, first + at_once))
        bits[first : first + some.layers] = _needed_bits(some, tiling, rows)
    tiles = np.argwhere(bits.any(axis=0))
    return tiles[:, ::-1].astype(np.int32), np.ascontiguousarray(bits[:, tiles[:, 0], tiles[:, 1]].T)


def _needed_bits(runs: Runs, tiling: Tiling, rows: int) -> NDArray[np.uint8]:
    """(layers, tiles down, tiles across) bits of the rows that are needed."""
    down, across = tiling.over(runs.grid)
    tile, groups = tiling.pixels[0], tiling.pixels[1] // rows
    shape = (runs.layers, down * groups, across + 1)
    layer, row = np.divmod(runs.row, runs.grid.rows)
    line = (layer * shape[1] + row // rows) * shape[2]
    first, end = runs.start // tile, (runs.stop - 1) // tile + 1
    change = np.bincount(line + first, minlength=np.prod(shape)) - np.bincount(line + end, minlength=np.prod(shape))
    change = change.reshape(shape)
    solid = (np.cumsum(change, axis=2)[:, :, :-1] > 0).reshape(runs.layers, down, groups, across)
    return np.asarray((solid << np.arange(groups, dtype=np.uint8)[:, None]).sum(axis=2, dtype=np.uint8))


def all_tiles(first: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int32]:
    """(T, 2) column and row of every tile from first up to, not including, end (column, row), by rows."""
    columns, rows = np.arange(first[0], end[0]), np.arange(first[1], end[1])
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.int32)
