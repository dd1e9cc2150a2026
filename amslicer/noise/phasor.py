"""Phasor noise (Tricard et al. 2019, "Procedural Phasor Noise"): G = Σ_j a_j(x) exp(i (k_j·(x - x_j) + φ_j)).

a_j(x) = exp(-π b² |x - x_j|²), (6); k_j = (2π/p) n_j with the painted normal n_j at x_j, (14, 15). Unlike the
paper's, the phases φ_j are random: then arg G is exactly uniform at every point, and the expected ratio of
any profile is the painted one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.noise.kernels import Cells, Kernels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.kernels import DrawWords, Normals

    Floats = NDArray[np.float64]

# Kernels per bandwidth^dimensions: from 2 on, direction, spectrum and ratio no longer depend on it; 1 leaves
# empty places.
DEFAULT_IMPULSES = 4.0
# Relative RMS error of cutting a kernel at its radius (Lagae et al. 2011, section IV).
TRUNCATION_ERROR = 1e-3


@dataclass(frozen=True)
class Phasor:
    """Phasor noise with one period and bandwidth.

    Attributes:
        period_mm: p, > 0.
        bandwidth: B, relative to 1/p: b = B/p in 1/mm.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
        impulses: kernels per b^dimensions.
    """

    period_mm: float
    bandwidth: float
    dimensions: int
    seed: int
    impulses: float = DEFAULT_IMPULSES

    @property
    def width_per_mm(self) -> float:
        """b of the envelope exp(-π b² r²), 1/mm."""
        return self.bandwidth / self.period_mm

    @property
    def radius_mm(self) -> float:
        """Where kernels are cut."""
        return truncation_radius(self.width_per_mm, self.dimensions, TRUNCATION_ERROR)

    @property
    def density(self) -> float:
        """Kernels per mm^dimensions."""
        return self.impulses * self.width_per_mm**self.dimensions

    @property
    def cells(self) -> Cells:
        """Cells of about one envelope width, a whole number of impulses in each."""
        per_cell = max(1, round(self.impulses))
        side = (per_cell / self.impulses) ** (1 / self.dimensions) / self.width_per_mm
        return Cells(side, per_cell, self.dimensions)

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> range:
        """The layers of cells whose kernels can reach these heights."""
        return self.cells.cell_layers(low_z_mm - self.radius_mm, high_z_mm + self.radius_mm)

    def kernels(self, draw: DrawWords, cell_layer: int, low_mm: Floats, high_mm: Floats, normals: Normals) -> Kernels:
        """The kernels of one layer of cells that reach a rectangle, in cell order."""
        radius = self.radius_mm
        place, phase = self.cells.impulses(draw, self.seed, cell_layer, low_mm - radius, high_mm + radius)
        normal = normals(place)
        return Kernels(
            centre_mm=place,
            wave=normal * (2 * np.pi / self.period_mm),
            phase=phase,
            decay=np.full(len(phase), np.pi * self.width_per_mm**2),
            radius_mm=np.full(len(phase), radius),
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
