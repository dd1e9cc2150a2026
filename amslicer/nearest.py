"""The part's surface as fields see it: the nearest point on it, and how deep a place lies below it.

Distances are to the nearest point of a triangle, found exactly by libigl's tree of boxes; what is inside is told by the
generalised winding number (Jacobson et al. 2013, by the fast approximation of Barill et al. 2018), as the slicer does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import numpy as np

from amslicer.fields.simplices import optional_library

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Bools = NDArray[np.bool_]

INSIDE = 0.5  # winding number: halfway between the inside and the outside of one shell
BESIDE = 1e-4  # of the part's size: nearer to a wall, winding numbers (float32) may tell the wrong side
BEYOND = 1e-5  # of the part's size: how far in front of a wall there may be solid; 160 times float32's rounding
MOST_BODIES, MOST_PAIRS = 2000, 50_000  # whose boxes are compared, a second's work; of more, all walls are looked at
FINEST = 1 / 200  # of the part's size: pieces that walls are cut into where another body cuts through them
ON_SURFACE = 1e-6  # of the part's size: nearer, the way to the nearest point is no direction
BLOCKS = (12, 4)  # spacings along blocks of points that are looked at as one first: 144 and 16 of a plane of nodes
ROUNDING = 1e-9  # of a distance
# Points of a triangle at which its two sides are looked at: near the corners, near the sides' middles, the centre.
SAMPLES = np.array(
    [(0.98, 0.01, 0.01), (0.01, 0.98, 0.01), (0.01, 0.01, 0.98),
     (0.49, 0.49, 0.02), (0.02, 0.49, 0.49), (0.49, 0.02, 0.49), (1 / 3, 1 / 3, 1 / 3)]
)  # fmt: skip
QUARTERS = np.array(
    [[(1, 0, 0), (0.5, 0.5, 0), (0.5, 0, 0.5)], [(0.5, 0.5, 0), (0, 1, 0), (0, 0.5, 0.5)],
     [(0.5, 0, 0.5), (0, 0.5, 0.5), (0, 0, 1)], [(0.5, 0.5, 0), (0, 0.5, 0.5), (0.5, 0, 0.5)]]
)  # fmt: skip


# Of jobs that are under way: several fields look at the same one. A surface keeps its arrays alive, so that no others
# have their ids.
_MADE: WeakValueDictionary[tuple[int, int, bool], Surface] = WeakValueDictionary()
_MAKING = Lock()


def surface_of(vertices: Floats, triangles: Ints, inner_walls: bool = False) -> Surface:
    """The surface of a solid; the same one where the same arrays are asked about again. In any thread.

    Args:
        inner_walls: with the walls of bodies that overlap or touch.
    """
    key = (id(vertices), id(triangles), inner_walls)
    with _MAKING:
        made = _MADE.get(key)
        if made is None:
            made = Surface.of(vertices, triangles)
            if not inner_walls and made.may_have_inner_walls():
                made = made.without_inner_walls()
            _MADE[key] = made
        return made


@dataclass(frozen=True, eq=False)
class Surface:
    """A solid, and those of its triangles (or pieces of them) that count as its surface. In any thread.

    Attributes:
        vertices: (V, 3) mm, of the whole solid.
        triangles: (T, 3) of the whole solid, counter-clockwise seen from outside.
        corners: (P, 3, 3) mm, corners of the pieces that count.
        parent: (P,) the triangle that each is a piece of.
        whole: whether the pieces bound the solid; else they are some of its faces.
        parts_of: of some faces, the surface that they are of.
    """

    vertices: Floats
    triangles: Ints
    corners: Floats
    parent: Ints
    whole: bool = True
    parts_of: Surface | None = None

    @classmethod
    def of(cls, vertices: Floats, triangles: Ints) -> Surface:
        """All triangles of a solid but those without an area: their sides are their neighbours' too."""
        corners = vertices[triangles]
        parent = np.flatnonzero(np.linalg.norm(area_vectors(corners), axis=1) > 0)
        return cls(vertices, triangles, corners[parent], parent)

    def without_inner_walls(self) -> Surface:
        """Only what lies between solid and air: where bodies overlap or touch, their walls are not the surface.

        Triangles that are partly such are cut into pieces of FINEST. A part of a wall is missed where it touches none
        of the SAMPLES of a triangle.
        """
        met = self._may_be_within_another()[self.parent]
        kept: list[tuple[Floats, Ints]] = [(self.corners[~met], self.parent[~met])]
        corners, parent = self.corners[met], self.parent[met]
        finest = FINEST * self.size_mm
        while len(corners):
            small = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1) <= finest
            outer = np.zeros((len(corners), len(SAMPLES)), bool)
            outer[small] = self._faces_air(corners[small], SAMPLES[-1:])
            outer[~small] = self._faces_air(corners[~small], SAMPLES)
            all_, any_ = outer.all(axis=1), outer.any(axis=1)
            kept.append((corners[all_], parent[all_]))
            cut = any_ & ~all_
            corners = np.einsum("qab,nbk->nqak", QUARTERS, corners[cut]).reshape(-1, 3, 3)
            parent = np.repeat(parent[cut], 4)
        return Surface(
            self.vertices, self.triangles, np.concatenate([c for c, _ in kept]), np.concatenate([p for _, p in kept])
        )

    def may_have_inner_walls(self) -> bool:
        """Whether triangles meet in more than pairs, or are not all connected: bodies that may touch or overlap."""
        from amslicer.components import connected_components

        corner = np.unique(self.vertices[self.triangles].reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
        sides = np.sort(np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]]), axis=1)
        count = int(corner.max()) + 1
        key, times = np.unique(sides[:, 0] * count + sides[:, 1], return_counts=True)
        return bool(times.max() > 2 or connected_components(count, key // count, key % count).max() > 0)

    def only(self, faces: Bools) -> Surface:
        """Some of the pieces, (P,) bool."""
        return Surface(self.vertices, self.triangles, self.corners[faces], self.parent[faces], False, self)

    def _faces_air(self, corners: Floats, samples: Floats) -> Bools:
        """(P, samples) whether air lies on the outer side of each sample.

        The inner side is not looked at: behind a wall is its own body, however thin.
        """
        areas = area_vectors(corners)
        normals = (areas / np.linalg.norm(areas, axis=1, keepdims=True))[:, None, :]
        places = np.einsum("sa,pak->psk", samples, corners) + BEYOND * self.size_mm * normals
        turns = self._winding.winding_number(np.ascontiguousarray(places.reshape(-1, 3)))
        return np.asarray(np.abs(turns) <= INSIDE).reshape(places.shape[:2])

    def _may_be_within_another(self) -> Bools:
        """(T,) whether a triangle of the solid is in the box of another body than its own, or its body is unclear."""
        from amslicer.bodynames import unclosed_pieces
        from amslicer.components import connected_components
        from amslicer.surface import edge_uses

        count = len(self.triangles)
        uses = edge_uses(self.vertices, self.triangles)
        paired = (np.bincount(uses.edge) == 2)[uses.edge]
        linked = np.flatnonzero(paired[1:] & (uses.edge[1:] == uses.edge[:-1]))
        body = connected_components(count, uses.triangle[linked], uses.triangle[linked + 1])
        # Those that share whole faces with others are one here, all of which is looked at.
        unclear = np.isin(body, unclosed_pieces(self.vertices, self.triangles, body))
        body = np.unique(np.where(unclear, -1, body), return_inverse=True)[1].reshape(-1)
        order = np.argsort(body, kind="stable")
        first = np.flatnonzero(np.diff(body[order], prepend=-1))
        corners, margin = self.vertices[self.triangles], 2 * BEYOND * self.size_mm
        low, high = corners.min(axis=1) - margin, corners.max(axis=1) + margin
        lows, highs = np.minimum.reduceat(low[order], first), np.maximum.reduceat(high[order], first)
        if len(first) > MOST_BODIES:
            return np.ones(count, bool)
        meet = np.ones((len(first), len(first)), bool)
        for axis in range(3):
            meet &= (lows[:, None, axis] <= highs[None, :, axis]) & (highs[:, None, axis] >= lows[None, :, axis])
        np.fill_diagonal(meet, False)
        pairs = np.argwhere(meet)
        if len(pairs) > MOST_PAIRS:
            return np.ones(count, bool)
        bounds = np.append(first, count)
        found = unclear
        for one, other in pairs.tolist():
            own = order[bounds[one] : bounds[one + 1]]
            found[own] |= np.all((low[own] <= highs[other]) & (high[own] >= lows[other]), axis=1)
        return found

    @cached_property
    def size_mm(self) -> float:
        """The largest side of its box."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def normals(self) -> Floats:
        """(P, 3) unit outward normals of the pieces."""
        areas = area_vectors(self.corners)
        unit: Floats = areas / np.linalg.norm(areas, axis=1, keepdims=True)
        return unit

    @cached_property
    def _tree(self) -> tuple[Any, Floats, Ints]:
        points = np.ascontiguousarray(self.corners.reshape(-1, 3))
        pieces = np.arange(len(points), dtype=np.int64).reshape(-1, 3)
        tree = _igl().AABB()
        tree.init(points, pieces)
        return tree, points, pieces

    @cached_property
    def _winding(self) -> Any:
        winding = _igl().FastWindingNumberBVH()
        winding.init(np.ascontiguousarray(self.vertices), np.ascontiguousarray(self.triangles))
        return winding

    def nearest(self, points: Floats) -> tuple[Floats, Ints, Floats]:
        """Of (N, 3) points: (N,) distance in mm, (N,) the piece, (N, 3) the nearest point on it."""
        tree, vertices, pieces = self._tree
        squared, piece, closest = tree.squared_distance(vertices, pieces, np.ascontiguousarray(points))
        return np.sqrt(squared), np.asarray(piece, np.int64), np.asarray(closest, np.float64).reshape(-1, 3)

    def inside(self, points: Floats) -> Bools:
        """(N,) whether (N, 3) points lie in the solid."""
        return np.asarray(self._winding.winding_number(np.ascontiguousarray(points)) > INSIDE)

    def depths(self, points: Floats, low_mm: float, high_mm: float, spacing_mm: float) -> Floats:
        """(N,) depth below the surface at (N, 3) points, mm, negative outside; clipped to low_mm < 0 and high_mm.

        Of a surface that is not the whole one, outside counts as above it only in front of its faces, and what is
        further than high_mm from them as deep below. A distance changes no faster than the place: blocks of points
        around one of a known distance are mostly settled by it.

        Args:
            spacing_mm: about how far apart the points are, for the size of the blocks; changes no value.
        """
        depth = np.full(len(points), float(high_mm))
        rest = np.arange(len(points))
        for spacings in BLOCKS:
            block, centre, radius = _blocks(points[rest], spacings * spacing_mm)
            beyond = self.nearest(centre)[0] - radius * (1 + ROUNDING)
            high = beyond > high_mm
            low = np.zeros_like(high)
            if self.whole:
                inner = self.inside(centre)
                away = beyond > BESIDE * self.size_mm  # no sign changes in it
                low = away & ~inner & (beyond > -low_mm)
                high &= away & inner
            depth[rest[low[block]]] = low_mm
            rest = rest[~(low | high)[block]]
            if not len(rest):
                return depth
        found = self._depths_of_faces(points[rest], high_mm) if not self.whole else self._signed(points[rest])
        depth[rest] = np.clip(found, low_mm, high_mm)
        return depth

    def _signed(self, points: Floats) -> Floats:
        distance = self.nearest(points)[0]
        return np.where(self.inside(points), distance, -distance)

    def _depths_of_faces(self, points: Floats, high_mm: float) -> Floats:
        distance, piece, closest = self.nearest(points)
        below = np.einsum("nk,nk->n", closest - points, self.normals[piece]) >= 0
        solid = self.inside(points) | below | (distance > high_mm)
        return np.where(solid, np.minimum(distance, high_mm), -distance)

    def directions(self, points: Floats) -> Floats:
        """(N, 3) vectors from the nearest point on the surface to (N, 3) points; on it, its normal."""
        distance, piece, closest = self.nearest(points)
        on = (distance <= ON_SURFACE * self.size_mm)[:, None]
        return np.where(on, self.normals[piece], points - closest)


def area_vectors(corners: Floats) -> Floats:
    """(P, 3) twice the areas of (P, 3, 3) triangles along their outward normals."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def barycentric(corners: Floats, points: Floats) -> Floats:
    """(N, 3) shares of the corners in (N, 3) points of (N, 3, 3) triangles: none below 0, summing to 1."""
    normal = area_vectors(corners)
    squared = np.maximum(np.einsum("nk,nk->n", normal, normal), np.finfo(float).tiny)
    second, third = (
        np.einsum("nk,nk->n", normal, crossed) / squared
        for crossed in (
            np.cross(points - corners[:, 0], corners[:, 2] - corners[:, 0]),
            np.cross(corners[:, 1] - corners[:, 0], points - corners[:, 0]),
        )
    )
    second = np.clip(second, 0.0, 1.0)
    third = np.clip(third, 0.0, 1.0 - second)
    return np.stack([1.0 - second - third, second, third], axis=1)


def _blocks(points: Floats, side_mm: float) -> tuple[Ints, Floats, Floats]:
    """(N,) block of each point; (B, 3) centre and (B,) radius of the box of each block's points."""
    cells = np.floor((points - points.min(axis=0)) / side_mm).astype(np.int64)
    counts = cells.max(axis=0) + 1
    _, block = np.unique((cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2], return_inverse=True)
    order = np.argsort(block, kind="stable")
    first = np.flatnonzero(np.diff(block[order], prepend=-1))
    low, high = (kind.reduceat(points[order], first, axis=0) for kind in (np.minimum, np.maximum))
    return block, (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2


def _igl() -> Any:
    return optional_library("igl", "the part's surface")
