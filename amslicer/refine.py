"""Finer triangles, and which way their corners go when the whole surface moves outwards by one distance.

Every edge that is too long is halved, and each triangle divided by which of its edges were: by none, one, two or three.
Both triangles at an edge see the same midpoint, so a closed surface stays closed; nothing else is asked of the mesh, so
shells that overlap or meet in an edge are refined like any other. New corners lie on the old edges: the solid is the
same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

MAX_TRIANGLES = 20_000_000
"""About 6 GB while they are refined, moved and made ready for slicing."""
MAX_STRETCH = 3.0
"""Of a corner's way over its height: 1.7 at a cube's corners; a needle's tip would go anywhere."""
TOWARDS_MEAN = 1e-6
"""Weight of the mean normal beside the faces': it says where the surface is flat, and nothing where it has edges."""
TIED = 1 + 1e-9
"""Lengths this close are equal: how a part is turned rounds them, and must not choose its triangles."""
DENSEST = float(np.sqrt(3)) / 4
"""Largest area of a triangle whose edges are no longer than 1."""

# How a triangle of corners 0 1 2 is divided by which of its edges (01, 12, 20) are halved; 3 4 5 are their midpoints.
# Where two are, a quadrilateral is left, whose shorter diagonal is taken: two ways each.
DIVISIONS: dict[tuple[bool, bool, bool], tuple[tuple[tuple[int, int, int], ...], ...]] = {
    (True, False, False): (((0, 3, 2), (3, 1, 2)),),
    (False, True, False): (((0, 1, 4), (0, 4, 2)),),
    (False, False, True): (((0, 1, 5), (1, 2, 5)),),
    (True, True, False): (((3, 1, 4), (0, 3, 4), (0, 4, 2)), ((3, 1, 4), (0, 3, 2), (3, 4, 2))),
    (False, True, True): (((4, 2, 5), (0, 1, 4), (0, 4, 5)), ((4, 2, 5), (0, 1, 5), (1, 4, 5))),
    (True, False, True): (((0, 3, 5), (3, 1, 2), (3, 2, 5)), ((0, 3, 5), (3, 1, 5), (1, 2, 5))),
    (True, True, True): (((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),),
}
# The diagonals of the two ways.
DIAGONALS = {
    (True, True, False): ((0, 4), (3, 2)), (False, True, True): ((0, 4), (1, 5)), (True, False, True): ((3, 2), (1, 5)),
}  # fmt: skip


@dataclass(frozen=True)
class Surface:
    """Triangles whose corners at one place of one body are one vertex.

    Attributes:
        vertices: (V, 3) mm.
        triangles: (T, 3) counter-clockwise seen from outside.
    """

    vertices: Floats
    triangles: Ints

    @property
    def area_mm2(self) -> float:
        """Of all triangles."""
        a, b, c = np.moveaxis(self.vertices[self.triangles], 1, 0)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2

    @property
    def volume_mm3(self) -> float:
        """Signed; overlaps count twice."""
        a, b, c = np.moveaxis(self.vertices[self.triangles], 1, 0)
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6


def join_places(vertices: Floats, triangles: Ints, body: Ints | None) -> Surface:
    """The surface of (V, 3) vertices and (T, 3) triangles, of which the bodies (T,) may touch and stay apart."""
    number = np.zeros(len(triangles), np.int64) if body is None else body
    place = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)
    corners = place[triangles] * (int(number.max()) + 1) + number[:, None]
    _, first, joined = np.unique(corners, return_index=True, return_inverse=True)
    return Surface(vertices[triangles.reshape(-1)[first]], joined.reshape(-1, 3))


