"""What is printed: a part, a validated job file and the field files that it names. `Run` says how, not what."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amslicer.errors import JobError, UsageError

if TYPE_CHECKING:
    import os

    from pydantic import ValidationError

    from amslicer.fields.source import Inputs, Source
    from amslicer.specification import JobFile
    from amslicer.yamlfile import Places

DEFAULT_PRINTER = "generic-600dpi"


@dataclass(frozen=True)
class Job:
    """A validated job: what is printed.

    Attributes:
        spec: the job file, defaults filled in.
        part: the mesh file.
        inputs: the field files.
        name: the job file's path, for messages.
    """

    spec: JobFile
    part: Path
    inputs: Inputs
    name: str

    @property
    def materials(self) -> tuple[str, ...]:
        """Names, in the order of the profile."""
        return tuple(m.name for m in self.spec.materials)

    def sources(self) -> Iterator[Source]:
        """Every field of the job that is not a plain number."""
        return _find_sources(self.spec)

    def digest(self, part_sha256: str, device_label: str, version: str) -> str:
        """SHA-256 over everything that can change a byte of the stack (and nothing else)."""
        renamed = {path: hashlib.sha256(self.inputs.read(path)).hexdigest() for path in self.input_paths()}
        content = {
            "job": _dump(self.spec, renamed),
            "part": part_sha256,
            "device": device_label,
            "version": version,
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def with_format(self, name: str) -> Job:
        """The same job, written in another format.

        Raises:
            UsageError: there is no such format.
        """
        from amslicer.writers import WRITERS

        if name not in WRITERS:
            raise UsageError(f"there is no format '{name}'", hint=f"there are: {', '.join(WRITERS)}")
        output = self.spec.output.model_copy(update={"format": name})
        return replace(self, spec=self.spec.model_copy(update={"output": output}))

    def resolved(self, renamed: Mapping[str, str] | None = None) -> dict[str, Any]:
        """The job file's content with every default filled in, its field files at other paths if told so."""
        return _dump(self.spec, dict(renamed or {}))

    def input_paths(self) -> tuple[str, ...]:
        """The field files that the job names, in order, once each."""
        return tuple(dict.fromkeys(path for source in self.sources() for path in source.paths()))


def load_job(
    fields: str | os.PathLike[str] | Mapping[str, Any],
    part: str | os.PathLike[str],
    overrides: Mapping[str, Any] | None = None,
) -> Job:
    """Reads and validates a job file.

    Args:
        fields: the job file's path, or its content as a mapping (paths are then relative to the current folder).
        part: the mesh file (stl obj ply off glb 3mf); it is read when the job runs.
        overrides: dotted keys of the job file and their values, e.g. {"pattern.period": 0.8}.

    Raises:
        JobError: the file, a key or a value cannot be used; the message says where.
        UsageError: an override cannot be applied.
    """
    from amslicer.fields.source import Inputs
    from amslicer.yamlfile import read_yaml

    places: Places = {}
    if isinstance(fields, Mapping):
        name, folder, content = "job", Path.cwd(), deepcopy(dict(fields))
    else:
        file = Path(fields)
        name, folder = str(file), file.parent
        content, places = read_yaml(file, "job file")
    content.setdefault("printer", DEFAULT_PRINTER)
    for key, value in (overrides or {}).items():
        _override(content, key, value, folder, places)
    content["printer"] = _expand_printer(content["printer"], folder)
    spec = _validate(content, name, places)
    _refuse_unbuilt(spec, name)
    return Job(spec, Path(part), Inputs(folder), name)


def _override(content: dict[str, Any], key: str, value: Any, folder: Path, places: Places) -> None:
    *parents, last = key.split(".")
    node: Any = content
    for depth, parent in enumerate(parents):
        if parent == "printer" and depth == 0:
            content["printer"] = _expand_printer(content["printer"], folder)
        node = node.setdefault(parent, {}) if isinstance(node, dict) else None
        if not isinstance(node, dict):
            raise UsageError(
                f"--set {key}: '{'.'.join(parents[: depth + 1])}' is {node!r}, which has no key '{last}'"
                if not isinstance(node, dict) and node is not None
                else f"--set {key}: there is no such key",
                hint=f"set the whole of it: --set '{parents[0]}=…'",
            )
    if parents == ["printer"]:
        for pair in (("dpi", "pitch_um"), ("layer_mm", "layer_um")):
            if last in pair:  # the other way to say the same thing
                for other in pair:
                    node.pop(other, None)
    node[last] = value
    for place in [p for p in places if p[: len(parents) + 1] == (*parents, last)]:
        del places[place]


def _expand_printer(printer: Any, folder: Path) -> Any:
    from amslicer.printers import read_printer

    return read_printer(printer, folder) if isinstance(printer, str) else printer


def _validate(content: dict[str, Any], name: str, places: Places) -> JobFile:
    from pydantic import ValidationError

    from amslicer.specification import JobFile

    try:
        return JobFile.model_validate(content)
    except ValidationError as error:
        raise _explain(error, content, name, places) from None


