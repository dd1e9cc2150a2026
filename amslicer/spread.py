"""How far a material's share of a window scatters about the painted ratio, from the theory of Gaussian phases.

Away from the painted ratio the indicator of a material is Σ_h a_h cos(h ϕ), ϕ = arg G the phase of phasor noise. A
complex Gaussian field with the envelope correlation r(d) = exp(-π b² |d|²/2) has

    E exp(ih(ψ(x) - ψ(x + d))) = C_h(d) = r^h Γ(1 + h/2)²/Γ(1 + h) ₂F₁(h/2, h/2; h + 1; r²),   ψ = ϕ - k·x.

₂F₁ is a power series in r², so C_h is a mixture of Gaussians exp(-π b² m |d|²/2), m = h + 2n, and the variance of
the mean of e^{ihϕ} over a box is a sum of products of one integral per side, with weights w_n:

    V_h = Σ_n w_n Π_i F(L_i),   F(L) = (2/L) ∫₀^L (1 - t/L) exp(-π b² m t²/2) cos(h k_i t) dt.

That is everything at once: sheets cut by the window's sides (m small), the noise's own wander, and its singularities
(the slow end of the series). Share's variance: ½ Σ_h a_h² V_h. Different h are uncorrelated, since the phase at a
point is uniform.

tests/test_spread.py measures (got - asked)/σ in windows of 2 to 10 periods, bandwidths 0.25 to 1, in 2D and in space.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from amslicer.profiles import Profile

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

# a_h² V_h falls as h^-4 (2D: singularities of density b²/2 alone give V_h ~ 1/h²); what is beyond is added as if
# it were as coherent as the last.
HARMONICS = 12
# Terms of the series: the first are summed, the rest integrated over log n up to SERIES_REACH times the n at which a
# Gaussian is as narrow as a period. V_h within 0.5 % of a thousand terms for bandwidths 0.1 to 2.
SERIES_TERMS, SERIES_NODES, SERIES_REACH = 4, 10, 10.0
# About four kernels per b^-d are not quite Gaussian: σ is 1.00 to 1.12 times the theory's, more at smaller bandwidths
# (0.143 singularities per period² where theory has 0.125), measured in windows of 2 to 20 periods.
FEW_KERNELS = 1.10
# Isotropy turns sheets within ±90° s, so beyond s = ¼ windows see all directions alike; as sheets bend, they end in
# more singularities: at s = 1, windows of 10 to 20 periods measured 1.35 (B = 0.25), 1.2 (0.5), 1.0 (1) × the average.
DIRECTIONS_MIX, BENDING = 4.0, 0.25
DIRECTIONS = {2: 24, 3: 64}  # normals in the average over directions
# The largest |error| among 10^6 windows of 1 to 10 periods is 4σ + 0.38 periods² (periods³ in space) over their area.
LIMIT_SIGMAS, DEFECT = 4.0, 0.5
ALIGNED_SHARE = 0.05  # of the bandwidth: what is left of the noise's own wander where phases are aligned
FLAT = 1e-3  # width × side of a perfect grating
# Filled fractions at which the law is evaluated; between them it is interpolated in logarithms.
FULL, FILLED = (1.0,), tuple(np.geomspace(1e-3, 1.0, 13).tolist())
# A part's border in a window counts as faces along the sheets, this many times as large as the window's largest: 1 left
# half-filled windows of aligned sheets at 1.18 σ; at 1.5, discs, rings, walls and half planes are all below 1.
FACES = 1.5
# Windows and normals closer than this share a result: 0.6° moves the far side of 5 periods by a twentieth of one.
SIDE_DIGITS, NORMAL_DIGITS = 6, 2
CACHED_WINDOWS, CACHED_CALLS = 4096, 64


def share_deviation(
    low: ArrayLike, high: ArrayLike, *, profile: Profile, bandwidth: float, dimensions: int, window_periods: ArrayLike,
    filled: ArrayLike = 1.0, isotropy: ArrayLike = 0.0, normal: ArrayLike | None = None,
) -> Floats:  # fmt: skip
    """Standard deviation of a material's share of a box window of unaligned phasor noise.

    Phase alignment makes it smaller. A window that is only filled in part gets a safe law, not the best one: the
    least of what cutting off a part of the window can do at worst, and of a box of the same volume plus faces along
    the sheets.

    Args:
        low, high: the material's cumulative ratios c(m-1) and c(m), 0…1; all arrays broadcast.
        bandwidth: B, relative to 1/period.
        dimensions: 2 or 3, of the pattern.
        window_periods: (..., 2) or (..., 3) sides along x, y (and z) in periods. Two sides of a 3D pattern are a
            plane cut of it; a third side of a 2D pattern changes nothing.
        filled: solid share of the window, above 0 up to 1.
        isotropy: 0…1.
        normal: (..., 3) unit normals of the laminate; default: the average variance over all directions. Where the
            sheets run along a side, the ones that it cuts add up, and the average is too small by up to a factor of 3.
    """
    low, high, filled, isotropy = (np.asarray(v, np.float64) for v in (low, high, filled, isotropy))
    sides = np.asarray(window_periods, np.float64)[..., : 2 if dimensions == 2 else 3]
    most = (high - low) * (1 - (high - low))  # every pixel alike
    power = profile.amplitudes(low, high, HARMONICS) ** 2 / 2
    remainder = np.maximum(most - np.sum(power, axis=-1), 0.0)
    scale = (FEW_KERNELS * (1 + BENDING * isotropy)) ** 2

    def variance(harmonic: Floats) -> Floats:
        return np.asarray(scale * (np.sum(power * harmonic, axis=-1) + remainder * harmonic[..., -1]))

    mix = np.ones(1) if normal is None else np.minimum(1.0, DIRECTIONS_MIX * isotropy)[..., None]
    harmonic = np.zeros(1)
    if np.any(mix > 0):
        harmonic = mix * _by_window(sides, bandwidth, dimensions, FULL)[..., 0, :]
    if normal is not None:
        harmonic = harmonic + (1 - mix) * _by_normal(sides, np.asarray(normal, np.float64), bandwidth)
    full = variance(harmonic)
    if np.all(filled >= 1):
        return np.sqrt(np.minimum(full, most))

    shape = np.broadcast_shapes(filled.shape, sides.shape[:-1])
    box = variance(_interpolate(_by_window(sides, bandwidth, dimensions, FILLED), filled, shape))
    volume = np.prod(sides, axis=-1)
    face = FACES * volume / np.min(sides, axis=-1)
    order = np.arange(1, HARMONICS + 1)
    faces = np.sum(power / (2 * np.pi * order) ** 2, axis=-1) * (face / (filled * volume)) ** 2
    cut = (np.sqrt(full) + (1 - filled) * np.sqrt(most)) ** 2 / filled**2
    partly = np.minimum(cut, np.maximum(full, box) + faces)
    return np.sqrt(np.minimum(np.where(filled < 1, partly, full), most))


def share_limit(
    low: ArrayLike, high: ArrayLike, *, profile: Profile, bandwidth: float, dimensions: int, window_periods: ArrayLike,
    filled: ArrayLike = 1.0, isotropy: ArrayLike = 0.0, normal: ArrayLike | None = None, pixels: ArrayLike = 0.0,
) -> Floats:  # fmt: skip
    """How far an honest window's share may be from the ratio: shares of few periods are not Gaussian.

    A singularity is rare and shifts the share of the window that has one by up to DEFECT periods² over its area.

    Args:
        pixels: standard deviation from sampling, of pixel_deviation or `locking.locked_deviation`.
        low, high, profile, bandwidth, dimensions, window_periods, filled, isotropy, normal: as in share_deviation.
    """
    sigma = share_deviation(
        low, high, profile=profile, bandwidth=bandwidth, dimensions=dimensions, window_periods=window_periods,
        filled=filled, isotropy=isotropy, normal=normal,
    )  # fmt: skip
    share = np.asarray(high, np.float64) - np.asarray(low, np.float64)
    return limit_of(LIMIT_SIGMAS * np.hypot(sigma, pixels), share, dimensions, window_periods, filled)


def limit_of(chance: Floats, share: Floats, dimensions: int, window_periods: ArrayLike, filled: ArrayLike) -> Floats:
    """What chance explains and a defect more, but no error that is not possible.

    Args:
        chance: some standard deviations.
        share: of the material, asked.
        dimensions, window_periods, filled: as in share_deviation.
    """
    sides = np.asarray(window_periods, np.float64)[..., : 2 if dimensions == 2 else 3]
    defect = DEFECT / (np.asarray(filled, np.float64) * np.prod(np.maximum(sides, 1.0), axis=-1))
    return np.asarray(np.minimum(chance + defect, np.maximum(share, 1 - share)))


def pixel_deviation(
    low: ArrayLike, high: ArrayLike, *, dimensions: int, pixels_per_period: ArrayLike, pixels: ArrayLike
) -> Floats:
    """Standard deviation that point-sampling by pixels adds to a share, where pixels and sheets are out of step.

    Errs on the large side for oblique laminates, but may be too small along a row of pixels. Where the laminate's
    normal is known, use `locking.locked_deviation`, which is right for both.

    A pixel that a sheet's face crosses has 0 or 1 instead of its covered part u: variance u(1 - u), 1/6 on average. A
    face across a row of pixels crosses Σ|n_i| <= √dimensions of them per row.

    Args:
        low, high: as in share_deviation.
        pixels_per_period: period over the coarsest pitch.
        pixels: solid pixels, of all layers that have a pattern of their own.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    share = np.minimum(high - low, 1 - (high - low))
    inner = (low > 0) & (high < 1)
    faces = np.where(inner, 4, 2) * math.sqrt(dimensions) / np.asarray(pixels_per_period, np.float64)
    return np.asarray(np.sqrt(np.minimum(faces / 6, share * (1 - share)) / np.asarray(pixels, np.float64)))


