"""Is a written stack what was asked for? Checked from its files, its manifest and its painted fields alone."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import AmslicerError, JobError, StorageError
from amslicer.manifest import LayerRecord, placement_of
from amslicer.painted import Painted, open_fields
from amslicer.stack import Stack, decode_bitmap
from amslicer.storage import JOB_FILE, storage_errors
from amslicer.writers.png import layer_path

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.pipeline import Progress

# Spread of the ratio over an area of A periods² of a plane cut: 0.075 B sin(πρ)/√A, measured for unaligned
# phasor noise of bandwidth B; four of them, and what faces parallel to the sheets cut off, ρ(1-ρ)/N for N
# sheets across, is as far as an honest stack goes.
SPREAD, SIGMAS = 0.075, 4.0
# Pixels that a sheet's edge passes through fall to either side: the share of n pixels scatters by about ½/√n.
PIXEL_SHARE = 0.5
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
    """One law, and what broke it."""

    name: str
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing broke it."""
        return not self.problems


@dataclass(frozen=True)
class Report:
    """Everything that was checked."""

    out: Path
    layers: int
    solid_pixels: int
    checks: tuple[Check, ...]
    materials: dict[str, MaterialReport]

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
            "checks": [{"name": c.name, "ok": c.ok, "problems": list(c.problems)} for c in self.checks],
            "materials": {
                name: {
                    "pixels": m.pixels, "ratio": m.ratio, "expected": m.expected, "error": m.error,
                    "tolerance": m.tolerance, "ok": m.ok,
                }
                for name, m in self.materials.items()
            },
        }  # fmt: skip


@dataclass
class _Findings:
    """Problems per law, in order of the layers."""

    problems: dict[str, list[str]] = field(default_factory=dict)

    def add(self, law: str, problem: str) -> None:
        self.problems.setdefault(law, []).append(problem)

    def check(self, law: str) -> Check:
        found = self.problems.get(law, [])
        more = [f"… and {len(found) - MAX_PROBLEMS} more"] if len(found) > MAX_PROBLEMS else []
        return Check(law, tuple(found[:MAX_PROBLEMS] + more))


@dataclass(frozen=True)
class _LayerCheck:
    pixels: list[int]
    asked: list[float]
    problems: list[tuple[str, str]]


FILES, HASHES, SIZES, PARTITION, COUNTS, RATIO = (
    "files: every layer and material is there",
    "hashes: no file was altered since it was written",
    "sizes: every bitmap has the grid's size",
    "partition: no pixel belongs to two materials",
    "counts: pixels are as the manifest says",
    "ratio: each material's share is as painted",
)
LAWS = (FILES, HASHES, SIZES, PARTITION, COUNTS, RATIO)


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
    painted = _painted(stack, job)
    findings = _Findings()
    for problem in _missing_layers(stack):
        findings.add(FILES, problem)
    totals, asked = [0] * len(stack.materials), [0.0] * len(stack.materials)
    with ThreadPoolExecutor(Run(jobs=jobs).threads) as pool:
        ratio = _Ratio(stack, painted)
        for done, result in enumerate(pool.map(lambda r: _check_layer(stack, r, ratio), stack.records), 1):
            totals = [a + b for a, b in zip(totals, result.pixels, strict=True)]
            asked = [a + b for a, b in zip(asked, result.asked, strict=True)]
            for law, problem in result.problems:
                findings.add(law, problem)
            if progress:
                progress(done, len(stack.records))
    materials = _material_reports(stack, job, painted, totals, asked)
    for m in materials.values():
        if not m.ok:
            findings.add(
                RATIO,
                f"{m.name}: {m.ratio:.4f} instead of {m.expected:.4f} "
                f"(error {m.error:+.4f}, allowed ± {m.tolerance:.4f})",
            )
    _check_totals(stack, totals, findings)
    checks = tuple(findings.check(law) for law in LAWS)
    return Report(stack.folder, len(stack.records), sum(totals), checks, materials)


def _job_of(stack: Stack, fields: str | os.PathLike[str] | None) -> Job:
    from amslicer.job import load_job

    own = stack.folder / JOB_FILE
    if fields is None and not own.is_file():
        raise StorageError(f"'{own}' is missing", hint="name the fields to compare with: --fields FIELDS.yaml")
    job = load_job(own if fields is None else fields, part=stack.manifest["part"]["file"])
    if job.materials != stack.materials:
        raise JobError(
            f"{job.name}: the materials are {', '.join(job.materials)}, but the stack has {', '.join(stack.materials)}"
        )
    return job


