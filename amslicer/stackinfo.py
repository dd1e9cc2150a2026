"""What is in a written stack, from its manifest and its job file; no bitmap is opened."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amslicer.errors import JobError, StorageError
from amslicer.specification import VOID
from amslicer.stack import open_stack
from amslicer.storage import JOB_FILE, MANIFEST, storage_errors

if TYPE_CHECKING:
    import os

    from amslicer.stack import Stack


@dataclass(frozen=True)
class MaterialInfo:
    """A material of a stack.

    Attributes:
        ratio, asked: share of the solid, got and painted.
        grams: None where the job gives no density.
    """

    name: str
    color: str
    pixels: int
    volume_mm3: float
    grams: float | None
    ratio: float
    asked: float


@dataclass(frozen=True)
class StackInfo:
    """A stack as a person wants to know it.

    Attributes:
        size_mm: of the placed part, along the printer's axes.
        layer_count: layers of the whole part.
        layer_ranges: half-open ranges of the layers that are there.
        printer, pattern: sections of the job; empty where its file cannot be read.
        problem: why the job cannot be read; None where it can.
        bytes: of all files in the folder.
    """

    out: Path
    part: str
    size_mm: tuple[float, ...]
    width_px: int
    height_px: int
    pitch_mm: tuple[float, float]
    layer_mm: float
    layer_count: int
    layer_ranges: tuple[tuple[int, int], ...]
    complete: bool
    solid_pixels: int
    materials: tuple[MaterialInfo, ...]
    printer: dict[str, Any]
    pattern: dict[str, Any]
    problem: str | None
    device: str
    version: str
    digest: str
    bytes: int

    @property
    def layers(self) -> int:
        """How many layers are there."""
        return sum(end - first for first, end in self.layer_ranges)


def describe_folder(out: str | os.PathLike[str]) -> StackInfo:
    """What the stack in a folder holds.

    Raises:
        StorageError: there is no finished stack, or its manifest is damaged.
    """
    stack = open_stack(out)
    job, problem = _job_of(stack.folder)
    try:
        return _describe(stack, job, problem)
    except (KeyError, TypeError, ValueError) as error:
        raise StorageError(f"'{stack.folder / MANIFEST}' is damaged: {error!r}", hint="slice the part again") from error


def _describe(stack: Stack, job: dict[str, Any], problem: str | None) -> StackInfo:
    manifest, grid = stack.manifest, stack.grid
    low, high = manifest["part"]["bbox_mm"]
    densities = {m["name"]: m.get("density_g_cm3") for m in job.get("materials", ())}
    return StackInfo(
        out=stack.folder,
        part=manifest["part"]["file"],
        size_mm=tuple(b - a for a, b in zip(low, high, strict=True)),
        width_px=grid.width_px,
        height_px=grid.height_px,
        pitch_mm=grid.pitch_mm,
        layer_mm=grid.layer_mm,
        layer_count=grid.layers,
        layer_ranges=tuple(ranges([record.index for record in stack.records])),
        complete=manifest["complete"],
        solid_pixels=manifest["solid_pixels"],
        materials=tuple(_material(m, densities.get(m["name"])) for m in (*manifest["materials"], *_void(manifest))),
        printer=job.get("printer", {}),
        pattern=job.get("pattern", {}),
        problem=problem,
        device=manifest["device"],
        version=manifest["amslicer"],
        digest=manifest["job_digest"],
        bytes=_bytes_in(stack.folder),
    )


def _void(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """What is left empty, like a material without a colour."""
    return [{"name": VOID, "color": "-", **manifest[VOID]}] if VOID in manifest else []


def _material(entry: dict[str, Any], density_g_cm3: float | None) -> MaterialInfo:
    volume = entry["volume_mm3"]
    grams = None if density_g_cm3 is None else volume / 1000 * density_g_cm3
    return MaterialInfo(
        entry["name"], entry["color"], entry["pixels"], volume, grams, entry["ratio"], entry["ratio_asked"]
    )


def _job_of(folder: Path) -> tuple[dict[str, Any], str | None]:
    """The stack's own job with its defaults, or why it cannot be read: the rest is worth showing without it."""
    from amslicer.job import load_job

    try:
        return load_job(folder / JOB_FILE, part="").resolved(), None
    except JobError as error:
        return {}, error.message


def ranges(numbers: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Half-open ranges that ascending whole numbers fill."""
    there = set(numbers)
    firsts = (n for n in numbers if n - 1 not in there)
    ends = (n + 1 for n in numbers if n + 1 not in there)
    return zip(firsts, ends, strict=True)


def _bytes_in(folder: Path) -> int:
    with storage_errors("read", folder):
        return sum(file.lstat().st_size for file in folder.rglob("*") if file.is_file())
