"""A stack on disk: writing one from a job, and reading one back as layers."""

from __future__ import annotations

import hashlib
import io
import logging
import time
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from amslicer.errors import StorageError
from amslicer.layer import Layer
from amslicer.manifest import (
    LayerRecord,
    describe_stack,
    grid_of,
    read_manifest,
    records_of,
)
from amslicer.specification import VOID
from amslicer.stackfolder import copy_inputs, opened_folder
from amslicer.storage import MANIFEST, json_bytes, space_note, storage_errors, sync_folder, write_atomically
from amslicer.writers.png import layer_path

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.pipeline import Made, Prepared, Progress, Run

BATCHES_WAITING = 2  # to be encoded and written while the next is computed
# Of the part's volume: overlaps below are what touching bodies have by rounding.
VOLUME_SHARE = 0.01


@dataclass(frozen=True)
class MaterialResult:
    """How much of a material a stack holds.

    Attributes:
        ratio, asked: share of the solid, got and painted.
        grams: None where the job gives no density.
    """

    name: str
    pixels: int
    volume_mm3: float
    ratio: float
    asked: float
    grams: float | None


@dataclass(frozen=True)
class Result:
    """What slicing a job gave.

    Attributes:
        out: the stack's folder.
        layers: layers written.
        complete: whether the stack holds all layers of the part.
        seconds: wall-clock time.
        notes: what a person should know.
        void: how much of the part is left empty; None where the job has no such material.
    """

    out: Path
    materials: tuple[MaterialResult, ...]
    solid_pixels: int
    layers: int
    complete: bool
    seconds: float
    notes: tuple[str, ...]
    void: MaterialResult | None = None