def _painted(stack: Stack, job: Job) -> Painted:
    low, high = np.array(stack.manifest["part"]["file_bbox_mm"], float)
    return open_fields(job, placement_of(stack.manifest), high - low)


def _missing_layers(stack: Stack) -> Iterator[str]:
    listed = {record.index for record in stack.records}
    missing = [i for i in range(stack.grid.layers) if i not in listed]
    if missing and stack.manifest["complete"]:
        yield f"the manifest calls the stack complete, but lists no layer {missing[0]} ({len(missing)} missing)"


class _Ratio:
    """The painted ratio at a layer's pixels, margin included; kept where all layers share it."""

    def __init__(self, stack: Stack, painted: Painted) -> None:
        self._grid, self._painted = stack.grid, painted
        self._shared = None if painted.ratio_depends_on_z else self._map(0)

    def at(self, layer: int) -> NDArray[np.float32]:
        """(materials - 1, H, W) cumulative ratios, row 0 = largest y."""
        return self._map(layer) if self._shared is None else self._shared

    def _map(self, layer: int) -> NDArray[np.float32]:
        margin = (self._grid.margin_px, self._grid.margin_px)
        return np.pad(self._painted.ratio_map(self._grid, layer), ((0, 0), margin, margin))[:, ::-1]


def _check_layer(stack: Stack, record: LayerRecord, ratio: _Ratio) -> _LayerCheck:
    shape = (stack.grid.height_px, stack.grid.width_px)
    claimed = np.zeros(shape, np.uint8)
    pixels, problems = [], []
    for name in stack.materials:
        file = stack.folder / layer_path(name, record.index)
        count = 0
        try:
            with storage_errors("read", file):
                content = file.read_bytes()
            if hashlib.sha256(content).hexdigest() != record.sha256.get(name):
                problems.append((HASHES, f"layer {record.index}: '{file}' was altered"))
            deposit = decode_bitmap(content, file)
            if deposit.shape == shape:
                count = int(np.count_nonzero(deposit))
                claimed += deposit
            else:
                size = f"{deposit.shape[1]} × {deposit.shape[0]}"
                wanted = f"{shape[1]} × {shape[0]}"
                problems.append((SIZES, f"layer {record.index}: '{file}' has {size} pixels instead of {wanted}"))
        except AmslicerError as error:
            problems.append((FILES, f"layer {record.index}: {error.message}"))
        if count != record.pixels.get(name):
            wanted = str(record.pixels.get(name))
            problems.append((COUNTS, f"layer {record.index}: {count} pixels of {name}; the manifest says {wanted}"))
        pixels.append(count)
    twice = int(np.count_nonzero(claimed > 1))
    if twice:
        row, column = np.argwhere(claimed > 1)[0]
        where = f"the first in column {column}, row {row}"
        problems.append((PARTITION, f"layer {record.index}: {twice} pixels belong to two materials, {where}"))
    solid = claimed > 0
    until = [float(plane[solid].sum(dtype=np.float64)) for plane in ratio.at(record.index)]
    asked = np.diff([0.0, *until, float(np.count_nonzero(solid))])
    return _LayerCheck(pixels, [float(a) for a in asked], problems)


def _check_totals(stack: Stack, totals: list[int], findings: _Findings) -> None:
    for entry, total in zip(stack.manifest["materials"], totals, strict=True):
        if entry["pixels"] != total:
            findings.add(COUNTS, f"all layers: {total} pixels of {entry['name']}; the manifest says {entry['pixels']}")


def _material_reports(
    stack: Stack, job: Job, painted: Painted, totals: list[int], asked: list[float]
) -> dict[str, MaterialReport]:
    solid = sum(totals)
    largest = max(sum(r.pixels.values()) for r in stack.records)
    reports = {}
    for name, count, wanted in zip(stack.materials, totals, asked, strict=True):
        share = wanted / solid if solid else 0.0
        tolerance = ratio_tolerance(stack.grid, job, painted, share, solid, largest)
        reports[name] = MaterialReport(name, count, count / solid if solid else 0.0, share, tolerance)
    return reports


def ratio_tolerance(grid: Grid, job: Job, painted: Painted, ratio: float, solid: int, largest: int) -> float:
    """How far the ratio of an honest stack may be from the painted mean: 4σ + ρ(1-ρ)/N + a pixel's share.

    Args:
        ratio: mean painted ratio over the solid.
        solid, largest: solid pixels of all layers, and of the layer that has most.
    """
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
    across = float(np.min(np.abs(painted.normals(corners)) @ size)) / period
    faces = ratio * (1 - ratio) / max(across, 1.0)
    return SIGMAS * sigma + faces + PIXEL_SHARE / math.sqrt(solid)
