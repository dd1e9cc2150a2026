"""Evaluates G at the nodes of tiles with OpenCL: as rank-1 sums (fast), or kernel by kernel (the readable form)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.tiles import TileLists, Tiling, reach, tile_lists

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.noise import Kernels

    Floats = NDArray[np.float64]

ROWS = 4  # rows of nodes per work-item: with 8-float vectors, 8 accumulators of 16 registers
BLOCK = 24  # kernels staged at a time: with the sums of a tile they fit the first-level cache (32 kB)
WAVES_BYTES = 16 << 20  # of directions at nodes that are made at a time
# cl/tile.h: struct Axis
AXIS = np.dtype([("offset", np.float32), ("wave", np.float32), ("tile", np.int32), ("table", np.uint32)])


def work_shape(device: Device, nodes: int) -> dict[str, int]:
    """The macros of cl/tile.h for tiles with so many nodes a side."""
    vector = min(16 if device.vector_width >= 16 else 8, nodes)
    return {"TILE": nodes, "ROWS": ROWS, "BLOCK": BLOCK, "VECTOR": vector}


def asked_for(
    device: Device, tiles: int, nodes: int, count: int, some: range | None, needed: Any, out: Any
) -> tuple[range, Any, Any]:
    """The tiles, what of them is needed, and the buffer for G of `count` planes, where whoever asks leaves them out."""
    some = some or range(tiles)
    if needed is None:
        needed = device.buffer(np.full((tiles, count), 0xFF, np.uint8))
    return some, needed, out or device.scratch("field", 8 * count * len(some) * nodes**2)


class Evaluator:
    """The kernels of a block of layers, on the device, ready to give G at the planes of nodes in it.

    Evaluators of one device share its scratch buffers: use one at a time.

    Args:
        device: an open device.
        kernels: all kernels that reach the block.
        tiles: (T, 2) tiles to evaluate.
        tile_normals: (T, 3) their reference normals.
        tiling: the tiles' nodes.
        block: number of the block of layers.
        planar: 2D: the kernels do not know z.
        envelope: of kernels that are no products along the axes: values over (|d|/radius)², evenly from 0 to 1, the
            last one 0. None: Gaussians.
        waves_at: of kernels that take the direction of the place: (N, 3) wave vectors, rad/mm, at (N, 3) places.
    """

    def __init__(
        self, device: Device, kernels: Kernels, tiles: NDArray[np.int32], tile_normals: Floats,
        tiling: Tiling, block: int, *, planar: bool, envelope: NDArray[np.float32] | None = None,
        waves_at: Callable[[Floats], Floats] | None = None,
    ) -> None:  # fmt: skip
        self.device = device
        self.kernels = kernels
        self.planar = planar
        self._envelope = envelope
        self._waves_at = waves_at
        self.tiling = tiling
        self._nodes = tiling.nodes[0].count
        self._base_mm = block * tiling.nodes[2].side_mm + tiling.nodes[2].start_mm
        self._reach = reach(kernels, 0, tiling.nodes[0]), reach(kernels, 1, tiling.nodes[1])
        self._work_shape = work_shape(device, self._nodes)
        self.lists: TileLists = tile_lists(kernels, *self._reach, tiles, tile_normals)
        shape = np.stack([kernels.decay, kernels.radius_mm], axis=-1).astype(np.float32)
        self._shape = device.buffer(shape)
        self._axes = [device.buffer(self._axis(a)) for a in (0, 1)]
        self._lists = [device.buffer(a) for a in (self.lists.tiles, self.lists.starts, self.lists.entries)]
        self._tables: list[Any] | None = None
        self._radial: tuple[Any, Any] | None = None
        self._along: tuple[tuple[int, int], Any] | None = None

    @property
    def floats_per_plane(self) -> int:
        """Size of G of one plane: real and imaginary part at every node of every tile."""
        return len(self.lists.tiles) * self._nodes**2 * 2

    def field(
        self, first: int, count: int, some: range | None = None, needed: Any = None, out: Any = None
    ) -> tuple[Any, NDArray[np.uint32]]:
        """Enqueues G of the block's planes first … first + count - 1.

        Args:
            some: a run of the listed tiles; None means all.
            needed: a buffer, (T, count) uint8, a bit for each ROWS rows of nodes of a tile that are wanted in each
                plane; G elsewhere is left as it was. None means all of them.
            out: a buffer of its own; None lends one that the next call overwrites.

        Returns:
            The buffer, float32 [planes][tiles][rows of a tile][real, imaginary][columns of a tile], and each
            tile's number in it.
        """
        some, needed, out = asked_for(self.device, len(self.lists.tiles), self._nodes, count, some, needed, out)
        if self._waves_at is not None:
            self._enqueue_simple(out, first, count, some, needed)
            return out, np.arange(len(some), dtype=np.uint32)
        if self._envelope is not None:
            self._enqueue_radial(out, first, count, some, needed)
            return out, np.arange(len(some), dtype=np.uint32)
        if self._tables is None:
            self._tables = [self._table(a) for a in (0, 1)]
        if len(some):
            tiles, starts, entries = self._lists
            self.device.kernel("rank1", self._work_shape)(
                self.device.queue, (count, len(some)), (1, 1), out, tiles, needed, starts, entries,
                *self._tables, *self._axes, self._along_z(first, count), np.uint32(len(self.kernels)),
                np.uint32(some.start),
            )  # fmt: skip
        return out, np.arange(len(some), dtype=np.uint32)

    def _enqueue_radial(self, out: Any, first: int, count: int, some: range, needed: Any) -> None:
        if not len(some):
            return
        tiles, starts, entries = self._lists
        self.device.kernel("radial", self._work_shape)(
            self.device.queue, (count, len(some)), (1, 1), out, tiles, needed, starts, entries, *self._axes,
            *self._shapes(), *self._places(first), np.uint32(some.start),
        )  # fmt: skip

    def _enqueue_simple(self, out: Any, first: int, count: int, some: range, needed: Any) -> None:
        """The same with the direction of each node, some tiles at a time: their waves are made here."""
        tiles, starts, entries = self._lists
        device, nodes = self.device, self._nodes
        normals = np.pad(self.kernels.normal, ((0, 0), (0, 1))).astype(np.float32)
        shapes, table = self._shapes()
        at_once = max(1, WAVES_BYTES // (12 * count * nodes**2))
        for start in range(some.start, some.stop, at_once):
            here = range(start, min(some.stop, start + at_once))
            device.kernel("simple", self._work_shape)(
                device.queue, (count, len(here)), (1, 1), out, tiles, needed, starts, entries, *self._axes,
                shapes, device.buffer(normals), device.buffer(self._waves(first, count, here)), table,
                *self._places(first), np.uint32(start), np.uint32(len(some)), np.uint32(start - some.start),
            )  # fmt: skip
            device.queue.finish()  # else the waves of all would wait in memory

    def _waves(self, first: int, count: int, some: range) -> NDArray[np.float32]:
        """(planes, tiles, rows, 3, columns) wave vectors at the nodes, rad/mm."""
        assert self._waves_at is not None
        x, y, z = self.tiling.nodes
        step = np.arange(self._nodes)
        columns, rows = self.lists.tiles[some.start : some.stop].T
        height = self._base_mm + (first + np.arange(count)) * z.step_mm
        across = columns[:, None] * x.side_mm + x.start_mm + step * x.step_mm
        down = rows[:, None] * y.side_mm + y.start_mm + step * y.step_mm
        shape = (count, len(some), self._nodes, self._nodes)
        places = np.stack(np.broadcast_arrays(
            across[None, :, None, :], down[None, :, :, None], height[:, None, None, None]
        ), axis=-1)  # fmt: skip
        waves = self._waves_at(places.reshape(-1, 3)).reshape(*shape, 3)
        return np.ascontiguousarray(np.swapaxes(waves, -1, -2).astype(np.float32))

    def _shapes(self) -> tuple[Any, Any]:
        """What cl/radial.cl knows of the kernels: height, wave along z, phase, radius; and their envelope."""
        assert self._envelope is not None
        kernels = self.kernels
        if self._radial is None:
            columns = (self._base_mm - kernels.centre_mm[:, 2], kernels.wave[:, 2], kernels.phase, kernels.radius_mm)
            table = np.append(self._envelope, 0).astype(np.float32)
            buffer = self.device.buffer
            self._radial = buffer(np.stack(columns, axis=-1).astype(np.float32)), buffer(table)
        return self._radial

    def _places(self, first: int) -> tuple[Any, ...]:
        """What cl/radial.cl knows of the nodes."""
        assert self._envelope is not None
        places = [np.array([n.step_mm, n.start_mm, n.side_mm, 0], np.float32) for n in self.tiling.nodes[:2]]
        step = np.float32(self.tiling.nodes[2].step_mm)
        return np.uint32(len(self._envelope) - 1), *places, step, np.uint32(first), np.uint32(self.planar)

    def field_per_pixel(self, first: int, count: int) -> tuple[Any, NDArray[np.uint32]]:
        """The same G of all tiles, whose nodes are pixels, with exponential, sine and cosine of each kernel at each."""
        assert self._envelope is None, "only of Gaussians"
        tile, tiles = self._nodes, len(self.lists.tiles)
        out = self.device.scratch("field", 8 * count * tiles * tile**2)
        if tiles:
            self.device.kernel("per_pixel", self._work_shape)(
                self.device.queue, (tile, tile * tiles, count), (tile, 1, 1), out, *self._lists,
                self._shape, *self._axes, self._along_z(first, count), np.uint32(len(self.kernels)),
                *(np.float32(nodes.step_mm) for nodes in self.tiling.nodes[:2]),
            )  # fmt: skip
        return out, np.arange(tiles, dtype=np.uint32)

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
        table = self.device.scratch(f"table{axis}", slots * 2 * self._nodes * 4)
        if count:
            kernel = self.device.kernel("tables", self._work_shape)
            nodes = self.tiling.nodes[axis]
            places = np.array([nodes.step_mm, nodes.start_mm, nodes.side_mm, 0], np.float32)
            kernel(self.device.queue, (count,), (1,), table, self._axes[axis], self._shape, places)
        return table

    def _along_z(self, first: int, count: int) -> Any:
        """The factors along z of some planes, the random phase included: complex64 [planes][kernels]; kept."""
        if self._along is not None and self._along[0] == (first, count):
            return self._along[1]
        # Heights count from the block's first plane, not from the first one asked for: float32 must round the same.
        kernels = self.kernels
        columns = (self._base_mm - kernels.centre_mm[:, 2], kernels.wave[:, 2], kernels.phase, kernels.decay)
        factors = self.device.scratch("along_z", 8 * count * len(kernels))
        if len(kernels):
            self.device.run(
                self.device.kernel("along_z", self._work_shape), len(kernels), factors,
                self.device.buffer(np.stack(columns, axis=-1).astype(np.float32)), self._shape,
                np.uint32(len(kernels)), np.uint32(count), np.float32(self.tiling.nodes[2].step_mm), np.uint32(first),
                np.uint32(self.planar),
            )  # fmt: skip
        self._along = ((first, count), factors)
        return factors
