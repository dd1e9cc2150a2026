"""TIFF stacks: one page per z, row 0 the lowest y. Also those of OME and ImageJ, with their spacing."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from amslicer.errors import JobError
from amslicer.volumefiles.volume import (
    UNITS_MM,
    ViewStream,
    Volume,
    check_data,
    check_inflated,
    check_shape,
    check_type,
    no_key,
    refusal,
)
from amslicer.volumefiles.xmltree import read_xml

if TYPE_CHECKING:
    from typing import IO

    from numpy.typing import NDArray
    from tifffile import TiffPage

    from amslicer.volumefiles.volume import Triple

MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MAX_PAGES = 65_536  # pages are found one after another; a thinner volume than this is sampled too finely
# Compressions that lose nothing and never unpack to more than the declared size, or are checked to.
PLAIN, DEFLATE, PACKED = 1, (8, 32946), (5, 32773)
SAVE_TIFF = "save it again: tifffile.imwrite('OUT.tif', a, compression='zlib')"
RESOLUTION = (282, 283)  # tags of x and y: pixels per unit, as a fraction
# Tags that change what the samples mean, and the values that do not.
EXPECTED = {
    274: ("Orientation", (1,)),
    262: ("PhotometricInterpretation", (1, 2)),
    266: ("FillOrder", (1,)),
    32997: ("ImageDepth", (1,)),
}


def read_tiff(data: memoryview, name: str, key: str | None) -> Volume:
    """The pages of a TIFF file as one array; where they lie one after another without compression, a view.

    Raises:
        JobError: not a TIFF file, or one that cannot be used.
    """
    no_key(key, name)
    if bytes(data[:4]) not in MAGICS:
        raise refusal(name, "is not a TIFF file, whatever its name says")
    try:
        import tifffile
    except ImportError:
        raise JobError(
            f"the volume '{name}' is a TIFF file, and the package tifffile is not installed",
            hint="pip install 'amslicer[fields]'",
        ) from None
    try:
        # Not as OME: that would open other files that the description names.
        with (
            _unheard("tifffile"),
            tifffile.TiffFile(cast("IO[bytes]", ViewStream(data)), name=name, is_ome=False) as file,
        ):
            count = len(file.pages)
            if count > MAX_PAGES:
                raise refusal(name, f"has {count} pages; at most {MAX_PAGES} are read")
            pages = [cast("TiffPage", file.pages[i]) for i in range(count)]
            return _volume(pages, data, name)
    except JobError:
        raise
    except Exception as error:  # tifffile raises many kinds for damaged files
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise refusal(name, f"cannot be read: {reason}", SAVE_TIFF) from error


@contextmanager
def _unheard(logger: str) -> Iterator[None]:
    """Without a library's own lines beside our error."""

    def nothing(record: logging.LogRecord) -> bool:
        return False

    logging.getLogger(logger).addFilter(nothing)
    try:
        yield
    finally:
        logging.getLogger(logger).removeFilter(nothing)


def _volume(pages: Sequence[TiffPage], data: memoryview, name: str) -> Volume:
    first = pages[0]
    for number, page in enumerate(pages):
        _check_page(page, first, number, name)
    assert first.dtype is not None
    rows, columns = (first.shape[first.axes.index(axis)] for axis in "YX")
    samples = int(first.samplesperpixel)
    description = first.description
    text = description.lstrip()
    layout: tuple[int, ...] = (len(pages), 1)  # z and channels, channels varying fastest
    slow_channels, spacing, whole = False, None, None
    if text.startswith(("<?xml", "<OME")) and "<OME" in text:
        layout, slow_channels, spacing = _ome(text, name)
    elif text.startswith("ImageJ="):
        layout, spacing = _imagej(text, first)
    elif text.startswith('{"shape"'):
        whole = _shaped(text)
    if math.prod(layout) != len(pages):
        raise refusal(name, f"describes {math.prod(layout)} images and has {len(pages)} pages", SAVE_TIFF)
    if len(pages) == 1 and whole is None:
        check_shape((rows, columns), first.dtype.itemsize, name)
    if layout[1] > 1 and samples > 1:
        raise refusal(name, f"has {layout[1]} channels of {samples} samples each", SAVE_TIFF)
    channels = max(layout[1], samples)
    planes = (layout[0], rows, columns)
    shape = whole or (planes if channels == 1 else (*planes, channels))
    size = check_shape(shape, first.dtype.itemsize, name)
    stored = (len(pages), *first.shape)
    if math.prod(stored) != math.prod(shape):
        raise refusal(name, f"describes samples {shape} and holds {stored}", SAVE_TIFF)
    array = _samples(pages, data, stored, size, name)
    if whole is not None:
        return Volume(array.reshape(whole))
    if first.axes.startswith("S"):  # samples in planes of their own
        array = np.moveaxis(array, 1, -1)
    if layout[1] > 1:
        order = (layout[1], layout[0]) if slow_channels else layout
        array = np.moveaxis(array.reshape(*order, rows, columns), 0 if slow_channels else 1, -1)
    return Volume(array.reshape(shape), spacing)


