"""A costly field made cheap: its values at the nodes of a grid over the part's box, made when asked, linear between.

For fields whose every value costs a search or a sum over many points (distances, scattered points, strokes): pixels
are asked by the million, and the field is smooth between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise, product
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from amslicer.fields.orientation import Lines, principal_lines, tensors_of, unit_vectors
from amslicer.fields.raster import Raster
from amslicer.fields.source import one_tap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST_NODES = 500_000  # by default: about a second of searches, and 1.4 % of a cube's side apart
AT_ONCE = 1 << 17  # points interpolated at a time: 1 MB per number of theirs
ROUNDING = 4 * float(np.finfo(np.float32).eps)  # of a bound: how far its own value may leave it at nodes
FINEST_MM = 0.05  # by default: a printer's pixel


def choose_spacing(size_mm: Floats, varies: tuple[bool, bool, bool] = (True, True, True)) -> float:
    """mm between nodes so that a box has about MOST_NODES of them."""
    sides = [max(float(side), FINEST_MM) for side, along in zip(size_mm, varies, strict=True) if along]
    if not sides:
        return FINEST_MM
    spacing = max((float(np.prod(sides)) / MOST_NODES) ** (1 / len(sides)), FINEST_MM)
    while np.prod([side / spacing + 1 for side in sides]) > MOST_NODES:  # flat boxes have more nodes than volume
        spacing *= 1.1
    return float(spacing)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Values at the nodes of a grid over a box from 0 to size_mm, trilinear between, clamped outside. In any thread.

    A plane of nodes (all x and y at one z) is made when first asked for, and kept.

    Attributes:
        function: (N, C) values at (N, 3) places, field frame, mm.
        channels: C.
        varies: axes along which the function changes; along others there is one node.
    """

    function: Callable[[Floats], Floats]
    size_mm: Floats
    spacing_mm: float
    channels: int = 1
    varies: tuple[bool, bool, bool] = (True, True, True)
    _planes: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Nodes along x, y, z."""
        x, y, z = (
            1 + max(1, int(np.ceil(float(side) / self.spacing_mm))) if along and side > 0 else 1
            for side, along in zip(self.size_mm, self.varies, strict=True)
        )
        return x, y, z

    def at(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(C, …) values at places; the coordinates broadcast. Equal values at all nodes around give that value."""
        along = [self._neighbours(position, axis) for axis, position in enumerate((x, y, z))]
        (c0, c1, fx), (r0, r1, fy), (p0, p1, fz) = along
        if p0.size == 1:  # one height: its plane first
            i, j, share = int(p0.flat[0]), int(p1.flat[0]), float(fz.flat[0])
            low = self._plane(i).astype(np.float64)
            plane = low + share * (self._plane(j) - low) if share else low
            return _bilinear(plane, (c0, c1, fx), (r0, r1, fy))
        shape = np.broadcast_shapes(p0.shape, r0.shape, c0.shape)
        c0, c1, r0, r1, p0, p1 = (np.broadcast_to(i, shape).ravel() for i in (c0, c1, r0, r1, p0, p1))
        fx, fy, fz = (np.broadcast_to(f, shape).ravel() for f in (fx, fy, fz))
        out = np.empty((self.channels, len(p0)))
        # Between two planes at a time: all that a strip of a turned part crosses would be many times what it needs.
        order = np.argsort(p0, kind="stable")
        steps = np.flatnonzero(np.diff(p0[order], prepend=-1))
        for first, end in pairwise([*steps.tolist(), len(order)]):
            for some in (order[k : min(k + AT_ONCE, end)] for k in range(first, end, AT_ONCE)):
                below, above = self._plane(int(p0[some[0]])), self._plane(int(p1[some[0]]))
                # Along z first, as above: a point's value is the same whoever is asked with it.
                a, b, c, d = (
                    _lerp(below[:, r, c].astype(np.float64), above[:, r, c], fz[some])
                    for r, c in product((r0[some], r1[some]), (c0[some], c1[some]))
                )
                out[:, some] = _lerp(_lerp(a, b, fx[some]), _lerp(c, d, fx[some]), fy[some])
        return out.reshape(self.channels, *shape)

    def raster(self, x: Floats, y: Floats, z: Floats) -> Raster:
        """The plane at one height of the first channel, as texels of a raster."""
        below, above, share = self._neighbours(z, 2)
        low, high = (self._plane(int(i.flat[0]))[0] for i in (below, above))
        texels = low + np.float32(share.flat[0]) * (high - low)
        return Raster(texels, self._neighbours(x[0], 0), self._neighbours(y[:, 0], 1))

    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value at any node; makes them all."""
        ends = [(float(p.min()), float(p.max())) for p in (self._plane(i) for i in range(self.shape[2]))]
        return min(low for low, _ in ends), max(high for _, high in ends)

    def whole(self) -> NDArray[np.float32]:
        """(C, z, y, x) all values."""
        return np.stack([self._plane(i) for i in range(self.shape[2])], axis=1)

    def axis_mm(self, axis: int) -> Floats:
        """Places of the nodes along an axis."""
        count = self.shape[axis]
        return np.linspace(0.0, float(self.size_mm[axis]), count) if count > 1 else self.size_mm[axis : axis + 1] / 2

    def _neighbours(self, position: Floats, axis: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        count = self.shape[axis]
        place = np.asarray(position, np.float64)
        if count == 1:
            zero = np.zeros(place.shape, np.int64)
            return zero, zero, np.zeros(place.shape)
        along = np.clip(place / float(self.size_mm[axis]) * (count - 1), 0.0, count - 1.0)
        below = np.minimum(along.astype(np.int64), count - 2)
        return below, below + 1, along - below

    def _plane(self, number: int) -> NDArray[np.float32]:
        """(C, y, x) values at the nodes of one height."""
        with self._lock:
            if number not in self._planes:
                x, y = self.axis_mm(0), self.axis_mm(1)
                across, up = np.meshgrid(x, y)
                height = np.full(across.size, self.axis_mm(2)[number])
                values = self.function(np.column_stack([across.ravel(), up.ravel(), height]))
                plane = np.asarray(values, np.float32).reshape(len(y), len(x), self.channels)
                self._planes[number] = np.ascontiguousarray(np.moveaxis(plane, -1, 0))
            return self._planes[number]


Along = tuple["NDArray[np.int64]", "NDArray[np.int64]", "Floats"]


def _bilinear(plane: Floats, columns: Along, rows: Along) -> Floats:
    """(C, …) of a (C, y, x) plane; along its rows once per row of nodes where the places are a raster."""
    (c0, c1, fx), (r0, r1, fy) = columns, rows
    if c0.ndim == r0.ndim == 2 and c0.shape[0] == r0.shape[1] == 1:
        used, place = np.unique([r0[:, 0], r1[:, 0]], return_inverse=True)
        some = plane[:, used]
        across = _lerp(some[:, :, c0[0]], some[:, :, c1[0]], fx[0])
        low, high = (across[:, i] for i in place.reshape(2, -1))
    else:
        low, high = (_lerp(plane[:, r, c0], plane[:, r, c1], fx) for r in (r0, r1))
    return low + fy * (high - low)


def _lerp(low: Floats, high: NDArray[np.floating], share: Floats) -> Floats:
    out: Floats = low + share * (high - low)
    return out


@dataclass(frozen=True, eq=False)
class NodesSampler:
    """A scalar field by its values at nodes.

    Attributes:
        nodes: of one channel.
        known_bounds: where they are known without making all nodes.
    """

    nodes: Nodes
    known_bounds: tuple[float, float] | None = None
    texels: None = None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the axes of the nodes."""
        return self.nodes.varies

    @property
    def bounds(self) -> tuple[float, float]:
        """Those given, or of all nodes."""
        return self.known_bounds or self.nodes.bounds()

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points, within the bounds."""
        values: Floats = self.nodes.at(x, y, z)[0]
        return values if self.known_bounds is None else np.clip(values, *self.known_bounds)

    def raster(self, x: Floats, y: Floats, z: Floats) -> Raster | None:
        """The nodes at one height, as texels of a raster; None where they leave the bounds.

        Clipping texels before they are interpolated is not what `scalar` does.
        """
        found = self.nodes.raster(x, y, z)
        if self.known_bounds is None:
            return found
        low, high = self.known_bounds
        room = ROUNDING * max(abs(low), abs(high))
        if not (found.texels.min() >= low - room and found.texels.max() <= high + room):
            return None
        return Raster(np.clip(found.texels, *np.array(self.known_bounds, np.float32)), found.columns, found.rows)

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point: an angle that is a plain number."""
        return one_tap(self.scalar(x, y, z), x)


def lines_on_nodes(
    lines: Callable[[Floats], Floats],
    size_mm: Floats,
    spacing_mm: float,
    varies: tuple[bool, bool, bool] = (True, True, True),
) -> Lines:
    """Directions by their lines at nodes, combined as lines between them (through n nᵀ).

    Args:
        lines: (N, 3) vectors of any length at (N, 3) places; where one is 0, it is +x.
    """
    nodes = Nodes(lambda places: tensors_of(unit_vectors(lines(places))), size_mm, spacing_mm, 6, varies)
    return Lines(lambda x, y, z: principal_lines(np.moveaxis(nodes.at(x, y, z), 0, -1)), varies)
