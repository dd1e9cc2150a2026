"""Interpolates numbers that are known at scattered places: thin plates, and straight within simplices.

Thin plates: Duchon 1977 (kernel r² log r with a linear term, which reproduces linear functions). Places that lie
(nearly) on a plane or a line are taken there: the result does not change across it. One place gives a constant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

CLOSEST_MM = 1e-6  # a nanometre: places that are closer are the same, far below what a printer places
FLAT = 1e-3  # thickness over extent of places on a plane: a linear term across it would be made of their noise
GLOBAL_MOST = 1000  # points of one thin plate: solved in 0.1 s, 40 µs per value; beyond, each value has its neighbours
NEIGHBOURS = 24  # by default: two shells around a point of a lattice are 18, and some to spare
BATCH_NUMBERS = 1 << 18  # numbers at a time in a step's largest array: 2 MB, which a processor's cache holds
INWARDS = 1e-9  # share of the way to the middle: a place on the hull's face is then within a simplex


@dataclass(frozen=True, eq=False)
class Span:
    """The point, line, plane or space that places lie in.

    Attributes:
        centre: (3,) a place in it, mm.
        basis: (d, 3) orthonormal directions.
    """

    centre: Floats
    basis: Floats

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along which axes a function of the coordinates in it changes."""
        x, y, z = (bool(np.any(self.basis[:, axis])) for axis in range(3))
        return x, y, z

    def coordinates(self, places: Floats) -> Floats:
        """(N, d) mm, of (N, 3) places."""
        found: Floats = ((places - self.centre)[:, None, :] * self.basis).sum(axis=2)
        return found


def span_of(places: Floats) -> Span:
    """The span of (N, 3) places; along the axes themselves where it is not oblique."""
    centre = places.mean(axis=0)
    axes = np.flatnonzero(np.ptp(places, axis=0) > CLOSEST_MM)
    if len(axes) == 0:
        return Span(centre, np.zeros((0, 3)))
    _, extents, directions = np.linalg.svd((places - centre)[:, axes], full_matrices=False)
    dimensions = int((extents > FLAT * extents[0]).sum())
    basis = np.zeros((dimensions, 3))
    basis[:, axes] = np.eye(len(axes)) if dimensions == len(axes) else directions[:dimensions]
    return Span(centre, basis)


def interpolate(
    places: Floats, values: Floats, method: str, smoothing: float = 0.0, neighbours: int | None = None
) -> tuple[Callable[[Floats], Floats], Span]:
    """A function from (M, 3) places to (M, C) values, and where it changes.

    Args:
        places: (N, 3) mm, all apart.
        values: (N, C).
        method: thin-plate or linear.
        smoothing: 0: through the values; more: a stiffer plate that passes near them.
        neighbours: how many points make a value; default: all up to GLOBAL_MOST points, else NEIGHBOURS.

    Raises:
        JobError: the points are so close to each other that their thin plate is not determined.
    """
    span = span_of(places)
    # Places of a plane may coincide once they are put on it: they are averaged.
    coordinates, group = np.unique(
        np.round(span.coordinates(places) / CLOSEST_MM) * CLOSEST_MM, axis=0, return_inverse=True
    )
    count = np.bincount(group.ravel())
    if len(count) < len(places):
        means = [np.bincount(group.ravel(), channel) / count for channel in values.T]
        values = np.stack(means, axis=1)
    else:
        coordinates, values = span.coordinates(places), values
    dimensions = coordinates.shape[1]
    if dimensions == 0:
        return lambda asked: np.broadcast_to(values[:1], (len(asked), values.shape[1])), span
    if method == "linear":
        within = _line(coordinates[:, 0], values) if dimensions == 1 else _simplices(coordinates, values)
    elif neighbours is None and len(coordinates) <= GLOBAL_MOST:
        within = _thin_plate(coordinates, values, smoothing)
    else:
        within = LocalThinPlates(coordinates, values, smoothing, min(neighbours or NEIGHBOURS, len(coordinates))).at
    return lambda asked: within(span.coordinates(asked)), span


def _line(coordinates: Floats, values: Floats) -> Callable[[Floats], Floats]:
    order = np.argsort(coordinates, kind="stable")
    along, sorted_values = coordinates[order], values[order]
    return lambda asked: np.stack([np.interp(asked[:, 0], along, channel) for channel in sorted_values.T], axis=1)


