"""Which pixels are near the part's outside: a skin of given thickness, thicker or thinner at tops and bottoms.

A pixel is skin if a place outside lies within half an ellipsoid around its centre: with the thickness as its radius in
the plane, and what is asked for tops above, for bottoms below. With one thickness everywhere that is the distance to
the surface. Distances are to the near faces of pixels outside, half a pixel before their centres: they miss the
surface by half a pixel at most along each axis.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid

    Bools = NDArray[np.bool_]

ONE = (
    30_000  # the square of the thickness: two of them fit into 16 bits, and a 120 000th of it is half a step at its end
)
SPARE = 64  # layers kept beyond those that one needs: blocks ask for their layers one after another


@dataclass(frozen=True)
class _Ring:
    """Of one layer, the pixels that are skin by their own layer alone, with squared distances; and what is solid."""

    place: NDArray[np.int64]
    squared: NDArray[np.uint16]
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
    _lock: RLock = field(default_factory=RLock)

    def of_layer(self, layer: int) -> Bools:
        """(rows, columns) solid pixels that are skin."""
        with self._lock:
            own = self._ring(layer)
            skin = np.zeros(self.grid.rows * self.grid.columns, bool)
            skin[own.place] = True
            inside = own.solid.copy()
            for step, reach_mm in ((1, self.top_mm), (-1, self.bottom_mm)):
                for away, squared in enumerate(_squares(self.grid.layer_mm, reach_mm), 1):
                    other = layer + step * away
                    if not 0 <= other < self.grid.layers:
                        inside[:] = 0
                        break
                    ring = self._ring(other)
                    skin[ring.place[ring.squared < ONE - squared]] = True
                    inside &= ring.solid
            solid, interior = (np.unpackbits(bits, count=skin.size).view(bool) for bits in (own.solid, inside))
            out: Bools = ((skin | ~interior) & solid).reshape(self.grid.rows, self.grid.columns)
            return out

    def _ring(self, layer: int) -> _Ring:
        if layer not in self._rings:
            self._rings[layer] = self._make_ring(layer)
            reach = sum(len(_squares(self.grid.layer_mm, v)) for v in (self.top_mm, self.bottom_mm))
            while len(self._rings) > reach + SPARE:
                self._rings.popitem(last=False)
        self._rings.move_to_end(layer)
        return self._rings[layer]

    def _make_ring(self, layer: int) -> _Ring:
        solid = self.solid_of(layer)
        (width, height), thickness = self.grid.pitch_mm, self.thickness_mm
        across, up = _squares(width, thickness), _squares(height, thickness)
        edges = np.diff(np.pad(solid, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        row, start = np.nonzero(edges > 0)
        _, stop = np.nonzero(edges < 0)
        along = np.where(solid, np.uint16(ONE), np.uint16(0))
        for k in range(len(across) - 1, -1, -1):  # the nearest last
            reaches = start + k < stop
            along[row[reaches], (start + k)[reaches]] = across[k]
            along[row[reaches], (stop - 1 - k)[reaches]] = across[k]
        reach = len(up)
        padded = np.pad(along, ((reach, reach), (0, 0)))
        nearest = along.copy()
        for away, squared in enumerate(up, 1):
            for shift in (reach - away, reach + away):
                np.minimum(nearest, padded[shift : shift + len(along)] + np.uint16(squared), out=nearest)
        place = np.flatnonzero(solid.ravel() & (nearest.ravel() < ONE))
        return _Ring(place, nearest.ravel()[place], np.packbits(solid))


def _squares(pitch_mm: float, reach_mm: float) -> list[int]:
    """Squared distances to the near faces of the next pixels, as long as they are within reach; ONE is the reach's."""
    if reach_mm <= 0:
        return []
    count = math.ceil(reach_mm / pitch_mm + 0.5)
    squares = [round(((k + 0.5) * pitch_mm / reach_mm) ** 2 * ONE) for k in range(count)]
    return [square for square in squares if square < ONE]
