"""From a job file's content to a validated specification, and from what is wrong with it to one sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amslicer.errors import AmslicerError, JobError, UsageError

if TYPE_CHECKING:
    from pydantic import ValidationError

    from amslicer.specification import JobFile
    from amslicer.yamlfile import KeyPath, Places

DEFAULT_PRINTER = "generic-600dpi"
PWM = ("pwm", "symmetric")
LEAST_WAVE_BANDWIDTH = 0.05  # narrower lobes are finer than the table of their weights
LEAST_IN_SPACE = 150  # directions by example: about 20° apart
DIRECTIONS_SHARE = 0.45  # of the default number: with fewer, some places have no wave

MOST_NESTED = 8  # fields in fields: more cannot be read
BY_BODY = "per_body"  # a mapping by names of the user's

OVERRIDES = "overrides"  # what messages call values that did not come from the job file
# Keys and values of the job file's language that this version does not know at all.
UNBUILT_KEYS = ("isotropy_model",)


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
    refuse_depth(content, origin)
    content["printer"] = _expand_printer(content["printer"], origin)
    _take_printers_format(content)
    try:
        spec = JobFile.model_validate(content)
    except ValidationError as error:
        raise _explain(error, content, origin) from None
    _refuse_many_materials(spec, origin)
    _refuse_contradictions(spec, origin)
    _refuse_regions(spec, origin)
    return spec


def refuse_depth(content: Mapping[str, Any], origin: Origin) -> None:
    """Fields in fields in fields, before anything walks through them by recursion.

    Raises:
        JobError, UsageError: more than MOST_NESTED of them, or any mappings and lists nested deeper than a file's.
    """
    from amslicer.fields import SOURCES
    from amslicer.yamlfile import MAX_DEPTH

    waiting: list[tuple[Any, KeyPath, int]] = [(content, (), 0)]
    seen: set[tuple[int, int, int]] = set()  # what stands in several places is looked at once per depth
    while waiting:
        node, path, fields = waiting.pop()
        if not isinstance(node, Mapping | list | tuple):
            continue
        known = (id(node), len(path), fields)
        if known in seen:
            continue
        seen.add(known)
        is_field = isinstance(node, Mapping) and path[-1:] != (BY_BODY,) and not SOURCES.keys().isdisjoint(node)
        fields += is_field
        if fields > MOST_NESTED:
            key = ".".join(map(str, path))
            raise origin.error(
                path, f"{key if len(key) <= 80 else key[:79] + '…'}: fields are nested more than {MOST_NESTED} deep",
                "combine fewer fields, or paint the result as a picture",
            )  # fmt: skip
        if len(path) > MAX_DEPTH:
            raise origin.error(path[:2], f"nested deeper than {MAX_DEPTH} levels", "`amslicer init` writes an example")
        children = node.items() if isinstance(node, Mapping) else enumerate(node)
        waiting.extend((child, (*path, key), fields) for key, child in children)


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


def _take_printers_format(content: dict[str, Any]) -> None:
    """Writes the stack as the printer's software takes it, where the job does not say how and this version can."""
    from amslicer.writers import WRITERS

    printer, output = content["printer"], content.get("output", {})
    wanted = printer.get("format") if isinstance(printer, dict) else None
    if isinstance(wanted, str) and wanted in WRITERS and isinstance(output, dict):
        content["output"] = {"format": wanted, **output}


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
    text = first["msg"].removeprefix("Value error, ").replace("valid tuple", "list")
    text = text[0].lower() + text[1:]
    if first["type"] in ("field_source", "profile", "waveform", "spectrum"):
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
    from amslicer.noise.spectra import SHAPES as SPECTRA
    from amslicer.profiles import SHAPES

    path: list[int | str] = []
    node, named = content, False
    for step in loc:
        # The location of a field or a profile starts with the name of its kind, which is one of its keys too.
        if (
            (step in SOURCES or step in SHAPES or step in SPECTRA)
            and isinstance(node, dict)
            and step in node
            and not named
            and path[-1:] != [BY_BODY]  # whose keys are names of bodies
        ):
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

    from amslicer.fields import SOURCES
    from amslicer.specification import FORMAT_NAMES

    if isinstance(value, str) and value in FORMAT_NAMES:
        return "not built yet in this version"
    if not isinstance(value, dict):
        return None
    named = [key for key in value if key in SOURCES]
    if len(named) > 1:
        return f"give one of {' and '.join(named)}, not both"
    for key in value:
        near = difflib.get_close_matches(key, [*SOURCES, "azimuth", "elevation", "vector"], n=1)
        if near:
            return f"did you mean {near[0]}?"
    return None


