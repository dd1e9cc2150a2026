"""Phase alignment: kernels turn their phases towards their neighbours', so that their waves meet in step.

The paper leaves the singularities of phasor noise to future work (Tricard et al. 2019, 3.1.4). With z_j = exp(iφ_j),
d = x_i - x_j, S = b_i² + b_j², a sweep is

    z_i <- normalise(z_i + Σ_j w_ij exp(iθ_ij) z_j),
    w_ij = (2 b_i b_j/S)^(dim/2) exp(-π b_i² b_j² |d|²/S - |k_i - k_j|²/(4π S)),   θ_ij = (b_i² k_j + b_j² k_i)·d/S:

w exp(iθ) is the overlap of the two kernels, so that each sweep raises ∫|G|². Where the painted normals of two kernels
point apart, the one is taken as its equal with -k_j and -φ_j (a laminate's normal is a line).

Coarse to fine: some of the kernels, with envelopes so much wider, are aligned first, then hand their phases on. Random
phases are turned all alike or conjugated, so arg G stays uniform, and the expected ratio the painted one (within two
periods of a place where lines make no arrows, only at one half).

Neighbours, overlaps and sweeps are made on the device (cl/neighbours.cl, cl/sweep.cl), in the order of a grid over all
kernels that reach the part's box, which nothing about a run changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError
from amslicer.noise.kernels import WORD, Kernels, join_kernels

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from amslicer.noise.kernels import CellLayer, Generator, KernelNoise

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

COARSE = 2  # levels before the finest, each with envelopes twice as wide
LEAST = 0.1  # smaller overlaps count for nothing
CELLS_PER_REACH = 2  # of a grid: fewer kernels are looked at for nothing than in cells twice as large
CELLS_PER_KERNEL = 4  # of a grid, at most: kernels far apart get larger cells
MAX_KERNELS = 1_000_000  # some 25 neighbours each in space: 300 MB
# The low bits of a phase's random word choose the kernels of the coarse levels: they say nothing of the phase itself.
CHOICE_BITS = 16


class Alignment:
    """The kernels of a noise that reach a part's box, with aligned phases; found when first asked for.

    Args:
        noise: whose kernels they are.
        sweeps: at each level.
        size_mm: (3,) of the part's box. Kernels that do not reach it keep their phases.
        draw: makes neighbours and sweeps.
        kernels_of: all kernels of a layer of cells that reach the box, and others.
    """

    def __init__(
        self,
        noise: KernelNoise,
        sweeps: int,
        size_mm: Floats,
        draw: Generator,
        kernels_of: Callable[[CellLayer], Kernels],
    ) -> None:
        self._noise, self._sweeps, self._size_mm, self._draw = noise, sweeps, size_mm, draw
        self._kernels_of = kernels_of
        self._layers: dict[CellLayer, Kernels] | None = None

    def kernels(self, cell_layer: CellLayer) -> Kernels:
        """The kernels of one layer of cells, with their aligned phases.

        Raises:
            JobError: the part has too many kernels, or a painted field is not usable at one.
        """
        if self._layers is None:
            self._layers = self._align()
        if cell_layer not in self._layers:
            return self._kernels_of(cell_layer)
        return self._layers[cell_layer]

    def _align(self) -> dict[CellLayer, Kernels]:
        numbers = self._noise.cell_layers(0.0, float(self._size_mm[2]))
        layers = [self._kernels_of(number) for number in numbers]
        inside = [self._reach_box(layer) for layer in layers]
        together = join_kernels([layer.take(some) for layer, some in zip(layers, inside, strict=True)])
        if len(together) > MAX_KERNELS:
            raise JobError(
                f"pattern.alignment: the part has {len(together)} kernels; at most {MAX_KERNELS} are aligned",
                hint="use a larger period or alignment: 0",
            )
        phase = aligned_phases(together, self._sweeps, self._noise.dimensions, self._draw)
        ends = np.cumsum([np.count_nonzero(some) for some in inside])[:-1]
        out = {}
        for number, layer, some, aligned in zip(numbers, layers, inside, np.split(phase, ends), strict=True):
            phases = layer.phase.copy()
            phases[some] = aligned
            out[number] = replace(layer, phase=phases)
        return out

    def _reach_box(self, kernels: Kernels) -> NDArray[np.bool_]:
        centre, radius = kernels.centre_mm[:, :2], kernels.radius_mm[:, None]
        return np.asarray(np.all((centre + radius > 0) & (centre - radius < self._size_mm[:2]), axis=1))


def aligned_phases(kernels: Kernels, sweeps: int, dimensions: int, draw: Generator) -> Floats:
    """(N,) phases in [0, 2π) after so many sweeps at each level, all kernels at once.

    Args:
        kernels: in any fixed order.
        sweeps: per level; 0 changes nothing.
        dimensions: 2 or 3.
        draw: makes neighbours and sweeps.
    """
    if sweeps == 0 or len(kernels) == 0:
        return kernels.phase
    word = np.rint(kernels.phase / (WORD * 2 * np.pi)).astype(np.int64)
    choice = (word & ((1 << CHOICE_BITS) - 1)) / (1 << CHOICE_BITS)
    z = np.exp(1j * kernels.phase)
    known = np.zeros(len(kernels), bool)
    for level in range(COARSE, -1, -1):
        chosen = np.flatnonzero(choice < 2.0 ** (-level * dimensions))
        if len(chosen):
            neighbours, order = _neighbours(kernels, chosen, 2.0**-level, dimensions)
            some = chosen[order]
            z[some] = draw.aligned(neighbours, z[some].astype(np.complex64), known[some], sweeps)
        known[chosen] = True
    return np.asarray(np.angle(z) % (2 * np.pi))


@dataclass(frozen=True)
class Neighbours:
    """Kernels sorted so that those near each other are found: groups of like widths, each in the cells of a grid.

    Attributes:
        places: (N, 4) float32 x, y, z in mm and b² in 1/mm².
        waves: (N, 4) float32 k in rad/mm, and the number of the group.
        normals: (N, 4) float32 painted normals, and 0.
        grids: (G, 4) float32 lowest corner of each group's grid, and 1/side of its cells.
        shapes: (G, 4) int32 cells along x, y, z, and the number of the first.
        reaches: (G,) float32 mm: how far kernels of a group overlap any of no wider ones.
        cells: (cells + 1,) uint32 where each cell's kernels start.
        dimensions: 2 or 3.
        least: log of the smallest overlap that counts.
    """

    places: NDArray[np.float32]
    waves: NDArray[np.float32]
    normals: NDArray[np.float32]
    grids: NDArray[np.float32]
    shapes: NDArray[np.int32]
    reaches: NDArray[np.float32]
    cells: NDArray[np.uint32]
    dimensions: int
    least: float


def _neighbours(kernels: Kernels, chosen: Ints, narrower: float, dimensions: int) -> tuple[Neighbours, Ints]:
    """Some kernels, their b times `narrower`, and the order that they are sorted in.

    Kernels more than an octave apart in width never overlap enough, so each group is an octave.
    """
    squared = narrower**2 * kernels.decay[chosen] / np.pi
    place = kernels.centre_mm[chosen]
    width = np.sqrt(squared)
    group = np.floor(np.log2(width / width.min())).astype(np.int64)
    groups = int(group.max()) + 1
    reaches = np.sqrt(-2 * np.log(LEAST) / np.pi) / (2.0 ** np.arange(groups) * width.min())
    grids, shapes = np.zeros((groups, 4)), np.ones((groups, 4), np.int64)
    cell, first = np.zeros(len(chosen), np.int64), 0
    for number, reach in enumerate(reaches):
        some = np.flatnonzero(group == number)
        shapes[number, 3] = first
        if len(some):
            low = place[some].min(axis=0)
            side = reach / CELLS_PER_REACH
            size = place[some].max(axis=0) - low
            while np.prod(np.floor(size / side) + 1) > CELLS_PER_KERNEL * len(some):
                side *= 2
            at = np.floor((place[some] - low) / side).astype(np.int64)
            grids[number], shapes[number, :3] = [*low, 1 / side], at.max(axis=0) + 1
            x, y, z = at.T
            cell[some] = first + (z * shapes[number, 1] + y) * shapes[number, 0] + x
        first += int(np.prod(shapes[number, :3]))
    order = np.argsort(cell, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=first))])
    wave, normal = kernels.wave[chosen], kernels.normal[chosen]

    def four(vectors: Floats, last: Floats) -> NDArray[np.float32]:
        return np.column_stack([vectors, last])[order].astype(np.float32)

    found = Neighbours(
        four(place, squared), four(wave, group.astype(np.float64)), four(normal, np.zeros(len(chosen))),
        grids.astype(np.float32), shapes.astype(np.int32), reaches.astype(np.float32), starts.astype(np.uint32),
        dimensions, float(np.log(LEAST)),
    )  # fmt: skip
    return found, order
