"""From job to layers to files: the order of the stages, and the threads that they share."""

from __future__ import annotations

import operator
import os
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np

from amslicer.arrows import refuse_lines, sample_places, turns_little
from amslicer.device import Device
from amslicer.errors import JobError, UsageError
from amslicer.fields.source import Part
from amslicer.grid import Grid, cover
from amslicer.holes import find_holes
from amslicer.lattice import Lattice, choose_lattice
from amslicer.layer import Bitmaps, Layer
from amslicer.mask import Slicer, join_runs, make_slicer
from amslicer.mesh import Mesh, read_mesh
from amslicer.noise.waves import MAX_TABLE_BYTES as MAX_WAVE_BYTES
from amslicer.notes import notes_of
from amslicer.painted import Painted, open_fields
from amslicer.pattern import Pattern, make_noise
from amslicer.placement import Placement, place
from amslicer.profiles import make_profile, profile_name
from amslicer.regions import Regions
from amslicer.relief import Moved, plan_relief
from amslicer.specification import VOID
from amslicer.tiles import CALM_DEG, CALM_TILE_PERIODS, TILE_PERIODS, Tiling, choose_tiling

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.block import Block
    from amslicer.job import Job
    from amslicer.mask import Runs
    from amslicer.noise import KernelNoise, Noise
    from amslicer.noise.waves import Wave

Progress = Callable[[int, int], None]
Given: TypeAlias = dict[int, "NDArray[np.uint8]"]  # bits of each material that pixels have whatever the pattern says

# Bitmaps and (where the ratio changes with z) ratios and thresholds of the layers of a block that are made at a time:
# changes no byte. The runs and the lattice of a whole block are not in it.
BATCH_BYTES = 1 << 27
MASK_BYTES, GRADED_BYTES = 2, 8  # per pixel
# Pillow reads no larger pictures back.
MAX_LAYER_PIXELS = 170_000_000
MAX_LAYERS = 1_000_000
MAX_SIDE_MM = 1e7  # 10 km
MAX_KERNELS, MAX_TABLE_BYTES = 20_000_000, 8 << 30  # of one batch of layers: beyond, memory runs out
MIN_PERIOD_MM = 1e-4
# Of wave noise: slices that a part meets, and their entries in the lists of all tiles (32 bytes, three times at most).
MAX_SLICES, MAX_ENTRIES, WAVES_IN_A_LOBE, SLICES_AT_A_TILE = 20_000_000, 40_000_000, 0.3, 1.3
MAX_PERIODS = 1e5  # of cells along a part
MAX_PERIOD_RATIO = 100  # longest to shortest painted period: the lattice is as fine as the shortest asks for
PERIOD_ROUNDING = 1e-9
ESTIMATE_BLOCKS, ESTIMATE_SHARE, ESTIMATE_SECONDS = 4, 0.25, 5.0  # blocks of layers, at most, but one at least
ESTIMATE_LAYERS = 8  # for the size


@dataclass(frozen=True)
class Run:
    """How a job is computed; nothing here but the device may change a byte.

    Attributes:
        device: part of an OpenCL device's label; None takes the first that works.
        jobs: threads used, the device's on CPUs included; None means all cores.
        layers: half-open range of layers, like a Python slice's; None means all.
    """

    device: str | None = None
    jobs: int | None = None
    layers: tuple[int | None, int | None] | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(f"jobs must be at least 1, but is {self.jobs}")

    @property
    def threads(self) -> int:
        """Number of threads for the host's share of the work."""
        if self.jobs:
            return self.jobs
        if hasattr(os, "sched_getaffinity"):  # what this process may use; not every system tells
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1


@dataclass(frozen=True)
class Prepared:
    """A part read, placed and covered by the printer's grid, with its fields open.

    Attributes:
        mesh: as it was read, without its relief.
        moved: the surface with its relief; None where it has none.
    """

    job: Job
    mesh: Mesh
    placement: Placement
    grid: Grid
    tiling: Tiling
    lattice: Lattice | None
    slicer: Slicer
    painted: Painted
    moved: Moved | None = None

    @property
    def volume_mm3(self) -> float:
        """Of the placed part, relief included; overlaps count twice."""
        return self.mesh.volume_mm3 * self.placement.scale**3 if self.moved is None else self.moved.volume_mm3

    def pattern(self, device: Device) -> Pattern:
        """The laminate, to be evaluated on a device."""
        return Pattern(self.job, self.painted, self.grid, self.tiling, self.lattice, device)

    def notes(self) -> list[str]:
        """What a person should know about the job, in sentences."""
        return [*notes_of(self), *(self.moved.notes() if self.moved else ())]


