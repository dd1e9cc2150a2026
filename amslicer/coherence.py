"""How far a material's share of a window scatters where all that is known is how alike places are at a distance.

Of a Gaussian value's level set, as of any function of it, the correlation is at most that of the value, |γ(d)|: each
term of its Hermite series has a power of it. So the variance of a share ρ is at most ρ (1 - ρ) times the mean of |γ|
over pairs of places in the window.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

Coherence = Callable[["Floats"], "Floats"]
NODES = {2: 48, 3: 24}  # of the quadrature along each side, dense near 0
DIGITS = 2  # of sides that count as equal
SIGMAS = 4.5  # of an honest stack's worst window
PIXEL_SHARE = 0.5  # pixels that an edge passes through fall to either side: n of them scatter by about ½/√n


def share_deviation(share: Floats, sides_mm: Floats, coherence: Coherence) -> Floats:
    """(W, M) at most this standard deviation of a material's share of a box.

    Args:
        share: (W, M) painted.
        sides_mm: (W, 2) in the plane, or (W, 3).
        coherence: |γ| at distances in mm.
    """
    rounded = np.array([[float(f"{side:.{DIGITS - 1}e}") for side in row] for row in sides_mm])
    unique, number = np.unique(rounded, axis=0, return_inverse=True)
    alike = np.array([mean_coherence(row, coherence) for row in unique])[number.reshape(-1)]
    return np.asarray(np.sqrt(share * (1 - share) * alike[:, None]))


def mean_coherence(sides_mm: Floats, coherence: Coherence) -> float:
    """The mean of |γ| over pairs of places in a box: distances along a side have a triangular law."""
    node, weight = np.polynomial.legendre.leggauss(NODES[len(sides_mm)])
    s, w = (node + 1) / 2, weight / 2
    share, density = s**3, w * 3 * s**2 * 2 * (1 - s**3)
    grids = np.meshgrid(*(share * side for side in sides_mm), indexing="ij")
    densities = np.meshgrid(*[density] * len(sides_mm), indexing="ij")
    distance = np.sqrt(np.sum(np.square(grids), axis=0))
    return float(min(1.0, np.sum(coherence(distance) * np.prod(densities, axis=0))))
