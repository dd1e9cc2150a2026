"""Where a picture lies: texels over a rectangle of the field frame, and what is beyond it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]
    Along = tuple[Indices, Indices, Floats]  # texel below, texel above and the share between them

Outside = Literal["clamp", "repeat", "mirror"]


@dataclass(frozen=True)
class Rectangle:
    """A rectangle along two axes of the field frame, tiled with texels.

    Attributes:
        low_mm: its lowest corner, along the two axes.
        size_mm: its sides.
        axes: the axes along the columns (0) and the rows (1); row 0 is where the second is smallest.
        outside: the nearest texel (clamp), or the picture again, as it is (repeat) or turned over (mirror).
    """

    low_mm: tuple[float, float]
    size_mm: tuple[float, float]
    axes: tuple[int, int]
    outside: Outside = "clamp"

    @property
    def normal(self) -> int:
        """The third axis."""
        return 3 - sum(self.axes)

    def varies(self, shape: tuple[int, ...]) -> tuple[bool, bool, bool]:
        """Along its two axes, where there is more than one texel of (rows, columns)."""
        along = {axis for axis, count in zip(self.axes, shape[::-1], strict=True) if count > 1}
        return (0 in along, 1 in along, 2 in along)

    def texel_mm(self, shape: tuple[int, ...]) -> tuple[float, float]:
        """Width and height of one of (rows, columns) texels."""
        return self._side(0) / shape[1], self._side(1) / shape[0]

    def around(self, position_mm: tuple[Floats, Floats, Floats], shape: tuple[int, ...]) -> tuple[Along, Along]:
        """The neighbours of places among (rows, columns) texels, along columns and along rows."""
        across, up = (position_mm[axis] for axis in self.axes)
        return self.neighbours(across, 0, shape[1]), self.neighbours(up, 1, shape[0])

    def neighbours(self, position_mm: Floats, along: int, count: int) -> Along:
        """Texel below, texel above and the share between them, along columns (0) or rows (1)."""
        place = self._place(position_mm, along, count)
        if self.outside == "clamp":
            place = np.clip(place, 0.0, count - 1.0)
            below = np.minimum(place.astype(np.int64), max(count - 2, 0))
            return below, np.minimum(below + 1, count - 1), place - below
        low = np.floor(place)
        below = low.astype(np.int64)
        return self._wrap(below, count), self._wrap(below + 1, count), place - low

    def turned(self, position_mm: Floats, along: int, count: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether the texel below and the one above lie in a tile that is turned over along this axis."""
        below = np.floor(self._place(position_mm, along, count)).astype(np.int64)
        return below // count % 2 == 1, (below + 1) // count % 2 == 1

    def _place(self, position_mm: Floats, along: int, count: int) -> Floats:
        """In texels from the centre of the first."""
        return (position_mm - self.low_mm[along]) / self._side(along) * count - 0.5

    def _side(self, along: int) -> float:
        return self.size_mm[along] or 1.0

    def _wrap(self, index: Indices, count: int) -> Indices:
        if self.outside == "repeat":
            return index % count
        index = index % (2 * count)
        return np.minimum(index, 2 * count - 1 - index)
