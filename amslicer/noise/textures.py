"""Random-phase textures of a picture (Galerne, Gousseau, Morel 2011) as patterns: materials by levels of their values.

The exemplar's periodic component is spread over a spot as large as the part (at most MOST_PX a side; beyond, the
texture begins again, without a seam), and its phases are drawn at random. In 2D every layer has the same texture; in 3D
there is another one after each period in z, and phases go from one to the next in STEPS steps (straight lines between).
The ratio follows from the values' own quantiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from amslicer.likeness import of_map
from amslicer.noise.setting import OneReading, Setting
from amslicer.randomphase import MOST_PX, STEPS, Frames, Kind, extended_spot, good_side, quantiles

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.likeness import Likeness
    from amslicer.specification import Pattern

    Floats = NDArray[np.float64]

SHARES = 4096  # of the table of levels
LOOKED_AT = 4  # textures that the levels of a renewed one are read from


@dataclass(frozen=True, eq=False)
class RandomPhase(OneReading):
    """Random-phase noise of an exemplar.

    Attributes:
        spot: (rows, columns), periodic; row 0 lowest.
        pixel_mm: of the spot.
        renewal_mm: along z, in 3D.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
    """

    spot: Floats
    pixel_mm: float
    renewal_mm: float
    dimensions: int
    seed: int
    _made: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    KIND: ClassVar[Kind] = "random-phase"
    made_of: ClassVar[str] = "textures"
    reads: ClassVar[str] = "value"
    directed: ClassVar[bool] = False
    band: ClassVar[None] = None
    keys: ClassVar[frozenset[str]] = frozenset({"exemplar", "exemplar_pixel_mm"})

    @classmethod
    def of_pattern(cls, pattern: Pattern, setting: Setting) -> Self:
        """The noise that a job's pattern asks for."""
        p = setting.exemplar
        assert p is not None, "a job without an exemplar is refused"
        columns, rows = (
            good_side(max(own, min(math.ceil(size / setting.pixel_mm) + 1, MOST_PX)))
            for own, size in zip(p.shape[::-1], setting.size_mm, strict=True)
        )
        spot = extended_spot(p, (rows, columns))
        return cls(spot, setting.pixel_mm, setting.periods_mm[0], pattern.dimensions, pattern.seed)

    @cached_property
    def _frames(self) -> Frames:
        return Frames(self.spot, self.KIND, self.seed)

    def place(self, height_mm: float) -> tuple[int, float]:
        """The step below a height, and how far it is from there to the next one, 0…1."""
        if self.dimensions == 2:
            return 0, 0.0
        at = height_mm / self.renewal_mm * STEPS
        return math.floor(at), at - math.floor(at)

    def texture(self, step: int) -> NDArray[np.float32]:
        """(rows, columns) values at a step, of mean 0 and variance 1; the last two are kept. Not for two threads."""
        if step not in self._made:
            values = self._frames.at(step / STEPS)
            while len(self._made) > 1:
                del self._made[next(iter(self._made))]
            self._made[step] = ((values - values.mean()) / values.std()).astype(np.float32)
        return self._made[step]

    def levels_of(self, cumulative: NDArray[Any]) -> Floats:
        """The values that shares of all values lie above: -∞ for 1, +∞ for 0."""
        c = np.asarray(cumulative, np.float64)
        inner = np.interp(c, np.linspace(0.0, 1.0, SHARES + 1), self._levels)
        return np.where(c <= 0, np.inf, np.where(c >= 1, -np.inf, inner))

    @cached_property
    def _levels(self) -> Floats:
        shares = np.linspace(0.0, 1.0, SHARES + 1)
        steps = (0,) if self.dimensions == 2 else range(0, LOOKED_AT * STEPS, STEPS)
        found = []
        for step in steps:
            values = self._frames.at(step / STEPS)
            found.append(quantiles((values - values.mean()) / values.std(), shares))
        return np.asarray(np.mean(found, axis=0))

    @property
    def likeness(self) -> Likeness:
        """By the spot's covariance, which is the texture's."""
        from scipy import fft

        power = np.abs(fft.rfft2(self.spot - self.spot.mean())) ** 2
        covariance = fft.irfft2(power, s=self.spot.shape)
        return of_map(covariance / covariance[0, 0], self.pixel_mm, self.renewal_mm)


@dataclass(frozen=True, eq=False)
class AsymptoticSpot(RandomPhase):
    """Asymptotic spot noise of an exemplar."""

    KIND: ClassVar[Kind] = "asymptotic-spot"