def _refuse_many_materials(spec: JobFile, origin: Origin) -> None:
    """More materials than the printer has."""
    from amslicer.specification import VOID

    most = spec.printer.max_materials
    printed = [material for material in spec.materials if material.name != VOID]
    if most is not None and len(printed) > most:
        raise origin.error(
            ("materials",),
            f"materials: {len(printed)} of them, but {spec.printer.name or 'the printer'} prints at most {most}",
            "leave some out, or choose another printer (`amslicer printers` lists them)",
        )


def _refuse_regions(spec: JobFile, origin: Origin) -> None:
    """Skins and bodies of materials that the job does not have."""
    import difflib

    from amslicer.specification import VOID

    names = [material.name for material in spec.materials]
    asked: list[tuple[KeyPath, str]] = [(("skin", "material"), spec.skin.material)] if spec.skin else []
    asked += [
        (("bodies", name, "material"), body.material) for name, body in (spec.bodies or {}).items() if body.material
    ]
    for path, name in asked:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]}?" if near else f"the materials are {', '.join(names)}"
            if name == VOID:
                hint = f"list it among the materials, too: [{', '.join((*names, VOID))}]"
            raise origin.error(path, f"{'.'.join(map(str, path))}: there is no material '{name}'", hint)
    if spec.skin and spec.skin.material == VOID:
        raise origin.error(("skin", "material"), f"skin.material: a skin of {VOID} would print nothing", None)


def _refuse_contradictions(spec: JobFile, origin: Origin) -> None:
    """What no single key is to blame for."""
    from amslicer.noise import NOISES
    from amslicer.profiles import make_profile, profile_name
    from amslicer.specification import AzimuthElevation, VectorComponents

    pattern, fields = spec.pattern, spec.fields
    if pattern.noise.startswith("phacelle") and pattern.impulses is not None:
        raise origin.error(
            ("pattern", "impulses"),
            f"pattern.impulses: {pattern.impulses:g}, but {pattern.noise} noise has one splat in each of its cells",
            "leave it out",
        )
    kind = NOISES[pattern.noise]
    if pattern.lobes and "lobes" not in kind.keys and kind.made_of == "kernels":
        directed = kind.follows(pattern)
        has = "reads its direction at each pixel" if directed else "has no direction"
        raise origin.error(
            ("pattern", "lobes"),
            f"pattern.lobes: {len(pattern.lobes)} of them, but {pattern.noise} noise {has}",
            f"leave them out, or use noise: {'phacelle' if directed else 'gabor'}",
        )
    for i, lobe in enumerate(pattern.lobes):
        if pattern.dimensions == 2 and lobe.about != "z":
            raise origin.error(
                ("pattern", "lobes", i, "about"),
                f"pattern.lobes.{i}.about: {lobe.about}, but pattern.dimensions is 2: the same in every layer",
                "set pattern.dimensions to 3, or turn about z",
            )
    _refuse_keys_of_others(spec, origin)
    reads = kind.read_by(pattern)
    if reads != "phase":
        bare = reads == "power" or kind.made_of in ("planes", "textures")  # no wave is behind the value
        waveless = bare or (kind.made_of == "waves" and not kind.follows(pattern))
        needs: tuple[tuple[str, bool, Any, Any], ...] = (
            (
                "profile",
                make_profile(pattern.profile).arrows or (bare and profile_name(pattern.profile) not in PWM),
                profile_name(pattern.profile),
                "pwm",
            ),
            ("edges", waveless and pattern.edges != "sharp", pattern.edges, "sharp"),
            ("alignment", pattern.alignment > 0, pattern.alignment, 0),
        )
        for key, refused, value, default in needs:
            if refused:
                raise origin.error(
                    ("pattern", key),
                    f"pattern.{key}: {value} needs a phase, but {pattern.noise} noise is read by its "
                    f"{'values' if reads == 'value' else 'modulus'}",
                    f"use {key}: {default}, or noise: phasor",
                )
    if isinstance(pattern.period, float) and pattern.period <= 0:
        raise origin.error(
            ("pattern", "period"), f"pattern.period: must be greater than 0 mm, but it is {pattern.period}"
        )
    if isinstance(fields.isotropy, float) and not 0 <= fields.isotropy <= 1:
        raise origin.error(
            ("fields", "isotropy"), f"fields.isotropy: must be between 0 and 1, but it is {fields.isotropy}"
        )
    _refuse_ratios(spec, origin)
    if pattern.dimensions == 2 and isinstance(fields.orientation, AzimuthElevation):
        raise origin.error(
            ("fields", "orientation"),
            "fields.orientation: has an elevation, but pattern.dimensions is 2: the same in every layer",
            "set pattern.dimensions to 3, or give orientation as one angle",
        )
    if pattern.dimensions == 2 and isinstance(fields.orientation, VectorComponents) and fields.orientation.vector[2]:
        raise origin.error(
            ("fields", "orientation", "vector"),
            "fields.orientation.vector: has a z component, but pattern.dimensions is 2: the same in every layer",
            "set pattern.dimensions to 3, or the third component to 0",
        )
    for path, plane, reads in _upright_pictures(fields.orientation, ("fields", "orientation")):
        if pattern.dimensions == 2:
            raise origin.error(
                path,
                f"{'.'.join(map(str, path))}: directions of reads: {reads} in the plane {plane} leave the layer, but "
                "pattern.dimensions is 2: the same in every layer",
                "set pattern.dimensions to 3, or paint the directions as seen from above",
            )


