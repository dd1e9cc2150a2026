"""From phase to material: the thresholds of a profile, apart from the noise that makes the phase.

With cumulative ratios 0 = c0 <= … <= cM = 1 and ϕ = arg G, material m is where the profile's share of a turn is in
[c(m-1), cm), the last interval closed:

    symmetric (pwm: of two materials)   |ϕ|/π          A B C B A B C …   n and -n are the same
    cyclic                              ϕ/2π mod 1     A B C A B C …     in the direction of n

No angle is ever computed: a key falls as the share grows from 0 to 1, and its value at c, times |G|², is compared with
that of G. The symmetric key is cos·|cos| of the angle, from 1 to -1; the cyclic one goes on to -3 in the second half of
the turn. A ratio of 0 or 1 is a plain fill.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

# Beyond 1 and -3, the keys' ranges: every phase is below or above these thresholds.
ALWAYS, NEVER = np.float32(-4.0), np.float32(4.0)
ROUNDING = float(np.finfo(np.float32).eps)  # a ratio this close to 0 or 1 is a plain fill


@dataclass(frozen=True)
class Profile:
    """How a phase becomes one of several materials.

    Attributes:
        key: of shares 0…1 of a turn, float64, any shape.
        cyclic: whether the sign of the phase counts, so that the painted direction must be an arrow.
    """

    key: Callable[[NDArray[Any]], NDArray[np.float64]]
    cyclic: bool

    def thresholds(self, cumulative: NDArray[Any]) -> NDArray[np.float32]:
        """The key at each cumulative ratio, or a plain fill where it is <= 0 or >= 1 within rounding.

        Args:
            cumulative: shares of all materials up to one, 0…1, any shape.
        """
        c = np.ascontiguousarray(cumulative, np.float64)
        thresholds = self.key(c).astype(np.float32)
        thresholds[c <= ROUNDING] = NEVER
        thresholds[c >= 1 - ROUNDING] = ALWAYS
        return thresholds


def symmetric_key(share: NDArray[Any]) -> NDArray[np.float64]:
    """cos(πc)·|cos(πc)|: from 1 to -1."""
    cosine = np.cos(np.pi * share)
    return np.asarray(cosine * np.abs(cosine))


def cyclic_key(share: NDArray[Any]) -> NDArray[np.float64]:
    """cos(2πc)·|cos(2πc)| in the first half of a turn, its mirror image at -1 in the second: from 1 to -3."""
    key = symmetric_key(2 * share)
    return np.where(share <= 0.5, key, -2 - key)


# pwm is the two-material name of symmetric.
PROFILES = {
    "pwm": Profile(symmetric_key, cyclic=False),
    "symmetric": Profile(symmetric_key, cyclic=False),
    "cyclic": Profile(cyclic_key, cyclic=True),
}
