"""What a volume file holds, and what the readers of all types refuse in the same words."""

from __future__ import annotations

import errno
import io
import math
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import JobError
from amslicer.fields.source import MAX_FILE_BYTES

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer
    from numpy.typing import NDArray

    Triple = tuple[float, float, float]

MAX_CHANNELS = 9  # components of a full tensor; more is a fourth axis that this program has no meaning for
MOST_LISTED = 20  # names in a message
CHUNK_BYTES = 1 << 24  # decoded at a time where the result is only counted
# Millimetres in the units of length that files name.
UNITS_MM = {
    "mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4, "inches": 25.4,
    "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "\\u00b5m": 1e-3, "micron": 1e-3, "microns": 1e-3, "micrometer": 1e-3,
    "nm": 1e-6,
}  # fmt: skip
SAVE = "save it as a plain array: numpy.save('OUT.npy', a) with axes z, y, x"


@dataclass(frozen=True, eq=False)
class Volume:
    """Samples of a box, axes z, y, x, all ascending.

    Attributes:
        array: (z, y, x) or (z, y, x, C), in the file's own number type; often a view of the file.
        spacing_mm: between samples along x, y, z, > 0; None where the file does not say.
        origin_mm: x, y, z of the first sample, file coordinates; None where the file does not say.
        at_corners: whether the outermost samples lie on the sides of the box, not half a voxel within.
    """

    array: NDArray[Any]
    spacing_mm: Triple | None = None
    origin_mm: Triple | None = None
    at_corners: bool = False

    @property
    def channels(self) -> int | None:
        """C; None of plain numbers."""
        return None if self.array.ndim == 3 else int(self.array.shape[3])

    @property
    def full_scale(self) -> float:
        """What `range` counts as 1: the largest integer of the type, 1 of floats and of bool."""
        return float(np.iinfo(self.array.dtype).max) if self.array.dtype.kind == "u" else 1.0


def refusal(name: str, why: str, hint: str = SAVE) -> JobError:
    """The error of a volume file that cannot be used."""
    return JobError(f"the volume '{name}' {why}", hint=hint)


def check_type(dtype: np.dtype[Any], name: str) -> None:
    """Numbers that mean something on a scale, and no others.

    Raises:
        JobError: they do not.
    """
    if dtype.hasobject:
        raise refusal(name, "holds Python objects (a pickle), which are never read: they could run any program")
    if dtype.fields is not None or dtype.subdtype is not None:
        hint = "save one field: numpy.save(OUT, a['NAME'])"
        raise refusal(name, f"holds records ({_short(dtype)}), not numbers", hint)
    if dtype.kind == "i":
        raise refusal(
            name,
            f"holds signed integers ({dtype.name}), whose full scale has no zero at its start",
            "convert it to floats, which are taken as they are: numpy.save(OUT, a.astype('f4')), or to unsigned ones",
        )
    if dtype.kind not in "ufb" or dtype.itemsize > 8:
        raise refusal(name, f"holds {_short(dtype)}; unsigned integers, floats of 16 to 64 bits and bool are read")


def check_shape(shape: Sequence[int], itemsize: int, name: str, more: str = "") -> int:
    """Bytes that an array of this shape takes.

    Raises:
        JobError: not (z, y, x) or (z, y, x, C), no samples, or too many to hold.
    """
    text = " × ".join(map(str, shape))
    if len(shape) not in (3, 4) or (len(shape) == 4 and shape[3] > MAX_CHANNELS):
        hint = "give three axes z, y, x, and a fourth, last one for the components of vectors (3) or tensors (6)"
        if len(shape) == 4 and shape[0] <= MAX_CHANNELS:
            hint = "the components come last: numpy.save(OUT, numpy.moveaxis(a, 0, -1))"
        if len(shape) == 2:
            hint = "a field of one picture is written {image: …}"
        raise refusal(name, f"has {len(shape)} axes ({text}){more}; three are needed", hint)
    if any(side < 1 for side in shape):
        raise refusal(name, f"has no samples ({text})")
    size = math.prod(int(side) for side in shape) * itemsize
    if size > MAX_FILE_BYTES:
        raise refusal(
            name,
            f"declares {text} samples, {size} bytes; at most {MAX_FILE_BYTES} are read",
            "make it smaller: fields are interpolated between samples",
        )
    return size


