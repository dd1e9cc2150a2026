"""Sparse convolution: what a noise hands to the evaluator, and the hashed cells that its impulses come from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.likeness import Likeness
    from amslicer.noise.alignment import Neighbours
    from amslicer.noise.bands import Band, TabledBand

    Floats = NDArray[np.float64]

WORD = 2.0**-32  # random words to [0, 1)
# The fourth word of a counter says what its random words are for: no two uses can share a stream.
# + 65536 × level + number in the cell: place and phase of an impulse; whether a candidate is one, and its lobe.
IMPULSES, CHOICE = 0, 1 << 30
LEVEL = 1 << 16
TURN_PLACES, TURN_WEIGHTS = 2 << 30, 3 << 30  # + 256 × level (8 bits) + number in the cell: amslicer/noise/turn.py
# 1 << 28 is wave noise's (amslicer/noise/waves.py), 3 << 29 that of dithered edges (amslicer/block.py).


CellLayer = tuple[int, int]
"""A layer of cells: its level, and its number from the part's lowest corner."""


class Generator(Protocol):
    """Random words and sums over random points, on a device or in plain NumPy."""

    def words(
        self, first: tuple[int, int, int], count: tuple[int, int, int], per_cell: int, seed: int, number: int
    ) -> NDArray[np.uint32]:
        """The random words of a box of cells: counters (cell x, y, z, number + 0 … per_cell - 1).

        Args:
            first: the box's first cell (x, y, z).
            count: cells along x, y, z.

        Returns:
            (cells z, cells y, cells x, per_cell, 4) uint32.
        """

    def normal_fields(
        self, places: Floats, cells: NDArray[np.int64], points: NDArray[np.float32], weights: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Random fields that are N(0, 1) at each place: Σ γ_m g_m / √Σ g_m², g_m = exp(-π d²), over the points
        within two cells.

        Args:
            places: (N, 3) within their cells, in cells: 0…1.
            cells: (N, 3) their cells, counted from the box's first; two cells of the box lie beyond each.
            points: (cells z, cells y, cells x, per cell, 3) points within their cells, in cells.
            weights: (cells z, cells y, cells x, per cell, 4) γ, N(0, 1), of up to four independent fields.

        Returns:
            (N, 4).
        """

    def aligned(
        self, neighbours: Neighbours, z: NDArray[np.complex64], known: NDArray[np.bool_], sweeps: int
    ) -> NDArray[np.complex64]:
        """exp(iφ) of kernels after phase alignment: first those not known from those that are, then sweeps of all.

        Args:
            neighbours: the kernels, sorted.
            z: (N,) exp(iφ) before, in the same order.
            known: (N,) which of them are aligned at a coarser level.
        """


class Paint(Protocol):
    """What noise reads of the painted fields, at (N, 3) places in the pattern frame, mm."""

    def normals(self, points_mm: Floats) -> Floats:
        """(N, 3) unit normals in printer axes."""

    def isotropies(self, points_mm: Floats) -> Floats:
        """(N,) 0 laminate … 1 isotropic."""

    def periods(self, points_mm: Floats) -> Floats:
        """(N,) mm."""

    def envelope_periods(self, points_mm: Floats, periods_mm: Floats) -> Floats:
        """(N,) mm, at most the periods: what a kernel's width follows."""

    @property
    def period_bounds_mm(self) -> tuple[float, float]:
        """No period is shorter than the first or longer than the second."""

    @property
    def is_laminate(self) -> bool:
        """Whether isotropy is 0 everywhere."""


@dataclass(frozen=True)
class Kernels:
    """N Gaussian kernels, in the fixed order of their cells: a_j(x) exp(i (k_j·(x - x_j) + φ_j)).

    Attributes:
        centre_mm: (N, 3) pattern frame; z is 0 in 2D.
        wave: (N, 3) wave vectors k, rad/mm; z is 0 in 2D.
        phase: (N,) φ, rad in [0, 2π).
        decay: (N,) 1/mm²: the envelope is exp(-decay |x - x_j|²).
        radius_mm: (N,) half side of the box outside which the kernel is zero.
        normal: (N, 3) the painted normal at the centre, with the sign that its source gives.
    """

    centre_mm: Floats
    wave: Floats
    phase: Floats
    decay: Floats
    radius_mm: Floats
    normal: Floats

    def __len__(self) -> int:
        return len(self.phase)

    def take(self, chosen: NDArray[np.bool_]) -> Kernels:
        """The chosen kernels, in the same order."""
        return Kernels(*(getattr(self, f.name)[chosen] for f in fields(self)))


class Noise(Protocol):
    """A noise with its parameters.

    Attributes:
        made_of: what it hands to whom evaluates it: "kernels" or "waves" (amslicer/pattern.py).
        reads: "phase": materials follow from arg G, which is uniform; "value": from Re G, and "power": from |G|², by
            its `levels_of`.
        directed: whether it follows the painted direction; else it is isotropic everywhere.
        band: the frequencies of G, which a lattice serves; None where there is no highest one: G is evaluated at the
            pixels themselves.
    """

    @property
    def made_of(self) -> str: ...

    @property
    def reads(self) -> str: ...

    @property
    def directed(self) -> bool: ...

    @property
    def band(self) -> Band | TabledBand | None: ...

    @property
    def dimensions(self) -> int:
        """2 or 3."""

    def levels_of(self, cumulative: NDArray[Any]) -> Floats:
        """The values that shares of all values, 0…1, lie above; of noises whose value or power is read."""

    @property
    def likeness(self) -> Likeness | None:
        """How alike places in a box are; None where phases or values of a laminate's band are read, of which more is
        known (amslicer/spread.py, amslicer/levelspread.py)."""


class KernelNoise(Noise, Protocol):
    """A noise made of kernels, ready to hand them out, one layer of cells after another.

    Attributes:
        impulses: kernels per bandwidth^dimensions.
        envelope: of kernels that are no products along the axes: values over (|d|/radius)², evenly from 0 to 1, the
            last one 0. None: Gaussians.
        at_nodes: whether kernels take the direction of the place where G is asked for (`waves_at`), not that of their
            centres: G is then not band-limited.
    """

    @property
    def impulses(self) -> float: ...

    @property
    def at_nodes(self) -> bool: ...

    @property
    def envelope(self) -> NDArray[np.float32] | None: ...

    @property
    def radius_mm(self) -> float:
        """No kernel reaches further along an axis."""

    @property
    def density(self) -> float:
        """The most kernels per mm^dimensions, where the period is shortest."""

    def waves_at(self, draw: Generator, paint: Paint, places_mm: Floats) -> Floats:
        """(N, 3) wave vectors, rad/mm, at (N, 3) places; of noises whose direction is that of the place."""

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> list[CellLayer]:
        """The layers of cells whose kernels can reach these heights: (level, layer of cells); one per level in 2D."""

    def kernels(self, draw: Generator, cell_layer: CellLayer, low_mm: Floats, high_mm: Floats, paint: Paint) -> Kernels:
        """The kernels of one layer of cells that reach a rectangle, in cell order.

        Args:
            draw: draws random numbers.
            cell_layer: one of those of `cell_layers`.
            low_mm, high_mm: (2,) corners of the rectangle, pattern frame.
            paint: the painted fields.
        """


def join_kernels(parts: Sequence[Kernels]) -> Kernels:
    """Several sets of kernels as one, in order."""
    return Kernels(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Kernels)))


