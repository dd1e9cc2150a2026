"""From a job file's content to a validated specification, and from what is wrong with it to one sentence."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amslicer.errors import AmslicerError, JobError, UsageError

if TYPE_CHECKING:
    from pydantic import ValidationError

    from amslicer.specification import JobFile
    from amslicer.yamlfile import KeyPath, Places

DEFAULT_PRINTER = "generic-600dpi"
OVERRIDES = "overrides"  # what messages call values that did not come from the job file
# Keys and values of the job file's language that this version does not know at all.
UNBUILT_KEYS = (
    "center",
    "radius",
    "exemplar",
    "exemplar_pixel_mm",
    "isotropy_model",
    "edges",
    "lobes",
    "skin",
    "bodies",
)
UNBUILT_VALUES = ("grabcad", "gcvf", "sl1", "tiff", "zarr", "vti", "nrrd", "3mf", "svx", "xz", "yz")


@dataclass
class Origin:
    """Where a job's values came from.

    Attributes:
        name: the job file, for messages.
        folder: what its paths are relative to.
        places: line and column of its keys.
        overridden: keys that were set from outside.
    """

    name: str
    folder: Path
    places: Places = field(default_factory=dict)
    overridden: set[KeyPath] = field(default_factory=set)

    def error(self, path: KeyPath, problem: str, hint: str | None = None) -> AmslicerError:
        """The error for a key: the job file's fault with its place, or that of whoever overrode it."""
        written = path in self.places
        if any(path[: len(key)] == key or (key[: len(path)] == path and not written) for key in self.overridden):
            return UsageError(f"{OVERRIDES}: {problem}", hint=hint)
        place = next((self.places[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.places), None)
        where = f"{self.name}, line {place[0]}, column {place[1]}" if place else self.name
        return JobError(f"{where}: {problem}", hint=hint)


def validate(content: dict[str, Any], origin: Origin, overrides: Mapping[str, Any]) -> JobFile:
    """The specification that a job file's content and some overrides make.

    Args:
        content: the job file; it is changed.
        overrides: dotted keys and their values.

    Raises:
        JobError, UsageError: the first thing that is wrong, and whose fault it is.
    """
    from pydantic import ValidationError

    from amslicer.specification import JobFile

    content.setdefault("printer", DEFAULT_PRINTER)
    for key, value in overrides.items():
        _override(content, tuple(key.split(".")), value, origin)
    content["printer"] = _expand_printer(content["printer"], origin)
    try:
        spec = JobFile.model_validate(content)
    except ValidationError as error:
        raise _explain(error, content, origin) from None
    _refuse_unbuilt(spec, origin)
    _refuse_contradictions(spec, origin)
    return spec


def _override(content: dict[str, Any], path: tuple[str, ...], value: Any, origin: Origin) -> None:
    origin.overridden.add(path)
    *parents, last = path
    if parents[:1] == ["printer"]:
        content["printer"] = _expand_printer(content["printer"], origin)
    node: Any = content
    for depth, parent in enumerate(parents, 1):
        node = node.setdefault(parent, {})
        if not isinstance(node, dict):
            above = ".".join(parents[:depth])
            raise UsageError(
                f"{OVERRIDES}: {'.'.join(path)}: {above} is {_shown(node)}, which has no keys below it",
                hint=f"set the whole of it: {above}=…",
            )
    if parents == ["printer"]:
        from amslicer.specification import ALTERNATIVES

        for pair in ALTERNATIVES:
            if last in pair:  # setting one takes the other away
                for key in pair:
                    node.pop(key, None)
    node[last] = value


def _expand_printer(printer: Any, origin: Origin) -> Any:
    from amslicer.printers import read_printer

    if not isinstance(printer, str):
        return printer
    try:
        return read_printer(printer, origin.folder)
    except JobError as error:
        if ("printer",) in origin.overridden or ("printer",) not in origin.places:
            raise
        line, column = origin.places["printer",]
        raise JobError(f"{origin.name}, line {line}, column {column}: {error.message}", hint=error.hint) from error


def _explain(error: ValidationError, content: dict[str, Any], origin: Origin) -> AmslicerError:
    """The first thing that is wrong, as a sentence with key and value."""
    from amslicer.specification import key_paths

    errors = error.errors(include_url=False)
    # A misspelt key is also a missing one: say what was typed.
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    path = _real_path(first["loc"], content)
    key = ".".join(map(str, path)) or "the job file"
    found: Any = content
    for step in path:
        found = _child(found, step)
    more = len(errors) - 1
    hint = f"{more} more problem{'s' if more > 1 else ''} after this one" if more else None
    if first["type"] == "extra_forbidden":
        return origin.error(path, f"unknown key '{key}'", _nearest_key(str(path[-1]), key_paths()) or hint)
    if first["type"] == "missing":
        missing = ".".join(map(str, (*path, first["loc"][-1])))
        return origin.error(path, f"the key '{missing}' is missing", "`amslicer init` writes an example")
    text = first["msg"].removeprefix("Value error, ")
    text = text[0].lower() + text[1:]
    if first["type"] == "field_source":
        problem = f"{key}: {_shown(found)} {text}"
    elif first["type"] == "value_error":  # our own sentences have the value in them
        problem = f"{key}: {text}"
    else:
        problem = f"{key}: {text}, but it is {_shown(found)}"
    return origin.error(path, problem, _source_hint(found) or hint)


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 80 else text[:77] + "…"


def _child(node: Any, step: str | int) -> Any:
    """What stands under a key or index, or None."""
    if isinstance(node, dict):
        return node.get(step)
    return node[step] if isinstance(node, list) and isinstance(step, int) and step < len(node) else None


def _real_path(loc: tuple[int | str, ...], content: Any) -> KeyPath:
    """The steps of a validation location that are keys of the content (it also names union members)."""
    from amslicer.fields import SOURCES

    path: list[int | str] = []
    node, named = content, False
    for step in loc:
        # A field's location starts with the name of its source, which is one of its keys too.
        if step in SOURCES and isinstance(node, dict) and step in node and not named:
            named = True
        elif (isinstance(node, dict) and step in node) or (isinstance(node, list) and isinstance(step, int)):
            path.append(step)
            node, named = _child(node, step), False
    return tuple(path)


def _nearest_key(key: str, known: Mapping[str, str]) -> str | None:
    import difflib

    if key in known:
        return f"the key is {known[key]}"
    if key in UNBUILT_KEYS:
        return "not built yet in this version"
    near = difflib.get_close_matches(key, list(known), n=1)
    return f"did you mean {known[near[0]]}?" if near else None


def _source_hint(value: Any) -> str | None:
    """What was meant by a mapping that is no field."""
    import difflib

    from amslicer.fields import PLANNED, SOURCES

    if isinstance(value, str) and value in UNBUILT_VALUES:
        return "not built yet in this version"
    if not isinstance(value, dict):
        return None
    if "rest" in value.values():
        return "a ratio per material is not built yet in this version: give the share of the first"
    named = [key for key in value if key in SOURCES]
    if len(named) > 1:
        return f"give one of {' and '.join(named)}, not both"
    for key in value:
        if key in (*PLANNED, "vector"):
            return f"{{{key}: …}} is not built yet in this version"
        near = difflib.get_close_matches(key, [*SOURCES, *PLANNED, "azimuth", "elevation"], n=1)
        if near:
            return f"did you mean {near[0]}?"
    return None


def _refuse_unbuilt(spec: JobFile, origin: Origin) -> None:
    """Keys of the language that this version accepts only at their defaults."""
    from amslicer.noise import NOISES
    from amslicer.profile import PROFILES

    pattern, fields = spec.pattern, spec.fields
    numbers = isinstance(pattern.period, float), fields.isotropy == 0
    refusals: tuple[tuple[bool, KeyPath, str, str], ...] = (
        (pattern.noise not in NOISES, ("pattern", "noise"), f"'{pattern.noise}'", ", ".join(NOISES)),
        (pattern.profile not in PROFILES, ("pattern", "profile"), f"'{pattern.profile}'", ", ".join(PROFILES)),
        (pattern.alignment != 0, ("pattern", "alignment"), f"{pattern.alignment}", "0"),
        (not numbers[0], ("pattern", "period"), "a painted field", "a number of mm"),
        (not numbers[1], ("fields", "isotropy"), "anything but 0", "0"),
        (len(spec.materials) > 2, ("materials",), f"{len(spec.materials)} of them", "two"),
    )
    for refused, path, what, built in refusals:
        if refused:
            key = ".".join(map(str, path))
            raise origin.error(path, f"{key}: {what} is not built yet in this version", f"built: {built}")


def _refuse_contradictions(spec: JobFile, origin: Origin) -> None:
    """What no single key is to blame for."""
    from amslicer.specification import AzimuthElevation

    pattern, fields = spec.pattern, spec.fields
    if isinstance(pattern.period, float) and pattern.period <= 0:
        raise origin.error(
            ("pattern", "period"), f"pattern.period: must be greater than 0 mm, but it is {pattern.period}"
        )
    if isinstance(fields.ratio, float) and not 0 <= fields.ratio <= 1:
        raise origin.error(("fields", "ratio"), f"fields.ratio: must be between 0 and 1, but it is {fields.ratio}")
    if isinstance(fields.orientation, AzimuthElevation) and pattern.dimensions == 2:
        raise origin.error(
            ("fields", "orientation"),
            "fields.orientation: has an elevation, but pattern.dimensions is 2: the same in every layer",
            "set pattern.dimensions to 3, or give orientation as one angle",
        )
