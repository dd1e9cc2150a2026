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
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import JobError
from amslicer.noise.kernels import WORD, Kernels, join_kernels

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from amslicer.noise.kernels import CellLayer, Generator, Noise, Paint

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Complexes = NDArray[np.complex128]

COARSE = 2  # levels before the finest, each with envelopes twice as wide
LEAST = 0.1  # smaller overlaps count for nothing
PAIRS_AT_ONCE = 1 << 20
MAX_KERNELS = 1_000_000  # some 25 neighbours each in space: 1 GB
# The low bits of a phase's random word choose the kernels of the coarse levels: they say nothing of the phase itself.
CHOICE_BITS = 16
BEYOND = 1e-6  # of a radius: drawn around the box, so that no rounding decides which kernels reach it


class Alignment:
    """The aligned phases of all kernels of a noise that reach a part's box; found when first asked for.

    Args:
        noise: whose kernels they are.
        sweeps: at each level.
        size_mm: (3,) of the part's box. Kernels that do not reach it keep their phases.
    """

    def __init__(self, noise: Noise, sweeps: int, size_mm: Floats) -> None:
        self._noise, self._sweeps, self._size_mm = noise, sweeps, size_mm
        self._phases: dict[CellLayer, Floats] = {}

    def aligned(self, kernels: Kernels, cell_layer: CellLayer, draw: Generator, paint: Paint) -> Kernels:
        """The kernels of one layer of cells, all those that reach the box among them, with their aligned phases.

        Raises:
            JobError: the part has too many kernels, or a painted field is not usable at one.
        """
        if not self._phases:
            self._align(draw, paint)
        if cell_layer not in self._phases:
            return kernels
        phase = kernels.phase.copy()
        phase[self._reach_box(kernels)] = self._phases[cell_layer]
        return replace(kernels, phase=phase)

    def _reach_box(self, kernels: Kernels) -> NDArray[np.bool_]:
        centre, radius = kernels.centre_mm[:, :2], kernels.radius_mm[:, None]
        return np.asarray(np.all((centre + radius > 0) & (centre - radius < self._size_mm[:2]), axis=1))

    def _align(self, draw: Generator, paint: Paint) -> None:
        noise, beyond = self._noise, BEYOND * self._noise.radius_mm
        low, high = np.zeros(2) - beyond, self._size_mm[:2] + beyond
        numbers = noise.cell_layers(0.0, float(self._size_mm[2]))
        layers = [noise.kernels(draw, number, low, high, paint) for number in numbers]
        layers = [layer.take(self._reach_box(layer)) for layer in layers]
        together = join_kernels(layers)
        if len(together) > MAX_KERNELS:
            raise JobError(
                f"pattern.alignment: the part has {len(together)} kernels; at most {MAX_KERNELS} are aligned",
                hint="use a larger period or alignment: 0",
            )
        phase = aligned_phases(together, self._sweeps, noise.dimensions)
        ends = np.cumsum([len(layer) for layer in layers])[:-1]
        self._phases.update(zip(numbers, np.split(phase, ends), strict=True))


def aligned_phases(kernels: Kernels, sweeps: int, dimensions: int) -> Floats:
    """(N,) phases in [0, 2π) after so many sweeps at each level, all kernels at once.

    Args:
        kernels: in any fixed order; the sums of a sweep follow it.
        sweeps: per level; 0 changes nothing.
        dimensions: 2 or 3.
    """
    if sweeps == 0 or len(kernels) == 0:
        return kernels.phase
    word = np.rint(kernels.phase / (WORD * 2 * np.pi)).astype(np.int64)
    choice = (word & ((1 << CHOICE_BITS) - 1)) / (1 << CHOICE_BITS)
    start: Complexes = np.exp(1j * kernels.phase)
    z, before = start[:0], np.zeros(0, np.int64)
    for level in range(COARSE, -1, -1):
        chosen = np.flatnonzero(choice < 2.0 ** (-level * dimensions))
        overlaps = _overlaps(kernels, chosen, 2.0**-level, dimensions)
        known = np.isin(chosen, before, assume_unique=True)
        grown = np.zeros(len(chosen), np.complex128)
        grown[known] = z
        grown[~known] = overlaps.of_neighbours(grown)[~known]
        z = _normalised(grown, start[chosen])
        for _ in range(sweeps):
            z = _normalised(z + overlaps.of_neighbours(z), z)
        before = chosen
    return np.asarray(np.angle(z) % (2 * np.pi))


