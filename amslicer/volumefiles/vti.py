"""VTK's image data, XML format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html."""

from __future__ import annotations

import binascii
import math
import re
from base64 import b64decode
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

import numpy as np

from amslicer.volumefiles.volume import Volume, check_data, check_shape, check_type, choose_array, inflated, refusal
from amslicer.volumefiles.xmltree import MAX_XML_BYTES, read_xml

if TYPE_CHECKING:
    from numpy.typing import NDArray

TYPES = {
    "UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8", "Float32": "f4", "Float64": "f8",
    "Int8": "i1", "Int16": "i2", "Int32": "i4", "Int64": "i8",
}  # fmt: skip
HEADERS = {"UInt32": 4, "UInt64": 8}  # bytes of a number before samples
ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
ZLIB = "vtkZLibDataCompressor"
APPENDED = re.compile(rb"<AppendedData\b[^>]*>\s*_")
SAVE_VTI = "write it again with vtkXMLImageDataWriter: appended raw data, with zlib or without compression"
WHERE = ("PointData", "CellData")


@dataclass(frozen=True)
class _Encoded:
    """How a file holds its samples.

    Attributes:
        appended: all bytes after the _ of AppendedData; None where there is no such element.
        base64: whether those are text.
    """

    order: str
    header_bytes: int
    packed: bool
    appended: memoryview | None
    base64: bool


def read_vti(data: memoryview, name: str, key: str | None) -> Volume:
    """One of the arrays of a VTI file; of appended raw samples a view.

    Raises:
        JobError: not a VTI file, or one that cannot be used.
    """
    start = APPENDED.search(data)
    text = bytes(data[: min(len(data), MAX_XML_BYTES + 1) if start is None else start.end() - 1])
    if b"<" not in text[:64]:
        raise refusal(name, "is not a VTI file, whatever its name says")
    if start is not None:
        text += b"</AppendedData></VTKFile>"
    root = read_xml(text, name)
    if root.tag != "VTKFile" or root.get("type") != "ImageData":
        raise refusal(name, f"is not a VTI file: {root.tag} {root.get('type', '')}; ImageData is read", SAVE_VTI)
    image = root.find("ImageData")
    pieces = [] if image is None else image.findall("Piece")
    if image is None or len(pieces) != 1:
        raise refusal(name, f"has {len(pieces)} pieces; one is read", SAVE_VTI)
    encoded = _encoding(root, None if start is None else data[start.end() :], name)
    extent = _numbers(pieces[0], "Extent", "", 6, int, name)
    whole = _numbers(image, "WholeExtent", "", 6, int, name)
    if extent != whole or any(extent[2 * i] > extent[2 * i + 1] for i in range(3)):
        raise refusal(name, f"has a piece {extent} of the whole {whole}; all of it is needed in one piece", SAVE_VTI)
    if _numbers(image, "Direction", "1 0 0 0 1 0 0 0 1", 9, float, name) != [1, 0, 0, 0, 1, 0, 0, 0, 1]:
        raise refusal(
            name, f"lies askew: its Direction is {image.get('Direction')}", "resample it along the axes x, y, z"
        )
    spacing = _numbers(image, "Spacing", "1 1 1", 3, float, name)
    origin = _numbers(image, "Origin", "0 0 0", 3, float, name)
    if not all(step > 0 for step in spacing):
        raise refusal(name, f"has the Spacing {spacing}; three positive numbers are needed", SAVE_VTI)
    element, where = _choose(pieces[0], key, name)
    # A box that is flat along an axis has one layer of cells there.
    cells = where == "CellData"
    x, y, z = (max(1, extent[2 * i + 1] - extent[2 * i] + (0 if cells else 1)) for i in range(3))
    array = _array(element, (z, y, x), encoded, name)
    half = [0.5 if cells and extent[2 * i + 1] > extent[2 * i] else 0.0 for i in range(3)]
    first = [origin[i] + (extent[2 * i] + half[i]) * spacing[i] for i in range(3)]
    return Volume(array, (spacing[0], spacing[1], spacing[2]), (first[0], first[1], first[2]), at_corners=not cells)


def _encoding(root: Element, appended: memoryview | None, name: str) -> _Encoded:
    order, header, packer = (
        root.get("byte_order", "LittleEndian"),
        root.get("header_type", "UInt32"),
        root.get("compressor"),
    )
    if order not in ORDERS or header not in HEADERS:
        raise refusal(name, f"has byte_order {order} and header_type {header}", SAVE_VTI)
    if packer not in (None, "", ZLIB):
        raise refusal(name, f"is compressed by {packer}; {ZLIB} is read", SAVE_VTI)
    element = root.find("AppendedData")
    encoding = "raw" if element is None else element.get("encoding", "base64")
    if encoding not in ("raw", "base64"):
        raise refusal(name, f"has appended data of encoding {encoding}; raw and base64 are read", SAVE_VTI)
    return _Encoded(ORDERS[order], HEADERS[header], packer == ZLIB, appended, encoding == "base64")


def _numbers(element: Element, key: str, default: str, count: int, kind: Any, name: str) -> list[Any]:
    text = element.get(key, default)
    try:
        found = [kind(word) for word in text.split()]
    except (ValueError, OverflowError):
        found = []
    if len(found) != count or not all(math.isfinite(v) for v in found):
        raise refusal(name, f"has {key} '{text[:80]}'; {count} numbers are needed", SAVE_VTI)
    return found


