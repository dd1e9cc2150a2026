"""What a noise is told of the job beside its own keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from amslicer.noise.lobes import Lobes
    from amslicer.specification import Pattern

    Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Setting:
    """The part's and the printer's share.

    Attributes:
        periods_mm: the shortest and the longest painted period.
        lobes: several directions at a place, in printer axes; None: the painted one.
        isotropy: the lowest that is painted.
        normal: painted in the middle of the part, printer axes.
        turns: whether the painted direction is not the same everywhere.
        painted: whether direction or isotropy are not.
        size_mm: along x and y, of what is to be covered.
        exemplar: (rows, columns) periodic component of the picture to imitate, row 0 lowest; None without one.
        pixel_mm: of the exemplar.
    """

    periods_mm: tuple[float, float]
    lobes: Lobes | None = None
    isotropy: float = 0.0
    normal: tuple[float, float, float] = (1.0, 0.0, 0.0)
    turns: bool = False
    painted: bool = False
    size_mm: tuple[float, float] = (0.0, 0.0)
    exemplar: Floats | None = None
    pixel_mm: float = 1.0


class OneReading:
    """Base of noises of which the same is read, and that follow the painted direction or not, whatever the job."""

    reads: ClassVar[str]
    directed: ClassVar[bool]

    @classmethod
    def read_by(cls, pattern: Pattern) -> str:
        """What of G a job's pattern reads."""
        return cls.reads

    @classmethod
    def follows(cls, pattern: Pattern) -> bool:
        """Whether a job's pattern follows the painted direction."""
        return cls.directed
