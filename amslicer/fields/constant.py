"""A field that is the same everywhere: a number in the job file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.fields.source import Number, one_tap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

Constant = Number


@dataclass(frozen=True)
class ConstantSampler:
    """The same value at every point."""

    value: float
    varies: tuple[bool, bool, bool] = (False, False, False)
    texels: None = None

    @property
    def bounds(self) -> tuple[float, float]:
        """The value, twice."""
        return (self.value, self.value)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """The value, as a scalar array that broadcasts."""
        return np.asarray(self.value, np.float64)

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point."""
        return one_tap(self.scalar(x, y, z), x)
