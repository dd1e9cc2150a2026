"""How much further shares scatter where several lobes are in resonance: amslicer/spread.py for more than one direction.

Materials follow from G by something that is not linear, so that waves of three lobes make one of u_i - u_j + u_k. Where
that is slow – of lobes 60° apart it is 0 – it adds noise that no window averages out: to the variance of a share c
about RESONANCE c(1 - c) w_i w_j w_k times what its wave, enveloped by all three, has left in the window; w are the
lobes' shares of the power.
"""

from __future__ import annotations

from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np

from amslicer.spread import harmonic_variance

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

# Measured at bandwidths 0.25 and 0.5, ratios 0.2 and 0.5, in windows of 3 to 12 periods, of three to six lobes: up to
# 0.35 for phases and 0.49 for values.
RESONANCE = 0.5
TRIPLE = 3  # envelopes that enclose a resonance: r³


def resonance_deviation(
    low: ArrayLike, high: ArrayLike, *, lobes: Floats, shares: Floats, bandwidth: float, window_periods: ArrayLike
) -> Floats:
    """Standard deviation of a material's share of box windows from resonances of lobes; 0 of one or two.

    Args:
        low, high: (..., materials) cumulative ratios c(m-1) and c(m).
        lobes: (..., L, 3) unit vectors, as they point (amslicer/noise/lobes.py).
        shares: (L,) of the kernels, which sum to 1.
        bandwidth: B, relative to 1/period.
        window_periods: (..., 2) or (..., 3) sides of the windows in periods.
    """
    share = np.asarray(high, np.float64) - np.asarray(low, np.float64)
    sides = np.asarray(window_periods, np.float64)
    triples = [(i, j, k) for i, j, k in permutations(range(lobes.shape[-2]), 3) if i < k]
    total = np.zeros(lobes.shape[:-2])
    for i, j, k in triples:
        wave = lobes[..., i, :] - lobes[..., j, :] + lobes[..., k, :]
        own = harmonic_variance(TRIPLE, sides, wave[..., : sides.shape[-1]], bandwidth)
        total = total + shares[i] * shares[j] * shares[k] * own
    return np.sqrt(RESONANCE * share * (1 - share) * np.minimum(total, 1.0)[..., None])
