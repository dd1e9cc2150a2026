"""What is printed: a part, a validated job file and the field files that it names. `Run` says how, not what."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amslicer.errors import UsageError

if TYPE_CHECKING:
    import os

    from amslicer.fields.source import Inputs, Source
    from amslicer.specification import JobFile


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

    @property
    def printed(self) -> tuple[str, ...]:
        """Names of the materials that are deposited: all but the one that stands for nothing."""
        from amslicer.specification import VOID

        return tuple(name for name in self.materials if name != VOID)

    @property
    def needs_part(self) -> bool:
        """Whether what is asked of a pixel cannot be told from the part's box alone."""
        regions = self.spec.skin is not None or bool(self.spec.bodies) or self.printed != self.materials
        return regions or any(source.needs_part for source in self.sources())

    @property
    def part_copy(self) -> str | None:
        """Where the stack keeps the part's file, of jobs that cannot be verified without it."""
        from amslicer.stackfolder import input_names
        from amslicer.storage import INPUTS

        if not self.needs_part:
            return None
        taken, name = set(input_names(self).values()), self.part.name
        while f"{INPUTS}/{name}" in taken:
            name = f"part-{name}"
        return f"{INPUTS}/{name}"

    def sources(self) -> Iterator[Source]:
        """Every field of the job that is not a plain number."""
        from amslicer.fields.source import find_sources

        return find_sources(self.spec)

    def digest(self, part_sha256: str, device_label: str, version: str) -> str:
        """SHA-256 over everything that can change a byte of the stack.

        The job counts as it was written, names and colours included; where its field files lie and how the job is
        computed (threads, range of layers) do not.
        """
        renamed = {path: self.inputs.digest(path) for path in self.input_paths()}
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
        exemplar = () if self.spec.pattern.exemplar is None else (self.spec.pattern.exemplar,)
        return tuple(dict.fromkeys([*(path for source in self.sources() for path in source.paths()), *exemplar]))


def load_job(
    fields: str | os.PathLike[str] | Mapping[str, Any],
    part: str | os.PathLike[str],
    overrides: Mapping[str, Any] | None = None,
    *,
    allow_outside: bool = False,
) -> Job:
    """Reads and validates a job file.

    Args:
        fields: the job file's path, or its content as a mapping (paths are then relative to the current folder).
        part: the mesh file (stl obj ply off glb 3mf); it is read when the job runs.
        overrides: dotted keys of the job file and their values, e.g. {"pattern.period": 0.8}.
        allow_outside: read field files outside the job file's folder too.

    Raises:
        JobError: the file, a key or a value cannot be used; the message says where.
        UsageError: an override cannot be applied.
    """
    from amslicer.fields.source import Inputs
    from amslicer.jobfile import Origin, refuse_depth, validate
    from amslicer.yamlfile import read_yaml

    if isinstance(fields, Mapping):
        origin = Origin("job", Path.cwd())
        refuse_depth(fields, origin)
        content = deepcopy(dict(fields))
    else:
        file = Path(fields)
        content, places = read_yaml(file, "job file")
        origin = Origin(str(file), file.parent, places)
    spec = validate(content, origin, overrides or {})
    return Job(spec, Path(part), Inputs(origin.folder, allow_outside=allow_outside), origin.name)


def _dump(spec: JobFile, renamed: Mapping[str, str]) -> dict[str, Any]:
    from amslicer.fields.source import rename_paths

    content: dict[str, Any] = rename_paths(spec, renamed).model_dump(mode="json", by_alias=True, exclude_none=True)
    exemplar = spec.pattern.exemplar
    if exemplar is not None:
        content["pattern"]["exemplar"] = renamed.get(exemplar, exemplar)
    return content
