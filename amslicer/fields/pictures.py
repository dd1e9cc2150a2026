"""Reads grey pictures for what they show, or refuses them: never a texel that the file does not hold."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL import Image

FORMATS = ("PNG", "TIFF")
# Full scale of the grey modes that Pillow keeps without loss.
FULL_SCALE = {"1": 1, "L": 255, "I;16": 65535, "I;16L": 65535, "I;16B": 65535}
MAX_TEXELS = 100_000_000  # larger pictures are refused on their declared size, before decoding
CONVERT_HINT = (
    "convert it to a plain grey picture: magick IN -auto-orient -colorspace Gray -alpha off -interlace none "
    "-depth 16 OUT.png"
)
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# PNG chunks that change what the texels mean: transparency, turning (Exif), animation.
PNG_REFUSED = {b"tRNS": "transparent parts", b"eXIf": "an Exif orientation or other Exif data", b"acTL": "frames"}
# TIFF tags: a value other than these changes what the texels mean.
TIFF_EXPECTED = {274: ("Orientation", (1,)), 339: ("SampleFormat", (1, (1,))), 262: ("PhotometricInterpretation", (1,))}


def read_grey(content: bytes, name: str) -> tuple[NDArray[np.uint16], int]:
    """Decodes an 8 or 16-bit grey picture: (texels, top row first; full scale).

    Raises:
        JobError: not a readable plain grey PNG or TIFF, truncated, or too large.
    """
    from PIL import Image, UnidentifiedImageError

    if content.startswith(PNG_SIGNATURE):
        _check_png(content, name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what matters of a picture is checked, and refused, here
            picture = Image.open(io.BytesIO(content), formats=FORMATS)
            _check_size(*picture.size, name)
            _check_meaning(picture, name)
            picture.load()
            return np.asarray(picture).astype(np.uint16), FULL_SCALE[picture.mode]
    except UnidentifiedImageError:
        raise _refusal(name, f"is not a {' or '.join(FORMATS)} picture") from None
    except JobError:
        raise
    except Exception as error:  # Pillow raises many kinds for damaged files
        raise _refusal(name, f"cannot be read: {str(error).splitlines()[0]}") from error


def _check_size(width: int, height: int, name: str) -> None:
    if width * height > MAX_TEXELS:
        raise JobError(
            f"the picture '{name}' has {width} × {height} pixels; at most {MAX_TEXELS // 10**6} million are read",
            hint="make it smaller: fields are interpolated between pixels",
        )


def _check_meaning(picture: Image.Image, name: str) -> None:
    if picture.mode not in FULL_SCALE:
        raise _refusal(name, f"is not grey (mode {picture.mode})")
    if getattr(picture, "n_frames", 1) != 1:
        raise _refusal(name, f"has {getattr(picture, 'n_frames', 1)} frames; one is needed")
    for tag, (meaning, accepted) in TIFF_EXPECTED.items():
        value = getattr(picture, "tag_v2", {}).get(tag, accepted[0])
        eight_bit_inverted = tag == 262 and value == 0 and picture.mode in ("1", "L")  # Pillow turns these over
        if value not in accepted and not eight_bit_inverted:
            raise _refusal(name, f"has {meaning} {value}")


def _check_png(content: bytes, name: str) -> None:
    """Walks the chunks: Pillow shows rows that are not there as black, and passes over some that matter."""
    width = height = row_bytes = 0
    packed = []
    for kind, data in _chunks(content):
        if kind == b"IHDR" and len(data) == 13:
            width, height, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", data)
            _check_size(width, height, name)
            if interlaced:
                raise _refusal(name, "is interlaced")
            row_bytes = 1 + -(-width * bits // 8) if colour == 0 else 0
        elif kind in PNG_REFUSED:
            raise _refusal(name, f"has {PNG_REFUSED[kind]}")
        elif kind == b"IDAT":
            packed.append(data)
    if row_bytes:
        expected = row_bytes * height
        try:
            found = len(zlib.decompressobj().decompress(b"".join(packed), expected))
        except zlib.error as error:
            raise _refusal(name, f"is damaged: {error}") from None
        if found < expected:
            raise _refusal(name, f"is cut short: {found // row_bytes} of {height} rows are there")


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(PNG_SIGNATURE)
    while at + 8 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        yield kind, content[at + 8 : at + 8 + length]
        at += 12 + length


def _refusal(name: str, why: str) -> JobError:
    return JobError(f"the picture '{name}' {why}", hint=CONVERT_HINT)
