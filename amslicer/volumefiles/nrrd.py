"""NRRD files (nearly raw raster data): https://teem.sourceforge.net/nrrd/format.html."""

from __future__ import annotations

import re
import warnings
import zlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import JobError
from amslicer.volumefiles.volume import (
    UNITS_MM,
    Volume,
    check_data,
    check_shape,
    check_type,
    inflated,
    no_key,
    refusal,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.volumefiles.volume import Triple

    Floats = NDArray[np.float64]

MAX_HEADER_BYTES = 1 << 20  # headers with all of a scanner's notes are some 10 kB
END_OF_HEADER = re.compile(rb"\n\r?\n")
DETACHED = re.compile(rb"^data ?file:", re.MULTILINE | re.IGNORECASE)
GZIP = zlib.MAX_WBITS | 16  # zlib's word for a gzip stream
TYPES = {
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
    "i1": ("signed char", "int8", "int8_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "i8": ("longlong", "long long", "long long int", "signed long long", "signed long long int", "int64", "int64_t"),
    "f4": ("float",),
    "f8": ("double",),
}
DTYPES = {word: code for code, words in TYPES.items() for word in words}
SPACE = ("domain", "space")  # kinds of axes along which there are places
# NRRD orders a symmetric matrix row by row: xx xy xz yy yz zz. Ours is xx yy zz xy yz xz.
SYMMETRIC, FROM_ROWS = "3D-symmetric-matrix", (0, 3, 5, 1, 4, 2)
MASKED = "3D-masked-symmetric-matrix"
NO_UNIT = ("", "???", "none")  # what tools write of axes without one
STRAIGHT = 1e-6  # of the spacing: less is rounding in the text of a header, and moves no sample by a pixel


def read_nrrd(data: memoryview, name: str, key: str | None) -> Volume:
    """The array of an NRRD file: of a raw one a view, of gzip or text unpacked.

    Raises:
        JobError: not an NRRD file, or one that cannot be used.
    """
    no_key(key, name)
    if bytes(data[:4]) != b"NRRD":
        raise refusal(name, "is not a NRRD file, whatever its name says")
    header, start = _header(data, name)
    sizes = [int(size) for size in header["sizes"]]
    dtype = np.dtype(DTYPES.get(str(header["type"]), "V1"))
    check_type(dtype, name)
    dtype = dtype.newbyteorder(_byte_order(header, dtype, name))
    along, channel = _axes(header, len(sizes), name)
    places = [sizes[axis] for axis in along[::-1]]
    size = check_shape([*places, *([] if channel is None else [sizes[channel]])], dtype.itemsize, name)
    array = _samples(header, data[start:], dtype, size, name).reshape(sizes[::-1])
    # The file's axes are in reverse: the first one varies fastest.
    order = [len(sizes) - 1 - axis for axis in (*along[::-1], *([] if channel is None else [channel]))]
    array = array.transpose(order)
    kinds = header.get("kinds", [])
    if channel is not None:
        _check_frame(header, name)
        if len(kinds) == len(sizes) and kinds[channel] == MASKED:
            raise refusal(name, f"holds masked tensors ({MASKED})", "leave out the mask: save the six components")
        if len(kinds) == len(sizes) and kinds[channel] == SYMMETRIC and sizes[channel] == len(FROM_ROWS):
            array = array[..., FROM_ROWS]
    spacing, origin = _placing(header, along, name)
    if spacing is not None:  # an axis that runs backwards is turned over
        for i, step in enumerate(spacing):
            if step < 0:
                array = np.flip(array, 2 - i)
                if origin is not None:
                    origin[i] += step * (places[2 - i] - 1)
    centers = header.get("centerings", [])
    node = len(centers) == len(sizes) and all(centers[axis] == "node" for axis in along)
    return Volume(
        array,
        None if spacing is None else _triple(np.abs(spacing)),
        None if origin is None else _triple(origin),
        at_corners=node,
    )


def _header(data: memoryview, name: str) -> tuple[Mapping[str, Any], int]:
    """Fields, and where the samples begin."""
    head = data[:MAX_HEADER_BYTES]
    end = END_OF_HEADER.search(head)
    if DETACHED.search(head if end is None else head[: end.end()]):
        raise refusal(
            name,
            "is a header whose samples lie in another file, which is not read",
            "save both as one: unu save -f nrrd -i IN.nhdr -o OUT.nrrd",
        )
    if end is None:
        raise refusal(name, f"has no end of its header within {min(len(data), MAX_HEADER_BYTES)} bytes")
    try:
        import nrrd  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise JobError(
            f"the volume '{name}' is a NRRD file, and the package pynrrd is not installed",
            hint="pip install 'amslicer[fields]'",
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            header: Mapping[str, Any] = nrrd.read_header(bytes(data[: end.end()]).splitlines(keepends=True))
    except Exception as error:  # of many kinds for damaged headers
        raise refusal(name, f"has a damaged header: {type(error).__name__}: {str(error)[:200]}") from error
    missing = [field for field in ("dimension", "type", "encoding", "sizes") if field not in header]
    if missing:
        raise refusal(name, f"has a header without {' and '.join(missing)}")
    if header["dimension"] != len(header["sizes"]):
        raise refusal(name, f"declares {header['dimension']} axes and {len(header['sizes'])} sizes")
    return header, end.end()


def _byte_order(header: Mapping[str, Any], dtype: np.dtype[Any], name: str) -> Any:
    order = header.get("endian", "little" if dtype.itemsize == 1 or header["encoding"] != "raw" else None)
    if order not in ("little", "big"):
        raise refusal(name, f"does not say whether its samples are little or big endian (endian: {order})")
    return "<" if order == "little" else ">"


def _samples(header: Mapping[str, Any], data: memoryview, dtype: np.dtype[Any], size: int, name: str) -> NDArray[Any]:
    """(n,) samples in the order of the file."""
    skipped = [field for field in ("line skip", "lineskip", "byte skip", "byteskip") if header.get(field, 0) != 0]
    if skipped:
        hint = "save it again: unu save -f nrrd -i IN -o OUT.nrrd"
        raise refusal(name, f"has a {skipped[0]}, which is not read", hint)
    encoding = str(header["encoding"]).lower()
    if encoding == "raw":
        check_data(size, len(data), name, exact=True)
        return np.frombuffer(data, dtype, count=size // dtype.itemsize)
    if encoding in ("gzip", "gz"):
        return np.frombuffer(inflated(data, size, name, wbits=GZIP), dtype)
    if encoding in ("ascii", "text", "txt"):
        words = bytes(data).split()
        if len(words) != size // dtype.itemsize:
            raise refusal(name, f"declares {size // dtype.itemsize} samples and holds {len(words)}")
        try:
            exact = np.array(words, dtype) if dtype.kind == "f" else np.array([int(word) for word in words], dtype)
        except (ValueError, OverflowError) as error:
            raise refusal(name, f"holds a word that is no {dtype.name}: {error}") from None
        return exact
    raise refusal(
        name, f"has the encoding {encoding}; raw, gzip and text are read",
        "save it again: unu save -f nrrd -e gzip -i IN -o OUT.nrrd",
    )  # fmt: skip


def _axes(header: Mapping[str, Any], count: int, name: str) -> tuple[list[int], int | None]:
    """Which of the file's axes are x, y, z, and which one holds components."""
    axes = list(range(count))
    if count != 4:
        return axes, None
    kinds = header.get("kinds", [])
    directions = header.get("space directions")
    if len(kinds) == count and sum(kind in SPACE for kind in kinds) == 3:
        channel = next(axis for axis in axes if kinds[axis] not in SPACE)
    elif directions is not None and len(directions) == count:
        without = [axis for axis in axes if directions[axis] is None or np.isnan(directions[axis]).any()]
        if len(without) != 1:
            raise refusal(name, f"has four axes, and {len(without)} of them have no direction in space; one is needed")
        channel = without[0]
    else:
        channel = 0  # components vary fastest, as tools write them
    return [axis for axis in axes if axis != channel], channel


def _placing(header: Mapping[str, Any], along: Sequence[int], name: str) -> tuple[Floats | None, Floats | None]:
    """Steps along x, y, z (negative ones run backwards) and the place of the first sample, mm."""
    directions, found = header.get("space directions"), header.get("space origin")
    spacing: Floats | None = None
    if directions is not None:
        rows = [directions[axis] if axis < len(directions) else None for axis in along]
        if any(row is None or len(row) != 3 or not np.isfinite(row).all() for row in rows):
            raise refusal(name, "has space directions that are not three vectors of three numbers")
        matrix = np.array(rows, np.float64)
        spacing = np.diag(matrix).copy()
        off = np.abs(matrix - np.diag(spacing)).max(axis=1)
        if not (spacing != 0).all() or (off > STRAIGHT * np.abs(spacing)).any():
            raise refusal(
                name,
                f"lies askew: its space directions are {matrix.tolist()}, and only boxes along x, y, z are read",
                "resample it along the axes, or give placed: box and leave the directions out of the header",
            )
    elif "spacings" in header:
        steps = np.asarray(header["spacings"], np.float64)
        if len(steps) > max(along) and np.isfinite(steps[list(along)]).all() and (steps[list(along)] != 0).all():
            spacing = steps[list(along)]
    origin = None if found is None or spacing is None else np.array(found, np.float64)
    if origin is not None and (origin.shape != (3,) or not np.isfinite(origin).all()):
        raise refusal(name, f"has a space origin that is not three numbers: {found}")
    scale = _unit_mm(header, along, name)
    return None if spacing is None else spacing * scale, None if origin is None else origin * scale


def _unit_mm(header: Mapping[str, Any], along: Sequence[int], name: str) -> float:
    key, units = "space units", {unit for unit in header.get("space units", []) if unit}
    per_axis = header.get("units", [])
    if not units and len(per_axis) > max(along):
        key, units = "units", {per_axis[axis] for axis in along} - {None, *NO_UNIT}
    if not units:
        return 1.0
    if len(units) > 1 or next(iter(units)).lower() not in UNITS_MM:
        raise refusal(name, f"has the {key} {', '.join(sorted(units))}", "give one unit of length: mm")
    return UNITS_MM[units.pop().lower()]


def _check_frame(header: Mapping[str, Any], name: str) -> None:
    frame = header.get("measurement frame")
    if frame is not None and not np.allclose(np.asarray(frame, np.float64), np.eye(3), atol=STRAIGHT):
        raise refusal(
            name,
            f"measures its vectors in a frame that is turned ({np.asarray(frame).tolist()})",
            "turn the vectors into the axes of the part and leave out the measurement frame",
        )


def _triple(values: Floats) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
