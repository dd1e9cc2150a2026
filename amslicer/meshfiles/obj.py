"""OBJ: the v and f lines, and the names of objects or groups."""

from __future__ import annotations

import codecs
import re
from typing import TYPE_CHECKING

import numpy as np

from amslicer.bodynames import unclosed_pieces
from amslicer.errors import PartError
from amslicer.meshfiles.soup import EXPORT, Soup, expect, joined, triangulated, with_names

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Ints = NDArray[np.int64]

_CONTINUATION = re.compile(rb"\\\r?\n")
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]+([^\r\n#]*)", re.MULTILINE)
_OBJECT, _GROUP = (re.compile(rb"^[ \t]*" + kind + rb"[ \t]+([^\r\n]*)", re.MULTILINE) for kind in (b"o", b"g"))
_COMMENT = re.compile(rb"(^|[ \t])#.*")  # behind a name, which may have a # within
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
    triangles, face_of = triangulated(faces)
    return _named(joined([(vertices, triangles)]), text, face_of)


def _named(soup: Soup, text: bytes, face_of: Ints) -> Soup:
    """The soup with the names of its objects; where none has a face, of its groups, if these are solids.

    Args:
        face_of: (T,) number of the face that each triangle is of.
    """
    faces_at = [match.start() for match in _FACE.finditer(text)]
    for kind in (_OBJECT, _GROUP):
        lines = list(kind.finditer(text))
        names = ["", *(_COMMENT.sub(b"", line[1]).decode(errors="replace") for line in lines)]
        above = np.searchsorted([line.start() for line in lines], faces_at)
        named = with_names(soup, names, above[face_of])
        if named.object_of is not None:
            # Groups are often no more than shading: parts of one solid's surface.
            shading = kind is _GROUP and unclosed_pieces(soup.vertices, soup.triangles, named.object_of).size
            return soup if shading else named
    return soup
