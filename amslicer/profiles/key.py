"""Profiles whose thresholds are those of one number, so that no angle is ever computed: symmetric (pwm) and cyclic.

With cumulative ratios 0 = c0 <= … <= cM = 1 and ϕ = arg G, material m is where the profile's share of a turn is in
[c(m-1), cm), the last interval closed:

    symmetric (pwm: of two materials)   |ϕ|/π          A B C B A B C …   n and -n are the same
    cyclic                              ϕ/2π mod 1     A B C A B C …     in the direction of n

A key falls as the share grows from 0 to 1, and its value at c, times |G|², is compared with that of G. The symmetric
key is cos·|cos| of the angle, from 1 to -1; the cyclic one goes on to -3 in the second half of the turn. A ratio of 0
or 1 is a plain fill.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.profiles.profile import plain_fills

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike, NDArray

    from amslicer.noise import Noise
    from amslicer.profiles.profile import RankTable

    Floats = NDArray[np.float64]

# Beyond 1 and -3, the keys' ranges: every phase is below or above these thresholds.
ALWAYS, NEVER = np.float32(-4.0), np.float32(4.0)


@dataclass(frozen=True)
class KeyProfile:
    """A profile that a key decides.

    Attributes:
        key: of shares 0…1 of a turn, float64, any shape.
        arrows: whether the sign of the phase counts: cyclic.
    """

    key: Callable[[NDArray[Any]], Floats]
    arrows: bool

    @property
    def humps(self) -> int:
        """As of Profile."""
        return 1

    def rank_table(self, noise: Noise) -> RankTable | None:
        """None: the key says it all."""
        return None

    def thresholds(self, cumulative: NDArray[Any]) -> NDArray[np.float32]:
        """The key at each cumulative ratio, or a plain fill where it is <= 0 or >= 1 within rounding.

        Args:
            cumulative: shares of all materials up to one, 0…1, any shape.
        """
        c = np.ascontiguousarray(cumulative, np.float64)
        return plain_fills(c, self.key(c).astype(np.float32), NEVER, ALWAYS)

    def amplitudes(self, low: ArrayLike, high: ArrayLike, harmonics: int) -> Floats:
        """As of Profile."""
        h = np.pi * np.arange(1, harmonics + 1)
        low, high = (np.asarray(v, np.float64)[..., None] for v in (low, high))
        if self.arrows:
            return np.asarray(2 * np.sin(h * (high - low)) / h)
        return np.asarray(2 * (np.sin(h * high) - np.sin(h * low)) / h)

    def over_values(self, until: Callable[[Floats], Floats], low: ArrayLike, high: ArrayLike) -> Floats:
        """As of Profile: a material is all between two shares."""
        return np.asarray(until(np.asarray(high, np.float64)) - until(np.asarray(low, np.float64)))[None]

    def levels(self, shares: Floats, blend: float = 0.0) -> Floats:
        """As of Profile: the cosine in the middle of each material's share of a turn."""
        middle = np.cumsum(shares) - shares / 2
        return np.asarray(np.cos((2 if self.arrows else 1) * np.pi * middle))


def symmetric_key(share: NDArray[Any]) -> Floats:
    """cos(πc)·|cos(πc)|: from 1 to -1."""
    cosine = np.cos(np.pi * share)
    return np.asarray(cosine * np.abs(cosine))


def cyclic_key(share: NDArray[Any]) -> Floats:
    """cos(2πc)·|cos(2πc)| in the first half of a turn, its mirror image at -1 in the second: from 1 to -3."""
    key = symmetric_key(2 * share)
    return np.where(share <= 0.5, key, -2 - key)


SYMMETRIC, CYCLIC = KeyProfile(symmetric_key, arrows=False), KeyProfile(cyclic_key, arrows=True)