def harmonic_variance(order: int, sides: ArrayLike, cycles: ArrayLike, width: ArrayLike) -> Floats:
    """V_h, the mean square of the mean of exp(ihϕ) over a box.

    Args:
        order: h, 1, 2, …
        sides: (..., d) of the box, in any unit per axis.
        cycles: (..., d) frequency that the h-th harmonic has in the box, per that unit: h n/p, or what sampling
            makes of it.
        width: (d,) envelope width b, per that unit.
    """
    side, wave = np.broadcast_arrays(np.asarray(sides, np.float64), np.asarray(cycles, np.float64))
    # Below this the envelope is flat over the largest side, and the series would have no end.
    flat = FLAT / np.max(side, axis=tuple(range(side.ndim - 1)))
    b: Floats = np.maximum(np.asarray(width, np.float64), flat)
    widest = float(np.max(b))
    relative = widest / max(float(np.max(np.abs(wave))) / order, widest / 2)
    multiple, weight = _mixture(order, relative)
    product = weight
    for axis in range(side.shape[-1]):
        decay = np.pi / 2 * b[axis] ** 2 * multiple
        product = product * along_side(side[..., axis, None], decay, 2 * np.pi * wave[..., axis, None])
    # Rounding leaves ±1e-12 where a grating's cut sheets cancel.
    return np.asarray(np.maximum(np.sum(product, axis=-1), 0.0))