def _explain(error: ValidationError, content: dict[str, Any], name: str, places: Places) -> JobError:
    """The first thing that is wrong, as a sentence with key, value, line and column."""
    from amslicer.specification import key_paths

    errors = error.errors(include_url=False)
    first = errors[0]
    path = _real_path(first["loc"], content)
    key = ".".join(map(str, path)) or "the job file"
    found: Any = content
    for step in path:
        found = _child(found, step)
    at = next((places[path[:n]] for n in range(len(path), 0, -1) if path[:n] in places), None)
    where = f"{name}, line {at[0]}, column {at[1]}" if at else name
    hint = f"{len(errors) - 1} more problems after this one" if len(errors) > 1 else None
    if first["type"] == "extra_forbidden":
        problem = f"unknown key '{key}'"
        hint = _nearest_key(str(path[-1]), key_paths()) or hint
    elif first["type"] == "missing":
        problem = f"the key '{'.'.join(map(str, first['loc']))}' is missing"
        hint = "`amslicer init` writes an example with every key"
    else:
        text = first["msg"].removeprefix("Value error, ")
        text = text[0].lower() + text[1:]
        problem = f"{key}: {_shown(found)} {text}" if first["type"] == "field_source" else f"{key}: {text}"
        if first["type"] != "value_error" and first["type"] != "field_source":
            problem += f", but it is {_shown(found)}"
        hint = _planned_hint(found) or hint
    return JobError(f"{where}: {problem}", hint=hint)


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 80 else text[:77] + "…"


def _child(node: Any, step: str | int) -> Any:
    """What stands under a key or index, or None."""
    if isinstance(node, dict):
        return node.get(step)
    return node[step] if isinstance(node, list) and isinstance(step, int) and step < len(node) else None


def _real_path(loc: tuple[int | str, ...], content: Any) -> tuple[int | str, ...]:
    """The steps of a validation location that are keys of the content (it also names union members)."""
    path: list[int | str] = []
    node = content
    for step in loc:
        if (isinstance(node, dict) and step in node) or (isinstance(node, list) and isinstance(step, int)):
            path.append(step)
            node = _child(node, step)
    return tuple(path)


def _nearest_key(key: str, known: Mapping[str, str]) -> str | None:
    import difflib

    if key in known:
        return f"the key is {known[key]}"
    near = difflib.get_close_matches(key, list(known), n=1)
    return f"did you mean {known[near[0]]}?" if near else None


def _planned_hint(value: Any) -> str | None:
    from amslicer.fields import PLANNED

    planned = [k for k in value if k in (*PLANNED, "vector")] if isinstance(value, dict) else []
    return f"{{{planned[0]}: …}} is not built yet in this version" if planned else None


def _refuse_unbuilt(spec: JobFile, name: str) -> None:
    """Keys of the language that this version accepts only at their defaults."""
    from amslicer.noise import NOISES
    from amslicer.profile import PROFILES
    from amslicer.specification import AzimuthElevation

    pattern, fields = spec.pattern, spec.fields
    refusals = (
        (pattern.noise not in NOISES, f"pattern.noise: '{pattern.noise}'", f"built: {', '.join(NOISES)}"),
        (
            pattern.profile not in PROFILES,
            f"pattern.profile: '{pattern.profile}'",
            f"built: {', '.join(PROFILES)}",
        ),
        (pattern.alignment != 0, f"pattern.alignment: {pattern.alignment}", "leave it at 0"),
        (not isinstance(pattern.period, float), "pattern.period: a painted field", "give a number of mm"),
        (fields.isotropy != 0, "fields.isotropy: other than 0", "leave it out"),
        (len(spec.materials) > 2, f"materials: {len(spec.materials)} of them", "give two"),
    )
    for refused, what, hint in refusals:
        if refused:
            raise JobError(f"{name}: {what} is not built yet in this version", hint=hint)
    if isinstance(pattern.period, float) and pattern.period <= 0:
        raise JobError(f"{name}: pattern.period: must be greater than 0 mm, but it is {pattern.period}")
    if isinstance(fields.orientation, AzimuthElevation) and pattern.dimensions == 2:
        raise JobError(
            f"{name}: fields.orientation: has an elevation, but pattern.dimensions is 2: the same in every layer",
            hint="set pattern.dimensions to 3, or give orientation as one angle",
        )
    if isinstance(fields.ratio, float) and not 0 <= fields.ratio <= 1:
        raise JobError(f"{name}: fields.ratio: must be between 0 and 1, but it is {fields.ratio}")


def _find_sources(node: Any) -> Iterator[Source]:
    from pydantic import BaseModel

    from amslicer.fields.source import Source

    if isinstance(node, Source):
        yield node
    elif isinstance(node, BaseModel):
        for key in type(node).model_fields:
            yield from _find_sources(getattr(node, key))


def _dump(spec: JobFile, renamed: Mapping[str, str]) -> dict[str, Any]:
    content: dict[str, Any] = spec.model_dump(mode="json", by_alias=True, exclude_none=True)
    if renamed:
        _rename(content, renamed)
    return content


def _rename(node: Any, renamed: Mapping[str, str]) -> None:
    if isinstance(node, dict):
        for key, value in node.items():
            if key == "image" and value in renamed:
                node[key] = renamed[value]
            else:
                _rename(value, renamed)
    elif isinstance(node, list):
        for value in node:
            _rename(value, renamed)