def prepare(job: Job) -> Prepared:
    """Reads the part and its fields, and lays the grid.

    Raises:
        PartError: the part cannot be sliced.
        JobError: a field cannot be used, or the job is too large.
    """
    spec = job.spec
    mesh = read_mesh(job.part, spec.part.units, allow_open=spec.part.allow_open)
    _refuse_huge(job, float(mesh.size_mm.max()) * spec.part.scale)
    placement, vertices = place(mesh, scale=spec.part.scale, rotate_deg=spec.part.rotate, on_bed=spec.part.on_bed)
    printer = spec.printer
    grid = cover(placement.size_mm.tolist(), printer.pitch_mm, printer.layer_height_mm, printer.margin_px)
    _refuse_absurd(job, grid, placement)
    relief = plan_relief(job, mesh, placement, vertices, lambda: Part(job.part, mesh))
    if relief is not None:
        placement = relief.placement
        grid = cover(placement.size_mm.tolist(), printer.pitch_mm, printer.layer_height_mm, printer.margin_px)
        _refuse_absurd(job, grid, placement)
    painted = open_fields(job, placement, mesh.size_mm, lambda: Part(job.part, mesh), grid)
    _refuse_periods(painted)
    _refuse_isotropies(painted)
    if make_profile(spec.pattern.profile).arrows:
        refuse_lines(painted, profile_name(spec.pattern.profile))
    lattice = None
    noise = make_noise(job, painted)
    if spec.pattern.evaluate == "lattice" and noise.band is not None:
        lattice = choose_lattice(
            grid, noise.band, painted.period_bounds_mm[0], tile_periods=_tile_periods(noise, painted),
            planar=noise.dimensions == 2,
        )  # fmt: skip
    tiling = lattice.tiling if lattice else choose_tiling(grid, painted.period_bounds_mm[0])
    SIZE_LIMITS[noise.made_of](job, noise, grid, painted)
    triangles, rim, moved = mesh.triangles, mesh.rim, None
    if relief is not None:
        moved = relief.moved(painted, noise)
        vertices, triangles, rim = moved.surface.vertices, moved.surface.triangles, moved.rim
    slicer = make_slicer(vertices, triangles, grid, find_holes(rim, vertices, grid))
    painted = replace(painted, regions=_regions(job, mesh, placement, grid, slicer, moved=moved is not None))
    return Prepared(job, mesh, placement, grid, tiling, lattice, slicer, painted, moved)


def _regions(job: Job, mesh: Mesh, placement: Placement, grid: Grid, slicer: Slicer, *, moved: bool) -> Regions | None:
    """What skins and bodies with materials of their own take from the pattern; None where there are none."""
    spec, names = job.spec, job.materials
    if spec.skin is None and not spec.bodies:
        return None
    skin = None
    if spec.skin is not None:
        thickness = spec.skin.thickness_mm
        top, bottom = (thickness if v is None else v for v in (spec.skin.top_mm, spec.skin.bottom_mm))
        skin = (names.index(spec.skin.material) + 1, thickness, top, bottom)
    labels: Callable[[int], NDArray[np.int16]] | None = None
    own: tuple[int, ...] = ()
    if spec.bodies:
        from amslicer.bodies import own_materials

        labels, own = own_materials(job, mesh, placement, grid, moved=moved)
    void = names.index(VOID) + 1 if VOID in names else 0
    return Regions(slicer, grid, labels, own, void, skin)


def _tile_periods(noise: Noise, painted: Painted) -> float:
    """How large tiles may be: all kernels (or waves) of one take their signs from one direction."""
    finest = painted.period_bounds_mm[0]
    reach = (cast("KernelNoise", noise).radius_mm if noise.made_of == "kernels" else 0.0) + CALM_TILE_PERIODS * finest
    return CALM_TILE_PERIODS if turns_little(painted, reach, CALM_DEG) else TILE_PERIODS


def _refuse_huge(job: Job, side_mm: float) -> None:
    if side_mm > MAX_SIDE_MM:
        raise JobError(
            f"the job is too large: '{job.part.name}' is {side_mm:.3g} mm long; at most {MAX_SIDE_MM:g} mm are sliced",
            hint="check the part's scale and units (--scale, --units)",
        )