@lru_cache(maxsize=CACHED_WINDOWS)
def _mixture(order: int, bandwidth: float) -> tuple[Floats, Floats]:
    """m and w of C_h = Σ w r^m, for fields whose Gaussians matter down to a period's width."""
    from scipy.special import gammaln

    top = max(100.0, SERIES_REACH * 2 * math.pi * (order / bandwidth) ** 2)
    node, part = np.polynomial.legendre.leggauss(SERIES_NODES)
    start, length = math.log(SERIES_TERMS - 0.5), math.log(top / (SERIES_TERMS - 0.5))
    reached = np.exp(start + length * (node + 1) / 2)
    n = np.concatenate([np.arange(SERIES_TERMS), reached])
    count = np.concatenate([np.ones(SERIES_TERMS), part * length / 2 * reached])
    h = float(order)
    logarithm = (
        2 * (gammaln(h / 2 + n) - gammaln(h / 2)) - gammaln(h + 1 + n) - gammaln(n + 1) + 2 * gammaln(1 + h / 2)
    )  # fmt: skip
    return h + 2 * n, count * np.exp(logarithm)


def along_side(side: Floats, decay: Floats, wave: Floats) -> Floats:
    """F(L) = (2/L) ∫₀^L (1 - t/L) exp(-A t²) cos(κ t) dt by the Faddeeva function, without cancelling exponentials."""
    from scipy.special import wofz

    # Below this the Gaussian is 1 along the side, and the closed form divides by nothing.
    decay = np.maximum(decay, 1e-6 / side**2)
    root = np.sqrt(decay)
    y = wave / (2 * root)
    end = np.exp(-decay * side**2 + 1j * wave * side)
    plain = math.sqrt(math.pi) / (2 * root) * (wofz(y) - end * wofz(y + 1j * root * side))
    weighted = (1 - end + 1j * wave * plain) / (2 * decay)
    return np.asarray(2 / side * (plain - weighted / side).real)


