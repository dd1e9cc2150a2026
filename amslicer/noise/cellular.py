"""Cells between random hyperplanes as noises of the table: a value at each pixel, without a phase or a direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from amslicer.likeness import of_distance
from amslicer.noise.hyperplanes import DEPTH, DIRECTIONS, PROBABILITY, Hyperplanes
from amslicer.noise.setting import OneReading, Setting

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.likeness import Likeness
    from amslicer.specification import Pattern

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Cellular(OneReading, Hyperplanes):
    """Walls along random planes; attributes as of Hyperplanes."""

    KIND: ClassVar[str] = "cellular"
    made_of: ClassVar[str] = "planes"
    reads: ClassVar[str] = "value"
    directed: ClassVar[bool] = False
    band: ClassVar[None] = None
    keys: ClassVar[frozenset[str]] = frozenset({"directions"})
    # Shares of windows scatter as if the pattern were alike over so many mean chords (tests/test_likeness.py).
    ALIKE: ClassVar[float] = 0.5

    @classmethod
    def of_pattern(cls, pattern: Pattern, setting: Setting) -> Self:
        """The noise that a job's pattern asks for."""
        return cls(
            kind=cls.KIND, period_mm=setting.periods_mm[0], dimensions=pattern.dimensions, seed=pattern.seed,
            directions=pattern.directions or DIRECTIONS,
            probability=PROBABILITY if pattern.probability is None else pattern.probability,
            depth=DEPTH if pattern.depth is None else pattern.depth,
        )  # fmt: skip

    @property
    def likeness(self) -> Likeness:
        """No wall is between places so far apart with probability exp(-d/p)."""
        return of_distance(lambda distance_mm: np.asarray(np.exp(-distance_mm / (self.ALIKE * self.period_mm))))


@dataclass(frozen=True)
class Polytope(Cellular):
    """Cells of one material each."""

    KIND: ClassVar[str] = "polytope"
    ALIKE: ClassVar[float] = 1.0


@dataclass(frozen=True)
class Stit(Cellular):
    """Walls of cells that are divided again and again."""

    KIND: ClassVar[str] = "stit"
    keys: ClassVar[frozenset[str]] = frozenset({"directions", "probability", "depth"})
    ALIKE: ClassVar[float] = 1.5
