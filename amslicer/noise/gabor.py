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

from dataclasses import dataclass, replace
from functools import cached_property
from math import erf, exp, pi, sqrt
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from amslicer.noise.distribution import above
from amslicer.noise.phasor import TRUNCATION_ERROR, Phasor, truncation_radius

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.kernels import CellLayer, Generator, Kernels, Paint

    Floats = NDArray[np.float64]

# So that values are nearly Gaussian.
DEFAULT_IMPULSES = 12.0
SAMPLES = 4096  # of an isotropic kernel over r²
RADII = 600  # places of a kernel for the law of its sums


@dataclass(frozen=True)
class Gabor(Phasor):
    """Gabor noise of one bandwidth; attributes as of Phasor."""

    impulses: float = DEFAULT_IMPULSES
    reads: ClassVar[str] = "value"
    keys: ClassVar[frozenset[str]] = frozenset({"impulses", "lobes"})

    @property
    def deviation(self) -> float:
        """σ of Re G."""
        return float(np.sqrt(self.impulses * 2.0 ** (-self.dimensions / 2) / 2))

    @property
    def kurtosis(self) -> float:
        """κ, excess, of Re G."""
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


@dataclass(frozen=True)
class IsotropicGabor(Phasor):
    """Gabor noise of kernels without a direction (Lagae et al. 2011, section III); attributes as of Phasor.

    With F = 1/p the kernels are exp(-π b² r²) J₀(2πF r) in the plane and exp(-π b² r²) sin(2πF r)/(2πF r) in space: the
    mean of a Gabor kernel over all directions. The painted direction and isotropy mean nothing to them. Where the
    period steps, F follows the envelope's period (amslicer/envelope.py).
    """

    impulses: float = DEFAULT_IMPULSES
    reads: ClassVar[str] = "value"
    keys: ClassVar[frozenset[str]] = frozenset({"impulses"})
    directed: ClassVar[bool] = False

    @property
    def envelope(self) -> NDArray[np.float32] | None:
        """w over (r/radius)²; the same for all periods, since b = B/p."""
        r = np.sqrt(np.linspace(0.0, 1.0, SAMPLES + 1)) * truncation_radius(
            self.bandwidth, self.dimensions, TRUNCATION_ERROR
        )
        w = isotropic_kernel(r, self.bandwidth, self.dimensions)
        w[-1] = 0.0
        return w.astype(np.float32)

    @property
    def deviation(self) -> float:
        """σ: λ ∫w²/2, with ∫w² in closed form (section III, scaled)."""
        return float(np.sqrt(self.impulses * self.bandwidth**self.dimensions * self._energy / 2))

    @property
    def _energy(self) -> float:
        """∫w² of the period 1."""
        from scipy.special import ive

        b = self.bandwidth
        if self.dimensions == 2:
            return float(ive(0, np.pi / b**2) / (2 * b**2))
        return float(np.sqrt(2) * (1 - np.exp(-2 * np.pi / b**2)) / (8 * np.pi * b))

    def levels_of(self, cumulative: NDArray[Any]) -> NDArray[np.float64]:
        """As Gabor's, by the exact distribution of independent kernels: they are peaked, and far from Gaussian.

        The characteristic function of Re G is exp(λ ∫ (J₀(u w) - 1)), inverted numerically (Gil-Pelaez 1951).
        """
        values, above = self._distribution
        c = np.asarray(cumulative, np.float64)
        inner = np.interp(-c, -above, values)
        return np.where(c <= 0, np.inf, np.where(c >= 1, -np.inf, inner))

    @cached_property
    def _distribution(self) -> tuple[Floats, Floats]:
        """Values of Re G, rising, and the shares of all values that lie above them."""
        from scipy.special import j0

        density = self.impulses * self.bandwidth**self.dimensions
        r = np.linspace(0.0, truncation_radius(self.bandwidth, self.dimensions, TRUNCATION_ERROR), RADII)
        area = 2 * np.pi * r if self.dimensions == 2 else 4 * np.pi * r**2
        w = isotropic_kernel(r, self.bandwidth, self.dimensions)

        def characteristic(u: Floats) -> Floats:
            return np.asarray(np.exp(density * np.trapezoid((j0(u[:, None] * w) - 1) * area, r, axis=1)))

        return above(characteristic, self.deviation)

    def kernels(self, draw: Generator, cell_layer: CellLayer, low_mm: Floats, high_mm: Floats, paint: Paint) -> Kernels:
        """As phasor noise's, without waves."""
        found = super().kernels(draw, cell_layer, low_mm, high_mm, paint)
        return replace(found, wave=np.zeros_like(found.wave))


def isotropic_kernel(r: Floats, bandwidth: float, dimensions: int) -> Floats:
    """w at distances r, in periods."""
    from scipy.special import j0

    wave = j0(2 * np.pi * r) if dimensions == 2 else np.sinc(2 * r)
    return np.asarray(np.exp(-np.pi * (bandwidth * r) ** 2) * wave)