def _by_window(sides: Floats, bandwidth: float, dimensions: int, filled: tuple[float, ...]) -> Floats:
    """(..., filled, HARMONICS) V_h averaged over directions, of boxes of the window's shape and part of its volume."""
    rows, inverse = np.unique(sides.reshape(-1, sides.shape[-1]).round(SIDE_DIGITS), axis=0, return_inverse=True)
    tables = np.stack([_average(tuple(row), bandwidth, dimensions, filled) for row in rows.tolist()])
    return tables[inverse.reshape(-1)].reshape(*sides.shape[:-1], *tables.shape[1:])


@lru_cache(maxsize=CACHED_WINDOWS)
def _average(sides: tuple[float, ...], bandwidth: float, dimensions: int, filled: tuple[float, ...]) -> Floats:
    normals = directions(dimensions)[:, None, : len(sides)]
    boxes = np.asarray(sides) * np.asarray(filled)[:, None] ** (1 / len(sides))
    table = [harmonic_variance(h, boxes, h * normals, bandwidth).mean(axis=0) for h in range(1, HARMONICS + 1)]
    return np.stack(table, axis=-1)


def _by_normal(sides: Floats, normal: Floats, bandwidth: float) -> Floats:
    """(..., HARMONICS) V_h of full windows, for the normals given."""
    axes = sides.shape[-1]
    shape = np.broadcast_shapes(sides.shape[:-1], normal.shape[:-1])
    parts = sides.round(SIDE_DIGITS), np.abs(normal[..., :axes]).round(NORMAL_DIGITS)
    pairs = np.concatenate([np.broadcast_to(part, (*shape, axes)) for part in parts], axis=-1)
    rows, inverse = np.unique(pairs.reshape(-1, 2 * axes), axis=0, return_inverse=True)
    table = _of_pairs(rows.tobytes(), axes, bandwidth)
    return table[inverse.reshape(-1)].reshape(*shape, HARMONICS)


@lru_cache(maxsize=CACHED_CALLS)
def _of_pairs(pairs: bytes, axes: int, bandwidth: float) -> Floats:
    sides, normals = np.split(np.frombuffer(pairs).reshape(-1, 2 * axes), 2, axis=1)
    return np.stack([harmonic_variance(h, sides, h * normals, bandwidth) for h in range(1, HARMONICS + 1)], axis=-1)


@lru_cache(maxsize=2)
def directions(dimensions: int) -> Floats:
    """(N, 3) normals spread evenly over an octant, which is all that a box can tell apart."""
    count = DIRECTIONS[dimensions]
    step = (np.arange(count) + 0.5) / count
    if dimensions == 2:
        return np.stack([np.cos(np.pi / 2 * step), np.sin(np.pi / 2 * step), 0 * step], axis=-1)
    golden = (np.arange(count) * (math.sqrt(5) - 1) / 2) % 1 * np.pi / 2
    level = np.sqrt(1 - step**2)
    return np.stack([level * np.cos(golden), level * np.sin(golden), step], axis=-1)


def _interpolate(table: Floats, filled: Floats, shape: tuple[int, ...]) -> Floats:
    """(*shape, HARMONICS) of a (..., FILLED, HARMONICS) table, linear in logarithms between filled fractions."""
    place = np.interp(np.log(np.broadcast_to(filled, shape)), np.log(FILLED), np.arange(len(FILLED)))
    below = np.minimum(place.astype(np.int64), len(FILLED) - 2)[..., None, None]
    table = np.broadcast_to(np.log(table + np.finfo(np.float64).tiny), (*shape, *table.shape[-2:]))
    low, high = (np.take_along_axis(table, below + i, axis=-2)[..., 0, :] for i in (0, 1))
    return np.asarray(np.exp(low + (place[..., None] - below[..., 0]) * (high - low)))
