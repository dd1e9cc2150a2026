"""What is painted on the vertices of a mesh file: colours, named values and texture coordinates.

The readers of shapes leave all of this out, so the file is read again, by a reader of its own here; that both found the
same mesh is checked. Integers are shares of their type's largest value, floats as they are.
"""

from __future__ import annotations

import codecs
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import AmslicerError, JobError
from amslicer.meshfiles.obj import _CONTINUATION, _FACE, _TEXTURE_AND_NORMAL, _VERTEX
from amslicer.meshfiles.soup import joined, load_raw

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from amslicer.fields.source import Part

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

COLOURS = ("red", "green", "blue", "alpha")
SAME = 1e-6  # of the part's size: how far two readings of a file may differ; float32's rounding
UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))  # of a PLY file's vertices
EXPORT = "export it as PLY, OBJ, GLB or 3MF with its colours or values per vertex"


@dataclass(frozen=True, eq=False)
class Paint:
    """A mesh with values at its vertices; a vertex with different values in two triangles is there twice.

    Attributes:
        vertices: (V, 3) in the file's unit; once made to fit a part, mm in the field frame.
        triangles: (T, 3).
        values: by name, (V,).
        uv: (T, 3, 2) texture coordinates of the triangles' corners.
        turns: whether the file turns (not only moves and scales) what it paints.
    """

    vertices: Floats
    triangles: Ints
    values: dict[str, Floats] = field(default_factory=dict)
    uv: Floats | None = None
    turns: bool = False


def read_paint(part: Part) -> Paint:
    """What is painted on a part, its triangles outward and its vertices in the field frame.

    Raises:
        JobError: its file holds no values, cannot be read again, or holds another mesh than the part's.
    """
    mesh = part.mesh
    suffix = part.path.suffix.lower().removeprefix(".")
    reader = _readers().get(suffix)
    if reader is None:
        raise JobError(f"{mesh.file}: {suffix} files hold no values at vertices", hint=EXPORT)
    try:
        data = part.path.read_bytes()
        if hashlib.sha256(data).hexdigest() != mesh.sha256:
            raise JobError(f"{mesh.file} changed while it was read", hint="run again")
        paint = reader(data)
    except AmslicerError as error:
        raise JobError(f"{mesh.file}: {error.message}", hint=error.hint) from error
    except Exception as error:  # whatever a reader trips over in a damaged file
        raise JobError(
            f"{mesh.file}: what is painted on it cannot be read ({type(error).__name__}: {error})", hint=EXPORT
        ) from error
    vertices = paint.vertices * mesh.unit_mm - mesh.minimum_mm
    used = vertices[paint.triangles].reshape(-1, 3)
    tolerance = SAME * float(max(mesh.size_mm.max(), np.abs(mesh.minimum_mm).max()))
    fits = len(paint.triangles) == len(mesh.triangles) and bool(
        np.abs(used.min(axis=0)).max() <= tolerance and np.abs(used.max(axis=0) - mesh.size_mm).max() <= tolerance
    )
    if not fits:
        low, high = (np.round(end(used, axis=0) + mesh.minimum_mm, 4).tolist() for end in (np.min, np.max))
        raise JobError(
            f"{mesh.file}: the painted mesh has {len(paint.triangles)} triangles from {low} to {high} mm, the part "
            f"{len(mesh.triangles)} within {mesh.size_mm.round(4).tolist()} mm of {mesh.minimum_mm.round(4).tolist()}",
            hint="export it again, as PLY for instance",
        )
    triangles = np.ascontiguousarray(paint.triangles[:, ::-1]) if mesh.turned else paint.triangles
    uv = paint.uv[:, ::-1] if mesh.turned and paint.uv is not None else paint.uv
    return Paint(vertices, triangles, paint.values, uv, paint.turns)


def _readers() -> dict[str, Callable[[bytes], Paint]]:
    from amslicer.meshfiles.painted_3mf import read_painted_3mf
    from amslicer.meshfiles.painted_glb import read_painted_glb

    return {"ply": read_painted_ply, "obj": read_painted_obj, "glb": read_painted_glb, "3mf": read_painted_3mf}


