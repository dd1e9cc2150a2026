"""Which pixels are near the part's outside: a skin of given thickness, thicker or thinner at tops and bottoms.

A pixel is skin if a place outside lies within half an ellipsoid around its centre: with the thickness as its radius in
the plane, and what is asked for tops above, for bottoms below. With one thickness everywhere that is the distance to
the surface. Distances are to the near faces of pixels outside, half a pixel before their centres: they miss the
surface by half a pixel at most along each axis.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid

    Bools = NDArray[np.bool_]

# The square of the thickness as a whole number of which two fit into 8 or 16 bits; of thin skins, up to so many pixels,
# rounding the squares to 8 bits moves the skin by less than a quarter of one.
COARSE, FINE, THIN_PX = 120, 30_000, 40
SPARE = 40  # layers kept beyond those that one needs: blocks ask for their layers one after another


@dataclass(frozen=True)
class _Ring:
    """Of one layer, the pixels that are skin by their own layer alone, with squared distances; and what is solid."""

    place: NDArray[np.uint32]
    squared: NDArray[np.uint8] | NDArray[np.uint16]
    solid: NDArray[np.uint8]  # bits


@dataclass(frozen=True, eq=False)
class Skin:
    """The skin of a part, layer by layer, in any order and thread.

    Attributes:
        solid_of: (rows, columns) what is solid in a layer.
        thickness_mm: at sides; also how far from an edge tops and bottoms are rounded.
        top_mm, bottom_mm: below surfaces that face up, above those that face down; 0: none there.
    """

    solid_of: Callable[[int], Bools]
    grid: Grid
    thickness_mm: float
    top_mm: float
    bottom_mm: float
    _rings: OrderedDict[int, _Ring] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def prepare(self, first: int, end: int, each: Callable[..., Iterable[Any]] = map) -> None:
        """Makes what the layers first … end - 1 need.

        Args:
            each: like map; over threads it is that much faster.
        """
        above, below = (len(self._squares(self.grid.layer_mm, v)) for v in (self.top_mm, self.bottom_mm))
        deque(each(self._ring, range(max(0, first - below), min(self.grid.layers, end + above))), maxlen=0)

    def of_layer(self, layer: int) -> Bools:
        """(rows, columns) solid pixels that are skin."""
        own = self._ring(layer)
        skin = np.zeros(self.grid.rows * self.grid.columns, bool)
        skin[own.place] = True
        inside = own.solid.copy()
        for step, reach_mm in ((1, self.top_mm), (-1, self.bottom_mm)):
            for away, squared in enumerate(self._squares(self.grid.layer_mm, reach_mm), 1):
                other = layer + step * away
                if not 0 <= other < self.grid.layers:
                    inside[:] = 0
                    break
                ring = self._ring(other)
                if np.array_equal(ring.solid, own.solid):  # upright sides: nothing that is not skin already
                    continue
                skin[ring.place[ring.squared < self._one - squared]] = True
                inside &= ring.solid
        solid, interior = (np.unpackbits(bits, count=skin.size).view(bool) for bits in (own.solid, inside))
        out: Bools = ((skin | ~interior) & solid).reshape(self.grid.rows, self.grid.columns)
        return out

    def _ring(self, layer: int) -> _Ring:
        with self._lock:
            if layer in self._rings:
                self._rings.move_to_end(layer)
                return self._rings[layer]
        made = self._make_ring(layer)
        with self._lock:
            self._rings[layer] = made
            reach = sum(len(self._squares(self.grid.layer_mm, v)) for v in (self.top_mm, self.bottom_mm))
            while len(self._rings) > reach + SPARE:
                self._rings.popitem(last=False)
        return made

    def _make_ring(self, layer: int) -> _Ring:
        solid = self.solid_of(layer)
        (width, height), thickness = self.grid.pitch_mm, self.thickness_mm
        across, up = self._squares(width, thickness), self._squares(height, thickness)
        row, start, stop = ends_of_runs(solid)
        kind = np.uint8 if self._one == COARSE else np.uint16
        along = np.where(solid, kind(self._one), kind(0))
        for k in range(len(across) - 1, -1, -1):  # the nearest last
            reaches = start + k < stop
            along[row[reaches], (start + k)[reaches]] = across[k]
            along[row[reaches], (stop - 1 - k)[reaches]] = across[k]
        reach = len(up)
        padded = np.pad(along, ((reach, reach), (0, 0)))
        nearest, further = along, np.empty_like(along)
        for away, squared in enumerate(up, 1):
            for shift in (reach - away, reach + away):
                np.add(padded[shift : shift + len(along)], kind(squared), out=further)
                np.minimum(nearest, further, out=nearest)
        place = np.flatnonzero(solid.ravel() & (nearest.ravel() < self._one))
        return _Ring(place.astype(np.uint32), nearest.ravel()[place], np.packbits(solid))

    @cached_property
    def _one(self) -> int:
        """The square of the thickness."""
        finest = min(*self.grid.pitch_mm, self.grid.layer_mm)
        return COARSE if max(self.thickness_mm, self.top_mm, self.bottom_mm) < THIN_PX * finest else FINE

    def _squares(self, pitch_mm: float, reach_mm: float) -> list[int]:
        """Squared distances to the near faces of the next pixels, as long as they are within reach.

        One pixel at least: a skin thinner than half of one is that of the outermost pixels.
        """
        if reach_mm <= 0:
            return []
        count = math.ceil(reach_mm / pitch_mm + 0.5)
        squares = [round(((k + 0.5) * pitch_mm / reach_mm) ** 2 * self._one) for k in range(count)]
        return [min(squares[0], self._one - 1), *(square for square in squares[1:] if square < self._one)]


def ends_of_runs(solid: Bools) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Row, first column and end of the runs of (rows, columns) pixels, in their order."""
    width = solid.shape[1] + 2
    padded = np.pad(solid, ((0, 0), (1, 1))).ravel().view(np.int8)
    change = np.flatnonzero(padded[1:] != padded[:-1])  # each run has two: before it, and at its last pixel
    row, start = np.divmod(change[::2], width)
    return row, start, change[1::2] - row * width