def _choose(piece: Element, key: str | None, name: str) -> tuple[Element, str]:
    """The array's element, and whether it lies at points or in cells."""
    found = [
        (f"{where}/{array.get('Name', '')}", array, where)
        for where in WHERE
        for group in piece.findall(where)
        for array in group.findall("DataArray")
    ]
    short = [label.partition("/")[2] for label, _, _ in found]
    # Where the same name stands for points and for cells, it needs its place before it.
    labels = [name_ if short.count(name_) == 1 else label for name_, (label, _, _) in zip(short, found, strict=True)]
    if key is not None and key in (full := [label for label, _, _ in found]):
        labels = full
    _, element, where = found[labels.index(choose_array(labels, key, name))]
    return element, where


def _array(element: Element, sides: tuple[int, int, int], encoded: _Encoded, name: str) -> NDArray[Any]:
    code = TYPES.get(element.get("type", ""))
    if code is None:
        raise refusal(name, f"holds {element.get('type')}; UInt8 to UInt64, Float32 and Float64 are read", SAVE_VTI)
    dtype = np.dtype(encoded.order + code)
    check_type(dtype, name)
    (channels,) = _numbers(element, "NumberOfComponents", "1", 1, int, name)
    shape = sides if channels == 1 else (*sides, channels)
    size = check_shape(shape, dtype.itemsize, name)
    form = element.get("format", "ascii")
    if form == "ascii":
        return _ascii(element.text or "", dtype, size, name).reshape(shape)
    if form == "binary":
        content = _from_base64((element.text or "").strip().encode(), size, encoded, name)
    elif form == "appended":
        if encoded.appended is None:
            raise refusal(name, "has an array of appended data, and no appended data", SAVE_VTI)
        (offset,) = _numbers(element, "offset", "", 1, int, name)
        if not 0 <= offset < len(encoded.appended):
            raise refusal(name, f"has an array at offset {offset} of {len(encoded.appended)} appended bytes", SAVE_VTI)
        content = encoded.appended[offset:]
        if encoded.base64:
            content = _from_base64(bytes(content).partition(b"<")[0], size, encoded, name)
        else:
            content = _unpacked(content, _header(content, encoded, name), size, encoded, name)
    else:
        raise refusal(name, f"has an array of format {form}; ascii, binary and appended are read", SAVE_VTI)
    return np.frombuffer(content, dtype, size // dtype.itemsize).reshape(shape)


def _ascii(text: str, dtype: np.dtype[Any], size: int, name: str) -> NDArray[Any]:
    words = text.split()
    check_data(size // dtype.itemsize, len(words), name, exact=True)
    try:
        return np.array(words if dtype.kind == "f" else [int(word) for word in words], dtype.newbyteorder("="))
    except (ValueError, OverflowError) as error:
        raise refusal(name, f"holds a word that is no {dtype.name}: {error}") from None


def _header(content: memoryview | bytes, encoded: _Encoded, name: str) -> NDArray[Any]:
    """How many bytes the samples take; or of packed ones blocks, bytes of each, of a smaller last one, packed bytes."""
    number = np.dtype(f"{encoded.order}u{encoded.header_bytes}")
    check_data(number.itemsize, len(content), name)
    if not encoded.packed:
        return np.frombuffer(content, number, 1)
    blocks = int(np.frombuffer(content, number, 1)[0])
    check_data((3 + blocks) * number.itemsize, len(content), name)
    return np.frombuffer(content, number, 3 + blocks)


def _unpacked(
    content: memoryview | bytes, header: NDArray[Any], size: int, encoded: _Encoded, name: str
) -> memoryview | bytes:
    """The samples' bytes after their header."""
    body = memoryview(content)[header.nbytes :]
    if not encoded.packed:
        _check_declared(int(header[0]), size, name)
        check_data(size, len(body), name)
        return body[:size]
    count, full, last, *packed = (int(n) for n in header)
    sizes = [full] * count
    if count and last:
        sizes[-1] = last
    _check_declared(sum(sizes), size, name)
    check_data(sum(packed), len(body), name)
    out, at = [], 0
    for length, block in zip(packed, sizes, strict=True):
        out.append(inflated(body[at : at + length], block, name))
        at += length
    return b"".join(out)


def _check_declared(declared: int, size: int, name: str) -> None:
    if declared != size:
        raise refusal(name, f"declares {declared} bytes of samples, and its extent takes {size}", SAVE_VTI)


def _from_base64(text: bytes, size: int, encoded: _Encoded, name: str) -> memoryview | bytes:
    """The samples' bytes of text; a header before packed ones is encoded by itself."""
    text = b"".join(text.split())
    try:
        if not encoded.packed:
            # Of appended text only what this array takes: others follow.
            content = b64decode(text[: 4 * -(-(encoded.header_bytes + size) // 3)], validate=True)
            return _unpacked(content, _header(content, encoded, name), size, encoded, name)
        number = encoded.header_bytes
        start = b64decode(text[: 4 * -(-number // 3)], validate=True)
        check_data(number, len(start), name)
        blocks = int.from_bytes(start[:number], "little" if encoded.order == "<" else "big")
        end = 4 * -(-(3 + blocks) * number // 3)
        check_data(end, len(text), name)
        header = _header(b64decode(text[:end], validate=True), encoded, name)
        body = text[end : end + 4 * -(-int(sum(map(int, header[3:]))) // 3)]
        return _unpacked(header.tobytes() + b64decode(body, validate=True), header, size, encoded, name)
    except binascii.Error as error:
        raise refusal(name, f"holds damaged base64 text: {error}", SAVE_VTI) from None
