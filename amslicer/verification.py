"""Is a written stack what was asked for? Checked from its files, its manifest and its painted fields alone."""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import AmslicerError, JobError, StorageError
from amslicer.fields.constant import ConstantSampler
from amslicer.judgement import (
    MIN_BLOCKS,
    direction_problems,
    isotropy_problems,
    of_low_isotropy,
    period_problems,
    ratio_problems,
)
from amslicer.levelspread import level_deviation
from amslicer.likeness import PIXEL_SHARE, share_deviation
from amslicer.lobespread import resonance_deviation
from amslicer.manifest import LayerRecord, placement_of
from amslicer.noise import NOISES
from amslicer.painted import Painted, open_fields
from amslicer.pattern import job_lobes, make_noise
from amslicer.profiles import make_profile
from amslicer.regions import Regions
from amslicer.specification import VOID
from amslicer.spread import DEFECT
from amslicer.stack import VOLUME_SHARE, Stack, decode_bitmap
from amslicer.storage import JOB_FILE, storage_errors
from amslicer.texture import Shown, Texture
from amslicer.windows import Level, RatioWindows
from amslicer.writers.png import layer_path

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.pipeline import Prepared, Progress

    Floats = NDArray[np.float64]

# Spread of the ratio over an area of A periods² of a plane cut: 0.075 B sin(πρ)/√A, measured for unaligned
# phasor noise of bandwidth B; four of them, and what faces parallel to the sheets cut off, ρ(1-ρ)/N for N
# sheets across, is as far as an honest stack goes.
SPREAD, SIGMAS = 0.075, 4.0
LAYERS_AHEAD = 8  # of the one that is added up
MAX_PROBLEMS = 20  # said in full; more are counted


@dataclass(frozen=True)
class MaterialReport:
    """A material's share of the solid.

    Attributes:
        ratio: got.
        expected: mean of the painted ratio over the solid.
        tolerance: how far an honest stack may be from it.
    """

    name: str
    pixels: int
    ratio: float
    expected: float
    tolerance: float

    @property
    def error(self) -> float:
        """got - expected."""
        return self.ratio - self.expected

    @property
    def ok(self) -> bool:
        """Whether the error is within the tolerance."""
        return abs(self.error) <= self.tolerance


@dataclass(frozen=True)
class Check:
    """One law, and what broke it.

    Attributes:
        made: whether there was anything to look at: blocks of the part that show one texture, for direction, period and
            isotropy.
    """

    name: str
    problems: tuple[str, ...]
    made: bool = True

    @property
    def ok(self) -> bool:
        """Whether nothing broke it."""
        return not self.problems


