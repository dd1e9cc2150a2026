"""What every field source offers: a validated specification, and a sampler opened over one part."""

from __future__ import annotations

import hashlib
import math
import mmap
import os
import stat
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, Literal, Protocol

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.orientation import Orientation
    from amslicer.grid import Grid
    from amslicer.mesh import Mesh
    from amslicer.placement import Placement

    Floats = NDArray[np.float64]

MAX_FILE_BYTES = 1 << 30
"""1024³ samples of one byte: more detail than a part has, still held in memory."""
SMALLEST_MAPPED = 64 << 20
"""Bytes; smaller files are read at once, so that nobody can change or cut them short while they are in use."""

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


def _has_width(ends: tuple[float, float]) -> tuple[float, float]:
    if not math.isfinite(ends[1] - ends[0]):
        raise ValueError(f"must be two numbers whose difference is one, too, but is {list(ends)}")
    return ends


Range = Annotated[tuple[Number, Number], AfterValidator(_has_width)]
"""Two values between which others lie: their difference does not overflow."""


MOST_PLACE_MM, LEAST_SIDE_MM = 1e9, 1e-6
"""No box is 1000 km away, and no side as short as a nanometre; such numbers differ by 1e-7 mm at least."""


def check_box(low: Sequence[float], high: Sequence[float]) -> None:
    """Whether a box in mm can be told from others.

    Raises:
        ValueError: it is too far away, or a side is too short.
    """
    if any(abs(place) > MOST_PLACE_MM for place in (*low, *high)):
        raise ValueError(f"must lie within ±{MOST_PLACE_MM:g} mm, but is {[*low, *high]}")
    if any(b - a < LEAST_SIDE_MM for a, b in zip(low, high, strict=True)):
        raise ValueError(f"must have sides of {LEAST_SIDE_MM:g} mm at least, but is {[*low, *high]}")


TINY_SHARE = 0.01
"""Of the part's size: a mesh or a volume that small is in another unit."""


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
class Part:
    """The part that fields are painted on, for sources that look at more than its box.

    Attributes:
        path: the mesh file.
        mesh: what it holds; its vertices are in the field frame.
    """

    path: Path
    mesh: Mesh


@dataclass(frozen=True)
class Frame:
    """The part's box in its file: what "stretched over the part" means.

    Attributes:
        minimum_mm: (3,) bounding box minimum in file coordinates, mm; of fields in bed coordinates, in the printer's.
        size_mm: (3,) bounding box size in the file's axes (or the printer's), mm.
        placement: where the part stands; None where only its box is known.
        load_part: reads the part, for sources that need more than its box.
        grid: the printer's pixels and layers; None where they are not known.
        body_priorities: of the part's bodies, by name, where they overlap; those that are not 0.
        bed: whether its coordinates are the printer's.
    """

    minimum_mm: Floats
    size_mm: Floats
    placement: Placement | None = None
    load_part: Callable[[], Part] | None = None
    grid: Grid | None = None
    body_priorities: Mapping[str, int] = field(default_factory=dict)
    bed: bool = False

    @property
    def coordinates(self) -> str:
        """What coordinates from minimum_mm on are, for messages."""
        return "printer coordinates" if self.bed else "file coordinates"

    def part(self, source: str) -> Part:
        """The part itself.

        Args:
            source: who asks, for the message.

        Raises:
            JobError: only the part's box is known.
        """
        if self.load_part is None:
            raise JobError(
                f"a field by {source} needs the part's mesh, and only its box is known here",
                hint="use it in a job with a part",
            )
        return self.load_part()

    def nearest(self, axis: int, position: Floats) -> Floats:
        """One coordinate (field frame) of the box's nearest points: beyond the box, fields stay as at its sides."""
        return np.clip(position, 0.0, self.size_mm[axis])


@dataclass(frozen=True)
class Mapped:
    """A file in the address space.

    Attributes:
        view: its bytes.
        state: inode, size and time of the last change, as the file was when it was mapped.
    """

    view: memoryview
    state: tuple[int, int, int]


