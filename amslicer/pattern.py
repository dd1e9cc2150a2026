"""The laminate inside one part: noise, painted fields, profile, evaluated slab by slab on a device."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.evaluator import ROWS, Evaluator, work_shape
from amslicer.generator import DeviceGenerator
from amslicer.noise import NOISES
from amslicer.noise.kernels import Kernels, join_kernels
from amslicer.profile import PROFILES
from amslicer.tiles import Tiling, all_tiles, needed_tiles, tiles_over

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.mask import Runs
    from amslicer.noise import Noise
    from amslicer.painted import Painted

    Floats = NDArray[np.float64]

FIELD_BYTES = 32 << 20  # G of some tiles at a time: 8 bytes per pixel and layer, within a processor's cache
EDGES = (1 << 30) + (1 << 29)  # fourth word of the counters of dithered edges, which no noise uses (noise/kernels.py)


def make_noise(job: Job, painted: Painted) -> Noise:
    """The job's noise with its parameters."""
    pattern = job.spec.pattern
    given = {} if pattern.impulses is None else {"impulses": pattern.impulses}
    return NOISES[pattern.noise](
        periods_mm=painted.period_bounds_mm, bandwidth=pattern.bandwidth, dimensions=pattern.dimensions,
        seed=pattern.seed, **given,
    )  # fmt: skip


@dataclass(frozen=True)
class PlanarField:
    """G of a 2D pattern: evaluated once for all tiles, the same for all layers."""

    buffer: Any
    slot_of_tile: NDArray[np.uint32]


