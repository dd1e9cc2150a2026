"""The laminate inside one part: noise, painted fields, profile, evaluated block by block of layers on a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from amslicer.block import Block, PlanarField
from amslicer.evaluator import Evaluator
from amslicer.generator import DeviceGenerator
from amslicer.mask import all_solid
from amslicer.noise import NOISES
from amslicer.noise.alignment import Alignment
from amslicer.noise.hyperplanes import Hyperplanes
from amslicer.noise.kernels import Kernels, join_kernels
from amslicer.noise.lobes import Lobes, make_lobes
from amslicer.noise.setting import Setting
from amslicer.noise.textures import RandomPhase
from amslicer.noise.waves import Wave
from amslicer.planeevaluator import PlaneEvaluator
from amslicer.profiles import ROUNDING, make_profile
from amslicer.textureevaluator import TextureEvaluator, Textures
from amslicer.tiles import Tiling, all_tiles, choose_tiling
from amslicer.waveevaluator import Tables, WaveEvaluator

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.fields.raster import Along, Raster
    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.lattice import Lattice, Taps
    from amslicer.mask import Runs
    from amslicer.noise import KernelNoise, Noise
    from amslicer.noise.kernels import CellLayer
    from amslicer.painted import Painted

    Floats = NDArray[np.float64]


TEXEL_BYTES = 32 << 20  # of painted ratios that the device is given at a time
BRIGHTNESS = np.array([0.299, 0.587, 0.114])  # of red, green, blue (ITU-R BT.601)


def make_noise(job: Job, painted: Painted) -> Noise:
    """The job's noise with its parameters."""
    pattern = job.spec.pattern
    width, depth = (float(v) for v in painted.placement.size_mm[:2])
    setting = Setting(
        painted.period_bounds_mm,
        job_lobes(job, painted),
        isotropy=min(max(painted.isotropy_bounds[0], 0.0), 1.0),
        normal=_in_the_middle(painted),
        turns=painted.turns,
        painted=not painted.one_direction,
        size_mm=(width, depth),
        exemplar=None if pattern.exemplar is None else _example(job),
        pixel_mm=pattern.exemplar_pixel_mm or job.spec.printer.pitch_mm[0],
    )
    return NOISES[pattern.noise].of_pattern(pattern, setting)


def _in_the_middle(painted: Painted) -> tuple[float, float, float]:
    x, y, z = painted.normals(painted.placement.size_mm[None] / 2)[0]
    return float(x), float(y), float(z)


def _example(job: Job) -> Floats:
    """The periodic component of the job's exemplar, of colours that of the brightness."""
    name = job.spec.pattern.exemplar
    assert name is not None
    return _periodic(job.inputs.read(name), name)


@lru_cache(maxsize=2)
def _periodic(content: bytes, name: str) -> Floats:
    from amslicer.exemplar import periodic_component, read_exemplar

    exemplar = read_exemplar(content, name)
    return periodic_component(exemplar.values[..., 0] if exemplar.is_grey else exemplar.values @ BRIGHTNESS)


def job_lobes(job: Job, painted: Painted) -> Lobes | None:
    """The job's lobes, if it has any, in printer axes: like all directions, they follow the part."""
    specs = job.spec.pattern.lobes
    if not specs:
        return None
    axes = np.eye(3)[["xyz".index(lobe.about) for lobe in specs]]
    if painted.dimensions == 3:
        axes = painted.placement.turn(axes)
    angles, weights = (np.array([getattr(lobe, name) for lobe in specs]) for name in ("angle", "weight"))
    return make_lobes(np.deg2rad(angles), axes, weights)


class FieldEvaluator(Protocol):
    """G at the planes of nodes of some tiles of a block of layers."""

    @property
    def floats_per_plane(self) -> int:
        """Size of G of one plane: real and imaginary part at every node of every tile."""

    def field(
        self, first: int, count: int, some: range | None = None, needed: Any = None, out: Any = None
    ) -> tuple[Any, NDArray[np.uint32]]:
        """As of amslicer.evaluator.Evaluator."""