def refine(surface: Surface, longest_mm: float, key: str) -> Surface:
    """The same surface with no edge longer than this.

    Args:
        key: of the job file, that asked for it; for the message.

    Raises:
        JobError: it takes too many triangles.
    """
    vertices, triangles = surface.vertices, surface.triangles
    _refuse_many(surface.area_mm2 / (DENSEST * longest_mm**2), longest_mm, key)
    while True:
        starts, ends = triangles, np.roll(triangles, -1, axis=1)
        length = np.linalg.norm(vertices[starts] - vertices[ends], axis=-1)
        halved = length > longest_mm * TIED
        if not halved.any():
            return Surface(vertices, triangles)
        _refuse_many(len(triangles) + int(np.count_nonzero(halved)), longest_mm, key)
        low, high = np.minimum(starts, ends)[halved], np.maximum(starts, ends)[halved]
        edges, which = np.unique(low * len(vertices) + high, return_inverse=True)
        a, b = np.divmod(edges, len(vertices))
        six = np.concatenate([triangles, np.full_like(triangles, -1)], axis=1)
        six[:, 3:][halved] = len(vertices) + which
        # In corner order, so that both triangles at an edge and every run make the same midpoint of it.
        vertices = np.concatenate([vertices, (vertices[a] + vertices[b]) / 2])
        triangles = _divided(vertices, triangles, six, halved)


def _divided(vertices: Floats, triangles: Ints, six: Ints, halved: NDArray[np.bool_]) -> Ints:
    """The parts of all triangles, given their corners and midpoints (T, 6)."""
    kind = halved @ np.array([1, 2, 4])
    parts = [triangles[kind == 0]]
    for marks, ways in DIVISIONS.items():
        some = six[kind == np.dot(marks, [1, 2, 4])]
        if len(ways) == 1:
            parts.append(some[:, np.array(ways[0])].reshape(-1, 3))
            continue
        one, other = (np.linalg.norm(vertices[some[:, p]] - vertices[some[:, q]], axis=1) for p, q in DIAGONALS[marks])
        for way, chosen in zip(ways, (one <= other * TIED, one > other * TIED), strict=True):
            parts.append(some[chosen][:, np.array(way)].reshape(-1, 3))
    return np.concatenate(parts)


def _refuse_many(triangles: float, longest_mm: float, key: str) -> None:
    if triangles > MAX_TRIANGLES:
        raise JobError(
            f"{key}: the part's surface would need {triangles / 1e6:.3g} million triangles or more with edges of at "
            f"most {longest_mm:.4g} mm; at most {MAX_TRIANGLES // 10**6} million are made",
            hint=f"give a larger {key}",
        )


def ways_out(surface: Surface) -> Floats:
    """(V, 3) how far each vertex moves when the surface moves outwards by 1.

    Where faces meet at an angle, all of them move by 1, as planes do: Σ a_i (n_i·d - 1)² is least, with the angles a_i
    that the faces n_i have at the vertex. No vertex moves further than MAX_STRETCH.
    """
    corners = surface.vertices[surface.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    normal = cross / np.where(doubled > 0, doubled, 1.0)[:, None]
    angle = np.empty(surface.triangles.shape)
    for corner in range(3):
        one, other = (corners[:, (corner + step) % 3] - corners[:, corner] for step in (1, 2))
        angle[:, corner] = np.arctan2(doubled, np.einsum("ij,ij->i", one, other))
    angle[doubled == 0] = 0.0
    at, weight, count = surface.triangles.reshape(-1), angle.reshape(-1), len(surface.vertices)

    def total(per_face: Floats) -> Floats:
        return np.asarray(np.bincount(at, weight * np.repeat(per_face, 3), minlength=count), np.float64)

    mean = np.stack([total(normal[:, i]) for i in range(3)], axis=-1)
    matrix = np.empty((count, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            matrix[:, i, j] = matrix[:, j, i] = total(normal[:, i] * normal[:, j])
    weights = np.bincount(at, weight, minlength=count)
    weights = np.where(weights > 0, weights, 1.0)
    length = np.linalg.norm(mean, axis=1)
    unit = mean / np.where(length > 0, length, 1.0)[:, None]
    small = TOWARDS_MEAN * weights
    matrix += small[:, None, None] * np.eye(3)
    out = np.linalg.solve(matrix, (mean + small[:, None] * unit)[..., None])[..., 0]
    stretch = np.linalg.norm(out, axis=1)
    return np.asarray(out * np.minimum(1.0, MAX_STRETCH / np.where(stretch > 0, stretch, 1.0))[:, None])
