"""Evaluates wave noise at the nodes of tiles with OpenCL: the slices of waves that reach each, read from tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from amslicer.evaluator import WAVES_BYTES, asked_for, work_shape
from amslicer.noise.waves import COSINES, ISOTROPIES

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.noise.waves import Wave, Waves
    from amslicer.tiles import Tiling

    Floats = NDArray[np.float64]

ROUNDING = 1e-6  # of cosines
PAIRS = 1 << 22  # of tiles and waves that are held against each other at a time
# cl/waves.cl: struct Wave and struct Entry
WAVE = np.dtype([("table", np.float32, 4), ("across", np.float32, 4), ("direction", np.float32, 4)])
ENTRY = np.dtype([
    ("wave", np.uint32), ("sample", np.int32), ("part", np.float32), ("low", np.float32), ("high", np.float32),
    ("weight", np.float32), ("blended", np.uint32), ("opposite", np.uint32),
])  # fmt: skip


class Paint(Protocol):
    """What wave noise reads of the painted fields, at (N, 3) places in the pattern frame, mm."""

    def normals(self, points_mm: Floats) -> Floats:
        """(N, 3) unit normals in printer axes."""

    def isotropies(self, points_mm: Floats) -> Floats:
        """(N,) 0 laminate … 1 isotropic."""

    def periods(self, points_mm: Floats) -> Floats:
        """(N,) mm."""

    @property
    def one_direction(self) -> bool:
        """Whether direction and isotropy are the same everywhere."""

    @property
    def direction_depends_on_z(self) -> bool:
        """Whether direction, isotropy or period change from layer to layer."""

    @property
    def isotropy_bounds(self) -> tuple[float, float]:
        """No isotropy is below the first or above the second."""


class Tables:
    """What all blocks of a job share on the device: the waves' tables and the table of weights."""

    def __init__(self, device: Device, noise: Wave, paint: Paint) -> None:
        self.noise = noise
        tables = noise.tables
        self.levels, self.samples = (1 if noise.by_part else len(tables)), tables.shape[1]
        closed = np.concatenate([tables, tables[:, :1]], axis=1).astype(np.complex64)
        self.tables = device.buffer(closed)
        low, high = (float(np.clip(v, 0.0, 1.0)) for v in paint.isotropy_bounds)
        isotropies = np.array([low]) if low == high else np.linspace(0.0, 1.0, ISOTROPIES)
        self.weights = noise.weights(isotropies)
        self.weights_buffer = device.buffer(self.weights.astype(np.float32))
        # The smallest cosine with any weight, per isotropy.
        self.least_cosine = np.array([_first_used(row) for row in self.weights])


def _first_used(row: Floats) -> float:
    return max(0.0, (int(np.argmax(row > 0)) - 1) / COSINES)


