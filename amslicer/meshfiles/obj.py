"""OBJ: the v and f lines, and the names of objects or groups."""

from __future__ import annotations

import codecs
import re
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import PartError
from amslicer.meshfiles.soup import EXPORT, Soup, expect, joined, with_names

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Ints = NDArray[np.int64]

_CONTINUATION = re.compile(rb"\\\r?\n")
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]+([^\r\n#]*)", re.MULTILINE)
_NAMES = [re.compile(rb"^[ \t]*" + kind + rb"[ \t]+([^\r\n#]*)", re.MULTILINE) for kind in (b"o", b"g")]
_TEXTURE_AND_NORMAL = re.compile(rb"/\S*")  # of a corner 1/2/3


def read_obj(data: bytes) -> Soup:
    """All faces of an OBJ file; not by trimesh, which takes index 0 as 1 and -1 as the file's last vertex.

    Raises:
        PartError: a number cannot be read, a face has fewer than 3 corners or uses a vertex that is not there.
    """
    text = _CONTINUATION.sub(b" ", data.removeprefix(codecs.BOM_UTF8))
    points = _VERTEX.findall(text)
    values = np.fromstring(b" ".join(points).decode(), sep=" ")
    expect(3 * len(points), len(values), "OBJ coordinates")
    vertices = values.reshape(-1, 3)
    lines = [_TEXTURE_AND_NORMAL.sub(b"", line) for line in _FACE.findall(text)]
    if not lines:
        return joined([(vertices, [])])
    sizes = np.array([len(line.split()) for line in lines])
    if sizes.min() < 3:
        raise PartError(f"face {int(sizes.argmin())} has {int(sizes.min())} corners", hint=EXPORT)
    given = np.fromstring(b" ".join(lines).decode(), sep=" ", dtype=np.int64)
    expect(int(sizes.sum()), len(given), "OBJ indices")
    if (given == 0).any():
        raise PartError("a face uses vertex 0, but OBJ counts from 1", hint=EXPORT)
    if (given < 0).any():  # -1 is the last vertex above the face
        vertices_at, faces_at = ([match.start() for match in kind.finditer(text)] for kind in (_VERTEX, _FACE))
        above = np.repeat(np.searchsorted(vertices_at, faces_at), sizes)
        given = np.where(given < 0, given + above + 1, given)
    equal = (sizes == sizes[0]).all()
    faces = (given - 1).reshape(len(sizes), -1) if equal else np.split(given - 1, np.cumsum(sizes)[:-1])
    return _named(joined([(vertices, faces)]), text, sizes)


def _named(soup: Soup, text: bytes, sizes: Ints) -> Soup:
    """The soup with the names of its objects; of its groups where there is no object.

    Args:
        sizes: (F,) corners of each face: two more than its triangles.
    """
    lines = next((found for kind in _NAMES if (found := list(kind.finditer(text)))), [])
    if not lines:
        return soup
    faces_at = [match.start() for match in _FACE.finditer(text)]
    ends = np.searchsorted(faces_at, [line.start() for line in lines])  # of the faces above each name
    triangles = np.diff(np.concatenate([[0], np.cumsum(sizes - 2)])[np.concatenate([[0], ends, [len(sizes)]])])
    return with_names(soup, ["", *(line[1].decode(errors="replace") for line in lines)], triangles)
