"""How far a material's share of a window scatters where materials are what lies above levels of a Gaussian value.

The indicator of {Y > t}, Y standard normal, is (1 - Φ(t)) + Σ_n φ(t) He_{n-1}(t) He_n(Y)/n!, and He_n(Y) of two places
has the covariance n! ρ^n. With ρ(d) = exp(-π b² |d|²/2) cos(k·d), as of Gabor noise, ρ^n is a sum of Gaussians times
cosines

    ρ^n = exp(-π b² n |d|²/2) 2^-n Σ_j C(n, j) cos((n - 2j) k·d),

whose mean over a box is a product of one integral per side (amslicer/spread.py). Even n have a term without a wave:
where the noise is weak it makes few sheets, or fat ones, for a whole envelope's width, so shares scatter several times
as far as those of phasor noise.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from amslicer.spread import DIRECTIONS_MIX, NORMAL_DIGITS, SIDE_DIGITS, along_side, directions, limit_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from amslicer.profiles import Profile

    Floats = NDArray[np.float64]

TERMS = 16  # of the series: what is beyond is added as if it were as coherent as the last two
FEW_KERNELS = 1.05  # a dozen kernels per b^-d are not quite Gaussian
LIMIT_SIGMAS = 4.5  # chosen, half a standard deviation above that of phases


def level_deviation(
    low: ArrayLike, high: ArrayLike, *, profile: Profile, bandwidth: float, dimensions: int, window_periods: ArrayLike,
    filled: ArrayLike = 1.0, isotropy: ArrayLike = 0.0, normal: ArrayLike | None = None,
) -> Floats:  # fmt: skip
    """Standard deviation of a material's share of a box window.

    Args: as of spread.share_deviation.
    """
    low, high, filled, isotropy = (np.asarray(v, np.float64) for v in (low, high, filled, isotropy))
    sides = np.asarray(window_periods, np.float64)[..., : 2 if dimensions == 2 else 3]
    most = (high - low) * (1 - (high - low))
    power = np.max(profile.over_values(_coefficients, low, high) ** 2, axis=0)
    mean = np.zeros((*sides.shape[:-1], TERMS))
    mix = np.ones(1) if normal is None else np.minimum(1.0, DIRECTIONS_MIX * isotropy)[..., None]
    if np.any(mix > 0):
        everywhere = directions(dimensions).reshape(-1, *(1,) * (sides.ndim - 1), 3)
        mean = mix * _means(sides[None], everywhere, bandwidth).mean(axis=0)
    if normal is not None:
        mean = mean + (1 - mix) * _means(sides, np.asarray(normal, np.float64), bandwidth)
    rest = np.maximum(most - power.sum(axis=-1), 0.0)
    last = power[..., -2:]  # an odd and an even one, which are coherent to very different degrees
    beyond = np.sum(last * np.abs(mean[..., -2:]), axis=-1) / np.maximum(last.sum(axis=-1), np.finfo(float).tiny)
    full = FEW_KERNELS**2 * np.maximum(np.sum(power * mean, axis=-1) + rest * beyond, 0.0)
    cut = (np.sqrt(full) + (1 - filled) * np.sqrt(most)) ** 2 / filled**2
    return np.asarray(np.sqrt(np.minimum(np.where(filled < 1, cut, full), most)))


def level_limit(
    low: ArrayLike, high: ArrayLike, *, profile: Profile, pixels: ArrayLike = 0.0, bandwidth: float,
    dimensions: int, window_periods: ArrayLike, filled: ArrayLike = 1.0, isotropy: ArrayLike = 0.0,
    normal: ArrayLike | None = None,
) -> Floats:  # fmt: skip
    """How far an honest window's share may be from the ratio. Args: as of spread.share_limit."""
    sigma = level_deviation(
        low, high, profile=profile, bandwidth=bandwidth, dimensions=dimensions, window_periods=window_periods,
        filled=filled, isotropy=isotropy, normal=normal,
    )  # fmt: skip
    share = np.asarray(high, np.float64) - np.asarray(low, np.float64)
    return limit_of(LIMIT_SIGMAS * np.hypot(sigma, pixels), share, dimensions, window_periods, filled)


def _coefficients(share: Floats) -> Floats:
    """(..., TERMS) φ(t) He_{n-1}(t)/√n! at the level with this share above it; 0 where there is none."""
    from scipy.special import ndtri

    t = -ndtri(np.clip(share, 0.0, 1.0))
    inner = np.isfinite(t)
    t = np.where(inner, t, 0.0)
    before, hermite = np.zeros_like(t), np.ones_like(t)
    out = np.empty((*t.shape, TERMS))
    for n in range(1, TERMS + 1):
        out[..., n - 1] = np.exp(-(t**2) / 2) / math.sqrt(2 * math.pi) * hermite / math.sqrt(math.factorial(n))
        before, hermite = hermite, t * hermite - (n - 1) * before
    return np.where(inner[..., None], out, 0.0)


def _means(sides: Floats, normal: Floats, bandwidth: float) -> Floats:
    """(..., TERMS) means of ρ^n over pairs of places of boxes, n = 1 …"""
    axes = sides.shape[-1]
    shape = np.broadcast_shapes(sides.shape[:-1], normal.shape[:-1])
    parts = sides.round(SIDE_DIGITS), np.abs(normal[..., :axes]).round(NORMAL_DIGITS)
    rows = np.concatenate([np.broadcast_to(part, (*shape, axes)) for part in parts], axis=-1).reshape(-1, 2 * axes)
    pairs, inverse = np.unique(rows, axis=0, return_inverse=True)
    side, cosine = np.split(pairs, 2, axis=1)
    out = np.zeros((len(pairs), TERMS))
    for n in range(1, TERMS + 1):
        for j in range(n // 2 + 1):
            waves = n - 2 * j
            weight = math.comb(n, j) * (2.0 if waves else 1.0) / 2**n
            product = np.full(len(pairs), weight)
            for axis in range(axes):
                decay = np.full(len(pairs), math.pi / 2 * bandwidth**2 * n)
                product = product * along_side(side[:, axis], decay, 2 * np.pi * waves * cosine[:, axis])
            out[:, n - 1] += product
    return out[inverse.reshape(-1)].reshape(*shape, TERMS)