@dataclass(frozen=True)
class _Overlaps:
    """Of each kernel with its neighbours: those of its own sign, and those of opposite sign."""

    same: Any
    opposite: Any

    def of_neighbours(self, z: Complexes) -> Complexes:
        """Σ_j w_ij exp(iθ_ij) z_j, conjugated where the sign is opposite."""
        total = self.same @ z
        return np.asarray(total + self.opposite @ z.conj() if self.opposite.nnz else total)


def _overlaps(kernels: Kernels, chosen: Ints, narrower: float, dimensions: int) -> _Overlaps:
    """Overlaps of some kernels, their b times `narrower`; both ways of each pair."""
    from scipy.sparse import coo_array

    parts = [_overlaps_of(kernels, i, j, narrower, dimensions) for i, j in _pairs(kernels, chosen, narrower)]
    column, row, value, sign = (np.concatenate(arrays) for arrays in zip(*parts, strict=True)) if parts else (
        np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.complex128), np.zeros(0)
    )  # fmt: skip
    place = np.zeros(len(kernels), np.int64)
    place[chosen] = np.arange(len(chosen))
    made = []
    for some in (sign > 0, sign < 0):
        matrix = coo_array((value[some], (place[row[some]], place[column[some]])), shape=(len(chosen),) * 2).tocsr()
        matrix.sort_indices()
        made.append(matrix)
    return _Overlaps(*made)


def _pairs(kernels: Kernels, chosen: Ints, narrower: float) -> Iterator[tuple[Ints, Ints]]:
    """Pairs of kernels that may overlap, in pieces; those of much different widths never do enough."""
    from scipy.spatial import cKDTree

    width = narrower * np.sqrt(kernels.decay[chosen] / np.pi)
    octave = np.floor(np.log2(width / width.min(initial=np.inf))).astype(np.int64) if len(chosen) else chosen
    groups = [chosen[octave == o] for o in range(int(octave.max(initial=-1)) + 1)]
    trees = [cKDTree(kernels.centre_mm[group]) for group in groups]
    for o, (group, tree) in enumerate(zip(groups, trees, strict=True)):
        if not len(group):
            continue
        reach = np.sqrt(-2 * np.log(LEAST) / np.pi) / (2.0**o * width.min())
        i, j = tree.query_pairs(reach, output_type="ndarray").T
        found = [(group[i], group[j])]
        if o + 1 < len(groups) and len(groups[o + 1]):
            pairs = tree.sparse_distance_matrix(trees[o + 1], reach, output_type="ndarray")
            found.append((group[pairs["i"]], groups[o + 1][pairs["j"]]))
        for first, second in found:
            for begin in range(0, len(first), PAIRS_AT_ONCE):
                yield first[begin : begin + PAIRS_AT_ONCE], second[begin : begin + PAIRS_AT_ONCE]


def _overlaps_of(
    kernels: Kernels, i: Ints, j: Ints, narrower: float, dimensions: int
) -> tuple[Ints, Ints, Complexes, Floats]:
    """Both ways of each pair that overlaps enough: (column j, row i, w exp(iθ), sign σ)."""
    sign = np.where(np.einsum("ni,ni->n", kernels.normal[i], kernels.normal[j]) < 0, -1.0, 1.0)
    d = kernels.centre_mm[i] - kernels.centre_mm[j]
    b_i, b_j = (narrower**2 * kernels.decay[k] / np.pi for k in (i, j))  # squared
    total = b_i + b_j
    apart = kernels.wave[i] - sign[:, None] * kernels.wave[j]
    exponent = dimensions / 4 * np.log(4 * b_i * b_j / total**2)
    exponent -= np.pi * b_i * b_j * np.einsum("ni,ni->n", d, d) / total
    exponent -= np.einsum("ni,ni->n", apart, apart) / (4 * np.pi * total)
    kept = exponent > np.log(LEAST)
    i, j, sign, exponent, d, b_i, b_j, total = (a[kept] for a in (i, j, sign, exponent, d, b_i, b_j, total))
    along_i, along_j = (np.einsum("ni,ni->n", kernels.wave[k], d) for k in (i, j))
    value = np.exp(exponent + 1j * (b_i * sign * along_j + b_j * along_i) / total)
    # The other way d is -d: the conjugate; with the opposite sign that is turned once more.
    value = np.concatenate([value, np.where(sign > 0, value.conj(), value)])
    return np.concatenate([j, i]), np.concatenate([i, j]), value, np.concatenate([sign, sign])


def _normalised(z: Complexes, otherwise: Complexes) -> Complexes:
    """Of unit length; where there is nothing, as before."""
    length = np.abs(z)
    return np.where(length > 0, z / np.where(length > 0, length, 1.0), otherwise)