def _refuse_absurd(job: Job, grid: Grid, placement: Placement) -> None:
    pixels = grid.width_px * grid.height_px
    if pixels > MAX_LAYER_PIXELS or grid.layers > MAX_LAYERS:
        size = " × ".join(f"{float(v):.1f}" for v in placement.size_mm)
        raise JobError(
            f"the job is too large: '{job.part.name}' measures {size} mm, which makes {grid.width_px} × "
            f"{grid.height_px} pixels in {grid.layers} layers; at most {MAX_LAYER_PIXELS // 10**6} million pixels "
            f"per layer and {MAX_LAYERS} layers are sliced",
            hint="check the part's units (--units), or use a coarser printer (--printer)",
        )


def _refuse_periods(painted: Painted) -> None:
    """A painted period is greater than 0 and graded by no more than the kernels' grid serves."""
    shortest, longest = painted.period_bounds_mm
    if shortest > 0 and not (shortest >= MIN_PERIOD_MM and longest <= MAX_SIDE_MM):
        painted_mm = f"{shortest:.4g}" + ("" if shortest == longest else f" to {longest:.4g}")
        raise JobError(
            f"the job is too large: pattern.period {painted_mm} mm; between "
            f"{MIN_PERIOD_MM:g} and {MAX_SIDE_MM:g} mm is sliced",
            hint="a period is mm from sheet to sheet: usually 0.3 to 10",
        )
    if not shortest > 0:
        raise JobError(
            f"pattern.period: the painted period falls to {shortest:.4g} mm; a period is greater than 0 mm",
            hint="change the field's range (or from and to), or clip() an expression",
        )
    if longest > MAX_PERIOD_RATIO * shortest * (1 + PERIOD_ROUNDING):
        raise JobError(
            f"pattern.period: the painted period goes from {shortest:.4g} to {longest:.4g} mm, a factor of "
            f"{longest / shortest:.3g}; up to {MAX_PERIOD_RATIO} is built in this version",
            hint="change the field's range (or from and to), or clip() an expression",
        )


def _refuse_isotropies(painted: Painted) -> None:
    """Looks for a painted isotropy outside 0…1 all over the part, before kernels meet one."""
    low, high = painted.isotropy.bounds
    if low < 0 or high > 1:
        painted.isotropies(sample_places(painted, painted.period_bounds_mm[1]).reshape(-1, 3))


def _refuse_many_kernels(job: Job, any_noise: Noise, grid: Grid, painted: Painted) -> None:
    """The kernels of one batch and their tables at the pixels, counted before any is drawn."""
    noise = cast("KernelNoise", any_noise)
    reach, size = noise.radius_mm, painted.placement.size_mm
    width, depth = (float(v) + 2 * reach for v in size[:2])
    shortest, longest = painted.period_bounds_mm
    tiling = choose_tiling(grid, shortest)
    height = 2 * reach + tiling.nodes[2].side_mm if noise.dimensions == 3 else 1.0
    period = painted.periods(sample_places(painted, longest).reshape(-1, 3))
    density = noise.density * (shortest / period) ** noise.dimensions
    kernels = width * depth * height * float(np.mean(density))
    slots = 2 * reach * (period / longest) / float(tiling.sides_mm.min()) + 2
    table_bytes = width * depth * height * float(np.mean(density * slots)) * tiling.nodes[0].count * 8
    if kernels > MAX_KERNELS or table_bytes > MAX_TABLE_BYTES:
        raise JobError(
            f"the job is too large: with pattern.period {shortest:g} mm and bandwidth {job.spec.pattern.bandwidth} a "
            f"layer needs {kernels:.3g} kernels that reach {reach:.3g} mm ({table_bytes / 1e9:.3g} GB of tables)",
            hint="use a period of at least 3 pixels, no larger than the part, and a bandwidth of 0.25 to 1",
        )


