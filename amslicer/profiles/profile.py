"""What every profile offers: thresholds for the device, and the Fourier coefficients that verification needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from numpy.typing import ArrayLike, NDArray

    from amslicer.noise import Noise

    Floats = NDArray[np.float64]

ROUNDING = float(np.finfo(np.float32).eps)  # a ratio this close to 0 or 1 is a plain fill


@dataclass(frozen=True, eq=False)
class RankTable:
    """Ranks of a waveform's values, for the device to look up.

    Attributes:
        ranks: (levels, samples) float32, 0…1: over the angle's stand-in that cl/deposit.h makes of G, or over Re G from
            -reach to reach; a row for each level of a blend.
        reach: of values; 0 where phases are read.
    """

    ranks: NDArray[np.float32]
    reach: float

    def look_up(self, g: NDArray[Any], blend: ArrayLike = 0.0) -> NDArray[np.float32]:
        """Ranks at values of G, as the device finds them.

        Args:
            g: complex, any shape.
            blend: 0…1, which broadcasts.
        """
        levels, samples = self.ranks.shape
        if self.reach:
            place = (g.real / (2 * self.reach) + 0.5) * samples
        else:
            size = np.abs(g.real) + np.abs(g.imag)
            turned = g.real / np.where(size > 0, size, 1.0)
            place = np.where(size > 0, np.where(g.imag >= 0, 1 - turned, 3 + turned), 2.0) * (samples / 4)
        row = np.broadcast_to(np.rint(np.asarray(blend) * (levels - 1)).astype(np.int64), np.shape(place))
        return np.asarray(self.ranks[row, np.clip(place, 0, samples - 1).astype(np.int64)])


class Profile(Protocol):
    """How a phase becomes one of several materials, whose cumulative ratios are 0 = c0 <= … <= cM = 1."""

    @property
    def arrows(self) -> bool:
        """Whether the sign of the phase counts, so that the painted direction must be an arrow."""

    @property
    def humps(self) -> int:
        """How many sheets of the first material there are to a period."""

    def rank_table(self, noise: Noise) -> RankTable | None:
        """What the device looks up, or None where it compares keys (cl/deposit.h)."""

    def thresholds(self, cumulative: NDArray[Any]) -> NDArray[np.float32]:
        """What the device compares with, at cumulative ratios 0…1 of any shape; a plain fill at 0 and 1."""

    def amplitudes(self, low: ArrayLike, high: ArrayLike, harmonics: int) -> Floats:
        """(..., harmonics) a_h of a material's indicator Σ a_h cos(h ϕ - α_h), h = 1, 2, …

        Args:
            low, high: the material's cumulative ratios c(m-1) and c(m).
        """

    def over_values(self, until: Callable[[Floats], Floats], low: ArrayLike, high: ArrayLike) -> Floats:
        """(levels, ..., n) how much a function of shares of all values grows over a material; of noises read by value.

        Args:
            until: from shares 0…1 of all values, the highest first, any shape, to (..., n) numbers.
            low, high: as in amplitudes.
        """

    def levels(self, shares: Floats, blend: float = 0.0) -> Floats:
        """(M,) what each of M materials with these shares says of the cosine of the phase.

        Args:
            blend: where the profile is between two, 0…1.
        """


def plain_fills(
    cumulative: Floats, thresholds: NDArray[np.float32], never: np.float32, always: np.float32
) -> NDArray[np.float32]:
    """Thresholds with plain fills where the cumulative ratio is 0 or 1 within rounding.

    Args:
        never: what no phase is on the near side of: for a ratio of 0.
        always: what every phase is on the near side of.
    """
    thresholds[cumulative <= ROUNDING] = never
    thresholds[cumulative >= 1 - ROUNDING] = always
    return thresholds