def shares(values: NDArray[Any]) -> Floats:
    """Integers as shares of their type's largest value, floats as they are."""
    exact = values.astype(np.float64)
    return exact / np.iinfo(values.dtype).max if np.issubdtype(values.dtype, np.integer) else exact


def read_painted_ply(data: bytes) -> Paint:
    """The scalar properties of a PLY file's vertices."""
    loaded = load_raw(data, "ply")
    columns = loaded["metadata"]["_ply_raw"]["vertex"]["data"]
    names = columns.dtype.names if isinstance(columns, np.ndarray) else tuple(columns)
    values = {
        name: shares(np.asarray(columns[name]).reshape(-1))
        for name in names
        if name not in ("x", "y", "z") and np.asarray(columns[name]).dtype.kind in "iuf"
    }
    soup = joined([(loaded["vertices"], loaded["faces"])])
    wrong = [name for name, column in values.items() if len(column) != len(soup.vertices)]
    if wrong:
        raise JobError(
            f"{len(soup.vertices)} vertices, but {len(values[wrong[0]])} values of '{wrong[0]}'",
            hint="export it without texture coordinates per face",
        )
    pair = next((pair for pair in UV_NAMES if set(pair) <= set(values)), None)
    uv = None if pair is None else np.stack([values[name][soup.triangles] for name in pair], axis=-1)
    return Paint(soup.vertices, soup.triangles, values, uv)


def read_painted_obj(data: bytes) -> Paint:
    """Colours behind the coordinates (v x y z r g b), and the vt of the faces' corners."""
    import re

    text = _CONTINUATION.sub(b" ", data.removeprefix(codecs.BOM_UTF8))
    lines = re.findall(rb"^[ \t]*v[ \t]+([^\r\n#]*)", text, re.MULTILINE)
    counts = np.array([len(line.split()) for line in lines])
    numbers = np.fromstring(b" ".join(lines).decode(), sep=" ")
    vertices = numbers[(np.cumsum(counts) - counts)[:, None] + np.arange(3)]
    values: dict[str, Floats] = {}
    plain = np.flatnonzero(counts < 6)
    if not len(plain):
        rows = (np.cumsum(counts) - counts)[:, None] + np.arange(3, 6)
        values = dict(zip(COLOURS, numbers[rows].T, strict=False))
    elif len(plain) < len(counts):
        raise JobError(f"vertex {plain[0] + 1} has no colour, and others have one", hint=EXPORT)
    faces = _FACE.findall(text)
    sizes = np.array([len(line.split()) for line in faces])
    starts = np.cumsum(sizes) - sizes
    split = np.split(np.arange(int(sizes.sum())), starts[1:])
    corners = joined([(np.zeros((int(sizes.sum()), 3)), np.stack(split) if (sizes == sizes[0]).all() else split)])
    faces_at = [match.start() for match in _FACE.finditer(text)]

    def indices(joined_numbers: bytes, kind: re.Pattern[bytes]) -> Ints:
        given = np.fromstring(joined_numbers.decode(), sep=" ", dtype=np.int64)
        above = np.searchsorted([match.start() for match in kind.finditer(text)], faces_at)
        return np.asarray(np.where(given < 0, given + np.repeat(above, sizes), given - 1))

    all_faces = b" ".join(faces)
    triangles = indices(_TEXTURE_AND_NORMAL.sub(b"", all_faces), _VERTEX)[corners.triangles]
    coordinate = re.compile(rb"^[ \t]*vt[ \t]+(\S+[ \t]+\S+)", re.MULTILINE)
    points = np.fromstring(b" ".join(coordinate.findall(text)).decode(), sep=" ").reshape(-1, 2)
    textured = re.findall(rb"-?\d+/(-?\d+)\S*", all_faces)
    uv = None
    if len(points) and len(textured) == len(corners.vertices):
        uv = points[indices(b" ".join(textured), coordinate)[corners.triangles]]
    return Paint(vertices, triangles, values, uv)
