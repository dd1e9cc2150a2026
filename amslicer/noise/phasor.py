"""Phasor noise (Tricard et al. 2019, "Procedural Phasor Noise"): G = Σ_j a_j(x) exp(i (k_j·(x - x_j) + φ_j)).

a_j(x) = exp(-π b² |x - x_j|²), (6); k_j = (2π/p) n_j with the painted normal n_j at x_j, (14, 15). Unlike the
paper's, the phases φ_j are random: then arg G is exactly uniform at every point, and the expected ratio of
any profile is the painted one.

The painted period p_j = p(x_j) may vary: each level l has candidates as dense as p_l = 2^l p_min asks for; those with
p_l <= p_j < 2 p_l are kernels with probability (p_l/p_j)^d. So there are always Λ kernels per (B/p)^-d, levels meet
without a seam, and no kernel of a level reaches twice as far as its narrowest. Where the period steps, the envelope
has a period of its own, q_j <= p_j, that grows no faster than distance allows (amslicer/envelope.py), so that wide
kernels do not reach over fine sheets; density and level follow q_j, the carrier p_j. Isotropy turns n_j at random
(amslicer/noise/turn.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from amslicer.noise.bands import Band
from amslicer.noise.kernels import Cells, Kernels
from amslicer.noise.setting import OneReading, Setting
from amslicer.noise.turn import turned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.kernels import CellLayer, Generator, Paint
    from amslicer.noise.lobes import Lobes
    from amslicer.specification import Pattern

    Floats = NDArray[np.float64]

# Kernels per bandwidth^dimensions: from 2 on, direction, spectrum and ratio no longer depend on it; 1 leaves
# empty places.
DEFAULT_IMPULSES = 4.0
# Relative RMS error of cutting a kernel at its radius (Lagae et al. 2011, section IV).
TRUNCATION_ERROR = 1e-3


@dataclass(frozen=True)
class Phasor(OneReading):
    """Phasor noise of one bandwidth.

    Attributes:
        periods_mm: the shortest and the longest period p, > 0.
        bandwidth: B, relative to 1/p: b = B/p in 1/mm.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
        impulses: kernels per b^dimensions.
        lobes: several directions at a place; None: the painted one.
    """

    periods_mm: tuple[float, float]
    bandwidth: float
    dimensions: int
    seed: int
    impulses: float = DEFAULT_IMPULSES
    lobes: Lobes | None = None
    reads: ClassVar[str] = "phase"
    directed: ClassVar[bool] = True
    at_nodes: ClassVar[bool] = False
    made_of: ClassVar[str] = "kernels"
    keys: ClassVar[frozenset[str]] = frozenset({"impulses", "lobes", "alignment"})

    @classmethod
    def of_pattern(cls, pattern: Pattern, setting: Setting) -> Self:
        """The noise that a job's pattern asks for."""
        given = {} if pattern.impulses is None else {"impulses": pattern.impulses}
        return cls(
            periods_mm=setting.periods_mm, bandwidth=pattern.bandwidth, dimensions=pattern.dimensions,
            seed=pattern.seed, lobes=setting.lobes, **given,
        )  # fmt: skip

    @property
    def likeness(self) -> None:
        """More is known."""
        return None

    @property
    def band(self) -> Band | None:
        """The kernels' frequencies; None where a direction that jumps makes G jump."""
        return None if self.at_nodes else Band(self.periods_mm, self.bandwidth)

    @property
    def envelope(self) -> NDArray[np.float32] | None:
        """None: Gaussians."""
        return None

    def levels_of(self, cumulative: NDArray[Any]) -> Floats:
        """Not of a noise whose phase is read."""
        raise NotImplementedError

    def waves_at(self, draw: Generator, paint: Paint, places_mm: Floats) -> Floats:
        """Not of a noise whose kernels have directions of their own."""
        raise NotImplementedError

    @property
    def radius_mm(self) -> float:
        """Where the widest kernels are cut."""
        return truncation_radius(self.bandwidth / self.periods_mm[1], self.dimensions, TRUNCATION_ERROR)

    @property
    def density(self) -> float:
        """The most kernels per mm^dimensions."""
        return self.impulses * (self.bandwidth / self.periods_mm[0]) ** self.dimensions

    @property
    def levels(self) -> int:
        """How many octaves the painted periods span, 1 for a single one."""
        return int(self._level(np.array([self.periods_mm[1]]))[0]) + 1

    def cells(self, level: int) -> Cells:
        """Cells of about one (narrowest) envelope width of the level, a whole number of candidates in each."""
        per_cell = max(1, round(self.impulses))
        width = self.bandwidth / (self.periods_mm[0] * 2**level)
        return Cells((per_cell / self.impulses) ** (1 / self.dimensions) / width, per_cell, self.dimensions, level)

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> list[CellLayer]:
        """The layers of cells whose kernels can reach these heights: (level, layer of cells)."""
        found = []
        for level in range(self.levels):
            reach = self._reach(level)
            found += [(level, n) for n in self.cells(level).cell_layers(low_z_mm - reach, high_z_mm + reach)]
        return found

    def kernels(self, draw: Generator, cell_layer: CellLayer, low_mm: Floats, high_mm: Floats, paint: Paint) -> Kernels:
        """The kernels of one layer of cells that reach a rectangle, in cell order.

        Raises:
            JobError: a painted field is not usable at a kernel's centre.
        """
        level, number = cell_layer
        shortest, longest = self.periods_mm
        farthest = self._reach(level)
        place, phase, choice = self.cells(level).impulses(
            draw,
            self.seed,
            number,
            low_mm - farthest,
            high_mm + farthest,
            choices=shortest < longest or self.lobes is not None,
        )
        period = np.clip(paint.periods(place), shortest, longest)  # bounds may differ from values by rounding
        envelope = np.clip(paint.envelope_periods(place, period), shortest, period)
        radius = self.radius_mm * (envelope / longest)
        taken = self._level(envelope) == level
        taken &= choice[:, 0] < (shortest * 2**level / envelope) ** self.dimensions
        taken &= np.all((place[:, :2] + radius[:, None] > low_mm) & (place[:, :2] - radius[:, None] < high_mm), axis=1)
        place, phase, lobe, period, envelope, radius = (
            a[taken] for a in (place, phase, choice[:, 1], period, envelope, radius)
        )
        return self._painted(draw, paint, place, phase, lobe, period, self.bandwidth / envelope, radius)

    def _painted(
        self, draw: Generator, paint: Paint, place: Floats, phase: Floats, lobe: Floats, period: Floats, width: Floats,
        radius: Floats,
    ) -> Kernels:  # fmt: skip
        """Kernels at places, with the direction painted there, turned as lobes and isotropy say."""
        normal = paint.normals(place)
        direction = normal if self.lobes is None else self.lobes.directions(normal, lobe)
        if not paint.is_laminate:
            direction = turned(direction, paint.isotropies(place), place, width, self.dimensions, self.seed, draw)
        return Kernels(
            centre_mm=place,
            wave=direction * (2 * np.pi / period)[:, None],
            phase=phase,
            decay=np.pi * width**2,
            radius_mm=radius,
            normal=normal,
        )

    def _level(self, period_mm: Floats) -> NDArray[np.int64]:
        """l with 2^l <= period/shortest < 2^(l + 1)."""
        return np.asarray(np.frexp(period_mm / self.periods_mm[0])[1] - 1, dtype=np.int64)

    def _reach(self, level: int) -> float:
        """Where the widest kernels of a level are cut."""
        shortest, longest = self.periods_mm
        return float(self.radius_mm * (min(longest, shortest * 2 ** (level + 1)) / longest))


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
