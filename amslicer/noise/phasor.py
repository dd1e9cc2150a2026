"""Phasor noise (Tricard et al. 2019, "Procedural Phasor Noise"): G = Σ_j a_j(x) exp(i (k_j·(x - x_j) + φ_j)).

a_j(x) = exp(-π b² |x - x_j|²), (6); k_j = (2π/p) n_j with the painted normal n_j at x_j, (14, 15). Unlike the
paper's, the phases φ_j are random: then arg G is exactly uniform at every point, and the expected ratio of
any profile is the painted one.

The painted period p_j = p(x_j) may vary: candidates at the density of the shortest period are taken with probability
(p_min/p_j)^d, so that there are always Λ kernels per (B/p)^-d. Isotropy turns n_j at random (amslicer/noise/turn.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.noise.kernels import Cells, Kernels
from amslicer.noise.turn import turned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.kernels import Generator, Paint

    Floats = NDArray[np.float64]

# Kernels per bandwidth^dimensions: from 2 on, direction, spectrum and ratio no longer depend on it; 1 leaves
# empty places.
DEFAULT_IMPULSES = 4.0
# Relative RMS error of cutting a kernel at its radius (Lagae et al. 2011, section IV).
TRUNCATION_ERROR = 1e-3


@dataclass(frozen=True)
class Phasor:
    """Phasor noise of one bandwidth.

    Attributes:
        periods_mm: the shortest and the longest period p, > 0.
        bandwidth: B, relative to 1/p: b = B/p in 1/mm.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
        impulses: kernels per b^dimensions.
    """

    periods_mm: tuple[float, float]
    bandwidth: float
    dimensions: int
    seed: int
    impulses: float = DEFAULT_IMPULSES

    @property
    def radius_mm(self) -> float:
        """Where the widest kernels are cut."""
        return truncation_radius(self.bandwidth / self.periods_mm[1], self.dimensions, TRUNCATION_ERROR)

    @property
    def density(self) -> float:
        """The most kernels per mm^dimensions."""
        return self.impulses * (self.bandwidth / self.periods_mm[0]) ** self.dimensions

    @property
    def cells(self) -> Cells:
        """Cells of about one (narrowest) envelope width, a whole number of candidates in each."""
        per_cell = max(1, round(self.impulses))
        side = (per_cell / self.impulses) ** (1 / self.dimensions) / (self.bandwidth / self.periods_mm[0])
        return Cells(side, per_cell, self.dimensions)

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> range:
        """The layers of cells whose kernels can reach these heights."""
        return self.cells.cell_layers(low_z_mm - self.radius_mm, high_z_mm + self.radius_mm)

    def kernels(self, draw: Generator, cell_layer: int, low_mm: Floats, high_mm: Floats, paint: Paint) -> Kernels:
        """The kernels of one layer of cells that reach a rectangle, in cell order.

        Raises:
            JobError: a painted field is not usable at a kernel's centre.
        """
        farthest = self.radius_mm
        shortest, longest = self.periods_mm
        place, phase, choice = self.cells.impulses(
            draw, self.seed, cell_layer, low_mm - farthest, high_mm + farthest, thinned=shortest < longest
        )
        period = np.clip(paint.periods(place), shortest, longest)  # bounds may differ from values by rounding
        radius = farthest * (period / longest)
        taken = choice < (shortest / period) ** self.dimensions
        taken &= np.all((place[:, :2] + radius[:, None] > low_mm) & (place[:, :2] - radius[:, None] < high_mm), axis=1)
        place, phase, period, radius = place[taken], phase[taken], period[taken], radius[taken]
        normal = paint.normals(place)
        width = self.bandwidth / period
        direction = normal
        if not paint.is_laminate:
            direction = turned(normal, paint.isotropies(place), place, width, self.dimensions, self.seed, draw)
        return Kernels(
            centre_mm=place,
            wave=direction * (2 * np.pi / period)[:, None],
            phase=phase,
            decay=np.pi * width**2,
            radius_mm=radius,
            normal=normal,
        )


def truncation_radius(width: float, dimensions: int, error: float) -> float:
    """Radius at which cutting exp(-π b² r²) leaves this relative RMS error (Lagae et al. 2011, section IV).

    e² = 1 - ∫₀^r g² dV / ∫₀^∞ g² dV: in 2D e = exp(-π b² r²); in 3D e² = erfc(q) + (2/√π) q exp(-q²),
    q² = 2π b² r².

    Args:
        width: b, 1/mm.
        dimensions: 2 or 3.
        error: relative RMS error, 0 < error < 1.
    """
    if dimensions == 2:
        return float(np.sqrt(-np.log(error) / np.pi) / width)
    low, high = 0.0, 20.0  # q; erfc(20) is far below any error that float64 can ask for
    while high - low > 1e-12:
        middle = (low + high) / 2
        low, high = (middle, high) if _error_3d(middle) > error else (low, middle)
    return float(low / np.sqrt(2 * np.pi) / width)


def _error_3d(q: float) -> float:
    from math import erfc, exp, pi, sqrt

    return sqrt(erfc(q) + 2 / sqrt(pi) * q * exp(-q * q))
