"""The readable definition of the pattern, in plain float64 NumPy: tests run every device against it.

Written from the mathematics and sharing no code with what it checks:

    G(x) = Σ_j a_j(x) exp(i (k_j·(x - x_j) + φ_j)),   a_j(x) = exp(-π b² |x - x_j|²),   k_j = (2π/p) n_j

(Tricard et al. 2019, "Procedural Phasor Noise", (6), (14), (15), with random phases φ_j), then material labels
from arg G. Lengths in mm, angles in rad, arrays of directions and places end in an axis (x, y, z).
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    # One normal for all kernels, or (N, 3) places -> (N, 3) unit normals.
    Normal = ArrayLike | Callable[[Floats], Floats]

# Philox-4x32-10 (Salmon et al. 2011, "Parallel Random Numbers: As Easy as 1, 2, 3"): multipliers, key steps.
PHILOX_ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
KEY_STEPS = (0x9E3779B9, 0xBB67AE85)  # golden ratio, √3 - 1
WORD_BITS = 32
WORD_MASK = 0xFFFFFFFF


def philox4x32(counter: ArrayLike, key: ArrayLike) -> NDArray[np.uint32]:
    """Four random words per counter: ten rounds of the Philox bijection.

    Args:
        counter: (..., 4) words.
        key: (..., 2) words; broadcasts against the counters.

    Returns:
        (..., 4) uint32.
    """
    c0, c1, c2, c3 = np.moveaxis(np.asarray(counter).astype(np.uint64), -1, 0)
    k0, k1 = np.moveaxis(np.asarray(key).astype(np.uint64), -1, 0)
    for _ in range(PHILOX_ROUNDS):
        left, right = c0 * np.uint64(MULTIPLIERS[0]), c2 * np.uint64(MULTIPLIERS[1])
        c0, c1, c2, c3 = (
            (right >> WORD_BITS) ^ c1 ^ k0, right & WORD_MASK,
            (left >> WORD_BITS) ^ c3 ^ k1, left & WORD_MASK,
        )  # fmt: skip
        k0, k1 = (k0 + np.uint64(KEY_STEPS[0])) & WORD_MASK, (k1 + np.uint64(KEY_STEPS[1])) & WORD_MASK
    return np.stack(np.broadcast_arrays(c0, c1, c2, c3), axis=-1).astype(np.uint32)


def cell_words(cells: ArrayLike, per_cell: int, seed: int) -> NDArray[np.uint32]:
    """The random words of cells (i, j, k): of counter (i, j, k, m), with the seed as the key.

    Args:
        cells: (..., 3) integers, negative ones included (two's complement).
        per_cell: impulses m = 0 … per_cell - 1 in each.
        seed: 0 … 2^64 - 1.

    Returns:
        (..., per_cell, 4) uint32.
    """
    corner = np.asarray(cells, np.int64)[..., None, :]
    index = np.broadcast_to(np.arange(per_cell)[:, None], (*corner.shape[:-2], per_cell, 1))
    corner = np.broadcast_to(corner, (*index.shape[:-1], 3))
    counter = np.concatenate([corner, index], axis=-1) & WORD_MASK
    return philox4x32(counter, (seed & WORD_MASK, seed >> WORD_BITS))


def cells_of(width: float, dimensions: int, impulses: float) -> tuple[int, float]:
    """Impulses per cell and side of a cell (mm), for `impulses` kernels per width^-dimensions on average."""
    per_cell = max(1, round(impulses))
    return per_cell, (per_cell / impulses) ** (1 / dimensions) / width


def impulses_of(
    cells: ArrayLike, *, side_mm: float, per_cell: int, dimensions: int, seed: int
) -> tuple[Floats, Floats]:
    """Places and phases of the impulses of cells: three words are the place in the cell, one is the phase.

    Args:
        cells: (..., 3) integers; in 2D the third is 0.

    Returns:
        (..., per_cell, 3) mm, with z = 0 in 2D; (..., per_cell) in [0, 2π).
    """
    share = cell_words(cells, per_cell, seed) / 2.0**WORD_BITS
    places = (np.asarray(cells)[..., None, :] + share[..., :3]) * side_mm
    if dimensions == 2:
        places[..., 2] = 0.0
    return places, 2 * np.pi * share[..., 3]


def cut_radius(width: float, dimensions: int, error: float) -> float:
    """Where a kernel of width b (1/mm) is cut so that the relative RMS error is `error`.

    e² = 1 - ∫₀^r g² dV / ∫₀^∞ g² dV with g² = exp(-2π b² r²) (Lagae et al. 2011, "Improving Gabor Noise",
    section IV): the upper regularised gamma function Γ(d/2, 2π b² r²).
    """
    from scipy.special import gammainccinv

    return math.sqrt(float(gammainccinv(dimensions / 2, error**2)) / (2 * math.pi)) / width


def phasor(
    x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: float, bandwidth: float, dimensions: int, seed: int,
    normal: Normal, impulses: float = 4.0, reference_normal: ArrayLike | None = None, error: float = 1e-3,
) -> Complexes:  # fmt: skip
    """G at any points, kernel by kernel, with box support |x - x_j| < r along each axis.

    Args:
        x, y, z: coordinates in mm, which broadcast; z is ignored in 2D.
        period: p in mm.
        bandwidth: b·p, relative.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
        normal: unit normals at the kernels' centres: one, or a function of (N, 3) places.
        impulses: kernels per b^dimensions.
        reference_normal: (..., 3) normals at the points, which broadcast. A kernel whose own normal points
            against it is conjugated: the laminate's normal is a line, and n, φ and -n, -φ are the same real wave.
        error: relative RMS error of cutting the kernels.

    Returns:
        complex128, in the coordinates' common shape.
    """
    point = np.stack(np.broadcast_arrays(*(np.asarray(c, np.float64) for c in (x, y, z))), axis=-1)
    shape = point.shape[:-1]
    reference = None if reference_normal is None else np.broadcast_to(np.asarray(reference_normal), point.shape)
    reference = None if reference is None else reference.reshape(-1, 3)
    point = point.reshape(-1, 3) * ((1, 1, 1) if dimensions == 3 else (1, 1, 0))

    width = bandwidth / period
    radius = cut_radius(width, dimensions, error)
    per_cell, side = cells_of(width, dimensions, impulses)
    cells, cell_of_point = np.unique(np.floor(point / side).astype(np.int64), axis=0, return_inverse=True)
    steps = range(-math.ceil(radius / side), math.ceil(radius / side) + 1)
    total = np.zeros(len(point), np.complex128)
    for offset in product(steps, steps, steps if dimensions == 3 else (0,)):
        places, phases = impulses_of(cells + offset, side_mm=side, per_cell=per_cell, dimensions=dimensions, seed=seed)
        normals = normal(places.reshape(-1, 3)) if callable(normal) else np.asarray(normal, np.float64)
        normals = np.broadcast_to(normals, (len(cells) * per_cell, 3)).reshape(places.shape)
        for m in range(per_cell):
            from_centre = point - places[cell_of_point, m]
            near = np.flatnonzero(np.all(np.abs(from_centre) < radius, axis=1))
            cell, d = cell_of_point[near], from_centre[near]
            n = normals[cell, m]
            angle = 2 * np.pi / period * _dot(n, d) + phases[cell, m]
            wave = np.exp(-np.pi * width**2 * _dot(d, d) + 1j * angle)
            if reference is not None:
                wave = np.where(_dot(n, reference[near]) < 0, wave.conj(), wave)
            total[near] += wave
    return total.reshape(shape)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.sum(a * b, axis=-1))


def symmetric_labels(g: NDArray[Any], cumulative: ArrayLike) -> NDArray[np.uint8]:
    """Material numbers (from 1) of the symmetric profile: m where |arg G|/π is in [c(m-1), c(m)).

    PWM is the profile with one cumulative ratio, the share of material 1. Ratios of 0 and 1 are plain fills.
    Where no kernel reaches, G = 0 has no phase and counts as the farthest, π.

    Args:
        g: complex, any shape.
        cumulative: (materials - 1, ...) c(1) <= c(2) <= …, each 0…1; broadcasts against (1, *g.shape).
    """
    share = np.where(g == 0, 1.0, np.abs(np.arctan2(g.imag, g.real)) / np.pi)
    c = np.asarray(cumulative, np.float64)
    beyond = ((share >= c) | (c <= 0)) & (c < 1)
    return np.asarray(1 + np.count_nonzero(beyond, axis=0), np.uint8)


def tables(
    offset_mm: Floats, wave: Floats, decay: Floats, radius_mm: Floats, *, pitch_mm: float, pixels: int
) -> Complexes:
    """Twin of tables.cl: the factor of each kernel along one pixel axis, zero outside its radius; (6), (14).

    Args:
        offset_mm: (N,) kernel centres from the first pixel's lower side.
        wave: (N,) wave vector components, rad/mm.
        decay: (N,) π b², 1/mm².
        radius_mm: (N,) half sides of the supports.

    Returns:
        (N, pixels).
    """
    d = (np.arange(pixels) + 0.5) * pitch_mm - offset_mm[:, None]
    factor = np.exp(-decay[:, None] * d**2 + 1j * wave[:, None] * d)
    return np.where(np.abs(d) < radius_mm[:, None], factor, 0)


def along_z(
    height_mm: Floats, wave: Floats, phase: Floats, decay: Floats, radius_mm: Floats, layers_mm: Floats
) -> Complexes:
    """Twin of along_z.cl: the factor of each kernel along z, its random phase included; (6), (14), (15).

    Args:
        height_mm: (N,) how far the first layer lies above the kernels' centres.
        wave, phase, decay, radius_mm: (N,) as in `tables`, with φ in rad.
        layers_mm: (L,) heights of the layers above the first.

    Returns:
        (L, N).
    """
    d = height_mm + layers_mm[:, None]
    return np.where(np.abs(d) < radius_mm, np.exp(-decay * d**2 + 1j * (wave * d + phase)), 0)


def fill(starts: NDArray[Any], runs: NDArray[Any], columns: int) -> NDArray[np.uint8]:
    """Twin of fill.cl: 1 where a row has a run, else 0.

    Args:
        starts: (rows + 1,) where each row's runs start.
        runs: (N, 2) first column, and one past the last.

    Returns:
        (rows, columns) uint8.
    """
    count = starts[1:].astype(np.int64) - starts[:-1]
    row = np.repeat(np.arange(len(count)), count)
    change = np.zeros((len(count), columns + 1), np.int64)
    np.add.at(change, (row, runs[:, 0]), 1)
    np.add.at(change, (row, runs[:, 1]), -1)
    return (np.cumsum(change, axis=1)[:, :-1] > 0).astype(np.uint8)