def slice_job(
    job: Job,
    out: str | os.PathLike[str],
    *,
    format: str | None = None,
    run: Run | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Slices a job into a folder of per-material bitmaps.

    Args:
        job: what to slice.
        out: folder; must be empty or new unless `overwrite`.
        format: a writer's name; default: the job's.
        run: device, threads, range of layers.
        overwrite: replace a stack that amslicer wrote there; nothing else is deleted.
        progress: called with (layers done, layers in all) after each batch.

    Raises:
        AmslicerError: of the kind that says where the fault is: usage, job, part, device, files.
    """
    from amslicer import __version__
    from amslicer.device import Device, ask_ahead

    ask_ahead()  # while the pipeline's libraries load and the part is read
    from amslicer.pipeline import Run, layer_range, make_layers, prepare, workers

    started = time.monotonic()
    run, out = run or Run(), Path(out)
    if format is not None:
        job = job.with_format(format)
    prepared = prepare(job)
    chosen = layer_range(run, prepared.grid.layers)
    prepared.painted.check_ratio(prepared.grid)
    _warn_of_full_disk(out, prepared, len(chosen))
    with (
        Device(run.device, run.jobs) as device,
        workers(run.threads) as pool,
        opened_folder(out, job, overwrite=overwrite) as large,
    ):
        pattern = prepared.pattern(device)
        records: list[LayerRecord] = []
        asked = np.zeros(len(job.materials))
        overlap_px = 0
        with (
            workers(1) as disk,  # waits for the disk while others compute
            workers(1) as copier,  # of large field files
            closing(make_layers(prepared, pattern, pool, chosen, run.threads)) as batches,
        ):
            copied = copier.submit(copy_inputs, out, job, large)
            waiting: deque[Future[list[LayerRecord]]] = deque()

            def collect(most: int) -> None:
                while len(waiting) > most:
                    records.extend(waiting.popleft().result())
                    if progress:
                        progress(len(records), len(chosen))

            for batch in batches:
                encoded = [pool.submit(_encode, made, prepared) for made in batch]
                waiting.append(disk.submit(_write, out, encoded))
                collect(BATCHES_WAITING if run.threads > 1 else 0)
                asked += np.sum([made.asked for made in batch], axis=0)
                overlap_px += sum(made.overlap_px for made in batch)
            collect(0)
            copied.result()
        digest = job.digest(prepared.mesh.sha256, device.label, __version__)
        manifest = describe_stack(
            prepared, records, asked.tolist(), overlap_px, device=device.label, digest=digest, version=__version__
        )
        for name in job.printed:
            sync_folder(out / name)
        write_atomically(out / MANIFEST, json_bytes(manifest))
        sync_folder(out)
    return _result(out, manifest, prepared, time.monotonic() - started)


def _warn_of_full_disk(out: Path, prepared: Prepared, layers: int) -> None:
    """Only a warning: what the bitmaps deflate to is not known before they are there."""
    grid = prepared.grid
    size = layers * len(prepared.job.printed) * grid.height_px * -(-grid.width_px // 8)
    if note := space_note(out, size, "the bitmaps may not fit: before compression they take"):
        logging.getLogger(__name__).info("note: %s", note)


def _encode(made: Made, prepared: Prepared) -> tuple[LayerRecord, list[tuple[str, bytes]]]:
    """A layer's record, and its files: (path in the stack, content)."""
    from amslicer.writers import WRITERS

    bitmaps, output = made.bitmaps, prepared.job.spec.output
    files = WRITERS[output.format](bitmaps, prepared.grid.pitch_mm, output.compression)
    sha256 = {material: hashlib.sha256(content).hexdigest() for _, material, content in files}
    record = LayerRecord(bitmaps.index, bitmaps.z_mm, bitmaps.pixels(), sha256, made.void_px)
    return record, [(path, content) for path, _, content in files]


def _write(out: Path, layers: list[Future[tuple[LayerRecord, list[tuple[str, bytes]]]]]) -> list[LayerRecord]:
    """Writes layers as they are encoded; returns their records."""
    records = []
    for layer in layers:
        record, files = layer.result()
        for path, content in files:
            write_atomically(out / path, content)
        records.append(record)
    return records


def _result(out: Path, manifest: dict[str, Any], prepared: Prepared, seconds: float) -> Result:
    printed = [m for m in prepared.job.spec.materials if m.name in prepared.job.printed]
    materials = tuple(
        MaterialResult(
            m["name"], m["pixels"], m["volume_mm3"], m["ratio"], m["ratio_asked"],
            None if spec.density_g_cm3 is None else m["volume_mm3"] / 1000 * spec.density_g_cm3,
        )
        for m, spec in zip(manifest["materials"], printed, strict=True)
    )  # fmt: skip
    return Result(
        out, materials, manifest["solid_pixels"], len(manifest["layers"]), manifest["complete"], seconds,
        (*prepared.notes(), *_outcome_notes(manifest, prepared)), _void(manifest),
    )  # fmt: skip


def _void(manifest: dict[str, Any]) -> MaterialResult | None:
    found = manifest.get(VOID)
    if found is None:
        return None
    return MaterialResult(VOID, found["pixels"], found["volume_mm3"], found["ratio"], found["ratio_asked"], None)


def _outcome_notes(manifest: dict[str, Any], prepared: Prepared) -> Iterator[str]:
    """What is odd about a finished stack, in sentences."""
    from amslicer.verification import ratio_tolerance

    records = records_of(manifest)
    solid = [record.solid_px for record in records]
    filled = [i for i, pixels in enumerate(solid) if pixels]
    if not filled:
        yield "no pixel is solid: the part is thinner than a layer or a pixel of this printer"
        return
    gaps = [records[i].index for i in range(filled[0], filled[-1]) if not solid[i]]
    if gaps:
        yield f"{len(gaps)} layers between solid ones are empty, first {gaps[0]}: the part is thinner than a pixel"
    first = manifest["materials"][0]
    allowed = ratio_tolerance(
        prepared.grid, prepared.job, prepared.painted, (0.0, first["ratio_asked"]), sum(solid), max(solid)
    )
    if abs(first["ratio"] - first["ratio_asked"]) > allowed:
        yield (
            f"{first['name']} is {100 * first['ratio']:.2f} % instead of {100 * first['ratio_asked']:.2f} %, more than "
            f"chance explains (± {100 * allowed:.2f} %): pixels are too coarse for the sheets"
        )
    if manifest["complete"] and not prepared.mesh.rim:
        yield from _volume_note(sum(solid) * prepared.grid.voxel_mm3, manifest["part"])


def _volume_note(volume_mm3: float, part: dict[str, Any]) -> Iterator[str]:
    if part["overlap_mm3"] > VOLUME_SHARE * part["volume_mm3"]:
        yield (
            f"the stack holds {volume_mm3:.4g} mm³ and the mesh's bodies together {part['volume_mm3']:.4g} mm³: "
            "overlapping bodies count once in a stack"
        )


class Stack(Sequence[Layer]):
    """A written stack: length, indexing and iteration give its layers, read when asked for."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self.manifest = read_manifest(self.folder)
        self.materials: tuple[str, ...] = tuple(m["name"] for m in self.manifest["materials"])
        self.colors: tuple[str, ...] = tuple(m["color"] for m in self.manifest["materials"])
        self.records = records_of(self.manifest)

    @property
    def grid(self) -> Grid:
        """Pixels and layers."""
        return grid_of(self.manifest)

    def __len__(self) -> int:
        return len(self.records)

    @overload
    def __getitem__(self, index: int) -> Layer: ...
    @overload
    def __getitem__(self, index: slice) -> list[Layer]: ...
    def __getitem__(self, index: int | slice) -> Layer | list[Layer]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        record = self.records[index]
        labels = np.zeros((self.grid.height_px, self.grid.width_px), np.uint8)
        for m, name in enumerate(self.materials):
            deposit = read_bitmap(self.folder / layer_path(name, record.index))
            if deposit.shape != labels.shape:
                raise StorageError(
                    f"'{self.folder / layer_path(name, record.index)}' has {deposit.shape[1]} × {deposit.shape[0]} "
                    f"pixels instead of {labels.shape[1]} × {labels.shape[0]}"
                )
            labels[deposit] = m + 1
        return Layer(record.index, record.z_mm, labels, self.materials)


def open_stack(folder: str | os.PathLike[str]) -> Stack:
    """Opens a written stack.

    Raises:
        StorageError: there is no finished stack in the folder.
    """
    return Stack(folder)


def read_bitmap(file: Path) -> NDArray[np.bool_]:
    """(H, W) where a 1-bit PNG is white.

    Raises:
        StorageError: missing, unreadable, or not 1-bit.
    """
    with storage_errors("read", file):
        content = file.read_bytes()
    return decode_bitmap(content, file)


def decode_bitmap(content: bytes, file: Path) -> NDArray[np.bool_]:
    """As read_bitmap, of the file's bytes."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # a printer's bed is that large
            picture = Image.open(io.BytesIO(content), formats=("PNG",))
        if picture.mode != "1":
            raise StorageError(f"'{file}' is not a 1-bit picture (mode {picture.mode})")
        return np.asarray(picture)
    except StorageError:
        raise
    except Exception as error:  # Pillow raises many kinds for damaged files
        raise StorageError(f"'{file}' is not a readable PNG: {error}") from error