class Pattern:
    """Labels of the solid pixels of a part, layer by layer, on an open device."""

    def __init__(self, job: Job, painted: Painted, grid: Grid, tiling: Tiling, device: Device) -> None:
        self.painted = painted
        self.grid = grid
        self.tiling = tiling
        self.device = device
        self.noise = make_noise(job, painted)
        self.planar = job.spec.pattern.dimensions == 2
        self._profile = PROFILES[job.spec.pattern.profile]
        self._dithered = job.spec.pattern.edges == "dithered"
        self._seed = job.spec.pattern.seed
        self._generator = DeviceGenerator(device)
        self._padded = tuple(tiling.pixels * count for count in tiles_over(grid, tiling.pixels))
        self._planar_field: PlanarField | None = None
        self._thresholds: Any = None
        self._ratio: dict[int, NDArray[np.float32]] = {}
        self._sums: list[Floats] = []
        self._cell_layers: dict[int, Kernels] = {}
        # What is ever looked at, margin included, in whole tiles: kernels are kept for all of it.
        first, end = self._all_tiles()
        side = tiling.pixels * np.array(grid.pitch_mm)
        self._rectangle = np.array(first) * side, np.array(end) * side

    def labels(self, runs: Runs, first: int) -> NDArray[np.uint8]:
        """Labels of the layers first, first + 1, …: 0 empty, m = material m.

        Args:
            runs: the solid pixels; the layers lie in one layer of tiles.
            first: index of the first of them.

        Returns:
            (layers, rows, columns) uint8, row 0 = lowest y.
        """
        rows, columns = self._padded
        labels = np.zeros((runs.layers, rows, columns), np.uint8)
        tiles, needed = needed_tiles(runs, self.tiling.pixels, ROWS)
        if len(tiles):
            self._label_tiles(labels, runs, tiles, needed, first)
        if self.painted.ratio_depends_on_z:
            self._ratio.clear()
        return labels[:, : self.grid.rows, : self.grid.columns]

    def asked(self, runs: Runs, first: int) -> list[list[float]]:
        """Per layer and material, the sum of its painted share over the solid pixels."""
        layer_of_run = runs.row // self.grid.rows
        materials = len(self.painted.materials)
        sums = np.zeros((runs.layers, materials + 1))
        sums[:, -1] = runs.pixels
        for layer in range(runs.layers) if self.painted.ratio_depends_on_z else (None,):
            here = slice(None) if layer is None else layer_of_run == layer
            row = runs.row[here] % self.grid.rows
            for m, until in enumerate(self._sums_until(first + (layer or 0)), 1):
                shares = until[row, runs.stop[here]] - until[row, runs.start[here]]
                sums[:, m] += np.bincount(layer_of_run[here], shares, minlength=runs.layers)
        return [[float(v) for v in row] for row in np.diff(sums, axis=1)]

    def _sums_until(self, layer: int) -> list[Floats]:
        """Per cumulative ratio, (rows, columns + 1) its running sum along each row."""
        if not self._sums or self.painted.ratio_depends_on_z:
            planes = self.ratio(layer)
            self._sums = [np.zeros((self.grid.rows, self.grid.columns + 1)) for _ in planes]
            for until, plane in zip(self._sums, planes, strict=True):
                np.cumsum(plane, axis=1, dtype=np.float64, out=until[:, 1:])
        return self._sums

    def ratio(self, layer: int) -> NDArray[np.float32]:
        """(materials - 1, rows, columns) cumulative painted ratios; made once, and kept until the layer is labelled."""
        key = layer if self.painted.ratio_depends_on_z else 0
        if key not in self._ratio:
            self._ratio[key] = self.painted.ratio_map(self.grid, key)
        return self._ratio[key]

    def field(self, layer: int, *, per_pixel: bool = False) -> NDArray[np.complex64]:
        """G at every pixel of a layer, margin included: (height, width) complex64, row 0 = lowest y."""
        grid, margin, tile = self.grid, self.grid.margin_px, self.tiling.pixels
        first, end = self._all_tiles()
        before = -first[0]
        evaluator = self._evaluator(layer, 1, all_tiles(first, end))
        parts = np.empty((end[1] + before, end[0] + before, tile, 2, tile), np.float32)
        evaluate = evaluator.field_per_pixel if per_pixel else evaluator.field
        self.device.read(evaluate(layer, 1)[0], parts)
        re, im = (parts[:, :, :, i].transpose(0, 2, 1, 3).reshape(parts.shape[0] * tile, -1) for i in (0, 1))
        corner = before * tile - margin
        window = slice(corner, corner + grid.height_px), slice(corner, corner + grid.width_px)
        return (re + 1j * im)[window].astype(np.complex64)

    def _all_tiles(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """First and end (column, row) of the tiles that cover the part and its margin."""
        grid, tile = self.grid, self.tiling.pixels
        before = -(-grid.margin_px // tile)
        columns, rows = (-(-(n + grid.margin_px) // tile) for n in (grid.columns, grid.rows))
        return (-before, -before), (columns, rows)

    def _label_tiles(
        self, labels: NDArray[np.uint8], runs: Runs, tiles: NDArray[np.int32], needed: NDArray[np.uint8], first: int
    ) -> None:
        """Writes the labels of the listed tiles into (layers, padded rows, padded columns)."""
        device, tile = self.device, self.tiling.pixels
        solid, out = self._solid(runs), device.scratch("labels", labels.nbytes)
        device.fill_zeros(out, labels.nbytes)
        planar = self._planar_g() if self.planar else None
        evaluator = None if planar else self._evaluator(first, runs.layers, tiles, needed)
        waves = self._waves(tiles, first) if self._dithered else np.zeros((len(tiles), 4), np.float32)
        shape = {**work_shape(device, self.tiling), "CYCLIC": self._profile.cyclic, "DITHERED": self._dithered}
        seed = np.array([self._seed & 0xFFFFFFFF, self._seed >> 32], np.uint32)
        # Few enough tiles at a time for their G to stay in the cache between the noise and the profile.
        layers = 1 if planar else runs.layers
        at_once = max(1, FIELD_BYTES // (8 * tile * tile * layers))
        graded = list(self._threshold_buffers(first, runs.layers))
        for start in range(0, len(tiles), at_once):
            some = tiles[start : start + at_once]
            if planar:
                field, slots = planar.buffer, planar.slot_of_tile[some[:, 1], some[:, 0]]
            else:
                assert evaluator is not None
                field, slots = evaluator.field(first, layers, range(start, start + len(some)))
            profiled = device.buffer(some), device.buffer(slots)
            waves_of_some = device.buffer(waves[start : start + at_once])
            field_tiles = np.uint32(planar.slot_of_tile.size if planar else len(some))
            for layer, count, thresholds in graded:
                device.kernel("profile", shape)(
                    device.queue, (tile, len(some), count), (tile, 1, 1), out, field, solid, thresholds, *profiled,
                    np.uint32(len(self.painted.materials) - 1), np.array(self._padded[::-1], np.uint32), field_tiles,
                    np.uint32(layers), np.uint32(layer), waves_of_some, seed, np.uint32(EDGES),
                    np.uint32(first + layer), np.uint32(self.planar),
                )  # fmt: skip
        device.read(out, labels)

    def _solid(self, runs: Runs) -> Any:
        """The solid pixels as a device buffer: uint8 [layers][padded rows][padded columns]."""
        rows, columns = self._padded
        size = runs.layers * rows * columns
        solid = self.device.scratch("solid", size)
        self.device.fill_zeros(solid, size)
        total = runs.layers * self.grid.rows
        starts = np.searchsorted(runs.row, np.arange(total + 1)).astype(np.uint32)
        pairs = np.stack([runs.start, runs.stop], axis=-1).astype(np.int32)
        self.device.run(
            self.device.kernel("fill"), total, solid, self.device.buffer(starts), self.device.buffer(pairs),
            np.uint32(columns), np.uint32(self.grid.rows), np.uint32(rows), np.uint32(total),
        )  # fmt: skip
        return solid

    def _planar_g(self) -> PlanarField:
        """G of a 2D pattern, evaluated once."""
        if self._planar_field is None:
            rows, columns = tiles_over(self.grid, self.tiling.pixels)
            evaluator = self._evaluator(0, 1, all_tiles((0, 0), (columns, rows)))
            buffer = self.device.empty(4 * evaluator.floats_per_layer)
            evaluator.field(0, 1, out=buffer)
            slots = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
            self._planar_field = PlanarField(buffer, slots)
        return self._planar_field

    def _evaluator(
        self, first: int, count: int, tiles: NDArray[np.int32], needed: NDArray[np.uint8] | None = None
    ) -> Evaluator:
        """An evaluator for some layers (of one layer of tiles) and tiles."""
        grid, side = self.grid, self.tiling.pixels * np.array(self.grid.pitch_mm)
        low, high = tiles.min(axis=0) * side, (tiles.max(axis=0) + 1) * side
        kernels = self._kernels(low, high, grid.z_mm(first), grid.z_mm(first + count - 1))
        normals = self.painted.normals(self._centres(tiles, first))
        return Evaluator(self.device, kernels, tiles, normals, grid, self.tiling, planar=self.planar, needed=needed)

    def _centres(self, tiles: NDArray[np.int32], layer: int) -> Floats:
        """(T, 3) centres of the tiles that hold a layer, mm."""
        side = self.tiling.pixels * np.array(self.grid.pitch_mm)
        middle = self.tiling.block_middle_mm(layer, self.grid.layer_mm)
        return np.column_stack([(tiles + 0.5) * side, np.full(len(tiles), middle)])

    def _waves(self, tiles: NDArray[np.int32], layer: int) -> NDArray[np.float32]:
        """(T, 4) the painted wave at the tiles' centres, in rad per column, row and layer; the last is 0."""
        centres = self._centres(tiles, layer)
        waves = self.painted.normals(centres) * (2 * np.pi / self.painted.periods(centres))[:, None]
        return np.pad(waves * (*self.grid.pitch_mm, self.grid.layer_mm), ((0, 0), (0, 1))).astype(np.float32)

    def _kernels(self, low_mm: Floats, high_mm: Floats, low_z_mm: float, high_z_mm: float) -> Kernels:
        """All kernels that reach a rectangle between two heights, in the order of their cells."""
        cell_layers = self.noise.cell_layers(low_z_mm, high_z_mm)
        self._cell_layers = {number: kernels for number, kernels in self._cell_layers.items() if number in cell_layers}
        for number in cell_layers:
            if number not in self._cell_layers:
                self._cell_layers[number] = self.noise.kernels(self._generator, number, *self._rectangle, self.painted)
        near = []
        for number in cell_layers:
            kernels = self._cell_layers[number]
            centre, radius = kernels.centre_mm, kernels.radius_mm
            reaches = np.all(centre[:, :2] + radius[:, None] > low_mm, axis=1)
            reaches &= np.all(centre[:, :2] - radius[:, None] < high_mm, axis=1)
            if not self.planar:
                reaches &= (centre[:, 2] + radius > low_z_mm) & (centre[:, 2] - radius < high_z_mm)
            near.append(kernels.take(reaches))
        return join_kernels(near)

    def _threshold_buffers(self, first: int, count: int) -> Iterator[tuple[int, int, Any]]:
        """For runs of layers with the same painted ratio: (number of the first, how many, thresholds)."""
        if not self.painted.ratio_depends_on_z:
            if self._thresholds is None:
                self._thresholds = self._threshold_buffer(first)
            yield 0, count, self._thresholds
            return
        for layer in range(count):
            yield layer, 1, self._threshold_buffer(first + layer)

    def _threshold_buffer(self, layer: int) -> Any:
        ratio = self.ratio(layer)
        padded = np.zeros((len(ratio), *self._padded), np.float32)
        padded[:, : self.grid.rows, : self.grid.columns] = self._profile.thresholds(ratio)
        return self.device.buffer(padded)
