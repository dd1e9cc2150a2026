"""Triangles as a file stores them, before anything is known of the solid; and what several readers share."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import PartError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

EXPORT = "export the part again, as STL for instance"
MAX_TRIANGLES = 20_000_000
"""Flattened triangles: about 2 GB while they are checked, what a desktop can spare."""
MAX_INSTANCES = 20_000
"""Placed objects and components: readers take a second for them, and some quadratically more beyond."""


@dataclass(frozen=True)
class Soup:
    """What a file holds, before any check of the solid; in the file's unit."""

    vertices: Floats  # (V, 3)
    triangles: Ints  # (T, 3)
    unit_mm: float = 1.0  # length of the file's unit
    missing: str = ""  # what shapes the part and is not implemented: the triangles may only stand in for it
    names: tuple[str, ...] = ()  # of the file's objects, once each; none where no object has a name
    object_of: Ints | None = None  # (T,) number of each triangle's object in names

    def check(self) -> None:
        """Raises PartError unless there are triangles, each uses vertices that are there, and all are finite."""
        if not len(self.triangles):
            raise PartError(
                "no triangles" + (f", only {len(self.vertices)} points" if len(self.vertices) else ""),
                hint="export a surface mesh (points, curves and empty scenes have no inside)",
            )
        _check_indices(self.triangles, len(self.vertices))
        bad = np.flatnonzero(~np.isfinite(self.vertices).all(axis=1))
        if bad.size:
            first = self.vertices[bad[0]].tolist()
            raise PartError(f"{bad.size} vertices are NaN or infinite, first vertex {bad[0]}: {first}", hint=EXPORT)


def joined(pieces: Iterable[tuple[Any, Any]], names: Sequence[str] = ()) -> Soup:
    """Pieces of (V, 3) vertices and their faces, which may have any number of corners, as one soup.

    Args:
        names: of the pieces' objects.

    Raises:
        PartError: a face uses a vertex that its piece does not have.
    """
    vertices, triangles, start, counts = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0, []
    for points, faces in pieces:
        split, _ = triangulated(faces)
        _check_indices(split, len(points))
        vertices.append(np.asarray(points, dtype=np.float64))
        triangles.append(split + start)
        start += len(points)
        counts.append(len(split))
    soup = Soup(np.concatenate(vertices), np.concatenate(triangles))
    return with_names(soup, names, np.repeat(np.arange(len(counts)), counts)) if names else soup


def with_names(soup: Soup, names: Sequence[str], object_of: Ints) -> Soup:
    """A soup whose triangles are those of objects, where one that has triangles has a name.

    Objects of the same name are one. Those without a name are called by their place in the file.

    Args:
        object_of: (T,) number of each triangle's object.
    """
    own = [name.strip() for name in names]
    counts = np.bincount(object_of, minlength=len(names))
    if not any(name for name, count in zip(own, counts, strict=True) if count):
        return soup
    full = [name or _free(str(number), own) for number, name in enumerate(own, 1)]
    kinds = list(dict.fromkeys(name for name, count in zip(full, counts, strict=True) if count))
    number_of = {name: number for number, name in enumerate(kinds)}
    objects = np.array([number_of.get(name, 0) for name in full], dtype=np.int64)
    return replace(soup, names=tuple(kinds), object_of=objects[object_of])


def _free(number: str, taken: Sequence[str]) -> str:
    """A name for an object without one, that no other has."""
    while number in taken:
        number += " (unnamed)"
    return number


def triangulated(faces: Any) -> tuple[Ints, Ints]:
    """(T, 3) triangles of faces of any number of corners, and (T,) the face of each: they are not in its order."""
    if isinstance(faces, np.ndarray) and faces.shape[1:] == (3,):
        return faces.astype(np.int64, copy=False), np.arange(len(faces))
    from trimesh.geometry import triangulate_quads

    sizes = np.array([len(face) for face in faces], dtype=np.int64)
    if not len(sizes):
        return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    corners = np.concatenate([np.asarray(face, np.int64) for face in faces])
    # The corners' numbers in place of the vertices: they say whose they are, and are cut in the same way.
    ends = np.cumsum(sizes)
    numbers = np.arange(len(corners))
    apart = numbers.reshape(len(sizes), -1) if (sizes == sizes[0]).all() else np.split(numbers, ends[:-1])
    split = np.asarray(triangulate_quads(apart), dtype=np.int64).reshape(-1, 3)
    return corners[split], np.searchsorted(ends, split[:, 0], side="right")


def _check_indices(triangles: Ints, count: int) -> None:
    bad = (triangles < 0) | (triangles >= count)
    if bad.any():
        first = int(np.flatnonzero(bad.any(axis=1))[0])
        raise PartError(
            f"{int(bad.sum())} vertex indices are out of range 0..{count - 1}, first "
            f"{int(triangles[first][bad[first]][0])} in triangle {first}",
            hint=EXPORT,
        )


def place(vertices: Floats, triangles: Ints, transform: Floats) -> tuple[Floats, Ints]:
    """A (V, 3), (T, 3) mesh moved by a 4 x 3 transform, its triangles still facing outward if it mirrors.

    The transform's rows are the images of x, y, z, then the translation: a point is a row vector.
    """
    determinant = float(np.linalg.det(transform[:3]))
    mirrors = math.isfinite(determinant) and determinant < 0
    return _moved(vertices, transform), triangles[:, ::-1] if mirrors else triangles


def _moved(vertices: Floats, transform: Floats) -> Floats:
    """Rows times the transform; written out, as BLAS may round differently from machine to machine."""
    if np.array_equal(transform[:3], np.eye(3)):
        return np.asarray(vertices + transform[3], dtype=np.float64)
    x, y, z = vertices[:, 0:1], vertices[:, 1:2], vertices[:, 2:3]
    moved = ((x * transform[0] + y * transform[1]) + z * transform[2]) + transform[3]
    return np.asarray(moved, dtype=np.float64)


def expect(declared: int, found: int, what: str) -> None:
    """Raises PartError unless a file holds as many of something as it declares."""
    if declared != found:
        raise PartError(
            f"{declared} {what} declared, {found} found",
            hint="the file is damaged or cut short: copy or export it again",
        )


def load_raw(data: bytes, suffix: str) -> dict[str, Any]:
    """What trimesh's reader of a format finds; its own mesh class may merge vertices and drop faces."""
    from trimesh.exchange.load import mesh_loaders

    reader: Any = mesh_loaders[suffix]
    return dict(reader(file_obj=io.BytesIO(data), file_type=suffix, skip_materials=True))
