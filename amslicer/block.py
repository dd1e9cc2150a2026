"""Bitmaps of the layers in one layer of tiles: their kernels and G are made once and shared by all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.evaluator import ROWS, work_shape
from amslicer.tiles import needed_tiles

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.lattice import Lattice
    from amslicer.mask import Runs
    from amslicer.pattern import FieldEvaluator, Pattern

FIELD_BYTES = 32 << 20  # G at the pixels of some tiles at a time, within a processor's cache
ROW_GROUPS = 8  # of a tile on a lattice: a bit each says whether it has solid pixels
EDGES = (1 << 30) + (1 << 29)  # fourth word of the counters of dithered edges, which no noise uses (noise/kernels.py)


@dataclass(frozen=True)
class PlanarField:
    """G of a 2D pattern: evaluated once for all tiles, the same for all layers."""

    buffer: Any
    slot_of_tile: NDArray[np.uint32]


class Block:
    """The layers of one layer of tiles that a run makes. One block of a device at a time.

    Args:
        pattern: the part's.
        runs: the solid pixels of all these layers.
        first: index of the first of them.
    """

    def __init__(self, pattern: Pattern, runs: Runs, first: int) -> None:
        self._pattern, self._device = pattern, pattern.device
        self._runs, self._first = runs, first
        self._number, self._in_block = divmod(first, pattern.tiling.layers)
        rows = ROWS if pattern.lattice is None else pattern.tiling.pixels[1] // ROW_GROUPS
        tiles, needed = needed_tiles(runs, pattern.tiling, rows)
        plain = pattern.plain(tiles)
        order = np.argsort(plain, kind="stable")
        self._tiles, self._needed = tiles[order], needed[order]
        # G is evaluated in the first tiles; one of them stands for G of the plain ones, which nothing reads.
        self._with_g = min(len(tiles), max(1, int(np.count_nonzero(~plain))))
        self._waves = pattern.waves(self._tiles, self._number)
        self._kept_evaluator: FieldEvaluator | None = None
        self._slab: tuple[Any, int] | None = None

    def deposits(self, first: int, end: int) -> NDArray[np.uint8]:
        """Where each material is in the layers first … end - 1, which are some of the block's.

        Returns:
            (layers, materials, rows, bytes) uint8, a bit per pixel, the highest first, row 0 = lowest y.
        """
        pattern, device = self._pattern, self._device
        rows, columns = pattern.padded
        shape = (end - first, len(pattern.painted.materials), rows, columns // 8)
        bits = np.empty(shape, np.uint8) if len(self._tiles) else np.zeros(shape, np.uint8)
        if len(self._tiles):
            labels = pattern.planar_labels() if pattern.same_in_all_layers else None  # before scratch buffers are lent
            solid, out = self._solid(first, end), device.scratch("deposits", bits.nbytes)
            if labels is not None:
                device.run(
                    device.kernel("reuse"), len(bits) * rows, out, labels, solid,
                    np.uint32(bits.shape[1]), np.uint32(rows), np.uint32(columns // 8), np.uint32(len(bits)),
                )  # fmt: skip
            else:
                device.fill_zeros(out, bits.nbytes)
                self._make(out, solid, first, end)
            device.read(out, bits)
        pattern.forget_ratios()
        return bits[:, :, : pattern.grid.rows, : -(-pattern.grid.columns // 8)]

    def labels(self) -> Any:
        """The bitmaps of the block's first layer as a device buffer of its own: [material][padded rows][bytes]."""
        rows, columns = self._pattern.padded
        size = len(self._pattern.painted.materials) * rows * columns // 8
        out = self._device.empty(size)
        self._device.fill_zeros(out, size)
        self._make(out, self._solid(self._first, self._first + 1), self._first, self._first + 1)
        return out

    def prepare(self) -> None:
        """Finds the kernels of a solid pattern; the first layers would do it else. May run in another thread."""
        if len(self._tiles) and not self._pattern.planar:
            self._evaluator  # noqa: B018

    def _make(self, out: Any, solid: Any, first: int, end: int) -> None:
        """Enqueues bitmaps of solid pixels into a buffer of zeros."""
        make = self._from_pixels if self._pattern.lattice is None else self._from_lattice
        make(out, solid, first, end)

    @property
    def _evaluator(self) -> FieldEvaluator:
        if self._kept_evaluator is None:
            self._kept_evaluator = self._pattern.evaluator(
                self._pattern.tiling, self._number, self._tiles[: self._with_g]
            )
        return self._kept_evaluator

    def _needed_in(self, first: int, end: int) -> NDArray[np.uint8]:
        return np.ascontiguousarray(self._needed[:, first - self._first : end - self._first])

    def _from_pixels(self, out: Any, solid: Any, first: int, end: int) -> None:
        """Enqueues bitmaps of tiles whose nodes are their pixels."""
        pattern, device, tiles = self._pattern, self._device, self._tiles
        tile, count = pattern.tiling.pixels[0], end - first
        planar = pattern.planar_field() if pattern.planar else None
        # Few enough tiles at a time for their G to stay in the cache between the noise and the profile.
        layers = 1 if planar else count
        at_once = max(1, FIELD_BYTES // (8 * tile * tile * layers))
        needed = device.buffer(self._needed_in(first, end))
        graded = list(pattern.threshold_buffers(first, count))
        in_block = self._in_block + first - self._first
        for start, stop in (*pieces_of(0, self._with_g, at_once), *pieces_of(self._with_g, len(tiles), at_once)):
            some = tiles[start:stop]
            if planar:
                field, slots = planar.buffer, planar.slot_of_tile[some[:, 1], some[:, 0]]
                field_tiles = np.uint32(planar.slot_of_tile.size)
            elif start < self._with_g:
                field, slots = self._evaluator.field(in_block, count, range(start, stop), needed)
                field_tiles = np.uint32(len(some))
            else:
                slots = np.zeros(len(some), np.uint32)
            buffers = device.buffer(some), device.buffer(slots)
            waves = device.buffer(self._waves[start:stop])
            for layer, some_layers, thresholds in graded:
                device.kernel("profile", self._macros(tile))(
                    device.queue, (tile, len(some), some_layers), (tile, 1, 1), out, field, solid, thresholds,
                    *pattern.ranks, *buffers, *self._materials(), field_tiles, np.uint32(layers), np.uint32(layer),
                    waves, *self._edges(first + layer),
                )  # fmt: skip

    def _from_lattice(self, out: Any, solid: Any, first: int, end: int) -> None:
        """Enqueues bitmaps of tiles whose pixels are interpolated from their nodes."""
        pattern, device, tiles, lattice = self._pattern, self._device, self._tiles, self._pattern.lattice
        assert lattice is not None
        if pattern.planar:
            planar = pattern.planar_field()
            field, first_plane, field_tiles = planar.buffer, 0, planar.slot_of_tile.size
            slots = planar.slot_of_tile[tiles[:, 1], tiles[:, 0]]
        else:
            field, first_plane = self._slab_of(lattice)
            field_tiles, slots = self._with_g, np.arange(len(tiles), dtype=np.uint32)
            slots[self._with_g :] = 0
        needed = device.buffer(self._needed_in(first, end))
        buffers, waves = (device.buffer(tiles), device.buffer(slots)), device.buffer(self._waves)
        x, y, z = pattern.taps_by_vector()
        taps = {"TAPS_X": x.count, "TAPS_Y": y.count, "TAPS_Z": z.count, "COLUMNS": len(x.first),
                "ROW_GROUPS": ROW_GROUPS}  # fmt: skip
        for layer, count, (thresholds, *painting) in pattern.shares(first, end - first, len(tiles)):
            device.kernel("interpolate", {**self._macros(lattice.tiling.nodes[0].count), **taps})(
                device.queue, (count, len(tiles)), (1, 1), out, field, solid, thresholds, *pattern.ranks, *buffers,
                *self._materials(), np.uint32(field_tiles), needed, np.uint32(end - first), np.uint32(layer), waves,
                *self._edges(first + layer), np.array(lattice.tiling.pixels, np.int32), np.uint32(first_plane),
                np.uint32(self._in_block + first + layer - self._first), *pattern.taps(), *painting,
            )  # fmt: skip

    def _slab_of(self, lattice: Lattice) -> tuple[Any, int]:
        """G at the nodes of all tiles, on the planes that the block's layers take; number of the first plane."""
        if self._slab is None:
            z = lattice.taps[2]
            low = int(z.first[self._in_block])
            high = int(z.first[self._in_block + self._runs.layers - 1]) + z.count
            out = self._device.scratch("slab", 4 * self._evaluator.floats_per_plane * (high - low))
            self._evaluator.field(low, high - low, out=out)
            self._slab = out, low
        return self._slab

    def _macros(self, nodes: int) -> dict[str, int]:
        return {**work_shape(self._device, nodes), **self._pattern.profile_macros()}

    def _materials(self) -> tuple[Any, Any]:
        return np.uint32(len(self._pattern.painted.materials) - 1), np.array(self._pattern.padded[::-1], np.uint32)

    def _edges(self, layer: int) -> tuple[Any, ...]:
        return self._pattern.seed, np.uint32(EDGES), np.uint32(layer), np.uint32(self._pattern.planar)

    def _solid(self, first: int, end: int) -> Any:
        """The solid pixels as a device buffer: bits, uint8 [layers][padded rows][padded columns / 8]."""
        grid, (rows, columns) = self._pattern.grid, self._pattern.padded
        runs = self._runs.part(first - self._first, end - self._first)
        size = runs.layers * rows * columns // 8
        solid = self._device.scratch("solid", size)
        self._device.fill_zeros(solid, size)
        total = runs.layers * grid.rows
        starts = np.searchsorted(runs.row, np.arange(total + 1)).astype(np.uint32)
        pairs = np.stack([runs.start, runs.stop], axis=-1).astype(np.int32)
        self._device.run(
            self._device.kernel("fill"), total, solid, self._device.buffer(starts), self._device.buffer(pairs),
            np.uint32(columns // 8), np.uint32(grid.rows), np.uint32(rows), np.uint32(total),
        )  # fmt: skip
        return solid


def pieces_of(first: int, end: int, size: int) -> list[tuple[int, int]]:
    """Half-open ranges of at most so many from first to end."""
    return [(start, min(end, start + size)) for start in range(first, end, size)]