def _check_page(page: TiffPage, first: TiffPage, number: int, name: str) -> None:
    for tag, (meaning, accepted) in EXPECTED.items():
        value = page.tags.valueof(tag, default=accepted[0])
        if value not in accepted:
            raise refusal(name, f"has {meaning} {value} in page {number}; {accepted[0]} is read", SAVE_TIFF)
    if page.dtype is None or page.bitspersample not in (8, 16, 32, 64):
        raise refusal(name, f"has samples of {page.bitspersample} bits in page {number}", SAVE_TIFF)
    check_type(page.dtype, name)
    if (page.shape, page.dtype, page.axes) != (first.shape, first.dtype, first.axes):
        raise refusal(
            name,
            f"has pages of several kinds: page 0 is {first.shape} {first.dtype}, "
            f"page {number} is {page.shape} {page.dtype}",
            "save the stack alone, without thumbnails or smaller copies",
        )
    if page.axes not in ("YX", "YXS", "SYX"):
        raise refusal(name, f"has pages of axes {page.axes}", SAVE_TIFF)
    if page.compression not in (PLAIN, *DEFLATE, *PACKED):
        raise refusal(name, f"is compressed by {getattr(page.compression, 'name', page.compression)}", SAVE_TIFF)


def _samples(
    pages: Sequence[TiffPage], data: memoryview, stored: tuple[int, ...], size: int, name: str
) -> NDArray[Any]:
    """(pages, …) of all pages."""
    ends = [a + n for page in pages for a, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
    check_data(max(ends, default=0), len(data), name)
    first = pages[0]
    segments = [segment for page in pages for segment in _segments(page, name)]
    if all(page.compression == PLAIN and page.predictor == 1 and not page.is_tiled for page in pages):
        assert first.dtype is not None
        dtype = np.dtype(f"{first.parent.byteorder}{first.dtype.char}")
        for _, length, needed in segments:  # some writers pad their strips
            check_data(needed, length, name)
        check_data(size, sum(needed for _, _, needed in segments), name, exact=True)
        if all(a + needed == b for (a, _, needed), (b, _, _) in pairwise(segments)):
            return np.frombuffer(data, dtype, size // dtype.itemsize, segments[0][0]).reshape(stored)
        return np.frombuffer(b"".join(data[a : a + needed] for a, _, needed in segments), dtype).reshape(stored)
    array = np.empty(stored, first.dtype)
    for page, target in zip(pages, array, strict=True):
        _check_segments(page, data, name)
        try:
            target[...] = page.asarray()
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
            method = getattr(page.compression, "name", page.compression)
            raise refusal(name, f"is compressed by {method}, which needs imagecodecs", SAVE_TIFF) from error
    return array


def _segments(page: TiffPage, name: str) -> list[tuple[int, int, int]]:
    """Offset, length and unpacked size of each strip or tile: tifffile shows those that are missing as 0."""
    assert page.dtype is not None
    count = math.prod(page.chunked)
    if len(page.dataoffsets) != count or not all(page.databytecounts):
        raise refusal(
            name, f"has {len(page.dataoffsets)} strips in a page of {count}, or empty ones", "copy it once more"
        )
    strip = page.chunks[0]  # rows, also where samples are in planes of their own
    row = math.prod(page.chunks[1:]) * page.dtype.itemsize
    sizes = [strip * row] * count
    if not page.is_tiled:  # the last strip is as high as is left
        heights = [min(strip, page.imagelength - done) for done in range(0, page.imagelength, strip)]
        sizes = [height * row for height in heights] * (count // len(heights))
    return list(zip(page.dataoffsets, page.databytecounts, sizes, strict=True))


def _check_segments(page: TiffPage, data: memoryview, name: str) -> None:
    """Whether each strip or tile unpacks to what it should."""
    for offset, length, size in _segments(page, name):
        if page.compression in DEFLATE:
            check_inflated(data[offset : offset + length], size, name)
        elif page.compression == PLAIN:
            check_data(size, length, name)


def _shaped(text: str) -> tuple[int, ...] | None:
    """The shape that tifffile notes, without axes of length 1 before the last three."""
    try:
        shape = [int(side) for side in json.loads(text)["shape"]]
    except (ValueError, KeyError, TypeError):
        return None
    while len(shape) > 3 and shape[0] == 1:
        del shape[0]
    if len(shape) > 3 and shape[-1] == 1:
        del shape[-1]
    return tuple(shape) if len(shape) >= 3 else None


def _ome(text: str, name: str) -> tuple[tuple[int, int], bool, Triple | None]:
    """z and channels, whether channels vary slower than z, and the spacing, of OME's description."""
    root = read_xml(text.encode(), name)
    pixels = [element for element in root.iter() if element.tag.rpartition("}")[2] == "Pixels"]
    if len(pixels) != 1:
        raise refusal(name, f"describes {len(pixels)} images in its OME-XML; one is read")
    a = pixels[0].attrib
    if int(a.get("SizeT", 1)) != 1:
        raise refusal(name, f"has {a['SizeT']} times; one is read", "save one of them")
    others = [e for e in pixels[0] if e.tag.rpartition("}")[2] == "Channel"]
    samples = max((int(e.get("SamplesPerPixel", 1)) for e in others), default=1)
    order = a.get("DimensionOrder", "XYZCT")
    steps = [
        float(a[f"PhysicalSize{axis}"]) * UNITS_MM.get(a.get(f"PhysicalSize{axis}Unit", "µm"), math.nan)
        for axis in "XYZ"
        if f"PhysicalSize{axis}" in a
    ]
    layout = int(a.get("SizeZ", 1)), max(1, int(a.get("SizeC", 1)) // samples)
    return layout, order.index("Z") < order.index("C"), _spacing(steps)


def _imagej(text: str, page: TiffPage) -> tuple[tuple[int, int], Triple | None]:
    """z and channels, and the spacing, of ImageJ's description."""
    values: Mapping[str, str] = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    channels = int(values.get("channels", 1))
    frames = int(values.get("frames", 1))
    slices = int(values.get("slices", 1))
    if slices == 1:  # ImageJ takes a stack for times as readily as for heights
        slices = frames if frames > 1 else int(values.get("images", 1)) // channels
        frames = 1
    unit = UNITS_MM.get(values.get("unit", "").strip().lower(), math.nan)
    pixels = [
        page.tags.get(number) for number in (282, 283)
    ]  # XResolution, YResolution: pixels per unit, as a fraction
    steps = [p.value[1] / p.value[0] * unit for p in pixels if p is not None and p.value[0]]
    if "spacing" in values:
        steps.append(abs(float(values["spacing"])) * unit)
    return (slices * frames, channels), _spacing(steps)


def _spacing(steps: Sequence[float]) -> Triple | None:
    """The spacing, where all three steps are known."""
    if len(steps) != 3 or not all(math.isfinite(step) and step > 0 for step in steps):
        return None
    return steps[0], steps[1], steps[2]
