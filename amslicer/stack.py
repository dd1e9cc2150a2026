"""A stack on disk: writing one from a job, and reading one back as layers."""

from __future__ import annotations

import hashlib
import io
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from amslicer.errors import StorageError, UsageError
from amslicer.layer import Layer
from amslicer.manifest import (
    INPUTS,
    JOB_FILE,
    MANIFEST,
    LayerRecord,
    describe_stack,
    grid_of,
    read_manifest,
    records_of,
)
from amslicer.storage import TEMPORARY, json_bytes, storage_errors, write_atomically
from amslicer.writers.png import layer_path

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.pipeline import Made, Prepared, Progress, Run

JOB_HEADER = "# written by amslicer: the whole job; slice it again with `amslicer PART --fields` and this file\n"
LAYER_FILE = re.compile(r"\d{5,}\.png(" + re.escape(TEMPORARY) + ")?")


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
    """

    out: Path
    materials: tuple[MaterialResult, ...]
    solid_pixels: int
    layers: int
    complete: bool
    seconds: float
    notes: tuple[str, ...]


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
    from amslicer.device import Device
    from amslicer.pipeline import Run, host_threads, layer_range, make_layers, prepare

    started = time.monotonic()
    run, out = run or Run(), Path(out)
    if format is not None:
        job = job.with_format(format)
    prepared = prepare(job)
    chosen = layer_range(run, prepared.grid.layers)
    with Device(run.device, run.jobs) as device, host_threads(run) as pool:
        pattern = prepared.pattern(device)
        open_folder(out, job, overwrite=overwrite)
        records: list[LayerRecord] = []
        asked = 0.0
        for batch in make_layers(prepared, pattern, pool, chosen, run.threads):
            records.extend(pool.map(lambda made: _write_layer(out, made, prepared), batch))
            asked += sum(made.asked for made in batch)
            if progress:
                progress(len(records), len(chosen))
        digest = job.digest(prepared.mesh.sha256, device.label, __version__)
        manifest = describe_stack(prepared, records, asked, device=device.label, digest=digest, version=__version__)
    write_atomically(out / MANIFEST, json_bytes(manifest))
    return _result(out, manifest, prepared, time.monotonic() - started)


def _write_layer(out: Path, made: Made, prepared: Prepared) -> LayerRecord:
    from amslicer.writers import WRITERS

    layer, output = made.layer, prepared.job.spec.output
    sha256 = {}
    for path, material, content in WRITERS[output.format](layer, prepared.grid.pitch_mm, output.compression):
        write_atomically(out / path, content)
        sha256[material] = hashlib.sha256(content).hexdigest()
    return LayerRecord(layer.index, layer.z_mm, layer.pixels(), sha256)


def _result(out: Path, manifest: dict[str, Any], prepared: Prepared, seconds: float) -> Result:
    materials = tuple(
        MaterialResult(
            m["name"], m["pixels"], m["volume_mm3"], m["ratio"], m["ratio_asked"],
            None if spec.density_g_cm3 is None else m["volume_mm3"] / 1000 * spec.density_g_cm3,
        )
        for m, spec in zip(manifest["materials"], prepared.job.spec.materials, strict=True)
    )  # fmt: skip
    return Result(
        out, materials, manifest["solid_pixels"], len(manifest["layers"]), manifest["complete"], seconds,
        tuple(prepared.notes()),
    )  # fmt: skip


def open_folder(out: Path, job: Job, *, overwrite: bool) -> None:
    """Makes the stack's folder ready: material folders, job.yaml and inputs/.

    Raises:
        UsageError: it holds something, and `overwrite` is off or would replace what amslicer did not write.
        StorageError: it cannot be written.
    """
    with storage_errors("write to", out):
        if out.exists() and not out.is_dir():
            raise UsageError(f"'{out}' is a file, not a folder", hint="choose another folder (-o OUT)")
        if out.is_dir() and any(out.iterdir()):
            if not overwrite:
                raise UsageError(
                    f"the folder '{out}' is not empty",
                    hint="choose another folder (-o OUT), or add --overwrite",
                )
            _remove_stack(out)
        renamed = _input_names(job)
        materials = [out / name for name in job.materials]
        taken = [p for f in materials if f.exists() for p in f.iterdir() if LAYER_FILE.fullmatch(p.name)]
        taken += [p for p in (out / name for name in (JOB_FILE, MANIFEST, *renamed.values())) if p.exists()]
        if taken:
            raise UsageError(
                f"'{taken[0]}' stands where the stack would go, and amslicer did not write it",
                hint="move it away or choose another folder (-o OUT)",
            )
        for folder in [*materials, *([out / INPUTS] if renamed else [])]:
            folder.mkdir(parents=True, exist_ok=True)
    for name, new in renamed.items():
        write_atomically(out / new, job.inputs.read(name))
    write_atomically(out / JOB_FILE, _job_yaml(job, renamed))


def _input_names(job: Job) -> dict[str, str]:
    """Where each field file goes: inputs/NAME, numbered where names repeat."""
    renamed: dict[str, str] = {}
    for path in job.input_paths():
        name, number = Path(path).name, 1
        while f"{INPUTS}/{name}" in renamed.values():
            number += 1
            name = f"{Path(path).stem}-{number}{Path(path).suffix}"
        renamed[path] = f"{INPUTS}/{name}"
    return renamed


def _job_yaml(job: Job, renamed: dict[str, str]) -> bytes:
    from ruamel.yaml import YAML

    stream = io.StringIO(JOB_HEADER)
    stream.seek(0, io.SEEK_END)
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.dump(job.resolved(renamed), stream)
    return stream.getvalue().encode()


def _remove_stack(out: Path) -> None:
    """Removes a stack that amslicer wrote (finished or not), and nothing else."""
    job_file = out / JOB_FILE
    if not (job_file.is_file() and job_file.read_text(encoding="utf-8", errors="replace").startswith(JOB_HEADER)):
        return
    from amslicer.yamlfile import read_yaml

    content = read_yaml(job_file, "job file of the stack")[0]
    for material in content.get("materials", []):
        folder = out / str(material["name"])
        if folder.is_dir():
            for file in folder.iterdir():
                if LAYER_FILE.fullmatch(file.name):
                    file.unlink()
            _remove_if_empty(folder)
    for name in _inputs_of(content):
        (out / name).unlink(missing_ok=True)
    _remove_if_empty(out / INPUTS)
    (out / MANIFEST).unlink(missing_ok=True)
    job_file.unlink()


def _inputs_of(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        for value in node.values():
            yield from _inputs_of(value)
    elif isinstance(node, str) and re.fullmatch(INPUTS + r"/[^/\\]+", node):
        yield node


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


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
        picture = Image.open(io.BytesIO(content), formats=("PNG",))
        if picture.mode != "1":
            raise StorageError(f"'{file}' is not a 1-bit picture (mode {picture.mode})")
        return np.asarray(picture)
    except StorageError:
        raise
    except Exception as error:  # Pillow raises many kinds for damaged files
        raise StorageError(f"'{file}' is not a readable PNG: {error}") from error