def check_data(size: int, found: int, name: str, *, exact: bool = False) -> None:
    """Whether the samples declared are there.

    Raises:
        JobError: fewer bytes than declared, or more where all belong to the array.
    """
    if found < size:
        raise refusal(name, f"is cut short: its samples take {size} bytes and {found} are there", "copy it once more")
    if exact and found > size:
        raise refusal(name, f"has {found - size} bytes more than its header declares ({size})", "save it once more")


def choose_array(names: Sequence[str], key: str | None, name: str) -> str:
    """Which of the arrays in a file is meant.

    Raises:
        JobError: there is none, there are several and no key, or none has this name.
    """
    listed = ", ".join(names[:MOST_LISTED]) + (", …" if len(names) > MOST_LISTED else "")
    if not names:
        raise refusal(name, "holds no array")
    hint = f"choose one of them, for example key: {names[0]}"
    if key is None and len(names) > 1:
        raise refusal(name, f"holds {len(names)} arrays: {listed}", hint)
    if key is not None and key not in names:
        raise refusal(name, f"has no array '{key}'; it holds {listed}", hint)
    return names[0] if key is None else key


def no_key(key: str | None, name: str) -> None:
    """Refuses a key where a file holds one array without a name.

    Raises:
        JobError: there is a key.
    """
    if key is not None:
        raise refusal(name, f"holds one array without a name, and key is '{key}'", "leave out key")


def inflated(data: memoryview, size: int, name: str, *, wbits: int = zlib.MAX_WBITS) -> bytes:
    """Exactly so many bytes of a zlib (or, by wbits, gzip) stream; never more is unpacked.

    Raises:
        JobError: damaged, cut short, or more or fewer bytes than declared.
    """
    out = b"".join(_inflate(data, size, name, wbits))
    check_data(size, len(out), name, exact=True)
    return out


def check_inflated(data: memoryview, size: int, name: str) -> None:
    """As `inflated`, for who unpacks it by other means.

    Raises:
        JobError: as inflated.
    """
    check_data(size, sum(map(len, _inflate(data, size, name, zlib.MAX_WBITS))), name, exact=True)


def _inflate(data: memoryview, size: int, name: str, wbits: int) -> Iterator[bytes]:
    """At most one byte more than asked for, in chunks."""
    left, feed = size + 1, iter(_pieces(data))
    unpacker, packed = zlib.decompressobj(wbits), b""
    while left > 0:
        if not packed:
            packed = bytes(next(feed, b""))
        try:
            chunk = unpacker.decompress(packed, min(left, CHUNK_BYTES))
        except zlib.error as error:
            raise refusal(name, f"is damaged: {error}", "copy it once more") from None
        if unpacker.eof and wbits > zlib.MAX_WBITS and unpacker.unused_data.lstrip(b"\0"):  # another gzip member
            packed, unpacker = unpacker.unused_data, zlib.decompressobj(wbits)
        elif unpacker.eof:
            yield chunk
            return
        else:
            ended = not packed and not chunk
            packed = unpacker.unconsumed_tail
            if ended:
                raise refusal(name, "is cut short: its compressed samples end too early", "copy it once more")
        left -= len(chunk)
        yield chunk


def _pieces(data: memoryview) -> Iterable[memoryview]:
    return (data[at : at + CHUNK_BYTES] for at in range(0, len(data), CHUNK_BYTES))


class ViewStream(io.RawIOBase):
    """A view as a file to read from, without copying it."""

    def __init__(self, view: memoryview) -> None:
        super().__init__()
        self.view, self.at = view, 0

    def readable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is."""
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        """Fills a buffer from here on; returns how many bytes there were."""
        target = memoryview(buffer).cast("B")
        count = max(0, min(len(target), len(self.view) - self.at))
        target[:count] = self.view[self.at : self.at + count]
        self.at += count
        return count

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """Goes elsewhere; returns where."""
        at = offset + (0, self.at, len(self.view))[whence]
        if at < 0:
            raise OSError(errno.EINVAL, f"seek to {at}")
        self.at = at
        return at

    def tell(self) -> int:
        """Where it is."""
        return self.at


def _short(dtype: np.dtype[Any]) -> str:
    """A type's name, of a record with hundreds of fields its beginning."""
    text = str(dtype)
    return text if len(text) <= 60 else text[:60] + "…"