def _simplices(coordinates: Floats, values: Floats) -> Callable[[Floats], Floats]:
    """Linear within a Delaunay triangulation; outside as where the straight line to the middle enters the hull."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

    try:
        inside, faces = LinearNDInterpolator(Delaunay(coordinates), values), ConvexHull(coordinates).equations
    except QhullError as error:
        reason = str(error).strip().partition("\n")[0]
        raise JobError(
            f"a field by points cannot be triangulated: {reason}", hint="take method: thin-plate or nearest"
        ) from error
    middle, tree = coordinates.mean(axis=0), cKDTree(coordinates)
    depth = -(faces[:, -1] + (faces[:, :-1] * middle).sum(axis=1))

    def at(asked: Floats) -> Floats:
        found: Floats = inside(asked)
        outside = np.flatnonzero(np.isnan(found[:, 0]))
        for some in _batches(outside, len(faces)):
            away = asked[some] - middle
            leaving = sum(away[:, axis, None] * faces[None, :, axis] for axis in range(len(middle)))
            share = np.where(leaving > depth, depth / np.where(leaving > depth, leaving, 1.0), 1.0).min(axis=1)
            found[some] = inside(middle + (1 - INWARDS) * share[:, None] * away)
        lost = np.flatnonzero(np.isnan(found[:, 0]))  # in a gap of rounding between simplices
        found[lost] = values[tree.query(asked[lost])[1]]
        return found

    return at


def _thin_plate(coordinates: Floats, values: Floats, smoothing: float) -> Callable[[Floats], Floats]:
    from scipy.interpolate import RBFInterpolator

    try:
        plate = RBFInterpolator(coordinates, values, smoothing=smoothing, kernel="thin_plate_spline", degree=1)
    except np.linalg.LinAlgError as error:
        raise _undetermined() from error

    def at(asked: Floats) -> Floats:
        found: Floats = plate(asked)
        if not np.isfinite(found).all():
            raise _undetermined()
        return found

    return at


def _undetermined() -> JobError:
    return JobError(
        "a field by points has a thin plate that is not determined: some of its points are very close to each other",
        hint="leave some out, or take method: linear or nearest",
    )


@dataclass(frozen=True, eq=False)
class LocalThinPlates:
    """At each place the thin plate of its nearest points.

    Neighbours that lie on a plane (a face that was measured) have no linear term across it.
    """

    coordinates: Floats
    values: Floats
    smoothing: float
    neighbours: int

    def __post_init__(self) -> None:
        from scipy.spatial import cKDTree

        object.__setattr__(self, "_tree", cKDTree(self.coordinates))

    def at(self, asked: Floats) -> Floats:
        """(M, C) values at (M, d) coordinates."""
        found = np.empty((len(asked), self.values.shape[1]))
        for some in _batches(np.arange(len(asked)), self.neighbours**2):
            found[some] = self._batch(asked[some])
        return found

    def _batch(self, asked: Floats) -> Floats:
        k, dimensions = self.neighbours, self.coordinates.shape[1]
        chosen = self._tree.query(asked, k=[*range(1, k + 1)])[1]  # type: ignore[attr-defined]
        points = self.coordinates[chosen]
        middle = points.mean(axis=1, keepdims=True)
        near = points - middle
        scale = np.abs(near).max(axis=(1, 2), keepdims=True)
        near, place = near / scale, (asked[:, None] - middle) / scale
        spread, directions = np.linalg.eigh(np.einsum("mki,mkj->mij", near, near))
        spans = spread > FLAT**2 * spread[:, -1:]
        size = k + 1 + dimensions
        matrix = np.zeros((len(asked), size, size))
        matrix[:, :k, :k] = _kernel(near[:, :, None], near[:, None])
        # In units of the neighbourhood: what smoothing does shall not depend on its size.
        matrix[:, np.arange(k), np.arange(k)] += self.smoothing / scale[:, :, 0] ** 2
        matrix[:, :k, k] = 1.0
        along = np.einsum("mki,mij->mkj", near, directions) * spans[:, None]
        matrix[:, :k, k + 1 :] = along
        matrix[:, k:, :k] = np.swapaxes(matrix[:, :k, k:], 1, 2)
        matrix[:, np.arange(k + 1, size), np.arange(k + 1, size)] = ~spans
        right = np.zeros((len(asked), size, self.values.shape[1]))
        right[:, :k] = self.values[chosen]
        try:
            solved = np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError as error:
            raise _undetermined() from error
        terms = np.ones((len(asked), size))
        terms[:, :k] = _kernel(place, near)
        terms[:, k + 1 :] = np.einsum("mi,mij->mj", place[:, 0], directions) * spans
        found: Floats = np.einsum("ms,msc->mc", terms, solved)
        if not np.isfinite(found).all():
            raise _undetermined()
        return found


def _kernel(a: Floats, b: Floats) -> Floats:
    """r² log r of the distances between places that broadcast."""
    squares = sum((a[..., axis] - b[..., axis]) ** 2 for axis in range(a.shape[-1]))
    kernel: Floats = 0.5 * squares * np.log(np.where(squares > 0, squares, 1.0))
    return kernel


def _batches(indices: NDArray[np.int64], numbers_each: int) -> list[NDArray[np.int64]]:
    step = max(1, BATCH_NUMBERS // max(numbers_each, 1))
    return [indices[first : first + step] for first in range(0, len(indices), step)]
