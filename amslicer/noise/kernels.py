"""Sparse convolution: what a noise hands to the evaluator, and the hashed cells that its impulses come from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    # (first cell (x, y, z), cells along (x, y, z), impulses per cell, seed)
    #   -> (cells z, cells y, cells x, per cell, 4) uint32
    DrawWords = Callable[[tuple[int, int, int], tuple[int, int, int], int, int], NDArray[np.uint32]]
    # (N, 3) places in the pattern frame, mm -> (N, 3) unit normals in printer axes
    Normals = Callable[[Floats], Floats]

WORD = 2.0**-32  # random words to [0, 1)


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
    """A noise with its parameters, ready to hand out kernels, one layer of cells after another."""

    @property
    def dimensions(self) -> int:
        """2 or 3."""

    @property
    def radius_mm(self) -> float:
        """The largest radius of a kernel."""

    @property
    def density(self) -> float:
        """Kernels per mm^dimensions."""

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> range:
        """The layers of cells whose kernels can reach these heights; range(1) in 2D."""

    def kernels(self, draw: DrawWords, cell_layer: int, low_mm: Floats, high_mm: Floats, normals: Normals) -> Kernels:
        """The kernels of one layer of cells that reach a rectangle, in cell order.

        Args:
            draw: draws the random words of a box of cells.
            cell_layer: index of the layer of cells.
            low_mm, high_mm: (2,) corners of the rectangle, pattern frame.
            normals: the painted normals at kernel centres.
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
    """

    side_mm: float
    per_cell: int
    dimensions: int

    def cell_layers(self, low_z_mm: float, high_z_mm: float) -> range:
        """The layers of cells that overlap these heights."""
        if self.dimensions == 2:
            return range(1)
        return range(math.floor(low_z_mm / self.side_mm), math.floor(high_z_mm / self.side_mm) + 1)

    def impulses(
        self, draw: DrawWords, seed: int, cell_layer: int, low_mm: Floats, high_mm: Floats
    ) -> tuple[Floats, Floats]:
        """Places (N, 3) in mm and phases (N,) in rad of one layer of cells within a rectangle, in cell order."""
        first = np.floor(low_mm / self.side_mm).astype(int)
        count = np.floor(high_mm / self.side_mm).astype(int) + 1 - first
        corner = (int(first[0]), int(first[1]), cell_layer)
        words = draw(corner, (int(count[0]), int(count[1]), 1), self.per_cell, seed)
        z, y, x = np.meshgrid([cell_layer], *(first[a] + np.arange(count[a]) for a in (1, 0)), indexing="ij")
        cell = np.stack([x, y, z], axis=-1)[:, :, :, None, :]
        place = ((cell + words[..., :3] * WORD) * self.side_mm).reshape(-1, 3)
        phase = words[..., 3].astype(np.float64).reshape(-1) * (WORD * 2 * np.pi)
        if self.dimensions == 2:
            place[:, 2] = 0.0
        inside = np.all((place[:, :2] > low_mm) & (place[:, :2] < high_mm), axis=1)
        return place[inside], phase[inside]