def _refuse_large_tables(job: Job, noise: Noise, grid: Grid, painted: Painted) -> None:
    """The tables of all painted periods."""
    wave = cast("Wave", noise)
    extent = float(np.linalg.norm(painted.placement.size_mm))
    tiling = choose_tiling(grid, painted.period_bounds_mm[0])
    tiles = float(np.prod(tiling.over(grid)))
    share = 1.0 if not wave.directed or wave.isotropy > 0 else WAVES_IN_A_LOBE
    slices = wave.directions * (1 + extent / wave.slice_mm)
    entries = tiles * wave.directions * share * SLICES_AT_A_TILE
    if slices > MAX_SLICES or entries > MAX_ENTRIES:
        raise JobError(
            f"the job is too large: with pattern.period {painted.period_bounds_mm[0]:g} mm and {wave.directions} "
            f"directions there are {slices:.3g} slices of waves, and {entries:.3g} of them at all tiles of a layer",
            hint="use a longer period, fewer pattern.directions, less isotropy, or noise: phasor",
        )
    if len(wave.table_periods_mm) > 1 and (wave.by_part or not wave.directed):
        shortest, longest = painted.period_bounds_mm
        raise JobError(
            f"pattern.period: from {shortest:.4g} to {longest:.4g} mm, but waves of this spectrum have one period",
            hint="give one number, or a spectrum that is the same in all directions",
        )
    if wave.by_part and wave.table_bytes > MAX_WAVE_BYTES:
        raise JobError(
            f"the job is too large: {wave.directions} directions need tables of {wave.samples} samples each "
            f"({wave.table_bytes / 1e6:.0f} MB); at most {MAX_WAVE_BYTES / 1e6:.0f} MB are made",
            hint="use a smaller exemplar, larger pixels (pattern.exemplar_pixel_mm) or fewer pattern.directions",
        )
    if wave.table_bytes > MAX_WAVE_BYTES:
        shortest, longest = painted.period_bounds_mm
        raise JobError(
            f"pattern.period: from {shortest:.4g} to {longest:.4g} mm, wave noise needs "
            f"{len(wave.table_periods_mm)} tables of {wave.samples} samples ({wave.table_bytes / 1e6:.0f} MB); at most "
            f"{MAX_WAVE_BYTES / 1e6:.0f} MB are made",
            hint="let the period change less, or use noise: phasor",
        )


def _refuse_graded_cells(job: Job, noise: Noise, grid: Grid, painted: Painted) -> None:
    """Planes go through the whole part: they have one distance."""
    shortest, longest = painted.period_bounds_mm
    if float(painted.placement.size_mm.max()) > MAX_PERIODS * shortest:
        raise JobError(
            f"the job is too large: the part measures {float(painted.placement.size_mm.max()):.4g} mm, more than "
            f"{MAX_PERIODS:g} periods of {shortest:g} mm",
            hint="use a longer period",
        )
    if longest > shortest * (1 + PERIOD_ROUNDING):
        raise JobError(
            f"pattern.period: from {shortest:.4g} to {longest:.4g} mm, but walls of {job.spec.pattern.noise} go "
            "through the whole part: they have one period",
            hint="give one number, or paint the ratio: walls get thicker where it is higher",
        )


def _refuse_graded_textures(job: Job, noise: Noise, grid: Grid, painted: Painted) -> None:
    """A texture is renewed after one period."""
    shortest, longest = painted.period_bounds_mm
    if longest > shortest * (1 + PERIOD_ROUNDING):
        raise JobError(
            f"pattern.period: from {shortest:.4g} to {longest:.4g} mm, but {job.spec.pattern.noise} is renewed along z "
            "after one period",
            hint="give one number; the texture's size is that of the exemplar's pixels (pattern.exemplar_pixel_mm)",
        )


# By what a noise is made of.
SIZE_LIMITS = {"kernels": _refuse_many_kernels, "waves": _refuse_large_tables, "planes": _refuse_graded_cells,
               "textures": _refuse_graded_textures}  # fmt: skip


def layer_range(run: Run, count: int) -> range:
    """The layers that a run makes.

    Raises:
        UsageError: the range holds no layer of this part.
    """
    if run.layers is None:
        return range(count)
    chosen = range(count)[slice(*run.layers)]
    if not chosen:
        raise UsageError(
            f"--layers {run.layers[0] if run.layers[0] is not None else ''}:"
            f"{run.layers[1] if run.layers[1] is not None else ''} holds no layer; the part has {count} layers",
            hint=f"give a range within 0:{count}, half-open like Python's",
        )
    return chosen


def layers(job: Job, run: Run | None = None) -> Iterator[Layer]:
    """Slices a job layer by layer; memory does not grow with the number of layers.

    Args:
        job: what to slice.
        run: device, threads, range of layers.

    Raises:
        AmslicerError: when the iteration starts or as soon as something is found wrong.
    """
    run = run or Run()
    prepared = prepare(job)
    with Device(run.device, run.jobs) as device, workers(run.threads) as pool:
        pattern = prepared.pattern(device)
        chosen = layer_range(run, prepared.grid.layers)
        with closing(make_layers(prepared, pattern, pool, chosen, run.threads)) as batches:
            for batch in batches:
                yield from (made.bitmaps.layer() for made in batch)