def _upright_pictures(node: Any, path: KeyPath) -> Iterator[tuple[KeyPath, str, str]]:
    """Where pictures of directions stand in an upright plane: the key, its plane and what is read."""
    from pydantic import BaseModel

    from amslicer.fields.image import NUMBERS, PictureSource

    if isinstance(node, PictureSource):
        if node.plane != "xy" and node.reads not in NUMBERS:
            yield (*path, "plane"), node.plane, str(node.reads)
    elif isinstance(node, BaseModel):
        for key, info in type(node).model_fields.items():
            yield from _upright_pictures(getattr(node, key), (*path, info.alias or key))
    elif isinstance(node, dict | tuple):
        for step, child in node.items() if isinstance(node, dict) else enumerate(node):
            yield from _upright_pictures(child, (*path, step))


def _refuse_keys_of_others(spec: JobFile, origin: Origin) -> None:
    """Keys that mean something to other noises only."""
    from amslicer.noise import NOISES
    from amslicer.noise.spectra import Waveform, make_spectrum
    from amslicer.specification import Pattern

    pattern, keys = spec.pattern, NOISES[spec.pattern.noise].keys
    for key in sorted(frozenset().union(*(kind.keys for kind in NOISES.values())) - keys):
        value, default = getattr(pattern, key), Pattern.model_fields[key].default
        if value != default:
            others = [name for name, kind in NOISES.items() if key in kind.keys]
            shown = _shown(pattern.model_dump(mode="json", by_alias=True)[key])
            raise origin.error(
                ("pattern", key),
                f"pattern.{key}: {shown} means nothing to {pattern.noise} noise",
                f"leave it out; it belongs to {', '.join(others)}",
            )
    _refuse_directions(spec, origin)
    if pattern.edges == "dithered" and pattern.spectrum != "laminate":
        raise origin.error(
            ("pattern", "edges"), "pattern.edges: dithered follows a laminate's waves, and these have another spectrum",
            "use edges: sharp",
        )  # fmt: skip
    if "exemplar" in keys and pattern.exemplar is None:
        raise origin.error(
            ("pattern", "exemplar"),
            f"pattern.exemplar: {pattern.noise} noise imitates a picture, and none is named",
            "exemplar: grain.png, a plain grey or RGB picture of the texture beside the job file",
        )
    if isinstance(make_spectrum(pattern.spectrum), Waveform) and pattern.reads not in (None, "real"):
        raise origin.error(
            ("pattern", "reads"),
            f"pattern.reads: {pattern.reads}, but waves of {pattern.spectrum} are real: they have a value alone",
            "leave it out",
        )


