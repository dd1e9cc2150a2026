"""What every field source offers: a validated specification, and a sampler opened over one part."""

from __future__ import annotations

import stat
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MAX_FILE_BYTES = 1 << 30
"""1024³ samples of one byte: more detail than a part has, still held in memory."""

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class Sampler(Protocol):
    """A scalar field over the part, in the field frame (mm, relative to the file's bounding box minimum).

    Attributes:
        varies: whether the value depends on x, y, z.
        bounds: no value is below the first or above the second.
        texels: identity of the sample grid behind `taps`; two samplers with equal texels can be combined
            texel by texel. None where there is no grid.
    """

    @property
    def varies(self) -> tuple[bool, bool, bool]: ...

    @property
    def bounds(self) -> tuple[float, float]: ...

    @property
    def texels(self) -> Hashable | None: ...

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points; the coordinates broadcast, and so may the answer."""

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The samples behind each value and their weights, both (K, N), for (N,) coordinates.

        Directions cannot be averaged as numbers (89° and -89° are 2° apart): whoever reads angles combines
        these as lines.
        """


@dataclass(frozen=True)
class Frame:
    """The part's box in its file: what "stretched over the part" means.

    Attributes:
        minimum_mm: (3,) bounding box minimum in file coordinates, mm.
        size_mm: (3,) bounding box size in the file's axes, mm.
    """

    minimum_mm: Floats
    size_mm: Floats

    def nearest(self, axis: int, position: Floats) -> Floats:
        """One coordinate (field frame) of the box's nearest points: beyond the box, fields stay as at its sides."""
        return np.clip(position, 0.0, self.size_mm[axis])


@dataclass
class Inputs:
    """The files that a job's fields name, each read once.

    Attributes:
        folder: the job file's folder; paths are relative to it.
        files: what was read: path as written in the job file, to its bytes.
        allow_outside: whether paths may leave the folder.
    """

    folder: Path
    files: dict[str, bytes] = field(default_factory=dict)
    allow_outside: bool = False

    def read(self, name: str) -> bytes:
        """The bytes of a field file.

        Raises:
            JobError: missing, outside the folder, not a regular file, or too large.
        """
        if name not in self.files:
            try:
                path = (self.folder / name).resolve()
                if not self.allow_outside and not path.is_relative_to(self.folder.resolve()):
                    raise JobError(
                        f"the field file '{name}' lies outside the job file's folder ({self.folder})",
                        hint="put it beside the job file or in a folder below it, or add --allow-outside",
                    )
                found = path.stat()
                if not stat.S_ISREG(found.st_mode):
                    raise JobError(
                        f"the field file '{name}' is not a regular file ({path})",
                        hint="name a file: folders, devices and pipes are not read",
                    )
                if found.st_size > MAX_FILE_BYTES:
                    raise JobError(
                        f"the field file '{name}' has {found.st_size} bytes; at most {MAX_FILE_BYTES} are read",
                        hint="make it smaller: fields are interpolated between samples",
                    )
                with path.open("rb") as stream:
                    self.files[name] = stream.read(MAX_FILE_BYTES)
            except (OSError, ValueError, RuntimeError) as error:  # also a zero byte, and a link to itself
                reason = getattr(error, "strerror", None) or error
                relative = f"paths are relative to the job file's folder ({self.folder})"
                raise JobError(
                    f"the field file {name!r} cannot be read: {reason}",
                    hint="download it first: only files are read" if "://" in name else relative,
                ) from error
        return self.files[name]


class Source(BaseModel):
    """Base of the field sources' specifications, as written in the job file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The sampler over a part with this frame."""
        raise NotImplementedError

    def paths(self) -> tuple[str, ...]:
        """The files that the specification names."""
        return ()

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its files at other paths."""
        return self


def blend(t: Floats, a: float, b: float) -> Floats:
    """a + t(b - a), exactly b where t is 1: how `range`, `from` and `to` map 0…1 to values. Never beyond either."""
    return np.where(t == 1, b, a + t * (b - a))


def one_tap(values: Floats, like: Floats) -> tuple[Floats, Floats]:
    """Samples and weights of a field that is a plain number at each point: one sample of weight 1."""
    samples = np.broadcast_to(values, like.shape)[None]
    return samples, np.ones(samples.shape)
