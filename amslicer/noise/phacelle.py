"""Phacelle noise (2026): one splat in each cell, with the direction painted at it; or, simple, at the pixel.

G(x) = Σ_j w(d_j) exp(i (k_j·(x - x_j) + φ_j)),   w(d) = max(0, exp(-2 d²) - exp(-2·1.5²)),

d in cells. The weight reaches 0 at 1.5 cells, the distance from a point to the nearest splat that a window of 4 × 4
cells around the nearest cell corner may leave out: no weight is cut off, and at most 16 splats (64 in space) count at a
point. Here the window is a splat's support. Unlike in the original, phases are random, so that arg G is exactly uniform
and the expected ratio the painted one.

A Gaussian exp(-π b² |x|²) is as wide as exp(-2 d²) where a cell's side is √(2/π)/b: `bandwidth` means what it means for
phasor noise. There are 1.6 splats per b^-2 (2.0 per b^-3), more evenly placed. Cells have one size: of a graded period,
the geometric mean's; the carrier is the painted one.

Simple Phacelle noise reads the direction once per pixel, for all splats: k(x) in place of k_j. The further a splat, the
more a direction that turns moves its waves, so sheets keep their painted direction to the pixel and their period less
well; where the painted direction jumps, so does G. Of k and -k, which are one laminate, the one's G must be the other's
conjugate: a splat whose painted normal points against k(x) has -φ_j.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from amslicer.noise.kernels import Cells
from amslicer.noise.phasor import Phasor
from amslicer.noise.turn import turned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.kernels import CellLayer, Generator, Kernels, Paint

    Floats = NDArray[np.float64]

REACH_CELLS = 1.5
SAMPLES = 1024  # of the weight over d²
CELL_SQUARED = 2 / pi  # of a cell's side, in units of 1/b²


@dataclass(frozen=True)
class Phacelle(Phasor):
    """Sampled Phacelle noise; attributes as of Phasor."""

    impulses: float = 1.0  # per cell; no other number is accepted
    reads: ClassVar[str] = "phase"
    keys: ClassVar[frozenset[str]] = frozenset({"lobes", "alignment"})

    @property
    def side_mm(self) -> float:
        """Of a cell."""
        shortest, longest = self.periods_mm
        return sqrt(CELL_SQUARED) * sqrt(shortest * longest) / self.bandwidth

    @property
    def envelope(self) -> NDArray[np.float32]:
        """w over (d/1.5)²."""
        squared = np.linspace(0.0, REACH_CELLS**2, SAMPLES + 1)
        return (np.exp(-2 * squared) - exp(-2 * REACH_CELLS**2)).astype(np.float32)

    @property
    def radius_mm(self) -> float:
        """Where the weight reaches 0."""
        return REACH_CELLS * self.side_mm

    @property
    def density(self) -> float:
        """Splats per mm^dimensions."""
        return float(self.side_mm**-self.dimensions)

    def cells(self, level: int) -> Cells:
        """One splat in each."""
        return Cells(self.side_mm, 1, self.dimensions)

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> list[CellLayer]:
        """The layers of cells whose splats can reach these heights."""
        return [(0, n) for n in self.cells(0).cell_layers(low_z_mm - self.radius_mm, high_z_mm + self.radius_mm)]

    def kernels(self, draw: Generator, cell_layer: CellLayer, low_mm: Floats, high_mm: Floats, paint: Paint) -> Kernels:
        """The splats of one layer of cells that reach a rectangle, in cell order."""
        reach = self.radius_mm
        place, phase, choice = self.cells(0).impulses(
            draw,
            self.seed,
            cell_layer[1],
            low_mm - reach,
            high_mm + reach,
            choices=self.lobes is not None,
        )
        period = np.clip(paint.periods(place), *self.periods_mm)
        width, radius = (np.full(len(place), v) for v in (sqrt(CELL_SQUARED) / self.side_mm, reach))
        return self._painted(draw, paint, place, phase, choice[:, 1], period, width, radius)


@dataclass(frozen=True)
class SimplePhacelle(Phacelle):
    """Simple Phacelle noise; attributes as of Phasor, without lobes."""

    at_nodes: ClassVar[bool] = True
    keys: ClassVar[frozenset[str]] = frozenset({"alignment"})

    def waves_at(self, draw: Generator, paint: Paint, places_mm: Floats) -> Floats:
        """(N, 3) k(x) at places, turned as isotropy says."""
        normal = paint.normals(places_mm)
        if not paint.is_laminate:
            width = np.full(len(places_mm), sqrt(CELL_SQUARED) / self.side_mm)
            isotropy = paint.isotropies(places_mm)
            normal = turned(normal, isotropy, places_mm, width, self.dimensions, self.seed, draw)
        period = np.clip(paint.periods(places_mm), *self.periods_mm)
        return np.asarray(normal * (2 * np.pi / period)[:, None])
