"""The period that kernels' widths follow: the painted one, held back where it grows faster than distance allows.

    q(x) = min_y (p(y) + SLOPE |x - y|)

with |x - y| along the axes, one after the other. Without it, wide kernels reach from coarse sheets far over fine ones
beside them. Looked at on a lattice over the part's box.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer.arrows import sample_places

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.painted import Painted

    Floats = NDArray[np.float64]

SLOPE = 0.2  # mm per mm, along each axis
STEP_PERIODS = 0.5  # of the shortest, between two places of the lattice
HELD_BACK = 0.97  # of the period: above, the lattice cannot tell from interpolation


class EnvelopePeriods:
    """q over a part."""

    def __init__(self, painted: Painted) -> None:
        places = sample_places(painted, STEP_PERIODS * painted.period_bounds_mm[0])
        shape = places.shape[:3]
        self._step_mm = painted.placement.size_mm / shape
        q = painted.periods(places.reshape(-1, 3)).reshape(shape).copy()
        for axis in range(3):
            rise = SLOPE * self._step_mm[axis] * np.arange(shape[axis])
            along = np.moveaxis(q, axis, -1)
            up = np.minimum.accumulate(along - rise, axis=-1) + rise
            down = np.minimum.accumulate((along + rise)[..., ::-1], axis=-1)[..., ::-1] - rise
            along[...] = np.minimum(up, down)
        self._values = q

    def at(self, points_mm: Floats, periods_mm: Floats) -> Floats:
        """(N,) q at (N, 3) points, pattern frame; beyond the box as at its sides. Where not held back, the period."""
        q = self._values
        place = np.clip(points_mm / self._step_mm - 0.5, 0, np.array(q.shape) - 1)
        below = np.minimum(place.astype(np.int64), np.maximum(np.array(q.shape) - 2, 0))
        share = place - below
        total = np.zeros(len(points_mm))
        for corner in np.ndindex(2, 2, 2):
            index = np.minimum(below + corner, np.array(q.shape) - 1)
            weight = np.prod(np.where(corner, share, 1 - share), axis=1)
            total += weight * q[tuple(index.T)]
        return np.where(total < HELD_BACK * periods_mm, total, periods_mm)
