"""STL, binary and text."""

from __future__ import annotations

import re

from amslicer.meshfiles.soup import Soup, expect, joined, load_raw

_HEADER, _TRIANGLE = 84, 50  # bytes: 80 of text and the count; 12 floats and 2 bytes
_FACET = re.compile(rb"^[ \t]*facet\b", re.IGNORECASE | re.MULTILINE)


def read_stl(data: bytes) -> Soup:
    """Every solid of an STL file; binary if its size fits its count, whatever the header's text says.

    Raises:
        PartError: the file's size or its triangles do not match what it declares.
    """
    declared = int.from_bytes(data[_HEADER - 4 : _HEADER], "little")
    size = _HEADER + declared * _TRIANGLE
    if len(data) != size:
        if data.lstrip()[:5].lower() != b"solid" or b"\0" in data:
            expect(size, len(data), f"bytes (binary STL of {declared} triangles)")
        declared = len(_FACET.findall(data))
    loaded = load_raw(data, "stl")
    solids = loaded["geometry"].values() if "geometry" in loaded else [loaded]
    soup = joined((solid["vertices"], solid["faces"]) for solid in solids)
    expect(declared, len(soup.triangles), "STL triangles")
    return soup