@dataclass(frozen=True)
class Report:
    """Everything that was checked.

    Attributes:
        windows: ratios in windows, the smallest first.
        shown: direction, period and isotropy of blocks.
    """

    out: Path
    layers: int
    solid_pixels: int
    checks: tuple[Check, ...]
    materials: dict[str, MaterialReport]
    windows: tuple[Level, ...] = ()
    shown: tuple[Shown, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the stack is what was asked for."""
        return all(check.ok for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """For --json."""
        return {
            "ok": self.ok,
            "out": str(self.out),
            "layers": self.layers,
            "solid_pixels": self.solid_pixels,
            "checks": [{"name": c.name, "ok": c.ok, "made": c.made, "problems": list(c.problems)} for c in self.checks],
            "materials": {
                name: {
                    "pixels": m.pixels, "ratio": m.ratio, "expected": m.expected, "error": m.error,
                    "tolerance": m.tolerance, "ok": m.ok,
                }
                for name, m in self.materials.items()
            },
            "windows": [
                {
                    "sizes": list(level.counts), "windows": len(level.got), "worst_z": float(np.abs(level.z).max()),
                    "worst_error": float(np.abs(level.got - level.asked).max()),
                }
                for level in self.windows
            ],
            "blocks": len(self.shown),
            "direction_error_deg": _mean([s.angle_deg for s in self.shown]),
            "period_ratio": _mean([1 / s.frequency for s in self.shown]),
        }  # fmt: skip


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


@dataclass
class _Findings:
    """Problems per law, in order of the layers."""

    problems: dict[str, list[str]] = field(default_factory=dict)

    def add(self, law: str, problem: str) -> None:
        self.problems.setdefault(law, []).append(problem)

    def check(self, law: str, *, made: bool) -> Check:
        found = self.problems.get(law, [])
        more = [f"… and {len(found) - MAX_PROBLEMS} more"] if len(found) > MAX_PROBLEMS else []
        return Check(law, tuple(found[:MAX_PROBLEMS] + more), made)


@dataclass(frozen=True)
class _LayerCheck:
    pixels: list[int]
    asked: list[float]
    problems: list[tuple[str, str]]
    in_windows: tuple[Floats, Floats]
    thinned: NDArray[np.float32] | None


FILES, HASHES, SIZES, PARTITION, COUNTS, VOLUME, RATIO, WINDOWS, DIRECTION, PERIOD, ISOTROPY = (
    "files: every layer and material is there",
    "hashes: no file was altered since it was written",
    "sizes: every bitmap has the grid's size",
    "partition: no pixel belongs to two materials",
    "counts: pixels are as the manifest says",
    "volume: as many pixels are solid as the part's mesh has volume",
    "ratio: each material's share is as painted",
    "windows: so it is in every part of the stack",
    "direction: sheets turn as painted",
    "period: sheets are as far apart as painted",
    "isotropy: directions spread as painted",
)
LAWS = (FILES, HASHES, SIZES, PARTITION, COUNTS, VOLUME, RATIO, WINDOWS, DIRECTION, PERIOD, ISOTROPY)


def verify_stack(
    out: str | os.PathLike[str],
    fields: str | os.PathLike[str] | None = None,
    *,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Report:
    """Checks a written stack against its own job, or against other fields.

    Args:
        out: the stack's folder.
        fields: a job file whose fields the stack is compared with; default: the stack's own.
        jobs: threads; None means all cores.
        progress: called with (layers done, layers in all).

    Raises:
        StorageError: there is no finished stack.
        JobError: the fields cannot be used.
    """
    from amslicer.pipeline import Run

    stack = Stack(out)
    job = _job_of(stack, fields)
    painted, solid_of = _painted(stack, job)
    findings = _Findings()
    for problem in _missing_layers(stack):
        findings.add(FILES, problem)
    totals, asked = [0] * len(job.materials), [0.0] * len(job.materials)
    windows = RatioWindows(painted, stack.grid)
    pattern = job.spec.pattern
    profile = make_profile(pattern.profile)
    lobes = job_lobes(job, painted)
    likeness = make_noise(job, painted).likeness
    texture = Texture(painted, stack.grid, pattern.bandwidth, profile, lobes)
    usable = texture.usable and likeness is None  # what is no laminate has no direction and period
    shown: list[Shown] = []
    with ThreadPoolExecutor(Run(jobs=jobs).threads) as pool:
        look = _LayerLook(stack, job, painted, windows, texture if usable else None, solid_of)
        for done, (record, result) in enumerate(_in_order(pool, look.check, stack.records), 1):
            totals = [a + b for a, b in zip(totals, result.pixels, strict=True)]
            asked = [a + b for a, b in zip(asked, result.asked, strict=True)]
            windows.add(record.index, *result.in_windows)
            if result.thinned is not None:
                shown.extend(texture.add(record.index, result.thinned))
            for law, problem in result.problems:
                findings.add(law, problem)
            if progress:
                progress(done, len(stack.records))
    shown.extend(texture.finish() if usable else ())
    levels = list(windows.levels(
        pattern.bandwidth, profile, values=NOISES[pattern.noise].read_by(pattern) != "phase",
        aligned=pattern.alignment > 0, lobes=lobes,
        likeness=likeness,
    ))  # fmt: skip
    shell = _shell_share(stack)
    materials = {
        name: replace(m, tolerance=min(1.0, m.tolerance + shell))
        for name, m in _material_reports(stack, job, painted, totals, asked).items()
    }
    for m in materials.values():
        if not m.ok:
            findings.add(
                RATIO,
                f"{m.name}: {m.ratio:.4f} instead of {m.expected:.4f} "
                f"(error {m.error:+.4f}, allowed ± {m.tolerance:.4f})",
            )
    _check_totals(stack, job.materials, totals, findings)
    # Of several lobes a block shows now one, now another: none is its direction.
    looked_at = {DIRECTION: [] if lobes else of_low_isotropy(shown), PERIOD: shown, ISOTROPY: shown}
    for law, problems in (
        (VOLUME, _volume_problems(stack, sum(totals))),
        (WINDOWS, () if shell else ratio_problems(levels, job.materials, painted.placement.origin_mm)),
        (DIRECTION, direction_problems(looked_at[DIRECTION])),
        (PERIOD, period_problems(looked_at[PERIOD], pattern.dimensions)),
        (ISOTROPY, isotropy_problems(looked_at[ISOTROPY])),
    ):
        for problem in problems:
            findings.add(law, problem)
    made = {law: len(blocks) >= MIN_BLOCKS for law, blocks in looked_at.items()} | {WINDOWS: not shell}
    checks = tuple(findings.check(law, made=made.get(law, True)) for law in LAWS)
    return Report(stack.folder, len(stack.records), sum(totals), checks, materials, tuple(levels), tuple(shown))


def _in_order(
    pool: ThreadPoolExecutor, check: Callable[[LayerRecord], _LayerCheck], records: Sequence[LayerRecord]
) -> Iterator[tuple[LayerRecord, _LayerCheck]]:
    """Checks layers in threads, a few ahead of whoever takes them: they are too large to wait in numbers."""
    waiting: deque[tuple[LayerRecord, Future[_LayerCheck]]] = deque()
    for record in records:
        waiting.append((record, pool.submit(check, record)))
        if len(waiting) > LAYERS_AHEAD:
            first, future = waiting.popleft()
            yield first, future.result()
    for first, future in waiting:
        yield first, future.result()


def _job_of(stack: Stack, fields: str | os.PathLike[str] | None) -> Job:
    from amslicer.job import load_job

    own = stack.folder / JOB_FILE
    if fields is None and not own.is_file():
        raise StorageError(f"'{own}' is missing", hint="name the fields to compare with: --fields FIELDS.yaml")
    part = stack.manifest["part"]
    job = load_job(own if fields is None else fields, part=stack.folder / part.get("copy", part["file"]))
    if job.printed != stack.materials or (job.printed != job.materials) != (VOID in stack.manifest):
        has = ", ".join((*stack.materials, *([VOID] if VOID in stack.manifest else [])))
        raise JobError(f"{job.name}: the materials are {', '.join(job.materials)}, but the stack has {has}")
    return job


def _painted(stack: Stack, job: Job) -> tuple[Painted, Callable[[int], NDArray[np.bool_]] | None]:
    """The painted fields; and what is solid in a layer, where the stack's bitmaps alone do not tell."""
    low, high = np.array(stack.manifest["part"]["file_bbox_mm"], float)
    solid_of = None
    if job.needs_part:
        prepared = _prepared(stack, job)
        painted = prepared.painted
        if job.printed != job.materials:
            solid_of = Regions(prepared.slicer, prepared.grid).solid
    else:
        painted = open_fields(job, placement_of(stack.manifest), high - low, grid=stack.grid)
    if not NOISES[job.spec.pattern.noise].follows(job.spec.pattern):
        painted = replace(painted, isotropy=ConstantSampler(1.0))
    return painted, solid_of


def _prepared(stack: Stack, job: Job) -> Prepared:
    """The part as it was sliced, from the stack's own copy of its file."""
    from amslicer.pipeline import prepare

    if not job.part.is_file():
        raise StorageError(
            f"'{job.part}' is missing: what is asked for depends on the part itself",
            hint="slice the part again, or compare with fields that need its box alone (--fields)",
        )
    settings = job.spec.part.model_copy(update=stack.manifest["part"].get("settings", {}))
    prepared = prepare(replace(job, spec=job.spec.model_copy(update={"part": settings})))
    if prepared.mesh.sha256 != stack.manifest["part"]["sha256"]:
        raise StorageError(f"'{job.part}' is not the part that was sliced", hint="slice the part again")
    if prepared.grid != stack.grid:
        raise JobError(f"{job.name}: makes other pixels than the stack has", hint="use the stack's printer and part")
    return prepared


def _shell_share(stack: Stack) -> float:
    """Of the part, that a relief by the pattern fills in part: any material may be there, as the same pattern says."""
    part = stack.manifest["part"]
    return float(part.get("relief", {}).get("shell_mm3", 0.0) / part["volume_mm3"]) if "relief" in part else 0.0


def _missing_layers(stack: Stack) -> Iterator[str]:
    listed = {record.index for record in stack.records}
    missing = [i for i in range(stack.grid.layers) if i not in listed]
    if missing and stack.manifest["complete"]:
        yield f"the manifest calls the stack complete, but lists no layer {missing[0]} ({len(missing)} missing)"


class _LayerLook:
    """What is looked at of each layer, in any order and thread."""

    def __init__(
        self,
        stack: Stack,
        job: Job,
        painted: Painted,
        windows: RatioWindows,
        texture: Texture | None,
        solid_of: Callable[[int], NDArray[np.bool_]] | None,
    ) -> None:
        self._stack, self._painted, self._windows, self._texture = stack, painted, windows, texture
        self._materials, self._solid_of = job.materials, solid_of
        self._shared = None if painted.asked_depends_on_z else painted.ratio_map(stack.grid, 0)

    def check(self, record: LayerRecord) -> _LayerCheck:
        """Reads a layer's bitmaps, counts them, and holds them against the manifest and each other."""
        stack, grid = self._stack, self._stack.grid
        labels = np.zeros((grid.height_px, grid.width_px), np.uint8)
        pixels, problems = [], []
        twice: NDArray[np.bool_] = np.zeros(labels.shape, bool)
        for m, name in enumerate(self._materials, 1):
            if name not in stack.materials:  # nothing, which has no bitmap
                pixels.append(0)
                continue
            deposit, found = _read_layer(stack, record, name)
            problems += found
            count = 0 if deposit is None else int(np.count_nonzero(deposit))
            if deposit is not None:
                twice |= deposit & (labels > 0)
                labels[deposit] = m
            if count != record.pixels.get(name):
                wanted = str(record.pixels.get(name))
                problems.append((COUNTS, f"layer {record.index}: {count} pixels of {name}; the manifest says {wanted}"))
            pixels.append(count)
        if twice.any():
            row, column = np.argwhere(twice)[0]
            where = f"the first in column {column}, row {row}"
            problems.append(
                (PARTITION, f"layer {record.index}: {np.count_nonzero(twice)} pixels belong to two materials, {where}")
            )
        margin = grid.margin_px
        inner = labels[::-1][margin : grid.height_px - margin, margin : grid.width_px - margin]
        if self._solid_of is not None:
            pixels, problems = self._with_void(record, inner, pixels, problems)
        cumulative = self._painted.asked_map(grid, record.index) if self._shared is None else self._shared
        got, asked = self._windows.count(inner, cumulative)
        if self._painted.regions is not None:  # what has its own material shows no laminate
            inner = np.where(self._painted.regions.labels(record.index) > 0, np.uint8(0), inner)
        thinned = None if self._texture is None else self._texture.thin(inner)
        return _LayerCheck(pixels, asked.sum(axis=(1, 2)).tolist(), problems, (got, asked), thinned)

    def _with_void(
        self, record: LayerRecord, inner: NDArray[np.uint8], pixels: list[int], problems: list[tuple[str, str]]
    ) -> tuple[list[int], list[tuple[str, str]]]:
        """Labels what is solid and has no material, and says what lies outside the part."""
        assert self._solid_of is not None
        solid, void = self._solid_of(record.index), self._materials.index(VOID)
        outside = np.argwhere((inner > 0) & ~solid)
        if len(outside):
            row, column = outside[0]
            where = f"the first in column {column}, row {row} from below"
            problems = [
                *problems, (PARTITION, f"layer {record.index}: {len(outside)} pixels lie outside the part, {where}"),
            ]  # fmt: skip
        empty = solid & (inner == 0)
        inner[empty] = void + 1
        count = int(np.count_nonzero(empty))
        if count != record.void_px:
            problem = f"layer {record.index}: {count} pixels of {VOID}; the manifest says {record.void_px}"
            problems = [*problems, (COUNTS, problem)]
        return [count if m == void else n for m, n in enumerate(pixels)], problems


def _read_layer(stack: Stack, record: LayerRecord, name: str) -> tuple[NDArray[np.bool_] | None, list[tuple[str, str]]]:
    """Where a material's bitmap is white, or None, and what is wrong with the file."""
    shape = (stack.grid.height_px, stack.grid.width_px)
    file = stack.folder / layer_path(name, record.index)
    problems = []
    try:
        with storage_errors("read", file):
            content = file.read_bytes()
        if hashlib.sha256(content).hexdigest() != record.sha256.get(name):
            problems.append((HASHES, f"layer {record.index}: '{file}' was altered"))
        deposit = decode_bitmap(content, file)
    except AmslicerError as error:
        return None, [*problems, (FILES, f"layer {record.index}: {error.message}")]
    if deposit.shape != shape:
        size, wanted = (f"{columns} × {rows}" for rows, columns in (deposit.shape, shape))
        return None, [*problems, (SIZES, f"layer {record.index}: '{file}' has {size} pixels instead of {wanted}")]
    return deposit, problems


def _volume_problems(stack: Stack, solid: int) -> Iterator[str]:
    """The stack's volume against the mesh's, beyond what sampling its surface can explain."""
    part, grid = stack.manifest["part"], stack.grid
    if not stack.manifest["complete"] or "open" in part or "volume_mm3" not in part:
        return
    expected = part["volume_mm3"] - part["overlap_mm3"]
    allowed = VOLUME_SHARE * expected + part["surface_mm2"] * max(*grid.pitch_mm, grid.layer_mm) / 2
    volume = solid * grid.voxel_mm3
    if abs(volume - expected) > allowed:
        yield (f"the stack holds {volume:.6g} mm³, the part {expected:.6g} mm³ (allowed ± {allowed:.3g} mm³)")


def _check_totals(stack: Stack, names: Sequence[str], totals: list[int], findings: _Findings) -> None:
    void = [{"name": VOID, **stack.manifest[VOID]}] if VOID in stack.manifest else []
    for entry in (*stack.manifest["materials"], *void):
        total = totals[names.index(entry["name"])]
        if entry["pixels"] != total:
            findings.add(COUNTS, f"all layers: {total} pixels of {entry['name']}; the manifest says {entry['pixels']}")


def _material_reports(
    stack: Stack, job: Job, painted: Painted, totals: list[int], asked: list[float]
) -> dict[str, MaterialReport]:
    solid = sum(totals)
    largest = max(record.solid_px for record in stack.records)
    reports, until = {}, 0.0
    for name, count, wanted in zip(job.materials, totals, asked, strict=True):
        share = wanted / solid if solid else 0.0
        below, until = until, min(until + share, 1.0)
        tolerance = ratio_tolerance(stack.grid, job, painted, (below, until), solid, largest)
        reports[name] = MaterialReport(name, count, count / solid if solid else 0.0, share, tolerance)
    return reports


def ratio_tolerance(
    grid: Grid, job: Job, painted: Painted, cumulative: tuple[float, float], solid: int, largest: int
) -> float:
    """How far the ratio of an honest stack may be from the painted mean: 4σ + ρ(1-ρ)/N, a pixel's share, a defect's.

    A part of about one period² may be of one material; there the largest error that is possible is allowed.

    Args:
        cumulative: mean painted ratios over the solid of all materials before one, and up to it.
        solid, largest: solid pixels of all layers, and of the layer that has most.
    """
    ratio = cumulative[1] - cumulative[0]
    if solid == 0 or not 0 < ratio < 1:
        return 0.0 if solid == 0 else 1.0 / solid
    pattern = job.spec.pattern
    period = painted.period_bounds_mm[1]
    pixel_periods = grid.pitch_mm[0] * grid.pitch_mm[1] / period**2
    area = largest * pixel_periods
    if pattern.dimensions == 3:
        # Layers further apart than an envelope's width are different laminates: their ratios average.
        depth = period / pattern.bandwidth
        area = max(area, solid * pixel_periods * grid.layer_mm / depth)
    sigma = SPREAD * pattern.bandwidth * math.sin(math.pi * ratio) / math.sqrt(area)
    size = painted.placement.size_mm
    corners = np.array([[0.0, 0.0, 0.0], size / 2, size])
    normals, lobes = painted.normals(corners), job_lobes(job, painted)
    axes = pattern.dimensions
    # Of the part's volume, or of the cross-section that is most of it: a box as large.
    filled = (solid * grid.voxel_mm3 / float(np.prod(size))) if axes == 3 else largest / (grid.columns * grid.rows)
    sides = size[:axes] / period * min(1.0, filled) ** (1 / axes)
    across = float(np.min(np.abs(normals) @ size)) / period
    resonance = 0.0
    if lobes is not None:
        directions = lobes.all_directions(normals)
        resonance = float(np.max(resonance_deviation(
            0.0, ratio, lobes=directions, shares=lobes.shares, bandwidth=pattern.bandwidth, window_periods=sides
        )))  # fmt: skip
        normals = directions.reshape(-1, 3)
        across = float(np.min(np.abs(normals) @ size)) / period
    likeness = make_noise(job, painted).likeness
    if likeness is not None:
        sides_mm = sides[None] * period
        below, until = (np.full((1, 1), c) for c in cumulative)
        sigma, across = float(share_deviation(below, until, sides_mm, likeness)[0, 0]), math.inf
    elif NOISES[pattern.noise].read_by(pattern) != "phase":
        sigma = max(
            float(np.max(level_deviation(
                *cumulative, profile=make_profile(pattern.profile), bandwidth=pattern.bandwidth,
                dimensions=axes, window_periods=sides, normal=n,
            )))
            for n in (None, *normals)
        )  # fmt: skip
    faces = ratio * (1 - ratio) / max(across, 1.0)
    allowed = SIGMAS * math.hypot(sigma, resonance) + faces + PIXEL_SHARE / math.sqrt(solid) + DEFECT / area
    return min(allowed, max(ratio, 1 - ratio))
