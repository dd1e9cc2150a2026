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
    from collections.abc import Callable, Sequence
    from typing import Any

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    # One normal for all kernels, or (N, 3) places -> (N, 3) unit normals.
    Normal = ArrayLike | Callable[[Floats], Floats]
    # One number for all kernels, or (N, 3) places -> (N,) numbers.
    Scalar = float | Callable[[Floats], Floats]
    # (angle about z in degrees, weight) of several directions.
    Lobes = Sequence[tuple[float, float]]

# Philox-4x32-10 (Salmon et al. 2011, "Parallel Random Numbers: As Easy as 1, 2, 3"): multipliers, key steps.
PHILOX_ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
KEY_STEPS = (0x9E3779B9, 0xBB67AE85)  # golden ratio, √3 - 1
WORD_BITS = 32
WORD_MASK = 0xFFFFFFFF
# Fourth words of the counters, beside 0 + LEVEL × level for impulses: choices among candidates, + LEVEL × level; places
# and weights of the points that turn directions, + 256 × level; dithered edges.
LEVEL = 0x10000
CHOICES, TURN_PLACES, TURN_WEIGHTS, EDGES = 0x40000000, 0x80000000, 0xC0000000, 0x60000000


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


def cell_words(cells: ArrayLike, per_cell: int, seed: int, number: int = 0) -> NDArray[np.uint32]:
    """The random words of cells (i, j, k): of counter (i, j, k, number + m), with the seed as the key.

    Args:
        cells: (..., 3) integers, negative ones included (two's complement).
        per_cell: impulses m = 0 … per_cell - 1 in each.
        seed: 0 … 2^64 - 1.

    Returns:
        (..., per_cell, 4) uint32.
    """
    corner = np.asarray(cells, np.int64)[..., None, :]
    index = np.broadcast_to(number + np.arange(per_cell)[:, None], (*corner.shape[:-2], per_cell, 1))
    corner = np.broadcast_to(corner, (*index.shape[:-1], 3))
    counter = np.concatenate([corner, index], axis=-1) & WORD_MASK
    return philox4x32(counter, (seed & WORD_MASK, seed >> WORD_BITS))


def cells_of(width: float, dimensions: int, impulses: float) -> tuple[int, float]:
    """Impulses per cell and side of a cell (mm), for `impulses` kernels per width^-dimensions on average."""
    per_cell = max(1, round(impulses))
    return per_cell, (per_cell / impulses) ** (1 / dimensions) / width


