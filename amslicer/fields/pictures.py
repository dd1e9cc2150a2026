"""Reads pictures for what they show, or refuses them: never a texel that the file does not hold."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL import Image

    Texels = NDArray[np.uint8 | np.uint16]

FORMATS = ("PNG", "TIFF")
# Full scale of the modes that Pillow keeps without loss; of RGB those of 8 bits, which is checked.
FULL_SCALE = {"1": 1, "L": 255, "I;16": 65535, "I;16L": 65535, "I;16B": 65535, "RGB": 255}
MAX_BYTE = 255
MAX_TEXELS = 100_000_000  # larger pictures are refused on their declared size, before decoding
AT_A_TIME = 1 << 20  # bytes unpacked, to count them
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# PNG chunks that change what the texels mean: transparency, turning (Exif), animation.
PNG_REFUSED = {b"tRNS": "transparent parts", b"eXIf": "an Exif orientation or other Exif data", b"acTL": "frames"}
PNG_GREY, PNG_RGB = 0, 2  # kinds of colour; the others are refused by their mode
# TIFF tags: a value other than these changes what the texels mean.
TIFF_EXPECTED = {274: ("Orientation", (1,)), 339: ("SampleFormat", (1, (1,))), 262: ("PhotometricInterpretation", (1,))}
# Of colours also what Pillow would cut to 8 bits, or leave out.
TIFF_EXPECTED_RGB = {
    274: ("Orientation", (1,)), 339: ("SampleFormat", (1, (1, 1, 1))), 262: ("PhotometricInterpretation", (2,)),
    258: ("BitsPerSample", ((8, 8, 8),)),
}  # fmt: skip


@dataclass(frozen=True)
class Wanted:
    """Which pictures a reader takes, and what it says of others.

    Attributes:
        kind: in words: "is not" goes before it.
        modes: Pillow's, keys of FULL_SCALE.
        most: pixels; larger pictures are refused on their declared size, before decoding.
        why_less: why fewer pixels do.
        convert: how to make one from any picture.
    """

    kind: str
    modes: tuple[str, ...]
    most: int
    why_less: str
    convert: str


GREY = Wanted(
    kind="grey",
    modes=("1", "L", "I;16", "I;16L", "I;16B"),
    most=MAX_TEXELS,
    why_less="fields are interpolated between pixels",
    convert="convert it to a plain grey picture: magick IN -auto-orient -colorspace Gray -alpha off -interlace none "
    "-depth 16 OUT.png",
)


RGB = replace(
    GREY,
    kind="RGB",
    modes=("RGB",),
    convert="convert it to a plain RGB picture: magick IN -auto-orient -colorspace sRGB -type TrueColor -alpha off "
    "-interlace none -depth 8 OUT.png",
)


def read_grey(content: bytes, name: str) -> tuple[Texels, int]:
    """Decodes an 8 or 16-bit grey picture: (texels, top row first; full scale).

    Raises:
        JobError: not a readable plain grey PNG or TIFF, truncated, or too large.
    """
    return read_picture(content, name, GREY)


def read_picture(content: bytes, name: str, wanted: Wanted) -> tuple[Texels, int]:
    """Decodes a picture: (texels, top row first, (rows, columns) or of RGB (rows, columns, 3); full scale).

    Texels are of 8 bits where the full scale fits in them: large pictures take no more memory than they must.

    Raises:
        JobError: not a readable plain PNG or TIFF of a wanted kind, truncated, or too large.
    """
    from PIL import Image, UnidentifiedImageError

    if content.startswith(PNG_SIGNATURE):
        _check_png(content, name, wanted)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what matters of a picture is checked, and refused, here
            picture = Image.open(io.BytesIO(content), formats=FORMATS)
            _check_size(*picture.size, name, wanted)
            _check_meaning(picture, name, wanted)
            picture.load()
            full_scale = FULL_SCALE[picture.mode]
            kind = np.uint8 if full_scale <= MAX_BYTE else np.uint16
            return np.asarray(picture).astype(kind, copy=False), full_scale
    except UnidentifiedImageError:
        raise _refusal(name, f"is not a {' or '.join(FORMATS)} picture", wanted) from None
    except JobError:
        raise
    except Exception as error:  # Pillow raises many kinds for damaged files
        raise _refusal(name, f"cannot be read: {str(error).splitlines()[0]}", wanted) from error


def _check_size(width: int, height: int, name: str, wanted: Wanted) -> None:
    if width * height > wanted.most:
        raise JobError(
            f"the picture '{name}' has {width} × {height} pixels; at most {wanted.most // 10**6} million are read",
            hint=f"make it smaller: {wanted.why_less}",
        )


def _check_meaning(picture: Image.Image, name: str, wanted: Wanted) -> None:
    if picture.mode not in wanted.modes:
        raise _refusal(name, f"is not {wanted.kind} (mode {picture.mode})", wanted)
    if getattr(picture, "n_frames", 1) != 1:
        raise _refusal(name, f"has {getattr(picture, 'n_frames', 1)} frames; one is needed", wanted)
    for tag, (meaning, accepted) in (TIFF_EXPECTED_RGB if picture.mode == "RGB" else TIFF_EXPECTED).items():
        value = getattr(picture, "tag_v2", {}).get(tag, accepted[0])
        eight_bit_inverted = tag == 262 and value == 0 and picture.mode in ("1", "L")  # Pillow turns these over
        if value not in accepted and not eight_bit_inverted:
            raise _refusal(name, f"has {meaning} {value}", wanted)


def _check_png(content: bytes, name: str, wanted: Wanted) -> None:
    """Walks the chunks: Pillow shows rows that are not there as black, and passes over some that matter."""
    width = height = row_bytes = 0
    packed = []
    for kind, data in _chunks(content):
        if kind == b"IHDR" and len(data) == 13:
            width, height, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", data)
            _check_size(width, height, name, wanted)
            if interlaced:
                raise _refusal(name, "is interlaced", wanted)
            in_colour = colour == PNG_RGB and "RGB" in wanted.modes
            if in_colour and bits != 8:  # Pillow would cut them
                raise _refusal(name, f"has {bits} bits per colour; 8 are read", wanted)
            samples = 3 if in_colour else int(colour == PNG_GREY)
            row_bytes = 1 + -(-width * bits * samples // 8) if samples else 0
        elif kind in PNG_REFUSED:
            raise _refusal(name, f"has {PNG_REFUSED[kind]}", wanted)
        elif kind == b"IDAT":
            packed.append(data)
    if row_bytes:
        expected = row_bytes * height
        try:
            found = _unpacked(packed, expected)
        except zlib.error as error:
            raise _refusal(name, f"is damaged: {error}", wanted) from None
        if found < expected:
            raise _refusal(name, f"is cut short: {found // row_bytes} of {height} rows are there", wanted)


def _unpacked(packed: list[bytes], most: int) -> int:
    """How many bytes these unpack to, counted up to a number of them."""
    stream, found = zlib.decompressobj(), 0
    for data in packed:
        rest = data
        while rest and found < most:
            found += len(stream.decompress(rest, min(AT_A_TIME, most - found)))
            rest = stream.unconsumed_tail
    return found


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(PNG_SIGNATURE)
    while at + 8 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        yield kind, content[at + 8 : at + 8 + length]
        at += 12 + length


def _refusal(name: str, why: str, wanted: Wanted) -> JobError:
    return JobError(f"the picture '{name}' {why}", hint=wanted.convert)