def field_of_layer(job: Job, index: int, run: Run | None = None) -> NDArray[np.complex64]:
    """G at one layer's pixels, margin included, solid or not: (H, W) complex64, row 0 = largest y.

    Args:
        index: layer, from 0; negative counts from the last.

    Raises:
        UsageError: there is no such layer.
    """
    run = run or Run()
    try:
        index = operator.index(index)
    except TypeError:
        raise UsageError(f"a layer is a whole number, but is {index!r}") from None
    prepared = prepare(job)
    count = prepared.grid.layers
    if not -count <= index < count:
        raise UsageError(f"there is no layer {index}; the part has {count} layers")
    with Device(run.device, run.jobs) as device:
        return prepared.pattern(device).field(index % count)[::-1]


@dataclass(frozen=True)
class Made:
    """A finished layer, and what its fields ask for.

    Attributes:
        bitmaps: of its materials.
        asked: per material, the sum of its painted share over the solid pixels: how many pixels are asked.
        overlap_px: pixels that overlapping bodies have in common.
        void_px: solid pixels where nothing is deposited; None where the job has no such material.
    """

    bitmaps: Bitmaps
    asked: list[float]
    overlap_px: int
    void_px: int | None = None


def make_layers(
    prepared: Prepared, pattern: Pattern, pool: ThreadPoolExecutor, chosen: range, threads: int
) -> Generator[list[Made]]:
    """Batches of layers: masks in the pool's threads, then materials on the device.

    With more than one thread, the masks and kernels of a block are made while the device is busy with the one before.
    Close it before the pool and the device.
    """
    grid = prepared.grid
    at_once = layers_at_once(grid, prepared.tiling, pattern.graded_planes)

    painted = pool.submit(pattern.sum_ratios, chosen.start)

    regions = prepared.painted.regions

    def begin(first: int, end: int) -> tuple[int, int, Runs, Given, Block]:
        shares = np.array_split(np.arange(first, end), min(threads, end - first))
        parts = pool.map(lambda share: prepared.slicer.runs(int(share[0]), int(share[-1]) + 1), shares)
        runs, given = join_runs(list(parts)), Given()
        if regions is not None:
            runs, given = regions.split(runs, first, pool.map)
        if pattern.may_be_plain:
            painted.result()
        block = pattern.block(runs, first)
        block.prepare()
        return first, end, runs, given, block

    ranges = pieces(chosen.start, chosen.stop, prepared.tiling.layers)
    with closing(_ahead(begin, ranges, threads)) as blocks:
        for first, end, runs, given, block in blocks:
            painted.result()
            for low in range(first, end, at_once):
                some = runs.part(low - first, min(end, low + at_once) - first)
                deposits = block.deposits(low, low + some.layers)
                asked = pattern.asked(some, low)
                for m, all_bits in given.items():
                    bits = all_bits[low - first : low - first + some.layers]
                    deposits[:, m - 1] |= bits
                    for sums, count in zip(asked, np.bitwise_count(bits).sum(axis=(1, 2), dtype=np.int64), strict=True):
                        sums[m - 1] += float(count)
                overlap = [0] * some.layers if some.overlap_px is None else some.overlap_px.tolist()
                yield [_made(prepared, low + i, bits, asked[i], overlap[i]) for i, bits in enumerate(deposits)]


def _ahead(
    begin: Callable[[int, int], tuple[int, int, Runs, Given, Block]], ranges: Iterator[tuple[int, int]], threads: int
) -> Generator[tuple[int, int, Runs, Given, Block]]:
    """Begins each range, the next one while the one before is worked on if there are threads for it."""
    if threads == 1:
        yield from (begin(*some) for some in ranges)
        return
    with workers(1) as other:
        waiting: Future[tuple[int, int, Runs, Given, Block]] | None = None
        for some in ranges:
            begun = other.submit(begin, *some)
            if waiting:
                yield waiting.result()
            waiting = begun
        if waiting:
            yield waiting.result()


