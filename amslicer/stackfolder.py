"""The folder that a stack is written to: locked, emptied of an older stack if asked, and of nothing else."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from amslicer.errors import JobError, UsageError
from amslicer.specification import MATERIAL_NAME
from amslicer.storage import INPUTS, JOB_FILE, MANIFEST, TEMPORARY, locked, storage_errors, write_atomically
from amslicer.writers.png import layer_path

if TYPE_CHECKING:
    from amslicer.job import Job

Contents: TypeAlias = dict[str, tuple[str, memoryview]]  # by where it goes: a field file's name in the job, its bytes
JOB_HEADER = "# written by amslicer: the whole job; slice it again with `amslicer PART --fields` and this file\n"
LARGE_BYTES = 8 << 20  # of a field file: its copy takes longer than the first layers
PART_LINE = re.compile(r"^# the part: (.+)$", re.MULTILINE)  # where a copy of the part's file is kept
LAYER_FILE = re.compile(r"\d{5,}\.png(" + re.escape(TEMPORARY) + ")?")


@contextmanager
def opened_folder(out: Path, job: Job, *, overwrite: bool) -> Iterator[Contents]:
    """Holds the stack's folder, ready to be written to: material folders, job.yaml and inputs/ are there.

    Yields:
        Field files that are too large to wait for: copy_inputs must put them there.

    Raises:
        UsageError: it holds something, and `overwrite` is off or would replace what amslicer did not write; or
            another process writes to it.
        StorageError: it cannot be written.
    """
    if out.exists() and not out.is_dir():
        raise UsageError(f"'{out}' is a file, not a folder", hint="choose another folder (-o OUT)")
    with storage_errors("make", out):
        out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        renamed = input_names(job)
        # Before room is made: they may be the copies in this very folder.
        contents = {new: (name, job.inputs.map(name)) for name, new in renamed.items()}
        copied = None
        if job.part_copy:
            with storage_errors("read", job.part):
                copied = job.part.read_bytes()
        with storage_errors("write to", out):
            _make_room(out, job, renamed, overwrite=overwrite)
        large = {new: content for new, content in contents.items() if content[1].nbytes >= LARGE_BYTES}
        copy_inputs(out, job, {new: content for new, content in contents.items() if new not in large})
        if job.part_copy and copied is not None:
            write_atomically(out / job.part_copy, copied)
        write_atomically(out / JOB_FILE, _job_yaml(job, renamed))
        yield large


def copy_inputs(out: Path, job: Job, contents: Contents) -> None:
    """Writes field files into the stack, and works out their digests."""
    for new, (name, content) in contents.items():
        write_atomically(out / new, content)
        job.inputs.digest(name, content)


def _make_room(out: Path, job: Job, renamed: dict[str, str], *, overwrite: bool) -> None:
    if any(out.iterdir()):
        if not overwrite:
            raise UsageError(
                f"the folder '{out}' is not empty", hint="choose another folder (-o OUT), or add --overwrite"
            )
        _remove_stack(out)
    materials = [out / name for name in job.printed]
    inputs = [*renamed.values(), *([job.part_copy] if job.part_copy else [])]
    taken = [p for f in materials if f.exists() for p in f.iterdir() if LAYER_FILE.fullmatch(p.name)]
    taken += [p for p in (out / name for name in (JOB_FILE, MANIFEST, *inputs)) if p.exists()]
    if taken:
        raise UsageError(
            f"'{taken[0]}' stands where the stack would go, and amslicer did not write it",
            hint="move it away or choose another folder (-o OUT)",
        )
    for folder in [*materials, *([out / INPUTS] if inputs else [])]:
        folder.mkdir(parents=True, exist_ok=True)


def input_names(job: Job) -> dict[str, str]:
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

    stream = io.StringIO()
    stream.write(JOB_HEADER)
    if job.part_copy:
        stream.write(f"# the part: {job.part_copy}\n")
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.dump(job.resolved(renamed), stream)
    return stream.getvalue().encode()


def _remove_stack(out: Path) -> None:
    """Removes a stack that amslicer wrote, finished or not, and nothing else."""
    from amslicer.yamlfile import read_yaml

    job_file = out / JOB_FILE
    if not (job_file.is_file() and job_file.read_text(encoding="utf-8", errors="replace").startswith(JOB_HEADER)):
        return
    try:
        content = read_yaml(job_file, "job file of the stack")[0]
    except JobError:  # no longer what amslicer wrote
        return
    for folder, files in _layer_files(out, content):
        for file in files:
            file.unlink(missing_ok=True)
        _remove_if_empty(folder)
    copy = PART_LINE.search(job_file.read_text(encoding="utf-8", errors="replace"))
    for name in (*_inputs_of(content), *_inputs_of(copy and copy[1]), MANIFEST, JOB_FILE):
        for file in (out / name, out / (name + TEMPORARY)):
            file.unlink(missing_ok=True)
    _remove_if_empty(out / INPUTS)


def _layer_files(out: Path, content: dict[str, Any]) -> Iterator[tuple[Path, list[Path]]]:
    """Each material's folder and the bitmaps in it: those that the manifest lists, or all of an unfinished stack."""
    entries = content.get("materials")
    names = [e.get("name") if isinstance(e, dict) else e for e in entries] if isinstance(entries, list) else []
    indices = _listed_layers(out / MANIFEST)
    for name in names:
        if isinstance(name, str) and re.fullmatch(MATERIAL_NAME, name) and (out / name).is_dir():
            if indices is None:
                files = [f for f in (out / name).iterdir() if LAYER_FILE.fullmatch(f.name)]
            else:
                files = [out / layer_path(name, index) for index in indices]
            yield out / name, files


def _listed_layers(manifest: Path) -> list[int] | None:
    try:
        return [int(layer["index"]) for layer in json.loads(manifest.read_bytes())["layers"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _inputs_of(node: Any) -> Iterator[str]:
    """The paths in a stack's job that lie in its inputs/."""
    if isinstance(node, dict):
        for value in node.values():
            yield from _inputs_of(value)
    elif isinstance(node, str) and re.fullmatch(INPUTS + r"/[^/\\]+", node) and node != f"{INPUTS}/..":
        yield node


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