class WaveEvaluator:
    """The waves of a block of layers, on the device, ready to give G at the planes of nodes in it.

    Args:
        device: an open device.
        tables: the job's.
        tiles: (T, 2) tiles to evaluate.
        tile_normals: (T, 3) their reference normals.
        tiling: the tiles' nodes.
        block: number of the block of layers.
        paint: the painted fields.
        planar: 2D: the same on every plane.
    """

    def __init__(
        self, device: Device, tables: Tables, tiles: NDArray[np.int32], tile_normals: Floats, tiling: Tiling,
        block: int, paint: Paint, *, planar: bool,
    ) -> None:  # fmt: skip
        self.device, self.tiling, self.planar = device, tiling, planar
        self._tables, self._noise, self._paint = tables, tables.noise, paint
        self._tiles, self._normals = tiles, tile_normals
        self._nodes = tiling.nodes[0].count
        self._base_mm = 0.0 if planar else block * tiling.nodes[2].side_mm + tiling.nodes[2].start_mm
        self._painted = self._noise.directed and not paint.one_direction
        self._graded = tables.levels > 1
        self._flat_paint: NDArray[np.float32] | None = None
        waves = self._all_waves()
        starts, entries, used = self._lists(waves)
        self.entries_per_tile = len(entries) / max(1, len(tiles))
        self._buffers = [device.buffer(a) for a in (starts, entries, used)]

    @property
    def floats_per_plane(self) -> int:
        """Size of G of one plane: real and imaginary part at every node of every tile."""
        return len(self._tiles) * self._nodes**2 * 2

    def field(
        self, first: int, count: int, some: range | None = None, needed: Any = None, out: Any = None
    ) -> tuple[Any, NDArray[np.uint32]]:
        """As of amslicer.evaluator.Evaluator."""
        some, needed, out = asked_for(self.device, len(self._tiles), self._nodes, count, some, needed, out)
        planes = count if self._paint.direction_depends_on_z and not self.planar else 1
        per_tile = 20 * planes * self._nodes**2
        has_paint = self._painted or self._graded
        at_once = max(1, WAVES_BYTES // per_tile) if has_paint else max(1, len(some))
        kernel = self.device.kernel("waves", self._macros())
        for start in range(some.start, some.stop, at_once):
            here = range(start, min(some.stop, start + at_once))
            paint = self.device.buffer(self._paint_of(first, planes, here) if has_paint else np.zeros(1, np.float32))
            kernel(
                self.device.queue, (count, len(here)), (1, 1), out, needed, *self._buffers, self._tables.tables,
                self._tables.weights_buffer, paint, np.uint32(planes), np.uint32(0 if self.planar else first),
                np.uint32(start), np.uint32(len(some)), np.uint32(start - some.start),
            )  # fmt: skip
            if has_paint:
                self.device.queue.finish()  # else what is painted at all nodes would wait in memory
        return out, np.arange(len(some), dtype=np.uint32)

    def _macros(self) -> dict[str, int]:
        return {
            **work_shape(self.device, self._nodes), "PAINTED": self._painted, "LEVELS": self._tables.levels,
            "SAMPLES": self._tables.samples, "COSINES": COSINES, "ISOTROPIES": len(self._tables.weights),
        }  # fmt: skip

    def _corners(self) -> tuple[Floats, Floats]:
        """(T, 3) the tiles' first nodes on the block's first plane, and (3,) from there to the last ones, mm."""
        x, y, z = self.tiling.nodes
        first = np.column_stack([self._tiles * self.tiling.sides_mm, np.full(len(self._tiles), self._base_mm)])
        first[:, :2] += (x.start_mm, y.start_mm)
        spans = [(n.count - 1) * n.step_mm for n in (x, y, z)]
        return first, np.array([*spans[:2], 0.0 if self.planar else spans[2]])

    def _all_waves(self) -> Waves:
        first, span = self._corners()
        waves = self._noise.waves(first.min(axis=0), first.max(axis=0) + span)
        if self._noise.by_part:
            return waves.take(self._noise.powers[self._noise.rows[waves.part]] > 0)
        if self._painted or not len(waves.offset):
            return waves
        weight = self._weight(waves.direction @ self._normals[0])
        return waves.take(weight > 0)

    def _weight(self, cosine: Floats) -> Floats:
        """(M,) weights where direction and isotropy are the same everywhere."""
        return np.asarray(np.interp(np.abs(cosine), np.linspace(0.0, 1.0, COSINES + 1), self._tables.weights[0]))

    def _lists(self, waves: Waves) -> tuple[NDArray[np.uint32], NDArray[Any], NDArray[Any]]:
        """Where each tile's entries start, the entries in the order of the waves, and the waves."""
        noise, tables = self._noise, self._tables
        first, span = self._corners()
        width, steps = 2 * noise.blend_mm, np.array([n.step_mm for n in self.tiling.nodes])
        if self.planar:
            steps[2] = 0.0
        per_mm = tables.samples / noise.length_mm
        device_waves = np.zeros(len(waves.offset), WAVE)
        device_waves["table"][:, :3] = waves.direction * steps * per_mm
        device_waves["across"][:, :3] = waves.axis * steps / width
        device_waves["direction"][:, :3] = waves.direction
        device_waves["table"][:, 3] = noise.rows[waves.part] if noise.by_part else 0
        device_waves["across"][:, 3] = noise.powers[noise.rows[waves.part]] if noise.by_part else 1
        reach = np.abs(waves.axis) @ span / 2
        middle = first + span / 2
        near = self._near(waves) if self._painted else None
        weight = np.ones(len(waves.offset)) if self._painted else self._weight(waves.direction @ self._normals[0])
        found, counts = [], np.zeros(len(first), np.int64)
        at_once = max(1, PAIRS // max(1, len(waves.offset)))
        for start in range(0, len(first), at_once):
            some = slice(start, start + at_once)
            across = middle[some] @ waves.axis.T
            here = (across + reach > waves.low_mm - noise.blend_mm) & (across - reach < waves.high_mm + noise.blend_mm)
            if near is not None:
                here &= near(some)
            tile, wave = np.nonzero(here)
            counts[some] = here.sum(axis=1)
            corner = first[some][tile]
            place = (np.einsum("ni,ni->n", corner, waves.direction[wave]) / noise.length_mm + waves.offset[wave]) % 1.0
            place *= tables.samples
            at = np.einsum("ni,ni->n", corner, waves.axis[wave])
            entries = np.zeros(len(tile), ENTRY)
            entries["wave"], entries["weight"] = wave, weight[wave]
            entries["sample"] = np.floor(place)
            entries["part"] = place - np.floor(place)
            entries["low"] = (at - waves.low_mm[wave]) / width + 0.5
            entries["high"] = (waves.high_mm[wave] - at) / width + 0.5
            low, high = (across - reach)[tile, wave], (across + reach)[tile, wave]
            entries["blended"] = (low < waves.low_mm[wave] + noise.blend_mm) | (
                high > waves.high_mm[wave] - noise.blend_mm
            )
            if not noise.by_part:  # whose parts are on one side already
                against = np.einsum("ni,ni->n", waves.direction[wave], self._normals[some][tile]) < 0
                entries["opposite"] = against
            found.append(entries)
        starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)
        return starts, np.concatenate(found) if found else np.zeros(0, ENTRY), device_waves

    def _near(self, waves: Waves) -> Callable[[slice], NDArray[np.bool_]]:
        """A function from some of the tiles to (some, M): which waves have any weight in them."""
        planes, most = self._planes_of_paint, len(self._tables.weights) - 1
        middle, reach = np.empty((len(self._tiles), 3)), np.empty(len(self._tiles))
        at_once = max(1, WAVES_BYTES // (20 * planes * self._nodes**2))
        for start in range(0, len(self._tiles), at_once):
            some = range(start, min(len(self._tiles), start + at_once))
            paint = self._paint_of(0, planes, some).astype(np.float64)
            normal = np.swapaxes(paint[:, :, :, :3], -1, -2).swapaxes(0, 1).reshape(len(some), -1, 3)
            mean = normal.mean(axis=1)
            length = np.linalg.norm(mean, axis=1, keepdims=True)
            mean = np.where(length > 0, mean / np.where(length > 0, length, 1.0), normal[:, 0])
            apart = np.arccos(np.clip(np.einsum("tni,ti->tn", normal, mean).min(axis=1), -1.0, 1.0))
            isotropy = np.ceil(paint[:, :, :, 3].swapaxes(0, 1).reshape(len(some), -1).max(axis=1)).astype(int)
            here = slice(some.start, some.stop)
            middle[here], reach[here] = mean, np.arccos(self._tables.least_cosine[np.minimum(isotropy, most)]) + apart
        least = np.where(reach < np.pi / 2, np.cos(np.minimum(reach, np.pi / 2)), -1.0) - ROUNDING

        def near(some: slice) -> NDArray[np.bool_]:
            return np.asarray(np.abs(middle[some] @ waves.direction.T) >= least[some, None])

        return near

    @property
    def _planes_of_paint(self) -> int:
        return self.tiling.nodes[2].count if self._paint.direction_depends_on_z and not self.planar else 1

    def _paint_of(self, first: int, planes: int, some: range) -> NDArray[np.float32]:
        """(planes, tiles, rows, 5, columns): normal on the tile's side, isotropy and period as places in tables."""
        if planes > 1 or 20 * len(self._tiles) * self._nodes**2 > WAVES_BYTES:
            return self._made_paint(first, planes, some)
        if self._flat_paint is None:
            self._flat_paint = self._made_paint(0, 1, range(len(self._tiles)))
        return self._flat_paint[:, some.start : some.stop]

    def _made_paint(self, first: int, planes: int, some: range) -> NDArray[np.float32]:
        x, y, z = self.tiling.nodes
        step = np.arange(self._nodes)
        columns, rows = self._tiles[some.start : some.stop].T
        height = self._base_mm + (first + np.arange(planes)) * z.step_mm
        across = columns[:, None] * x.side_mm + x.start_mm + step * x.step_mm
        down = rows[:, None] * y.side_mm + y.start_mm + step * y.step_mm
        shape = (planes, len(some), self._nodes, self._nodes)
        points = np.stack(np.broadcast_arrays(
            across[None, :, None, :], down[None, :, :, None], height[:, None, None, None]
        ), axis=-1).reshape(-1, 3)  # fmt: skip
        out = np.empty((planes, len(some), self._nodes, 5, self._nodes), np.float32)
        normal = self._paint.normals(points).reshape(*shape, 3)
        against = np.einsum("ptrci,ti->ptrc", normal, self._normals[some.start : some.stop]) < 0
        out[:, :, :, :3] = np.swapaxes(np.where(against[..., None], -normal, normal), -1, -2)
        isotropy = self._paint.isotropies(points) * (ISOTROPIES - 1) if len(self._tables.weights) > 1 else np.zeros(1)
        out[:, :, :, 3] = np.broadcast_to(isotropy, len(points)).reshape(shape)
        level = np.zeros(len(points))
        if self._graded:
            periods = self._noise.table_periods_mm
            level = np.interp(self._paint.periods(points), periods, np.arange(len(periods)))
        out[:, :, :, 4] = level.reshape(shape)
        return out
