"""The surface of a part: its edges and bodies, whether it is closed, which way its bodies face.

All of it is over places: vertices with exactly the same coordinates are one. Nothing is repaired.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from amslicer.components import connected_components
from amslicer.errors import PartError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

FLAT = 1e-9
"""Volume over (area x size) that counts as none: float64 sums err by 1e-15, a 1 um film 1 m wide has 5e-7."""
CAVITY_SAMPLES = 16
"""Vertices of an inverted body that are tested: enough to see past a few that touch the outside."""
CAVITY_WORK = 10_000_000
"""Solid angles spent on finding cavities, about three seconds; beyond, fewer vertices are tested."""
SOLID_ANGLES_AT_ONCE = 500_000
"""Solid angles per step: temporaries of about 100 MB."""
OUTSIDE = 0.01
"""Winding number below which a point is clearly outside: rounding leaves 1e-10, an edge of 4 degrees 0.01."""

REPAIR = "repair it (in Blender's 3D Print Toolbox, MeshLab or PrusaSlicer) and export it again"


@dataclass(frozen=True)
class Rim:
    """The borders of a mesh's holes."""

    edges: Ints  # (E, 2) vertices
    uses: Ints  # (E,) triangles that run from the first vertex to the second, less those that run back
    hole: Ints  # (E,) number of the hole: borders that meet are one


@dataclass(frozen=True)
class Surface:
    """A mesh with its edges and bodies found."""

    vertices: Floats  # (V, 3) mm from the bounding box minimum
    triangles: Ints  # (T, 3)
    minimum_mm: Floats  # (3,) bounding box minimum in the file's frame, for messages
    open_edges: Ints  # (E, 2) vertices of the edges whose directed uses do not cancel
    open_uses: Ints  # (E,) triangles at each of them
    open_body: Ints  # (E,) body of one of these triangles
    rim: Rim  # the same edges, for whoever slices an open mesh
    body: Ints  # (T,) body that each triangle belongs to
    volumes: Floats  # (B,) signed volume of each body, mm3; holes count as closed by a cone
    flat: Floats  # (B,) volume below which a body counts as flat, mm3

    def describe(self, body: int) -> str:
        """A body's number, place in the file's frame and volume, for messages."""
        own = self.vertices[self.triangles[self.body == body]].reshape(-1, 3) + self.minimum_mm
        low, high = (", ".join(f"{value:.6g}" for value in end) for end in (own.min(axis=0), own.max(axis=0)))
        return f"body {body} of {len(self.volumes)} (from ({low}) to ({high}) mm, volume {self.volumes[body]:.6g} mm3)"


@dataclass(frozen=True)
class _EdgeUses:
    """Every use of an edge by a triangle, sorted by edge; triangles with a repeated corner have none."""

    edge: Ints  # (U,) number of the edge
    triangle: Ints  # (U,)
    sign: Ints  # (U,) 1 or -1: the direction in which the triangle runs along the edge
    ends: Ints  # (U, 2) the triangle's vertices there
    places: Ints  # (U, 2) numbers of their places, the lower first


