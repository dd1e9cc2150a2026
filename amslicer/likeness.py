"""How far a material's share of a window scatters where all that is known is how alike places are at a distance.

Of a level set of a Gaussian value with the covariance γ(d), the Hermite series has a term in γ with the coefficient
c₁ = φ(t), t the level, and others in γ², γ³, … So the variance of a share ρ is at most

    c₁² mean(γ) + (ρ (1 - ρ) - c₁²) mean(γ²),

with means over pairs of places in the window; of |G|², which has no first term, ρ (1 - ρ) mean(|γ|²).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# From the sides of a box in mm to the means of γ and γ² over pairs of places in it.
Likeness = Callable[["Floats"], tuple[float, float]]
NODES = {2: 48, 3: 24}  # of the quadrature along each side, dense near 0
PAIRS = 1 << 20  # of lines that are looked at a time
DIGITS = 2  # of sides that count as equal
SIGMAS = 4.5  # of an honest stack's worst window
PIXEL_SHARE = 0.5  # pixels that an edge passes through fall to either side: n of them scatter by about ½/√n


def share_deviation(below: Floats, until: Floats, sides_mm: Floats, likeness: Likeness) -> Floats:
    """(W, M) at most this standard deviation of a material's share of a box.

    Args:
        below, until: (W, M) its cumulative painted shares.
        sides_mm: (W, 2) in the plane, or (W, 3).

    Raises:
        ValueError: a likeness is no number.
    """
    from scipy.special import ndtri

    rounded = np.array([[float(f"{side:.{DIGITS - 1}e}") for side in row] for row in sides_mm])
    unique, number = np.unique(rounded, axis=0, return_inverse=True)
    means = np.array([likeness(row) for row in unique])[number.reshape(-1)]
    if not np.isfinite(means).all():
        raise ValueError("how alike places are is no number")
    low, high = (np.clip(c, 0.0, 1.0) for c in (below, until))
    normal = [np.exp(-(ndtri(np.clip(c, 1e-12, 1 - 1e-12)) ** 2) / 2) / np.sqrt(2 * np.pi) for c in (low, high)]
    most = (high - low) * (1 - (high - low))
    first = np.minimum((normal[1] - normal[0]) ** 2, most)
    variance = first * means[:, :1] + (most - first) * means[:, 1:]
    return np.asarray(np.sqrt(np.clip(variance, 0.0, most)))


def of_distance(coherence: Callable[[Floats], Floats]) -> Likeness:
    """Of what depends on the distance alone, and of which no more is known: γ for both."""

    def likeness(sides_mm: Floats) -> tuple[float, float]:
        node, weight = np.polynomial.legendre.leggauss(NODES[len(sides_mm)])
        s, w = (node + 1) / 2, weight / 2
        share, density = s**3, w * 3 * s**2 * 2 * (1 - s**3)  # distances along a side have a triangular law
        grids = np.meshgrid(*(share * side for side in sides_mm), indexing="ij")
        densities = np.meshgrid(*[density] * len(sides_mm), indexing="ij")
        distance = np.sqrt(np.sum(np.square(grids), axis=0))
        mean = float(np.sum(coherence(distance) * np.prod(densities, axis=0)))
        return mean, mean

    return likeness


def of_lines(waves: Floats, power: Floats, *, modulus: bool) -> Likeness:
    """Of a sum of plane waves: the mean of cos(2π ν·d) over pairs of places in a box is Π sinc²(ν_i side_i).

    Args:
        waves: (L, 3) frequencies ν, 1/mm.
        power: (L,) of each, Σ 1.
        modulus: of |G|², whose only term is |γ|².
    """

    def likeness(sides_mm: Floats) -> tuple[float, float]:
        scaled = waves[:, : len(sides_mm)] * sides_mm
        first = float(power @ np.prod(np.sinc(scaled) ** 2, axis=1))
        at_once, square = max(1, PAIRS // len(power)), 0.0
        for start in range(0, len(power), at_once):
            some, weight = scaled[start : start + at_once, None], power[start : start + at_once, None] * power
            apart = np.prod(np.sinc(some - scaled) ** 2, axis=-1)
            if not modulus:
                apart = (apart + np.prod(np.sinc(some + scaled) ** 2, axis=-1)) / 2
            square += float(np.sum(weight * apart))
        return (square, square) if modulus else (first, square)

    return likeness


def of_map(covariance: Floats, pixel_mm: float, renewal_mm: float) -> Likeness:
    """Of a periodic texture: its covariance at whole pixels, 1 at (0, 0); another texture after each renewal in z."""

    def likeness(sides_mm: Floats) -> tuple[float, float]:
        weights = []
        for count, side in zip(covariance.shape, sides_mm[1::-1], strict=True):
            most = max(1, int(side / pixel_mm))
            lag = np.arange(-most, most + 1)
            along = np.bincount(lag % count, np.maximum(0.0, 1 - np.abs(lag) / (most + 1)), minlength=count)
            weights.append(along / along.sum())
        upright = 1.0
        if len(sides_mm) == 3:
            z = np.linspace(0.0, 1.0, 401) * sides_mm[2]
            upright = float(np.mean(2 * (1 - z / sides_mm[2]) * np.maximum(0.0, 1 - z / (1.5 * renewal_mm))))
        mean, square = (float(weights[0] @ c @ weights[1]) * upright for c in (covariance, covariance**2))
        return max(mean, 0.0), square

    return likeness
