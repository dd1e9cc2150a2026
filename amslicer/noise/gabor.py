"""Gabor noise (Lagae et al. 2009, 2011): the real part of a sum of Gabor kernels, which is nearly Gaussian.

N(x) = Re G(x) = Σ_j exp(-π b² |x - x_j|²) cos(k_j·(x - x_j) + φ_j): the field of phasor noise with more kernels, of
which the value is read, not the phase. Sheets fade out and in where the intensity |G| does, so they are less regular
than phasor noise's; materials are what lies above a level, so the ratio follows from the distribution of values:

    σ² = λ ∫g² = Λ 2^(-d/2)/2,   excess kurtosis κ = (1.5/Λ) (1 - 2η)      (random phases, unit weights),

    η = η₁^d,   η₁ = 2 ∫₀¹ (1 - t) exp(-π β² t²) dt = erf(√π β)/β - (1 - exp(-π β²))/(π β²),   β = b × side of a cell,

(λ ∫g⁴/σ⁴ = 1.5/Λ would be that of independent places; cells with a fixed number of kernels each are more even)
and the level with a share c of the values above it is σ (t + κ (t³ - 3t)/24), t = Φ⁻¹(1 - c) (Cornish and Fisher 1938).
Kernels of any width have the same variance, for there are Λ of them per b^-d.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from amslicer.noise.phasor import Phasor

if TYPE_CHECKING:
    from numpy.typing import NDArray

# So that values are nearly Gaussian.
DEFAULT_IMPULSES = 12.0


@dataclass(frozen=True)
class Gabor(Phasor):
    """Gabor noise of one bandwidth; attributes as of Phasor."""

    impulses: float = DEFAULT_IMPULSES
    reads: ClassVar[str] = "value"

    @property
    def deviation(self) -> float:
        """σ of Re G."""
        return float(np.sqrt(self.impulses * 2.0 ** (-self.dimensions / 2) / 2))

    @property
    def kurtosis(self) -> float:
        """κ, excess, of Re G."""
        from math import erf, exp, pi, sqrt

        beta = self.cells(0).side_mm * self.bandwidth / self.periods_mm[0]
        even = (erf(sqrt(pi) * beta) / beta - (1 - exp(-pi * beta**2)) / (pi * beta**2)) ** self.dimensions
        return 1.5 / self.impulses * (1 - 2 * even)

    def levels_of(self, cumulative: NDArray[Any]) -> NDArray[np.float64]:
        """The value that a share of all values, 0…1, lies above: -∞ for 1, +∞ for 0; any shape."""
        from scipy.special import ndtri

        t = -ndtri(np.asarray(cumulative, np.float64))
        finite = np.isfinite(t)
        inner = np.where(finite, t, 0.0)
        corrected = inner + self.kurtosis * (inner**3 - 3 * inner) / 24
        return np.asarray(self.deviation * np.where(finite, corrected, t))