@dataclass
class Inputs:
    """The files that a job's fields name, each read once.

    Attributes:
        folder: the job file's folder; paths are relative to it.
        files: what was read: path as written in the job file, to its bytes.
        allow_outside: whether paths may leave the folder.
        maps: large files that were mapped instead of read.
        digests: of the files for which `digest` was asked.
    """

    folder: Path
    files: dict[str, bytes] = field(default_factory=dict)
    allow_outside: bool = False
    maps: dict[str, Mapped] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)

    def digest(self, name: str, content: memoryview | None = None) -> str:
        """BLAKE2 of a field file's bytes, 64 hexadecimal digits: of large files three times as fast as SHA-256.

        Args:
            content: the bytes, if they are at hand.

        Raises:
            JobError: as map.
        """
        if name not in self.digests:
            self.digests[name] = hashlib.blake2b(
                self.map(name) if content is None else content, digest_size=32
            ).hexdigest()
        elif name in self.maps and self._changed_in_place(name):
            raise self._changed(name)
        return self.digests[name]

    def read(self, name: str) -> bytes:
        """The bytes of a field file.

        Raises:
            JobError: missing, outside the folder, not a regular file, or too large.
        """
        if name not in self.files:
            with self._opened(name) as stream:
                self.files[name] = stream.read(MAX_FILE_BYTES)
        return self.files[name]

    def map(self, name: str) -> memoryview:
        """The bytes of a field file, of a large one without reading more of it than is looked at; read-only.

        Raises:
            JobError: as read; or the file has changed since it was first asked for.
        """
        if name in self.files:
            return memoryview(self.files[name])
        with self._opened(name) as stream:
            found = os.fstat(stream.fileno())
            if name not in self.maps and found.st_size < SMALLEST_MAPPED:
                self.files[name] = stream.read(MAX_FILE_BYTES)
                return memoryview(self.files[name])
            state = (found.st_ino, found.st_size, found.st_mtime_ns)
            if name not in self.maps:
                view = memoryview(mmap.mmap(stream.fileno(), found.st_size, access=mmap.ACCESS_READ))
                self.maps[name] = Mapped(view, state)
        if self.maps[name].state != state:
            raise self._changed(name)
        return self.maps[name].view

    def _changed_in_place(self, name: str) -> bool:
        """Whether a mapped file was written to; one that another took the place of stays as it was mapped."""
        try:
            found = (self.folder / name).stat()
        except OSError:
            return False
        inode, *rest = self.maps[name].state
        return found.st_ino == inode and [found.st_size, found.st_mtime_ns] != rest

    @staticmethod
    def _changed(name: str) -> JobError:
        return JobError(
            f"the field file '{name}' changed while it was in use",
            hint="run again, and leave the file alone until the run has ended",
        )

    @contextmanager
    def _opened(self, name: str) -> Iterator[BinaryIO]:
        """A field file that may be read, open."""
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
                yield stream
        except (OSError, ValueError, RuntimeError) as error:  # also a zero byte, and a link to itself
            reason = getattr(error, "strerror", None) or error
            relative = f"paths are relative to the job file's folder ({self.folder})"
            raise JobError(
                f"the field file {name!r} cannot be read: {reason}",
                hint="download it first: only files are read" if "://" in name else relative,
            ) from error


class Source(BaseModel):
    """Base of the field sources' specifications, as written in the job file.

    A source of numbers has `open`, one of directions `open_orientation`; some have both. A number where a direction is
    asked for is its angle in degrees; a direction where a number is asked for is refused by `open`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    frame: Literal["part", "bed"] | None = Field(
        default=None,
        description="part (the default): follows the part when it is turned, scaled and moved; bed: the printer's axes",
    )

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The sampler over a part with this frame.

        Raises:
            JobError: a file cannot be used, or the source makes directions and no numbers.
        """
        raise NotImplementedError

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The directions over a part with this frame; of plain numbers, angles in degrees.

        Raises:
            JobError: a file cannot be used, or the numbers are means of samples.
        """
        from amslicer.fields.orientation import Angles

        self.check_angles("fields.orientation")
        return Angles(self.open(frame, inputs))

    @property
    def mixes_numbers(self) -> bool:
        """Whether its numbers are means of samples, which cannot be taken apart again: no angles are made of them."""
        return any(source.mixes_numbers for source in self.nested())

    def check_angles(self, key: str) -> None:
        """That its numbers may be angles.

        Args:
            key: of the angle in the job file, for the message.

        Raises:
            JobError: they are means of samples.
        """
        if self.mixes_numbers:
            mixer: Source = self
            while inner := next((source for source in mixer.nested() if source.mixes_numbers), None):
                mixer = inner
            name = next(field for field in type(mixer).model_fields if field != "frame")
            raise JobError(
                f"{key}: a field by {name} has means of its numbers between samples, and of the angles 1° and 179° "
                "that would be 90°",
                hint="give the angle as the whole orientation, {orientation: {" + name + ": …}}, which combines lines; "
                "or directions in space, by columns nx,ny,nz for instance",
            )

    @property
    def needs_part(self) -> bool:
        """Whether it looks at more of the part than its box."""
        return any(source.needs_part for source in self.nested())

    def nested(self) -> Iterator[Source]:
        """The sources that it is made of, directly."""
        for key in type(self).model_fields:
            yield from find_sources(getattr(self, key))

    def paths(self) -> tuple[str, ...]:
        """The files that the specification names, its parts' included."""
        return tuple(path for source in self.nested() for path in source.paths())

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its files at other paths."""
        return self.model_copy(
            update={key: rename_paths(getattr(self, key), renamed) for key in type(self).model_fields}
        )


def find_sources(node: Any) -> Iterator[Source]:
    """The outermost sources in a specification, or in a value of it."""
    if isinstance(node, Source):
        yield node
    elif isinstance(node, BaseModel):
        for key in type(node).model_fields:
            yield from find_sources(getattr(node, key))
    elif isinstance(node, dict | tuple):
        for child in node.values() if isinstance(node, dict) else node:
            yield from find_sources(child)


def rename_paths(node: Any, renamed: Mapping[str, str]) -> Any:
    """The same specification with its sources' files at other paths."""
    if isinstance(node, Source):
        return node.with_paths(renamed)
    if isinstance(node, BaseModel):
        return node.model_copy(
            update={key: rename_paths(getattr(node, key), renamed) for key in type(node).model_fields}
        )
    if isinstance(node, dict):
        return {key: rename_paths(child, renamed) for key, child in node.items()}
    if isinstance(node, tuple):
        return tuple(rename_paths(child, renamed) for child in node)
    return node


def blend(t: Floats, a: float, b: float) -> Floats:
    """a + t(b - a), exactly b where t is 1: how `range`, `from` and `to` map 0…1 to values. Never beyond either."""
    return np.where(t == 1, b, a + t * (b - a))


def one_tap(values: Floats, like: Floats) -> tuple[Floats, Floats]:
    """Samples and weights of a field that is a plain number at each point: one sample of weight 1."""
    samples = np.broadcast_to(values, like.shape)[None]
    return samples, np.ones(samples.shape)
