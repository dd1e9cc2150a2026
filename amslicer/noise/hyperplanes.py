"""Cells between random hyperplanes (Guehl et al. 2025, "Wave noise", section 6.3): walls, polytopes, divisions.

Families of stacked planes (lines in 2D) cut space. A family's slices are bounded by a stack of parallel planes; each
slice has its own stack of others, its waves, which end at the slice (Algorithm 2). Plane i of a stack of direction ω,
spacing W and offset o in [0, 1) lies where ω·x/W + o = i + 0.3 + 0.4 r_i. The values, of which material 1 takes the
highest, are

    cellular   -F(x), F the distance to the nearest plane: walls are where F < t/2;
    polytope   -u, u in [0, 1) hashed from the numbers of the slices and waves that x is in;
    stit       -F(x) after some cells were divided by the families of a next level: those with u < probability, and of
               their parts again, `depth` times at most. As in Nagel, Mecke, Ohser and Weiss (2008), but a level's
               planes go on from one divided cell to the next.

As planes end at walls only, F is the distance to the set of all walls: |F(x) - F(y)| <= |x - y|.

Laws, over all seeds; exact but for the 32 bits of random numbers. r_i, offsets and directions of different stacks are
independent, offsets uniform: the pattern is stationary, and a slice knows nothing of where its waves are. A place has
no plane of a stack within t/2 with probability

    S(t/W) = E max(0, 1 + 0.4 (r' - r) - t/W),  which is 1 - t/W up to t = 0.6 W and 0 from 1.4 W on,

and none of N families with S^2N: walls have the share 1 - S^2N; of "stit", 1 - Σ_d P(d) S^(2N (d + 1)), with
P(d) = π^d (1 - π) below the last depth and π the probability. A random line meets E|cos|/W planes of a stack per mm,
E|cos| being 2/π in 2D and 1/2 in 3D: W = 2N E|cos| p Σ_l π^l for the mean chord p of all cells that are left, of all
levels. In the plane, by Euler's formula, there are as many cells as crossings of lines; an end at a wall is half a
crossing, so that each two stacks, slices and their own waves included, have E|sin|/W² of them per area.

What one part has scatters around these laws, most of all of "stit", whose first cells are divided or not as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.noise.kernels import WORD

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.kernels import Generator

    Floats = NDArray[np.float64]

KINDS = ("cellular", "polytope", "stit")
# Fourth words of the counters, of the range (1 << 29) … (1 << 29) + (1 << 24) - 1 that no other use has
# (noise/kernels.py, noise/waves.py, block.py). The counters are
# (0, 0, family): across, upright, offset of the slices; (slice, 0, family): plane, and across, upright, offset of its
# waves; (wave, slice, family): plane, and two words of the cell's code; (code, code, level): u of the cell.
PLANES = 1 << 29
FAMILY, SLICE, WAVE, CELL = range(PLANES, PLANES + 4)
FAMILIES_PER_LEVEL = 256  # a family's name is this × level + its number
DIRECTIONS = 4  # 3 show as directions, more make needles where lines nearly agree
PROBABILITY, DEPTH = 0.7, 4  # as in Fig. 11 (d): four divisions after the first
JITTER = 0.4  # of a plane's place, in spacings: none are nearer than 0.6, none next to each other further than 1.4
SAMPLES = 1 << 14  # of the share of walls over their thickness: off by less than 1e-6


@dataclass(frozen=True)
class Stacks:
    """Stacks of parallel planes, in arrays of any shape.

    Attributes:
        direction: (..., 3) unit normals; z is 0 in 2D.
        offset: (...) o, in spacings, 0…1.
    """

    direction: Floats
    offset: Floats


@dataclass(frozen=True)
class Hyperplanes:
    """A pattern of cells between random hyperplanes.

    Attributes:
        kind: one of KINDS.
        period_mm: p, the mean distance from wall to wall along a line in a random direction, > 0.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
        directions: N, families of planes; of "stit", at each level. 1 … FAMILIES_PER_LEVEL.
        probability: of "stit": π, that a cell is divided further, 0…1.
        depth: of "stit": how often at most, ≥ 0.

    Raises:
        ValueError: another kind, or other dimensions.
    """

    kind: str
    period_mm: float
    dimensions: int
    seed: int
    directions: int = DIRECTIONS
    probability: float = PROBABILITY
    depth: int = DEPTH

    def __post_init__(self) -> None:
        if self.kind not in KINDS or self.dimensions not in (2, 3):
            raise ValueError(f"'{self.kind}' in {self.dimensions} dimensions: there are {', '.join(KINDS)} in 2 and 3")

    @property
    def levels(self) -> int:
        """Of families: one, and one for each division."""
        return self.depth + 1 if self.kind == "stit" else 1

    @property
    def numbered(self) -> bool:
        """Whether values are those of the cells that places are in, and not distances."""
        return self.kind == "polytope"

    @property
    def _active(self) -> Floats:
        """(levels,) share of places where each level's planes count."""
        return self.probability ** np.arange(self.levels, dtype=np.float64)

    @property
    def spacing_mm(self) -> float:
        """W, of all stacks."""
        cosine = 2 / pi if self.dimensions == 2 else 0.5
        return float(2 * self.directions * cosine * self._active.sum() * self.period_mm)

    def names(self) -> NDArray[np.int64]:
        """(levels × N,) third words of the families' counters, level by level."""
        level, number = np.divmod(np.arange(self.levels * self.directions), self.directions)
        return np.asarray(FAMILIES_PER_LEVEL * level + number)

    def slices(self, draw: Generator) -> Stacks:
        """(levels × N) stacks between which the slices of each family are."""
        names = self.names()
        words = draw.words((0, 0, 0), (1, 1, int(names[-1]) + 1), 1, self.seed, FAMILY)[names, 0, 0, 0]
        return self._stacks(words[:, :3], names)

    def waves(self, draw: Generator, name: int, first: int, count: int) -> tuple[Stacks, NDArray[np.uint32]]:
        """The stacks of waves in some slices of a family, and the random words (count,) of the planes below those.

        Args:
            name: of the family.
            first: number of the first slice, which is that of the plane below it.
        """
        words = draw.words((first, 0, name), (count, 1, 1), 1, self.seed, SLICE)[0, 0, :, 0]
        return self._stacks(words[:, 1:], np.full(count, name)), words[:, 0]

    def levels_of(self, cumulative: NDArray[Any]) -> Floats:
        """The value that a share of all values, 0…1, lies above: -∞ for 1, +∞ for 0; any shape."""
        c = np.asarray(cumulative, np.float64)
        level = -c if self.numbered else -self.wall_mm(c) / 2
        return np.where(c <= 0, np.inf, np.where(c >= 1, -np.inf, level))

    def wall_mm(self, share: NDArray[Any] | float) -> Floats:
        """t, the thickness of walls that take a share, 0…1, of all places; any shape.

        Raises:
            ValueError: polytopes have no walls.
        """
        if self.numbered:
            raise ValueError("polytopes have no walls")
        thickness, clear = self._table
        return np.asarray(np.interp(np.asarray(share, np.float64) - 1, -clear, thickness))

    @cached_property
    def _table(self) -> tuple[Floats, Floats]:
        """Thicknesses of walls, rising, and the share of places that are in none."""
        t = np.linspace(0.0, 1 + JITTER, SAMPLES + 1)
        of_a_level = clear_of_a_stack(t) ** (2 * self.directions)
        at_depth = self._active - np.append(self._active[1:], 0.0)
        clear = (at_depth * of_a_level[:, None] ** np.arange(1, self.levels + 1)).sum(axis=1)
        return t * self.spacing_mm, clear

    def cells_per_area(self) -> float:
        """Expected number of cells per mm², in 2D.

        Raises:
            ValueError: in 3D.
        """
        if self.dimensions == 3:
            raise ValueError("cells per area are known in 2D")
        overlay = [0.0, *(self._crossings(level + 1) for level in range(self.levels))]
        return float((self._active * np.diff(overlay)).sum()) / self.spacing_mm**2

    def _crossings(self, levels: int) -> float:
        """Of the lines of so many levels that all count, per W²: the sum of E|sin| over all pairs of stacks.

        Directions are uniform in sectors δ wide: E|sin| is sin(kδ) (sin(δ/2)/(δ/2))² of sectors k apart, and
        2 (1/δ - sin(δ)/δ²) within one.
        """
        n, width = self.directions, pi / self.directions
        same = 2 * (1 / width - sin(width) / width**2)
        # Of the N (N - 1)/2 pairs of sectors N - k are k apart, and Σ (N - k) sin(kδ) = N/2 Σ sin(kδ) = N/2 cot(δ/2).
        apart = n / 2 * cos(width / 2) / sin(width / 2) * (sin(width / 2) / (width / 2)) ** 2
        stacks = 2 * levels  # of each sector
        return stacks**2 * apart + n * stacks * (stacks - 1) / 2 * same

    def _stacks(self, words: NDArray[np.uint32], names: NDArray[np.int64]) -> Stacks:
        """Of (n, 3) random words: a direction of the family's part of the half circle or half sphere, and an offset."""
        across, upright, offset = (words * WORD).T
        number = names % FAMILIES_PER_LEVEL
        if self.dimensions == 2:
            azimuth, cosine = pi * (number + across) / self.directions, np.zeros(len(words))
        else:
            around, ring = np.divmod(number, self._rings)
            azimuth = 2 * pi * (around + across) * self._rings / self.directions
            cosine = (ring + upright) / self._rings
        sine = np.sqrt(1 - cosine**2)
        return Stacks(np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1), offset)

    @property
    def _rings(self) -> int:
        """Of the half sphere's parts, N_θ: the most with N_φ >= 2 N_θ, which are about as wide as high."""
        fitting = [r for r in range(1, self.directions + 1) if self.directions % r == 0 and 2 * r**2 <= self.directions]
        return max(fitting, default=1)


def clear_of_a_stack(thickness: Floats) -> Floats:
    """S: the share of places that no wall of a stack covers, of walls so thick; in spacings."""
    excess = np.abs(thickness - 1)  # of the gap's 1 + JITTER (r' - r), which has a triangular density
    beyond = np.maximum(JITTER - excess, 0.0) ** 3 / (6 * JITTER**2)
    return np.asarray(np.maximum(1 - thickness, 0.0) + beyond)
