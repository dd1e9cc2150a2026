"""Evaluates G on pixels with OpenCL: as rank-1 sums (fast), or kernel by kernel at each pixel (the readable form)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.tiles import TileLists, Tiling, reach, tile_lists

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.grid import Grid
    from amslicer.noise import Kernels

    Floats = NDArray[np.float64]

ROWS = 4  # pixel rows per work-item: with 8-float vectors, 8 accumulators of 16 registers
BLOCK = 24  # kernels staged at a time: with the sums of a tile they fit the first-level cache (32 kB)
# cl/tile.h: struct Axis
AXIS = np.dtype([("offset", np.float32), ("wave", np.float32), ("tile", np.int32), ("table", np.uint32)])


def work_shape(device: Device, tiling: Tiling) -> dict[str, int]:
    """The macros of cl/tile.h."""
    vector = min(16 if device.vector_width >= 16 else 8, tiling.pixels)
    return {"TILE": tiling.pixels, "ROWS": ROWS, "BLOCK": BLOCK, "VECTOR": vector}


class Evaluator:
    """The kernels of a slab of layers, on the device, ready to give G for its layers.

    Evaluators of one device share its scratch buffers: use one at a time.

    Args:
        device: an open device.
        kernels: all kernels that reach the slab.
        tiles: (T, 2) tiles to evaluate.
        tile_normals: (T, 3) their reference normals.
        grid, tiling: pixels and layers, and the tiles that they make.
        planar: 2D: the kernels do not know z.
        needed: (T, layers) uint8, a bit for each ROWS rows of a tile that are wanted in each layer that will be
            asked for; G elsewhere is left as it was. None means all of them.
    """

    def __init__(
        self, device: Device, kernels: Kernels, tiles: NDArray[np.int32], tile_normals: Floats,
        grid: Grid, tiling: Tiling, *, planar: bool, needed: NDArray[np.uint8] | None = None,
    ) -> None:  # fmt: skip
        self.device = device
        self.kernels = kernels
        self.planar = planar
        self.grid = grid
        self.tiling = tiling
        sides = [tiling.pixels * pitch for pitch in grid.pitch_mm]
        self._reach = reach(kernels, 0, sides[0]), reach(kernels, 1, sides[1])
        self._work_shape = work_shape(device, tiling)
        self.lists: TileLists = tile_lists(kernels, *self._reach, tiles, tile_normals)
        shape = np.stack([kernels.decay, kernels.radius_mm], axis=-1).astype(np.float32)
        self._shape = device.buffer(shape)
        self._axes = [device.buffer(self._axis(a)) for a in (0, 1)]
        self._needed = needed
        self._lists = [device.buffer(a) for a in (self.lists.tiles, self.lists.starts, self.lists.entries)]
        self._tables: list[Any] | None = None
        self._along: tuple[tuple[int, int], Any] | None = None
        self._wanted: tuple[int, Any] | None = None

    @property
    def floats_per_layer(self) -> int:
        """Size of G of one layer: real and imaginary part of every pixel of every tile."""
        return len(self.lists.tiles) * self.tiling.pixels**2 * 2

    def field(
        self, first: int, count: int, some: range | None = None, out: Any = None
    ) -> tuple[Any, NDArray[np.uint32]]:
        """Enqueues G of the layers first … first + count - 1.

        Args:
            some: a run of the listed tiles; None means all.
            out: a buffer of its own; None lends one that the next call overwrites.

        Returns:
            The buffer, float32 [layers][tiles][rows of a tile][real, imaginary][columns of a tile], and each
            tile's number in it.
        """
        some = some or range(len(self.lists.tiles))
        out = out or self.device.scratch("field", 8 * count * len(some) * self.tiling.pixels**2)
        if self._tables is None:
            self._tables = [self._table(a) for a in (0, 1)]
        if len(some):
            tiles, starts, entries = self._lists
            self.device.kernel("rank1", self._work_shape)(
                self.device.queue, (count, len(some)), (1, 1), out, tiles, self._needed_rows(count), starts, entries,
                *self._tables, *self._axes, self._along_z(first, count), np.uint32(len(self.kernels)),
                np.uint32(some.start),
            )  # fmt: skip
        return out, np.arange(len(some), dtype=np.uint32)

    def field_per_pixel(self, first: int, count: int) -> tuple[Any, NDArray[np.uint32]]:
        """The same G of all tiles, each kernel's exponential, sine and cosine computed at each pixel."""
        tile, tiles = self.tiling.pixels, len(self.lists.tiles)
        out = self.device.scratch("field", 8 * count * tiles * tile**2)
        if tiles:
            self.device.kernel("per_pixel", self._work_shape)(
                self.device.queue, (tile, tile * tiles, count), (tile, 1, 1), out, *self._lists,
                self._shape, *self._axes, self._along_z(first, count), np.uint32(len(self.kernels)),
                np.float32(self.grid.pitch_mm[0]), np.float32(self.grid.pitch_mm[1]),
            )  # fmt: skip
        return out, np.arange(tiles, dtype=np.uint32)

    def _needed_rows(self, count: int) -> Any:
        if self._wanted is None or self._wanted[0] != count:
            shape = (len(self.lists.tiles), count)
            needed = np.full(shape, 0xFF, np.uint8) if self._needed is None else self._needed
            assert needed.shape == shape
            self._wanted = (count, self.device.buffer(needed))
        return self._wanted[1]

    def _axis(self, axis: int) -> NDArray[Any]:
        """The kernels along x (0) or y (1), and a last entry for where their tables end."""
        out = np.zeros(len(self.kernels) + 1, AXIS)
        out["offset"][:-1] = self._reach[axis].offset_mm
        out["wave"][:-1] = self.kernels.wave[:, axis]
        out["tile"][:-1] = self._reach[axis].first
        out["table"] = self._reach[axis].tables
        return out

    def _table(self, axis: int) -> Any:
        """Enqueues the 1-D factors of all kernels along x (0) or y (1)."""
        count = len(self.kernels)
        slots = int(self._reach[axis].tables[-1])
        table = self.device.scratch(f"table{axis}", slots * 2 * self.tiling.pixels * 4)
        if count:
            kernel = self.device.kernel("tables", self._work_shape)
            pitch = np.float32(self.grid.pitch_mm[axis])
            kernel(self.device.queue, (count,), (1,), table, self._axes[axis], self._shape, pitch)
        return table

    def _along_z(self, first: int, count: int) -> Any:
        """The factors along z of some layers, the random phase included: complex64 [layers][kernels]; kept."""
        if self._along is not None and self._along[0] == (first, count):
            return self._along[1]
        # Heights count from the block of layers, not from the first layer asked for: float32 must round the same.
        kernels, in_block = self.kernels, first % self.tiling.layers
        base = self.grid.z_mm(first - in_block)
        columns = (base - kernels.centre_mm[:, 2], kernels.wave[:, 2], kernels.phase, kernels.decay)
        factors = self.device.scratch("along_z", 8 * count * len(kernels))
        if len(kernels):
            self.device.run(
                self.device.kernel("along_z", self._work_shape), len(kernels), factors,
                self.device.buffer(np.stack(columns, axis=-1).astype(np.float32)), self._shape,
                np.uint32(len(kernels)), np.uint32(count), np.float32(self.grid.layer_mm), np.uint32(in_block),
                np.uint32(self.planar),
            )  # fmt: skip
        self._along = ((first, count), factors)
        return factors
