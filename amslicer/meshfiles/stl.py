"""STL, binary and text."""

from __future__ import annotations

import re

import numpy as np

from amslicer.meshfiles.soup import Soup, expect, joined, load_raw

# A binary file: 80 bytes of text and the count; per triangle a normal, three corners and two bytes that mean nothing.
_COUNT = slice(80, 84)
_HEADER = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_FACET = re.compile(rb"^[ \t]*facet\b", re.IGNORECASE | re.MULTILINE)


def read_stl(data: bytes) -> Soup:
    """Every solid of an STL file; binary if its size fits its count, whatever the header's text says.

    Raises:
        PartError: the file's size or its triangles do not match what it declares.
    """
    declared = int.from_bytes(data[_COUNT], "little")
    size = _HEADER + declared * _TRIANGLE.itemsize
    if len(data) == size:
        # Here rather than by trimesh, whose import takes as long as a small job.
        corners = np.frombuffer(data, _TRIANGLE, offset=_HEADER)["corners"].reshape(-1, 3)
        return Soup(corners.astype(np.float64), np.arange(len(corners)).reshape(-1, 3))
    if data.lstrip()[:5].lower() != b"solid" or b"\0" in data:
        expect(size, len(data), f"bytes (binary STL of {declared} triangles)")
    loaded = load_raw(data, "stl")
    solids = loaded["geometry"].values() if "geometry" in loaded else [loaded]
    soup = joined((solid["vertices"], solid["faces"]) for solid in solids)
    expect(len(_FACET.findall(data)), len(soup.triangles), "STL triangles")
    return soup
