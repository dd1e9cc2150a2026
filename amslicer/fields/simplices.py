"""Places in a mesh of finite elements: the tetrahedron or triangle around a point, and the shares of its corners.

Cells are split into tetrahedra by pulling the corner of the smallest number: every face between two cells is then cut
along the same diagonal. Cells of higher order count with their corner nodes alone, so their edges are straight.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

# Corner nodes per kind of cell; they come before all others in the file formats that are read.
FLAT = {"triangle": 3, "quad": 4}
SOLID = {"tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
# The faces of solid kinds, in the order of nodes that VTK and Gmsh share.
TRIANGLES = {
    "tetra": ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
    "pyramid": ((0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "wedge": ((0, 1, 2), (3, 4, 5)),
}
QUADS = {
    "pyramid": ((0, 1, 2, 3),),
    "wedge": ((0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "hexahedron": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
FLATNESS = 1e-9  # of the mesh's size: what rounding leaves of a plane, and of a cell without a volume
NUDGE = 1e-9 * np.array([0.27, 0.53, 0.80])  # of the mesh's size: along no face that anybody draws


def optional_library(name: str, source: str) -> Any:
    """A library that only some fields need.

    Raises:
        JobError: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise JobError(
            f"a field by {source} needs the library {name}, which is not installed ({error})",
            hint="pip install 'amslicer[fields]'",
        ) from error


@dataclass(frozen=True)
class Located:
    """Where N points are in a mesh.

    Attributes:
        corners: (N, K) numbers of the nodes around each point; K = 4 in solids, 3 on surfaces.
        weights: (N, K) their shares, 0 … 1, which sum to 1.
        cells: (N,) numbers of the cells that the points are in, or nearest to.
    """

    corners: Integers
    weights: Floats
    cells: Integers

    def between(self, values: Floats) -> Floats:
        """(N, C) linear between (P, C) values at nodes; where all corners have the same value, exactly that."""
        first = values[self.corners[:, 0]]
        result = first.copy()
        for k in range(1, self.corners.shape[1]):
            result += self.weights[:, k : k + 1] * (values[self.corners[:, k]] - first)
        return result


@dataclass(frozen=True, eq=False)
class Simplices:
    """A mesh cut into simplices.

    Attributes:
        points: (P, 3) nodes.
        simplices: (T, 4) nodes of tetrahedra, or (T, 3) of triangles, each of some volume or area.
        cells: (T,) the cell that each was cut from.
        sizes: (T,) volume or area of each.
        faces: (F, 3) nodes of triangles: where a tetrahedron has no neighbour; of surfaces, the simplices themselves.
        face_cells: (F,) the cell that each face belongs to.
        level: height of a mesh that is flat in z, whose values are the same at all heights; else None.
    """

    points: Floats
    simplices: Integers
    cells: Integers
    sizes: Floats
    faces: Integers
    face_cells: Integers
    level: float | None

    def locate(self, places: Floats) -> Located:
        """The simplex around each of (N, 3) places; outside, the nearest place of the surface."""
        places = np.ascontiguousarray(places, np.float64)
        if self.level is not None:
            places = np.column_stack([places[:, :2], np.full(len(places), self.level)])
        if self.simplices.shape[1] == 3:
            return self._on_surface(places)
        found = self._solid_tree.containing(places)
        # Rounding may leave a place on a face outside both neighbours: a hair away it is inside one of them.
        nudge = NUDGE * float(np.ptp(self.points, axis=0).max())
        for step in (nudge, -nudge):
            lost = np.flatnonzero(found < 0)
            if len(lost):
                found[lost] = self._solid_tree.containing(places[lost] + step)
        inside, outside = np.flatnonzero(found >= 0), np.flatnonzero(found < 0)
        corners = np.empty((len(places), 4), np.int64)
        weights, cells = np.empty((len(places), 4)), np.empty(len(places), np.int64)
        corners[inside] = self.simplices[found[inside]]
        weights[inside] = shares_in_tetrahedra(self.points[corners[inside]], places[inside])
        cells[inside] = self.cells[found[inside]]
        if len(outside):
            near = self._on_surface(places[outside])
            corners[outside] = near.corners[:, [0, 1, 2, 2]]
            weights[outside] = np.column_stack([near.weights, np.zeros(len(outside))])
            cells[outside] = near.cells
        return Located(corners, weights, cells)

    def cell_sizes(self, count: int) -> Floats:
        """(count,) volume or area of each cell."""
        return np.bincount(self.cells, self.sizes, count).astype(np.float64)

    def _on_surface(self, places: Floats) -> Located:
        face, nearest = self._surface_tree.nearest(places)
        corners = self.faces[face]
        return Located(corners, shares_in_triangles(self.points[corners], nearest), self.face_cells[face])

    @cached_property
    def _solid_tree(self) -> Tree:
        return Tree(self.points, self.simplices)

    @cached_property
    def _surface_tree(self) -> Tree:
        return Tree(self.points, self.faces)


class Tree:
    """A hierarchy of boxes around simplices (libigl)."""

    def __init__(self, points: Floats, simplices: Integers) -> None:
        self._igl = optional_library("igl", "mesh_data")
        self._mesh = np.ascontiguousarray(points), np.ascontiguousarray(simplices)
        self._boxes = self._igl.AABB()
        self._boxes.init(*self._mesh)

    def containing(self, places: Floats) -> Integers:
        """(N,) a tetrahedron around each of (N, 3) places, or -1."""
        return np.array(self._igl.in_element(*self._mesh, places, self._boxes), np.int64)

    def nearest(self, places: Floats) -> tuple[Integers, Floats]:
        """(N,) the triangle nearest to each of (N, 3) places, and (N, 3) its nearest place."""
        _, triangle, nearest = self._boxes.squared_distance(*self._mesh, places)
        return np.asarray(triangle, np.int64), np.asarray(nearest, np.float64)