def impulses_of(
    cells: ArrayLike, *, side_mm: float, per_cell: int, dimensions: int, seed: int, level: int = 0
) -> tuple[Floats, Floats]:
    """Places and phases of the impulses of cells: three words are the place in the cell, one is the phase.

    Args:
        cells: (..., 3) integers; in 2D the third is 0.

    Returns:
        (..., per_cell, 3) mm, with z = 0 in 2D; (..., per_cell) in [0, 2π).
    """
    share = cell_words(cells, per_cell, seed, LEVEL * level) / 2.0**WORD_BITS
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
    x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: Scalar, bandwidth: float, dimensions: int, seed: int,
    normal: Normal, isotropy: Scalar = 0.0, impulses: float = 4.0, periods: tuple[float, float] | None = None,
    lobes: Lobes = (), envelope: Scalar | None = None, reference_normal: ArrayLike | None = None, error: float = 1e-3,
) -> Complexes:  # fmt: skip
    """G at any points, kernel by kernel, with box support |x - x_j| < r along each axis.

    Args:
        x, y, z: coordinates in mm, which broadcast; z is ignored in 2D.
        period: p in mm at the kernels' centres.
        bandwidth: b·p, relative.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
        normal: unit normals at the kernels' centres: one, or a function of (N, 3) places.
        isotropy: s at the kernels' centres, 0…1.
        impulses: kernels per b^dimensions.
        lobes: (angle about z in degrees, weight) of the directions at a place, of which each kernel takes one.
        periods: the shortest and the longest p, where it varies. Level l has candidates as dense as P = 2^l shortest
            asks for; where P <= p < 2P they are kernels with probability (P/p)^dimensions.
        envelope: the period that the envelope, density and level follow; default: the period itself.
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

    shortest, longest = periods or (float(period),) * 2  # type: ignore[arg-type]
    total = np.zeros(len(point), np.complex128)
    for level in range(math.floor(math.log2(longest / shortest)) + 1):
        least = shortest * 2**level
        farthest = cut_radius(bandwidth / min(longest, 2 * least), dimensions, error)
        per_cell, side = cells_of(bandwidth / least, dimensions, impulses)
        cells, cell_of_point = np.unique(np.floor(point / side).astype(np.int64), axis=0, return_inverse=True)
        steps = range(-math.ceil(farthest / side), math.ceil(farthest / side) + 1)
        offsets = np.array(list(product(steps, steps, steps if dimensions == 3 else (0,))))
        drawn, cell_near = np.unique((cells[:, None] + offsets).reshape(-1, 3), axis=0, return_inverse=True)
        cell_near = cell_near.reshape(len(cells), len(offsets))  # the drawn cell at each offset from a point's own
        places, phases = impulses_of(
            drawn, side_mm=side, per_cell=per_cell, dimensions=dimensions, seed=seed, level=level
        )
        places, phases = places.reshape(-1, 3), phases.reshape(-1)
        p = _at(period, places)
        q = p if envelope is None else _at(envelope, places)
        width = bandwidth / q
        radius = cut_radius(1.0, dimensions, error) / width
        words = cell_words(drawn, per_cell, seed, CHOICES + LEVEL * level).reshape(-1, 4) / 2.0**WORD_BITS
        choice, lobe = words[:, 0], words[:, 1]
        is_kernel = (least <= q) & (q < 2 * least) & (choice < (least / q) ** dimensions) | (shortest == longest)
        normals = np.broadcast_to(normal(places) if callable(normal) else np.asarray(normal, np.float64), places.shape)
        directions = _of_lobes(normals, lobe, lobes)
        waves = turned(directions, _at(isotropy, places), places, width, dimensions, seed) * (2 * np.pi / p)[:, None]
        for cell_of_offset in cell_near.T:
            for m in range(per_cell):
                j = cell_of_offset[cell_of_point] * per_cell + m
                d = point - places[j]
                near = np.flatnonzero(np.all(np.abs(d) < radius[j, None], axis=1) & is_kernel[j])
                j, d = j[near], d[near]
                wave = np.exp(-np.pi * width[j] ** 2 * _dot(d, d) + 1j * (_dot(waves[j], d) + phases[j]))
                if reference is not None:
                    wave = np.where(_dot(normals[j], reference[near]) < 0, wave.conj(), wave)
                total[near] += wave
    return total.reshape(shape)


def phacelle(
    x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: Scalar, side_mm: float, dimensions: int, seed: int,
    normal: Normal, isotropy: Scalar = 0.0, lobes: Lobes = (), simple: bool = False,
) -> Complexes:  # fmt: skip
    """Phacelle noise: in a window of 4 cells a side around the nearest cell corner, one splat per cell.

    Σ_j max(0, exp(-2 d_j²) - exp(-4.5)) exp(i (k_j·(x - x_j) + φ_j)), d_j in cells; the φ_j are random, unlike there.

    Args:
        x, y, z: coordinates in mm, which broadcast; z is ignored in 2D.
        side_mm: of a cell.
        period, normal, isotropy, lobes: at the splats, as in `phasor`.
        simple: at the points instead; a splat whose own normal points against a point's has the phase -φ_j there.
    """
    point = np.stack(np.broadcast_arrays(*(np.asarray(c, np.float64) for c in (x, y, z))), axis=-1)
    shape, point = point.shape[:-1], point.reshape(-1, 3) * ((1, 1, 1) if dimensions == 3 else (1, 1, 0))
    corner = np.rint(point / side_mm).astype(np.int64)
    steps = range(-2, 2)
    window = np.array(list(product(steps, steps, steps if dimensions == 3 else (0,))))
    cells, splat = np.unique((corner[:, None] + window).reshape(-1, 3), axis=0, return_inverse=True)
    places, phases = impulses_of(cells, side_mm=side_mm, per_cell=1, dimensions=dimensions, seed=seed)
    places, phases = places[:, 0], phases[:, 0]
    n = np.broadcast_to(normal(places) if callable(normal) else np.asarray(normal, np.float64), places.shape)
    width = np.full(len(places), math.sqrt(2 / math.pi) / side_mm)
    lobe = cell_words(cells, 1, seed, CHOICES)[:, 0, 1] / 2.0**WORD_BITS
    waves = turned(_of_lobes(n, lobe, lobes), _at(isotropy, places), places, width, dimensions, seed)
    waves = waves * (2 * np.pi / _at(period, places))[:, None]
    total = np.zeros(len(point), np.complex128)
    if simple:
        own = np.broadcast_to(normal(point) if callable(normal) else np.asarray(normal, np.float64), point.shape)
        own = turned(own, _at(isotropy, point), point, np.full(len(point), width[0]), dimensions, seed)
        k = own * (2 * np.pi / _at(period, point))[:, None]
    for j in splat.reshape(len(point), len(window)).T:
        d = point - places[j]
        weight = np.maximum(0, np.exp(-2 * _dot(d, d) / side_mm**2) - math.exp(-4.5))
        phase = np.where(_dot(k, n[j]) < 0, -phases[j], phases[j]) if simple else phases[j]
        total += weight * np.exp(1j * (_dot(k if simple else waves[j], d) + phase))
    return total.reshape(shape)


def isotropic_gabor(
    x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: float, bandwidth: float, dimensions: int, seed: int,
    impulses: float, error: float = 1e-3,
) -> Complexes:  # fmt: skip
    """Sums of isotropic Gabor kernels exp(-πb²r²) J₀(2πr/p), in space exp(-πb²r²) sin(2πr/p)/(2πr/p), times exp(iφ_j).

    Args:
        x, y, z: coordinates in mm, which broadcast; z is ignored in 2D.
        period, bandwidth, dimensions, seed, impulses, error: as in `phasor`; kernels end at a distance r.
    """
    from scipy.special import j0

    point = np.stack(np.broadcast_arrays(*(np.asarray(c, np.float64) for c in (x, y, z))), axis=-1)
    shape, point = point.shape[:-1], point.reshape(-1, 3) * ((1, 1, 1) if dimensions == 3 else (1, 1, 0))
    width = bandwidth / period
    radius = cut_radius(width, dimensions, error)
    per_cell, side = cells_of(width, dimensions, impulses)
    low, high = (
        np.floor((edge + s * radius) / side).astype(int) for edge, s in ((point.min(0), -1), (point.max(0), 1))
    )
    if dimensions == 2:
        low[2], high[2] = 0, 0
    cells = np.array(list(product(*(range(a, b + 1) for a, b in zip(low, high, strict=True)))))
    places, phases = impulses_of(cells, side_mm=side, per_cell=per_cell, dimensions=dimensions, seed=seed)
    total = np.zeros(len(point), np.complex128)
    for place, phase in zip(places.reshape(-1, 3), phases.reshape(-1), strict=True):
        r = np.sqrt(_dot(point - place, point - place))
        near = r < radius
        wave = j0(2 * np.pi * r[near] / period) if dimensions == 2 else np.sinc(2 * r[near] / period)
        total[near] += np.exp(-np.pi * (width * r[near]) ** 2) * wave * np.exp(1j * phase)
    return total.reshape(shape)


def _at(value: Scalar, places: Floats) -> Floats:
    return np.asarray(value(places) if callable(value) else np.full(len(places), float(value)))


def _of_lobes(normal: Floats, choice: Floats, lobes: Lobes) -> Floats:
    """(N, 3) normals turned by a lobe each, with the signs ±1, ±1 … that make the smallest dot product largest."""
    if not lobes:
        return normal
    angles, weights = np.array(lobes, np.float64).T
    taken = np.searchsorted(np.cumsum(weights / weights.sum())[:-1], choice, side="right")
    x, y, z = normal.T
    turned = [(x * math.cos(a) - y * math.sin(a), x * math.sin(a) + y * math.cos(a), z) for a in np.deg2rad(angles)]
    u = np.moveaxis(np.array(turned), 1, -1)  # (lobe, kernel, 3)
    best, most = np.ones((len(lobes), len(normal))), np.full(len(normal), -2.0)
    for rest in product((1.0, -1.0), repeat=len(lobes) - 1):
        signs = np.array([1.0, *rest])
        least = np.min([signs[i] * signs[j] * _dot(u[i], u[j]) for i in range(len(u)) for j in range(i + 1)], axis=0)
        better = least > most + 1e-9
        best[:, better], most[better] = signs[:, None], least[better]
    kernel = np.arange(len(normal))
    return np.asarray(best[taken, kernel][:, None] * u[taken, kernel])


def turned(normal: Floats, isotropy: Floats, place: Floats, width: Floats, dimensions: int, seed: int) -> Floats:
    """Directions of kernels: uniform in ±90° s of the painted ones in the plane, in caps of half-angle 90° s in space.

    They follow from fields w that are N(0, 1) everywhere.

    Args:
        normal, place: (N, 3).
        isotropy, width: (N,) s, and b of the envelopes in 1/mm.
    """
    from scipy.special import erf

    if not np.any(isotropy > 0):
        return normal
    w = normal_fields(place, width / 2, dimensions, seed)
    if dimensions == 2:
        angle = isotropy * np.pi / 2 * erf(w[:, 0] / math.sqrt(2))
        azimuth = np.arctan2(normal[:, 1], normal[:, 0]) + angle
        return np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(angle))], axis=-1)
    across = w - _dot(w, normal)[:, None] * normal
    length = np.linalg.norm(across, axis=1)
    beta = np.arccos(1 - (1 - np.exp(-(length**2) / 2)) * (1 - np.cos(isotropy * np.pi / 2)))
    side = np.cross(across / np.where(length > 0, length, 1)[:, None], normal)
    return np.asarray(np.cos(beta)[:, None] * normal + np.sin(beta)[:, None] * side)


def normal_fields(place: Floats, width: Floats, dimensions: int, seed: int) -> Floats:
    """Three fields that are N(0, 1) at every place: Σ γ g / √Σ g² over hashed points, g = exp(-π b² d²), cut at 2/b.

    Blended from b = 2^l and 2^(l+1) on either side of the width.

    Args:
        place: (N, 3) mm.
        width: (N,) 1/mm.

    Returns:
        (N, 3).
    """
    level = np.floor(np.log2(width))
    upper = np.log2(width) - level
    out = np.zeros((len(place), 3))
    for step, share in ((0, np.sqrt(1 - upper)), (1, np.sqrt(upper))):
        for b in np.unique(2.0 ** (level + step)):
            here = np.flatnonzero(2.0 ** (level + step) == b)
            out[here] += share[here, None] * _normal_fields(place[here] * b, int(np.log2(b)), dimensions, seed)
    return out


def _normal_fields(point: Floats, level: int, dimensions: int, seed: int) -> Floats:
    """The same of one width; lengths in cells of side 1/b, four points in each."""
    cell = np.floor(point).astype(np.int64)
    if dimensions == 2:
        cell[:, 2] = 0
        point = point * (1, 1, 0)
    total, power = np.zeros((len(point), 3)), np.zeros(len(point))
    steps, number = range(-2, 3), 256 * (level % 256)
    for offset in product(steps, steps, steps if dimensions == 3 else (0,)):
        words = cell_words(cell + offset, 4, seed, TURN_PLACES + number)
        y = (cell + offset)[:, None] + words[..., :3] / 2.0**WORD_BITS
        u = cell_words(cell + offset, 4, seed, TURN_WEIGHTS + number)
        radius = np.sqrt(-2 * np.log((u[..., :2] + 0.5) / 2.0**WORD_BITS))  # Box and Muller 1958
        angle = 2 * np.pi * u[..., 2:] / 2.0**WORD_BITS
        gamma = np.concatenate([radius * np.cos(angle), radius[..., :1] * np.sin(angle[..., :1])], axis=-1)
        d = (y - point[:, None]) * ((1, 1, 1) if dimensions == 3 else (1, 1, 0))
        squared = _dot(d, d)
        g = np.where(squared < 4, np.exp(-np.pi * squared), 0)
        total += (gamma * g[..., None]).sum(axis=1)
        power += (g**2).sum(axis=1)
    return total / np.sqrt(power)[:, None]


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


def cyclic_labels(g: NDArray[Any], cumulative: ArrayLike) -> NDArray[np.uint8]:
    """Material numbers (from 1) of the cyclic profile: m where arg G/2π mod 1 is in [c(m-1), c(m)).

    Args:
        g, cumulative: as in `symmetric_labels`.
    """
    share = np.where(g == 0, 0.5, np.arctan2(g.imag, g.real) / (2 * np.pi) % 1)
    c = np.asarray(cumulative, np.float64)
    beyond = ((share >= c) | (c <= 0)) & (c < 1)
    return np.asarray(1 + np.count_nonzero(beyond, axis=0), np.uint8)


def waveform_labels(
    g: NDArray[Any], cumulative: ArrayLike, wave: Callable[[Floats], Floats], samples: int = 200_001
) -> NDArray[np.uint8]:
    """Material numbers (from 1) of a waveform's profile: m where the share with f > f(ϕ) is in [c(m-1), c(m)).

    Args:
        g, cumulative: as in `symmetric_labels`.
        wave: f of shares of a turn, without plateaus.
        samples: of a turn that the share is counted among.
    """
    heights = np.sort(wave((np.arange(samples) + 0.5) / samples))
    share = 1 - np.searchsorted(heights, wave(np.arctan2(g.imag, g.real) / (2 * np.pi) % 1)) / samples
    c = np.asarray(cumulative, np.float64)
    beyond = ((share >= c) | (c <= 0)) & (c < 1)
    return np.asarray(1 + np.count_nonzero(beyond, axis=0), np.uint8)


def jittered(g: NDArray[Any], columns: ArrayLike, rows: ArrayLike, layer: int, wave: ArrayLike, seed: int) -> Complexes:
    """G as at a random place within each pixel, for dithered edges: turned by wave · u, u uniform in ±½ on each axis.

    Args:
        g: complex, (rows, columns).
        columns, rows: numbers of the pixels from the part's corner, broadcasting to g's shape.
        layer: number of the layer; 0 in 2D.
        wave: (3,) the laminate's wave in rad per column, row and layer.
    """
    column, row = np.broadcast_arrays(columns, rows)
    counter = np.stack([column, row, np.full(column.shape, layer), np.full(column.shape, EDGES)], axis=-1)
    u = philox4x32(counter, (seed & WORD_MASK, seed >> WORD_BITS))[..., :3] / 2.0**WORD_BITS - 0.5
    return np.asarray(g * np.exp(1j * (u @ np.asarray(wave))))


def aligned(
    places: Floats, waves: Floats, widths: Floats, phases: Floats, normals: Floats, *, sweeps: int, dimensions: int,
    coarse: int = 2, least: float = 0.1,
) -> Floats:  # fmt: skip
    """Twin of noise/alignment.py, with all N × N overlaps at once: phases after so many sweeps at each level.

    The overlap of kernels i and j is (2 b_i b_j/S)^(d/2) exp(-π b_i² b_j² |x_i - x_j|²/S - |k_i - σ k_j|²/(4πS)) times
    exp(i (b_i² σ k_j + b_j² k_i)·(x_i - x_j)/S), S = b_i² + b_j², σ the sign of n_i·n_j; where σ = -1 it takes z_j*.

    Args:
        places, waves, normals: (N, 3) x_j in mm, k_j in rad/mm, painted n_j.
        widths, phases: (N,) b_j in 1/mm, φ_j in rad.
        coarse: levels before the finest. Level l has the kernels whose phase word's low 16 bits, as a share, are below
            2^(-l d), with b_j/2^l.
        least: smaller overlaps are none.
    """
    words = np.rint(phases / (2 * np.pi) * 2.0**WORD_BITS)
    share = (words % 65536) / 65536
    z = np.zeros(len(phases), np.complex128)
    for level in range(coarse, -1, -1):
        here = share < 2.0 ** (-level * dimensions)
        x, k, n, b = places[here], waves[here], normals[here], widths[here] / 2**level
        d = x[:, None] - x[None, :]
        sign = np.where(n @ n.T < 0, -1.0, 1.0)
        s = b[:, None] ** 2 + b**2
        k_i, k_j = k[:, None], sign[:, :, None] * k[None, :]
        product = (b[:, None] * b) ** 2
        size = (4 * product / s**2) ** (dimensions / 4) * np.exp(
            -np.pi * product * _dot(d, d) / s - _dot(k_i - k_j, k_i - k_j) / (4 * np.pi * s)
        )
        angle = _dot(b[:, None, None] ** 2 * k_j + b[None, :, None] ** 2 * k_i, d) / s
        overlap = np.where(size > least, size * np.exp(1j * angle), 0)
        np.fill_diagonal(overlap, 0)

        def neighbours(own: Complexes, overlap: Complexes = overlap, sign: Floats = sign) -> Complexes:
            return np.asarray((overlap * np.where(sign > 0, own, own.conj())).sum(axis=1))

        own = z[here]
        new = own == 0
        handed = neighbours(own)
        own = np.where(new, np.where(handed == 0, np.exp(1j * phases[here]), handed), own)
        own /= np.abs(own)
        for _ in range(sweeps):
            own = own + neighbours(own)
            own /= np.abs(own)
        z[here] = own
    return np.asarray(np.angle(z) % (2 * np.pi))


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