def pieces(first: int, end: int, size: int) -> Iterator[tuple[int, int]]:
    """Half-open ranges that cut first … end - 1 at the multiples of size."""
    while first < end:
        border = min(end, (first // size + 1) * size)
        yield first, border
        first = border


def layers_at_once(grid: Grid, tiling: Tiling, graded: int) -> int:
    """How many layers of a block are made at a time, within the memory bound.

    Args:
        graded: cumulative ratios that change from layer to layer.
    """
    bytes_per_pixel = MASK_BYTES + GRADED_BYTES * graded
    return max(1, min(tiling.layers, BATCH_BYTES // (bytes_per_pixel * grid.columns * grid.rows)))


def _made(prepared: Prepared, index: int, deposits: NDArray[np.uint8], asked: list[float], overlap_px: int) -> Made:
    """A layer from the bits of all materials; of the one that stands for nothing there is no bitmap."""
    grid, margin, job = prepared.grid, prepared.grid.margin_px, prepared.job
    void_px = None
    if job.printed != job.materials:
        void = job.materials.index(VOID)
        void_px = int(np.bitwise_count(deposits[void]).sum(dtype=np.int64))
        deposits = np.delete(deposits, void, axis=0)
    rows = deposits[:, ::-1]
    if margin:
        inner = np.unpackbits(rows, axis=-1, count=grid.columns)
        rows = np.packbits(np.pad(inner, ((0, 0), (margin, margin), (margin, margin))), axis=-1)
    z = float(prepared.placement.origin_mm[2]) + grid.z_mm(index)
    return Made(Bitmaps(index, z, job.printed, grid.width_px, rows), asked, overlap_px, void_px)


@contextmanager
def workers(threads: int) -> Iterator[ThreadPoolExecutor]:
    """A pool of threads; nothing outlives it, and what has not begun when it closes never does."""
    pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@dataclass(frozen=True)
class Estimate:
    """What a job would make, judged from a few of its layers.

    Attributes:
        bytes: size of all bitmaps, about.
        seconds: time for all layers, about.
    """

    width_px: int
    height_px: int
    layers: int
    files: int
    bytes: int
    seconds: float
    device: str
    notes: tuple[str, ...]


def estimate(job: Job, run: Run) -> Estimate:
    """Makes some layers in memory and scales up their time and size.

    The size is that of single layers from all over the part. The time is that of whole blocks of layers, since those of
    one share most of their work: half of it is taken to go with the number of layers, half with what is solid in them.
    """
    from amslicer.writers import WRITERS

    prepared = prepare(job)
    grid, output = prepared.grid, job.spec.output
    chosen = layer_range(run, grid.layers)
    blocks = list(pieces(chosen.start, chosen.stop, prepared.tiling.layers))
    count = max(1, min(ESTIMATE_BLOCKS, int(ESTIMATE_SHARE * len(blocks))))
    sampled = [blocks[len(blocks) * (2 * i + 1) // (2 * count)] for i in range(count)]
    single = sorted({chosen[len(chosen) * (2 * i + 1) // (2 * ESTIMATE_LAYERS)] for i in range(ESTIMATE_LAYERS)})
    with Device(run.device, run.jobs) as device, workers(run.threads) as pool:
        pattern = prepared.pattern(device)

        def make(first: int, end: int) -> tuple[int, int, int]:
            """Layers made, bytes of their files, and solid pixels."""
            made = size = solid = 0
            with closing(make_layers(prepared, pattern, pool, range(first, end), run.threads)) as batches:
                for batch in batches:
                    files = pool.map(
                        lambda m: WRITERS[output.format](m.bitmaps, grid.pitch_mm, output.compression), batch
                    )
                    size += sum(len(content) for layer in files for _, _, content in layer)
                    made += len(batch)
                    solid += sum(sum(m.bitmaps.pixels().values()) for m in batch)
            return made, size, solid

        _, size, everywhere = np.sum([make(layer, layer + 1) for layer in single], axis=0)  # this compiles, too
        started = time.monotonic()
        made = solid = 0
        for block in sampled:
            more = make(*block)
            made, solid = made + more[0], solid + more[2]
            seconds = time.monotonic() - started
            if seconds > ESTIMATE_SECONDS:
                break
        label = device.label
    layers, of_single = len(chosen) / made, len(chosen) / len(single)
    pixels = float(everywhere * of_single / solid) if solid else layers
    return Estimate(
        grid.width_px, grid.height_px, len(chosen), len(chosen) * len(job.printed), round(float(size * of_single)),
        seconds * (layers + pixels) / 2, label, tuple(prepared.notes()),
    )  # fmt: skip