class Pattern:
    """The materials of the solid pixels of a part, block by block of layers, on an open device.

    Args:
        tiling: the tiles that layers are made in.
        lattice: how their pixels come from their nodes; None where the nodes are the pixels.
    """

    def __init__(
        self, job: Job, painted: Painted, grid: Grid, tiling: Tiling, lattice: Lattice | None, device: Device
    ) -> None:
        self.painted = painted
        self.grid = grid
        self.tiling = tiling
        self.lattice = lattice
        self.device = device
        self.noise = make_noise(job, painted)
        sweeps = job.spec.pattern.alignment
        self.planar = job.spec.pattern.dimensions == 2
        self.profile = make_profile(job.spec.pattern.profile)
        self._rank_table = self.profile.rank_table(self.noise)
        self._ranks: Any = None
        self.dithered = job.spec.pattern.edges == "dithered"
        self.seed = np.array([job.spec.pattern.seed & 0xFFFFFFFF, job.spec.pattern.seed >> 32], np.uint32)
        down, across = tiling.over(grid)
        self.padded = down * tiling.pixels[1], across * tiling.pixels[0]
        self._pixel_tiling = choose_tiling(grid, painted.period_bounds_mm[0])
        self._generator = DeviceGenerator(device)
        self._planar_field: PlanarField | None = None
        self._thresholds: Any = None
        self._planes: NDArray[np.float32] | None = None
        self._planar_labels: Any = None
        self._plain: NDArray[np.bool_] | None = None
        self._by_vector: tuple[Taps, Taps, Taps] | None = None
        self._taps: list[Any] | None = None
        self._ratio: dict[int, NDArray[np.float32]] = {}
        self._sums: list[Floats] = []
        self._sums_on_device: dict[int, tuple[Any, int, int]] = {}
        self._cell_layers: dict[CellLayer, Kernels] = {}
        # What is ever looked at, margin included, in whole tiles: kernels are kept for all of it.
        corners = [self._all_tiles(some) for some in (self._pixel_tiling, tiling)]
        sides = [some.sides_mm for some in (self._pixel_tiling, tiling)]
        low, high = (
            np.array([np.array(ends[i]) * side for ends, side in zip(corners, sides, strict=True)]) for i in (0, 1)
        )
        self._rectangle = low.min(axis=0) - tiling.outside_mm, high.max(axis=0) + tiling.outside_mm
        self._alignment: Alignment | None = None
        self._wave_tables: Tables | None = None
        self._textures: Textures | None = None
        if sweeps:
            size = painted.placement.size_mm
            self._alignment = Alignment(self._kernel_noise, sweeps, size, self._generator, self._kernels_of)

    def block(self, runs: Runs, first: int) -> Block:
        """The layers first, first + 1, …, which lie in one layer of tiles, ready to be made.

        Args:
            runs: their solid pixels.
            first: index of the first of them.
        """
        return Block(self, runs, first)

    def sum_ratios(self, layer: int) -> None:
        """Makes what `asked` needs of a layer. May run in another thread, while no other needs it."""
        if not self._on_device:
            self._sums_until(layer)

    @cached_property
    def _on_device(self) -> bool:
        """Whether the device makes thresholds of the painted ratio, which changes with z, and adds it up."""
        keyed = self._rank_table is None and self.noise.reads == "phase"
        return keyed and self.lattice is not None and self.painted.ratio_depends_on_z

    def asked(self, runs: Runs, first: int) -> list[list[float]]:
        """Per layer and material, the sum of its painted share over the solid pixels. After the layers are made."""
        if self._on_device:
            return [self._asked_of(first + layer, int(pixels)) for layer, pixels in enumerate(runs.pixels)]
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

    def _asked_of(self, layer: int, solid: int) -> list[float]:
        """From the device's sums over its tiles."""
        planes = len(self.painted.materials) - 1
        until = np.zeros(planes)
        if layer in self._sums_on_device:  # else nothing is solid there
            buffer, number, layers = self._sums_on_device.pop(layer)
            sums = np.empty((layers, buffer.size // (4 * planes * layers), planes), np.float32)
            self.device.read(buffer, sums)
            until = sums[number].sum(axis=0, dtype=np.float64)
        return [float(v) for v in np.diff([0.0, *until, float(solid)])]

    def _sums_until(self, layer: int) -> list[Floats]:
        """Per cumulative ratio, (rows, columns + 1) its running sum along each row."""
        if not self._sums or self.painted.ratio_depends_on_z:
            planes = self.ratio(layer)
            self._sums = [np.zeros((self.grid.rows, self.grid.columns + 1)) for _ in planes]
            for until, plane in zip(self._sums, planes, strict=True):
                np.cumsum(plane, axis=1, dtype=np.float64, out=until[:, 1:])
        return self._sums

    def ratio(self, layer: int) -> NDArray[np.float32]:
        """(materials - 1, rows, columns) cumulative painted ratios; made once, and kept until the layer is made."""
        key = layer if self.painted.ratio_depends_on_z else 0
        if key not in self._ratio:
            self._ratio[key] = self.painted.ratio_map(self.grid, key)
        return self._ratio[key]

    def forget_ratios(self) -> None:
        """Lets go of the painted ratios of layers that are made."""
        if self.painted.ratio_depends_on_z:
            self._ratio.clear()

    def field(self, layer: int, *, per_pixel: bool = False) -> NDArray[np.complex64]:
        """G at every pixel of a layer, margin included, evaluated there: (height, width), row 0 = lowest y."""
        grid, margin, tiling = self.grid, self.grid.margin_px, self._pixel_tiling
        tile = tiling.pixels[0]
        first, end = self._all_tiles(tiling)
        before = -first[0]
        block, plane = divmod(layer, tiling.layers)
        evaluator = self.evaluator(tiling, block, all_tiles(first, end))
        parts = np.empty((end[1] + before, end[0] + before, tile, 2, tile), np.float32)
        if per_pixel:
            assert isinstance(evaluator, Evaluator)
            made = evaluator.field_per_pixel(plane, 1)
        else:
            made = evaluator.field(plane, 1)
        self.device.read(made[0], parts)
        re, im = (parts[:, :, :, i].transpose(0, 2, 1, 3).reshape(parts.shape[0] * tile, -1) for i in (0, 1))
        corner = before * tile - margin
        window = slice(corner, corner + grid.height_px), slice(corner, corner + grid.width_px)
        return (re + 1j * im)[window].astype(np.complex64)

    def _all_tiles(self, tiling: Tiling) -> tuple[tuple[int, int], tuple[int, int]]:
        """First and end (column, row) of the tiles that cover the part and its margin."""
        grid = self.grid
        (across, down), margin = tiling.pixels, grid.margin_px
        columns, rows = -(-(grid.columns + margin) // across), -(-(grid.rows + margin) // down)
        return (-(-margin // across) * -1, -(-margin // down) * -1), (columns, rows)

    @property
    def same_in_all_layers(self) -> bool:
        """Whether a pixel has the same material in every layer where it is solid."""
        return self.planar and not self.painted.materials_depend_on_z

    def planar_labels(self) -> Any:
        """Bitmaps of a pattern that is the same in all layers, made once, as a device buffer."""
        if self._planar_labels is None:
            self._planar_labels = self.block(all_solid(self.grid), 0).labels()
            self._planar_field = None
        return self._planar_labels

    @property
    def may_be_plain(self) -> bool:
        """Whether some tiles may need no G: a solid pattern whose ratio, the same in all layers, reaches 0 or 1."""
        bounds = self.painted.share_bounds()
        reaches = any(low <= ROUNDING or high >= 1 - ROUNDING for low, high in bounds)
        return reaches and not self.planar and not self.painted.ratio_depends_on_z

    def plain(self, tiles: NDArray[np.int32]) -> NDArray[np.bool_]:
        """(T,) tiles where every cumulative ratio is 0 or 1 all over: their materials are plain fills."""
        if not self.may_be_plain:
            return np.zeros(len(tiles), bool)
        if self._plain is None:
            (across, down), ratio = self.tiling.pixels, self.ratio(0)
            rows, columns = (np.arange(0, n, side) for n, side in zip(ratio.shape[1:], (down, across), strict=True))
            low, high = (
                extreme.reduceat(extreme.reduceat(ratio, rows, axis=1), columns, axis=2)
                for extreme in (np.minimum, np.maximum)
            )
            self._plain = np.all((high <= ROUNDING) | (low >= 1 - ROUNDING), axis=0)
        return np.asarray(self._plain[tiles[:, 1], tiles[:, 0]])

    def planar_field(self) -> PlanarField:
        """G of a 2D pattern at the nodes of all tiles, evaluated once."""
        if self._planar_field is None:
            rows, columns = self.tiling.over(self.grid)
            evaluator = self.evaluator(self.tiling, 0, all_tiles((0, 0), (columns, rows)))
            buffer = self.device.empty(4 * evaluator.floats_per_plane)
            evaluator.field(0, 1, out=buffer)
            slots = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
            self._planar_field = PlanarField(buffer, slots)
        return self._planar_field

    def evaluator(self, tiling: Tiling, block: int, tiles: NDArray[np.int32]) -> FieldEvaluator:
        """An evaluator for some tiles of one block of layers."""
        return EVALUATORS[self.noise.made_of](self, tiling, block, tiles)

    def kernel_evaluator(self, tiling: Tiling, block: int, tiles: NDArray[np.int32]) -> Evaluator:
        """Of noises made of kernels."""
        noise = self._kernel_noise
        side, along_z = tiling.sides_mm, tiling.nodes[2]
        low = tiles.min(axis=0) * side - tiling.outside_mm
        high = (tiles.max(axis=0) + 1) * side + tiling.outside_mm
        base = block * along_z.side_mm
        kernels = self._kernels(low, high, base + along_z.start_mm, base + along_z.end_mm)
        normals = self.painted.normals(self._centres(tiling, tiles, block))
        return Evaluator(
            self.device, kernels, tiles, normals, tiling, block, planar=self.planar, envelope=noise.envelope,
            waves_at=self._waves_at if noise.at_nodes else None,
        )  # fmt: skip

    def wave_evaluator(self, tiling: Tiling, block: int, tiles: NDArray[np.int32]) -> WaveEvaluator:
        """Of noises made of waves."""
        if self._wave_tables is None:
            assert isinstance(self.noise, Wave)
            self._wave_tables = Tables(self.device, self.noise, self.painted)
        normals = self.painted.normals(self._centres(tiling, tiles, block))
        return WaveEvaluator(
            self.device, self._wave_tables, tiles, normals, tiling, block, self.painted, planar=self.planar
        )

    def plane_evaluator(self, tiling: Tiling, block: int, tiles: NDArray[np.int32]) -> PlaneEvaluator:
        """Of noises made of planes."""
        assert isinstance(self.noise, Hyperplanes)
        return PlaneEvaluator(self.device, self.noise, tiles, tiling, block, planar=self.planar)

    def texture_evaluator(self, tiling: Tiling, block: int, tiles: NDArray[np.int32]) -> TextureEvaluator:
        """Of noises that are textures."""
        if self._textures is None:
            assert isinstance(self.noise, RandomPhase)
            self._textures = Textures(self.device, self.noise)
        return TextureEvaluator(self.device, self._textures, tiles, tiling, block)

    @property
    def _kernel_noise(self) -> KernelNoise:
        assert self.noise.made_of == "kernels"
        return cast("KernelNoise", self.noise)

    def _waves_at(self, places_mm: Floats) -> Floats:
        return self._kernel_noise.waves_at(self._generator, self.painted, places_mm)

    def waves(self, tiles: NDArray[np.int32], block: int) -> NDArray[np.float32]:
        """(T, 4) the painted wave at the tiles' centres, in rad per column, row and layer; 0 where edges are sharp."""
        if not self.dithered:
            return np.zeros((len(tiles), 4), np.float32)
        centres = self._centres(self.tiling, tiles, block)
        waves = self.painted.normals(centres) * (2 * np.pi / self.painted.periods(centres))[:, None]
        return np.pad(waves * (*self.grid.pitch_mm, self.grid.layer_mm), ((0, 0), (0, 1))).astype(np.float32)

    def taps_by_vector(self) -> tuple[Taps, Taps, Taps]:
        """The lattice's taps as the device takes them."""
        assert self.lattice is not None
        if self._by_vector is None:
            self._by_vector = self.lattice.by_vector(self.device)
        return self._by_vector

    def taps(self) -> list[Any]:
        """First nodes and weights along z, y and vectors along x, as device buffers."""
        if self._taps is None:
            arrays = [a for t in self.taps_by_vector()[::-1] for a in (t.first, t.weights)]
            self._taps = [self.device.buffer(np.ascontiguousarray(a)) for a in arrays]
        return self._taps

    def _centres(self, tiling: Tiling, tiles: NDArray[np.int32], block: int) -> Floats:
        """(T, 3) centres of the tiles of a block of layers, mm."""
        middle = (block + 0.5) * tiling.nodes[2].side_mm
        return np.column_stack([(tiles + 0.5) * tiling.sides_mm, np.full(len(tiles), middle)])

    def _kernels_of(self, number: CellLayer) -> Kernels:
        """All kernels of a layer of cells that reach what is ever looked at."""
        return self._kernel_noise.kernels(self._generator, number, *self._rectangle, self.painted)

    def _kernels(self, low_mm: Floats, high_mm: Floats, low_z_mm: float, high_z_mm: float) -> Kernels:
        """All kernels that reach a rectangle between two heights, in the order of their cells."""
        cell_layers = self._kernel_noise.cell_layers(low_z_mm, high_z_mm)
        self._cell_layers = {number: kernels for number, kernels in self._cell_layers.items() if number in cell_layers}
        for number in cell_layers:
            if number not in self._cell_layers:
                made = self._alignment.kernels if self._alignment else self._kernels_of
                self._cell_layers[number] = made(number)
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

    @property
    def graded_planes(self) -> int:
        """Planes of ratios and thresholds that are kept for each layer while its batch is made."""
        if not self.painted.materials_depend_on_z or self._on_device:
            return 0
        return len(self.painted.materials) - 1 + self.blended

    def threshold_buffers(self, first: int, count: int) -> Iterator[tuple[int, int, Any]]:
        """For runs of layers with the same painted ratio and blend: (number of the first, how many, thresholds)."""
        if not self.painted.materials_depend_on_z:
            if self._thresholds is None:
                self._thresholds = self._threshold_buffer(first)
            yield 0, count, self._thresholds
            return
        for layer in range(count):
            yield layer, 1, self._threshold_buffer(first + layer)

    def shares(self, first: int, count: int, tiles: int) -> Iterator[tuple[int, int, tuple[Any, ...]]]:
        """What cl/interpolate.cl takes of some layers: (number of the first, how many, what says their ratios).

        Args:
            tiles: how many the kernel looks at.
        """
        if not self._on_device:
            for layer, some, thresholds in self.threshold_buffers(first, count):
                yield layer, some, (thresholds,)
            return
        start = 0
        while start < count:
            rasters = self.painted.ratio_rasters(self.grid, first + start)
            at_once = max(1, min(count - start, TEXEL_BYTES // sum(raster.texels.nbytes for raster in rasters)))
            for layer in range(start + 1, start + at_once):
                rasters += self.painted.ratio_rasters(self.grid, first + layer)
            painting = self._painting(range(first + start, first + start + at_once), rasters, tiles)
            yield start, at_once, (self.ranks[0], *painting)  # no thresholds are looked at
            start += at_once

    def _painting(self, layers: range, rasters: list[Raster], tiles: int) -> tuple[Any, ...]:
        """Where sums of the ratios go, and the ratios of some layers as texels (the Painting of cl/graded.h).

        Args:
            rasters: of each layer, all with the pixels at the same places between texels.
        """
        device, (rows, columns) = self.device, self.padded
        down, across = rasters[0].texels.shape
        texels = np.zeros((len(rasters), down, across + 1), np.float32)  # with a texel above the last
        for plane, raster in zip(texels, rasters, strict=True):
            plane[:, :-1] = raster.texels
        size = 4 * tiles * len(rasters)
        sums = device.empty(size)
        device.fill_zeros(sums, size)
        for number, layer in enumerate(layers):
            self._sums_on_device[layer] = sums, number, len(layers)
        return (
            sums, device.buffer(texels), np.array([across + 1, down], np.uint32),
            *self._neighbours(rasters[0].columns, columns)[::2], *self._neighbours(rasters[0].rows, rows),
        )  # fmt: skip

    def _neighbours(self, along: Along, size: int) -> tuple[Any, Any, Any]:
        """Texels below and above, and the share between them, for so many pixels."""
        below, above, share = (np.pad(a, (0, size - len(a))) for a in along)
        arrays = below.astype(np.int32), above.astype(np.int32), share.astype(np.float32)
        a, b, c = (self.device.buffer(array) for array in arrays)
        return a, b, c

    def _levels(self, cumulative: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values of Re G or |G|² at cumulative ratios; infinite where they are plain fills."""
        c = cumulative.astype(np.float64)
        c = np.where(c <= ROUNDING, 0.0, np.where(c >= 1 - ROUNDING, 1.0, c))
        return self.noise.levels_of(c).astype(np.float32)

    def _threshold_buffer(self, layer: int) -> Any:
        """Thresholds of a layer, and its blend; those of a ratio that is the same in all layers are made once."""
        if self._planes is None or self.painted.ratio_depends_on_z:
            ratio = self.ratio(layer)
            self._planes = np.zeros((len(ratio) + self.blended, *self.padded), np.float32)
            by_level = self.noise.reads != "phase" and self._rank_table is None
            thresholds = (self._levels if by_level else self.profile.thresholds)(ratio)
            self._planes[: len(ratio), : self.grid.rows, : self.grid.columns] = thresholds
        if self.blended:
            assert self._rank_table is not None
            rows = np.rint(self.painted.blend_map(self.grid, layer) * (len(self._rank_table.ranks) - 1))
            self._planes[-1, : self.grid.rows, : self.grid.columns] = rows
        planes = self._planes
        if not self.painted.materials_depend_on_z or self.painted.ratio_depends_on_z:
            self._planes = None
        return self.device.buffer(planes)

    @property
    def blended(self) -> bool:
        """Whether a painted field says how the profile is blended."""
        return self.painted.blend is not None

    @property
    def ranks(self) -> tuple[Any, np.float32]:
        """What profiles of waveforms look up, as the device takes it: the table, and how far values go."""
        if self._ranks is None:
            table = self._rank_table
            self._ranks = self.device.buffer(np.zeros((1, 1), np.float32) if table is None else table.ranks)
        return self._ranks, np.float32(1.0 if self._rank_table is None else self._rank_table.reach)

    def profile_macros(self) -> dict[str, int]:
        """What cl/deposit.h is compiled for."""
        return {
            "CYCLIC": self._rank_table is None and self.profile.arrows, "DITHERED": self.dithered,
            "VALUE": ("phase", "value", "power").index(self.noise.reads), "BLENDED": self.blended,
            "TABLE": 0 if self._rank_table is None else self._rank_table.ranks.shape[1],
            "GRADED": len(self.painted.materials) - 1 if self._on_device else 0,
        }  # fmt: skip


# By what a noise is made of.
EVALUATORS: dict[str, Callable[[Pattern, Tiling, int, NDArray[np.int32]], FieldEvaluator]] = {
    "kernels": Pattern.kernel_evaluator,
    "waves": Pattern.wave_evaluator,
    "planes": Pattern.plane_evaluator,
    "textures": Pattern.texture_evaluator,
}