@dataclass(frozen=True)
class Cells:
    """A grid of cells, anchored to the part's corner, with the same number of impulses in each.

    Attributes:
        side_mm: side of a cell.
        per_cell: impulses per cell.
        dimensions: 2 or 3; in 2D there is one layer of cells and z is 0.
        level: 0 … 255; another level, other random numbers.
    """

    side_mm: float
    per_cell: int
    dimensions: int
    level: int = 0

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> range:
        """The layers of cells that overlap these heights."""
        if self.dimensions == 2:
            return range(1)
        return range(math.floor(low_z_mm / self.side_mm), math.floor(high_z_mm / self.side_mm) + 1)

    def impulses(
        self, draw: Generator, seed: int, cell_layer: int, low_mm: Floats, high_mm: Floats, *, choices: bool
    ) -> tuple[Floats, Floats, Floats]:
        """The candidates of one layer of cells within a rectangle, in cell order.

        Args:
            choices: whether choices are drawn, which cost as much as the rest.

        Returns:
            Places (N, 3) in mm; phases (N,) in rad; choices (N, 2), uniform in [0, 1): whether a candidate is taken,
            and its lobe; 0 where none are drawn.
        """
        first = np.floor(low_mm / self.side_mm).astype(int)
        count = np.floor(high_mm / self.side_mm).astype(int) + 1 - first
        box = (int(first[0]), int(first[1]), cell_layer), (int(count[0]), int(count[1]), 1), self.per_cell, seed
        words = draw.words(*box, IMPULSES + LEVEL * self.level)
        z, y, x = np.meshgrid([cell_layer], *(first[a] + np.arange(count[a]) for a in (1, 0)), indexing="ij")
        cell = np.stack([x, y, z], axis=-1)[:, :, :, None, :]
        place = ((cell + words[..., :3] * WORD) * self.side_mm).reshape(-1, 3)
        phase = words[..., 3].astype(np.float64).reshape(-1) * (WORD * 2 * np.pi)
        choice = np.zeros((len(phase), 2))
        if choices:
            choice += draw.words(*box, CHOICE + LEVEL * self.level)[..., :2].reshape(-1, 2) * WORD
        if self.dimensions == 2:
            place[:, 2] = 0.0
        inside = np.all((place[:, :2] > low_mm) & (place[:, :2] < high_mm), axis=1)
        return place[inside], phase[inside], choice[inside]