def _refuse_directions(spec: JobFile, origin: Origin) -> None:
    """Too few directions for a lobe, too narrow a lobe, too many families of walls."""
    from amslicer.noise import NOISES
    from amslicer.noise.hyperplanes import FAMILIES_PER_LEVEL
    from amslicer.noise.waves import default_directions

    pattern = spec.pattern
    kind, count = NOISES[pattern.noise], pattern.directions
    if kind.made_of == "planes" and (count or 0) > FAMILIES_PER_LEVEL:
        raise origin.error(
            ("pattern", "directions"),
            f"pattern.directions: {count}, but {pattern.noise} has at most {FAMILIES_PER_LEVEL} families of walls",
            "3 to 5 show as directions, more make needles",
        )
    if "planes" in kind.keys and pattern.dimensions == 3 and count is not None and count < LEAST_IN_SPACE:
        raise origin.error(
            ("pattern", "directions"),
            f"pattern.directions: {count} are too few: in space {pattern.noise} needs {LEAST_IN_SPACE} or more, a "
            "fifth of which lie near a plane",
            "leave it out",
        )
    if kind.made_of != "waves" or not kind.follows(pattern):
        return
    if pattern.bandwidth < LEAST_WAVE_BANDWIDTH:
        raise origin.error(
            ("pattern", "bandwidth"),
            f"pattern.bandwidth: {pattern.bandwidth:g}, but wave noise has {LEAST_WAVE_BANDWIDTH:g} or more",
            "use noise: phasor for narrower bands",
        )
    least = math.ceil(default_directions(pattern.bandwidth, pattern.dimensions) * DIRECTIONS_SHARE)
    if count is not None and count < least:
        raise origin.error(
            ("pattern", "directions"),
            f"pattern.directions: {count} are too few: at bandwidth {pattern.bandwidth:g} a laminate needs {least} or "
            "more, for some normals lie between two",
            f"leave it out, which makes {default_directions(pattern.bandwidth, pattern.dimensions)}",
        )


def _refuse_ratios(spec: JobFile, origin: Origin) -> None:
    """Whether each material has exactly one share."""
    import difflib

    from amslicer.fields.materialmap import MaterialMap
    from amslicer.specification import REST, shares_by_material

    painted, names = spec.fields.ratio, [material.name for material in spec.materials]
    path: KeyPath = ("fields", "ratio")
    if isinstance(painted, MaterialMap):
        try:
            painted.colors_of([(material.name, material.color) for material in spec.materials])
        except JobError as error:
            raise origin.error((*path, "colors"), f"fields.ratio: {error.message}", error.hint) from None
        return
    ratio = shares_by_material(painted, names)
    if ratio is None:
        raise origin.error(
            path,
            f"fields.ratio: is one field, but there are {len(names)} materials",
            f"give a ratio per material: {{{', '.join(f'{name}: …' for name in names[:-1])}, {names[-1]}: {REST}}}",
        )
    for name in ratio:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]}?" if near else f"the materials are {', '.join(names)}"
            raise origin.error((*path, name), f"fields.ratio: there is no material '{name}'", hint)
    missing = [name for name in names if name not in ratio]
    if missing:
        raise origin.error(
            path, f"fields.ratio: has no ratio for '{missing[0]}'", f"give it one, or {missing[0]}: {REST}"
        )
    takers = [name for name in ratio if ratio[name] == REST]
    if len(takers) > 1:
        raise origin.error(
            (*path, takers[1]), f"fields.ratio: {' and '.join(takers)} are both {REST}; one can be", None
        )
    for name, share in ratio.items():
        if isinstance(share, float) and not 0 <= share <= 1:
            key = f"fields.ratio.{name}" if isinstance(painted, dict) else "fields.ratio"
            raise origin.error((*path, name), f"{key}: must be between 0 and 1, but it is {share}")
