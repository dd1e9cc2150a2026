"""From phase to material: the thresholds of a profile, apart from the noise that makes the phase.

PWM of two materials and its symmetric extension to several: with cumulative ratios 0 = c0 <= … <= cM = 1,
material m where |ϕ|/π is in [c(m-1), cm), ϕ = arg G. Since cos falls on 0…π, |ϕ| >= π c is Re G <= cos(π c) |G|:
no angle is ever computed. The device compares squares with their signs; a ratio of 0 or 1 is a plain fill.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

# Beyond ±1, the squared cosine's range: every phase is below or above these thresholds.
ALWAYS, NEVER = np.float32(-2.0), np.float32(2.0)


def symmetric_thresholds(cumulative: NDArray[Any]) -> NDArray[np.float32]:
    """cos(πc)·|cos(πc)| for each cumulative ratio, or a plain fill where c <= 0 or >= 1 within rounding.

    Args:
        cumulative: shares of all materials up to one, 0…1, any shape.
    """
    c = np.ascontiguousarray(cumulative, np.float64)
    cosine = np.cos(np.pi * c)
    thresholds = (cosine * np.abs(cosine)).astype(np.float32)
    rounding = np.finfo(np.float32).eps
    thresholds[c <= rounding] = NEVER
    thresholds[c >= 1 - rounding] = ALWAYS
    return thresholds


# pwm is the two-material name of symmetric; `cyclic` will have thresholds of its own.
PROFILES = {"pwm": symmetric_thresholds, "symmetric": symmetric_thresholds}