def connect(vertices: Floats, triangles: Ints, minimum_mm: Floats) -> Surface:
    """The surface of (V, 3) vertices, in mm from their minimum, and (T, 3) triangles."""
    uses = edge_uses(vertices, triangles)
    net = np.bincount(uses.edge, weights=uses.sign).astype(np.int64)
    unbalanced = net != 0
    first = np.flatnonzero(np.diff(uses.edge, prepend=-1))[unbalanced]
    body = _bodies(uses, len(triangles))
    open_body = body[uses.triangle[first]]
    corners = vertices[triangles]
    if first.size:
        corners = corners - _cone_tips(vertices[uses.ends[first, 0]], open_body, int(body.max()) + 1)[body][:, None]
    a, b, c = np.moveaxis(corners, 1, 0)
    volumes = np.bincount(body, weights=np.einsum("ij,ij->i", a, np.cross(b, c))) / 6
    areas = np.bincount(body, weights=np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2
    return Surface(
        vertices,
        triangles,
        minimum_mm,
        open_edges=uses.ends[first],
        open_uses=np.bincount(uses.edge)[unbalanced],
        open_body=open_body,
        rim=Rim(uses.ends[first], net[unbalanced] * uses.sign[first], _holes(uses.places[first])),
        body=body,
        volumes=volumes,
        flat=FLAT * areas * float(vertices.max()),
    )


def _cone_tips(points: Floats, body: Ints, count: int) -> Floats:
    """(count, 3) the middle of each body's open edges, or 0: a cone from there to a flat hole adds no volume."""
    edges = np.maximum(np.bincount(body, minlength=count), 1)
    return np.column_stack([np.bincount(body, axis, minlength=count) / edges for axis in points.T])


def _holes(places: Ints) -> Ints:
    """(E,) number of the connected group that each edge between (E, 2) places belongs to."""
    used, ends = np.unique(places, return_inverse=True)
    start, end = ends.reshape(-1, 2).T
    return connected_components(len(used), start, end)[start]


def edge_uses(vertices: Floats, triangles: Ints) -> _EdgeUses:
    corners = _places(vertices)[triangles]
    whole = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))  # no repeated corner
    start, end = corners[whole][:, [0, 1, 2]].ravel(), corners[whole][:, [1, 2, 0]].ravel()
    key = np.minimum(start, end) * (int(corners.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    return _EdgeUses(
        edge=np.cumsum(np.diff(key[order], prepend=key[order][:1]) != 0),
        triangle=whole[order // 3],
        sign=np.where(start < end, 1, -1)[order],
        ends=triangles[whole][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)[order],
        places=np.column_stack([np.minimum(start, end), np.maximum(start, end)])[order],
    )


def _places(vertices: Floats) -> Ints:
    """(V,) number of each vertex's place; exact, never within a tolerance."""
    order = np.lexsort(vertices.T)
    inorder = vertices[order]
    number = np.zeros(len(vertices), dtype=np.int64)
    number[order[1:]] = np.cumsum((inorder[1:] != inorder[:-1]).any(axis=1))
    return number


def _bodies(uses: _EdgeUses, count: int) -> Ints:
    """(T,) body of each triangle; bodies that only touch in a vertex or an edge stay apart.

    Triangles are joined across edges that two share. Where more meet, they are joined only if the bodies
    found so far do not close there by themselves.
    """
    shared = (np.bincount(uses.edge) == 2)[uses.edge]
    body = _connected(uses, shared, count)
    _, which = np.unique(uses.edge * count + body[uses.triangle], return_inverse=True)
    unclosed = np.zeros(int(uses.edge.max(initial=-1)) + 1, dtype=bool)
    unclosed[uses.edge[(np.bincount(which, weights=uses.sign) != 0)[which]]] = True
    return _connected(uses, shared | unclosed[uses.edge], count)


def _connected(uses: _EdgeUses, joins: NDArray[np.bool_], count: int) -> Ints:
    linked = np.flatnonzero(joins[1:] & (uses.edge[1:] == uses.edge[:-1]))
    return connected_components(count, uses.triangle[linked], uses.triangle[linked + 1])


def check_closed(surface: Surface, *, allow_open: bool = False) -> None:
    """Every edge is used as often in one direction as in the other.

    Raises:
        PartError: there are open edges (unless they are allowed), or a body is partly inside out.
    """
    count = len(surface.open_edges)
    facing = surface.open_uses % 2 == 0  # two triangles that run along it the same way: no hole
    if count and (facing.any() if allow_open else facing.all()):
        bodies = np.unique(surface.open_body[facing])
        edges = int((surface.open_body[facing] == bodies[0]).sum())
        raise PartError(
            f"{surface.describe(int(bodies[0]))} is partly inside out: {edges} edges where "
            f"neighbouring triangles face opposite sides{_and_more(len(bodies))}",
            hint="make its normals consistent (recalculate outside) and export it again",
        )
    if not count or allow_open:
        return
    z = surface.vertices[surface.open_edges, 2] + surface.minimum_mm[2]
    raise PartError(
        f"the mesh is open: {count} open edges between z = {z.min():.6g} and {z.max():.6g} mm (of "
        f"{len(surface.triangles)} triangles)",
        hint=f"a hole, or a vertex on a neighbour's edge that does not split it (T-junction): {REPAIR}; --allow-open "
        "leaves the pixel rows that pass through holes empty",
    )


def _and_more(bodies: int) -> str:
    return f" ({bodies} bodies are)" if bodies > 1 else ""


def must_turn(surface: Surface) -> bool:
    """Whether the whole of a closed surface is inside out.

    Raises:
        PartError: nothing has a volume, or one body is inside out and no cavity.
    """
    total = float(surface.volumes.sum())
    if not (np.abs(surface.volumes) > surface.flat).any():
        raise PartError(
            f"no volume ({total:.3g} mm3): a sheet without thickness",
            hint="give it a thickness before exporting it",
        )
    if total < 0 and not _inverted_bodies(surface, -1.0).size:
        return True
    bad = _inverted_bodies(surface, 1.0)
    if bad.size:
        raise PartError(
            f"{surface.describe(int(bad[0]))} is inside out and no cavity of another{_and_more(bad.size)}",
            hint="turn its normals over (flip faces) and export it again",
        )
    if total <= 0:
        raise PartError(f"its cavities are larger than its bodies (volume {total:.6g} mm3)", hint=REPAIR)
    return False


def _inverted_bodies(surface: Surface, facing: float) -> Ints:
    """Bodies of negative volume outside those of positive volume; facing -1: of the mesh turned over."""
    volumes = surface.volumes * facing
    negative = np.flatnonzero(volumes < -surface.flat)
    positive = surface.triangles[(volumes > surface.flat)[surface.body]]
    if not negative.size or not len(positive):
        return negative
    samples = int(np.clip(CAVITY_WORK // (len(positive) * negative.size), 1, CAVITY_SAMPLES))
    order = np.argsort(surface.body, kind="stable")
    bounds = np.searchsorted(surface.body[order], np.arange(len(volumes) + 1))
    outside = []
    for body in negative:
        own = np.unique(surface.triangles[order[bounds[body] : bounds[body + 1]]])
        tested = surface.vertices[own[np.linspace(0, len(own) - 1, min(samples, len(own))).astype(int)]]
        winding = winding_numbers(tested, surface.vertices[positive]) * facing
        # A cavity may touch the surface from inside, where the winding number is a fraction.
        if winding.min() < OUTSIDE or winding.mean() < 0.5:
            outside.append(body)
    return np.array(outside, dtype=np.int64)


def winding_numbers(points: Floats, corners: Floats) -> Floats:
    """(P,) turns of triangles (T, 3, 3) around points: solid angles of Van Oosterom and Strackee (1983)."""
    total = np.zeros(len(points))
    steps = range(0, len(corners), SOLID_ANGLES_AT_ONCE)
    for first, last in pairwise([*steps, len(corners)]):
        for index, point in enumerate(points):
            a, b, c = np.moveaxis(corners[first:last] - point, 1, 0)
            la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
            above = np.einsum("ij,ij->i", a, np.cross(b, c))
            below = (
                la * lb * lc
                + np.einsum("ij,ij->i", a, b) * lc
                + np.einsum("ij,ij->i", b, c) * la
                + np.einsum("ij,ij->i", c, a) * lb
            )
            total[index] += np.arctan2(above, below).sum() / (2 * np.pi)
    return total