def shares_in_tetrahedra(corners: Floats, places: Floats) -> Floats:
    """(N, 4) barycentric coordinates of (N, 3) places in tetrahedra of (N, 4, 3) corners, none below 0."""
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    p = places - corners[:, 0]
    ends = [np.einsum("ni,ni->n", p, np.cross(u, v)) for u, v in ((b, c), (c, a), (a, b))]
    inner = np.column_stack(ends) / np.einsum("ni,ni->n", a, np.cross(b, c))[:, None]
    return _shares(inner)


def shares_in_triangles(corners: Floats, places: Floats) -> Floats:
    """(N, 3) barycentric coordinates of (N, 3) places on triangles of (N, 3, 3) corners, none below 0."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = places - corners[:, 0]
    normal = np.cross(a, b)
    ends = [np.einsum("ni,ni->n", np.cross(*pair), normal) for pair in ((p, b), (a, p))]
    return _shares(np.column_stack(ends) / np.einsum("ni,ni->n", normal, normal)[:, None])


def _shares(inner: Floats) -> Floats:
    shares = np.maximum(np.column_stack([1 - inner.sum(axis=1), inner]), 0.0)
    result: Floats = shares / shares.sum(axis=1, keepdims=True)
    return result


def cut(points: Floats, blocks: list[tuple[str, Integers]], name: str) -> Simplices:
    """Cuts cells into simplices.

    Args:
        points: (P, 3) nodes.
        blocks: kinds and (C, corners) nodes of cells, all of FLAT or all of SOLID; cells are numbered through.
        name: the file, for the message.

    Raises:
        JobError: no cell has a volume (or, of surfaces, an area).
    """
    solid = blocks[0][0] in SOLID
    pieces, cells, before = [], [], 0
    for kind, nodes in blocks:
        simplices, own = _tetrahedra(kind, nodes) if solid else _triangles(nodes)
        pieces.append(simplices)
        cells.append(own + before)
        before += len(nodes)
    simplices, cell = np.concatenate(pieces), np.concatenate(cells)
    corners = points[simplices]
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, -1))
    normals = np.cross(a, b)
    sizes = np.abs(np.einsum("ni,ni->n", normals, c)) / 6 if solid else np.linalg.norm(normals, axis=1) / 2
    longest = np.max([np.linalg.norm(side, axis=1) for side in (a, b, c)], axis=0)
    kept = sizes > FLATNESS * longest ** (3 if solid else 2)
    if not kept.any():
        raise JobError(
            f"the {len(cell)} cells of '{name}' have no {'volume' if solid else 'area'}",
            hint="check the mesh: all nodes of each cell lie in one plane, or on one line",
        )
    simplices, cell, sizes = simplices[kept], cell[kept], sizes[kept]
    if solid:
        faces, owners = _boundary(simplices)
        return Simplices(points, simplices, cell, sizes, faces, cell[owners], None)
    z = points[np.unique(simplices), 2]
    flat = np.ptp(z) <= FLATNESS * np.ptp(points[np.unique(simplices)], axis=0).max()
    return Simplices(points, simplices, cell, sizes, simplices, cell, float(z[0]) if flat else None)


def _halves(quads: Integers) -> Integers:
    """(N, 2, 3) triangles of (N, 4) quadrangles, cut at the corner of the smallest number."""
    first = quads.argmin(axis=1)[:, None]
    turned = np.take_along_axis(quads, (first + np.arange(4)) % 4, axis=1)
    return turned[:, [[0, 1, 2], [0, 2, 3]]]


def _triangles(nodes: Integers) -> tuple[Integers, Integers]:
    if nodes.shape[1] == 3:
        return nodes, np.arange(len(nodes))
    return _halves(nodes).reshape(-1, 3), np.repeat(np.arange(len(nodes)), 2)


def _tetrahedra(kind: str, nodes: Integers) -> tuple[Integers, Integers]:
    """(T, 4) tetrahedra of (C, corners) cells, and (T,) which cell each is of."""
    if kind == "tetra":
        return nodes, np.arange(len(nodes))
    sides = [nodes[:, None, list(face)] for face in TRIANGLES.get(kind, ())]
    sides += [_halves(nodes[:, list(face)]) for face in QUADS[kind]]
    triangles = np.concatenate(sides, axis=1)
    apex = nodes.min(axis=1)
    cell, side = np.nonzero((triangles != apex[:, None, None]).all(axis=-1))
    return np.column_stack([apex[cell], triangles[cell, side]]), cell


def _boundary(tetrahedra: Integers) -> tuple[Integers, Integers]:
    """(F, 3) faces that only one tetrahedron has, and (F,) which one."""
    faces = tetrahedra[:, list(TRIANGLES["tetra"])].reshape(-1, 3)
    ordered = np.sort(faces, axis=1)
    order = np.lexsort(ordered.T)
    ordered = ordered[order]
    change = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1), [True]])
    alone = np.sort(order[change[1:] & change[:-1]])
    return faces[alone], alone // 4
