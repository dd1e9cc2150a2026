"""Gabor noise with its authors' parameters, in one to four dimensions: for checking equations, not for slicing.

Lagae, Lefebvre, Dutré 2011, "Improving Gabor Noise", whose equation numbers these are. Lengths are in any unit. A noise
is N(x) = Σ_i w_i g(x - x_i) over λ impulses x_i per unit of space, w_i uniform in [-1, 1]:

    anisotropic   g = K exp(-π a² r²) cos(2π F₀ x·ω)                                     (2)
    isotropic     g = K exp(-π a² r²) 2π F₀^(n/2) r^(1-n/2) J_(n/2-1)(2π F₀ r)           (11), (35)-(38)

    σ² = λ E[w²] ∫g²,  E[w²] = ⅓;   power spectrum λ E[w²] |G|²;   relative error of cutting g at r: (23).

`gabor` and `gabor-isotropic` of amslicer.noise are the same kernels with unit weights and random phases.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from numbers import Integral, Real
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import UsageError
from amslicer.reference import WORD_BITS, WORD_MASK, philox4x32

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MEAN_SQUARE_WEIGHT = 1 / 3  # of weights uniform in [-1, 1]
STEPS = 20_001  # of integrals over the radius
FAR = 6.0  # in 1/a: exp(-π a² r²) is 1e-49
NO_FREQUENCY = 1e-6  # of F₀
LEAST_ERROR = 1e-6  # smaller ones drown in the rounding of their integrals
PER_CELL = 4  # impulses: hashed cells of this many, the same for every box that is asked for
PAIRS_AT_ONCE = 4_000_000  # of points and impulses


@dataclass(frozen=True)
class GaborKernel:
    """A Gabor kernel.

    Attributes:
        magnitude: K > 0.
        width: a > 0, of the Gaussian; 1/a is a length.
        frequency: F₀ > 0.
        dimensions: n, 1 to 4.
        direction: unit vector ω of n components of an anisotropic kernel; None: isotropic.
    """

    magnitude: float
    width: float
    frequency: float
    dimensions: int
    direction: tuple[float, ...] | None = field(default=None)

    def __post_init__(self) -> None:
        if self.dimensions not in (1, 2, 3, 4):
            raise UsageError(f"dimensions is {self.dimensions}; Gabor kernels have 1 to 4")
        for name in ("magnitude", "width", "frequency"):
            value: object = getattr(self, name)
            if not isinstance(value, int | float) or not 0 < value < math.inf:
                raise UsageError(f"{name} is {value!r}; it is a number greater than 0")
        w = self.direction
        if w is not None and (len(w) != self.dimensions or not math.isclose(math.hypot(*w), 1, abs_tol=1e-6)):
            raise UsageError(f"direction is {w}; it is a unit vector of {self.dimensions} components")

    def at(self, offsets: Floats) -> Floats:
        """(...,) g at (..., n) offsets from the centre."""
        r = np.linalg.norm(offsets, axis=-1)
        if self.direction is None:
            return self.radial(r)
        along = np.asarray(offsets) @ np.asarray(self.direction)
        return np.asarray(self._gaussian(r) * np.cos(2 * np.pi * self.frequency * along))

    def radial(self, r: Floats) -> Floats:
        """(...,) g of an isotropic kernel at distances: (35)-(38)."""
        x = 2 * np.pi * self.frequency * np.asarray(r, np.float64)
        return np.asarray(self._gaussian(r) * self._harmonic_at_0 * _bessel(self.dimensions, x))

    def power(self, frequencies: Floats) -> Floats:
        """(...,) |G|², the kernel's energy spectrum, at (..., n) frequencies; its integral is `energy`.

        The Fourier transform of an isotropic kernel is (39)-(42); of an anisotropic one two Gaussians at ± F₀ ω.
        """
        if self.direction is None:
            return self.radial_power(np.linalg.norm(frequencies, axis=-1))
        centre = self.frequency * np.asarray(self.direction)
        parts = [np.exp(-np.pi * np.sum((frequencies - s * centre) ** 2, axis=-1) / self.width**2) for s in (1, -1)]
        return np.asarray((self.magnitude / (2 * self.width**self.dimensions) * (parts[0] + parts[1])) ** 2)

    def radial_power(self, f: Floats) -> Floats:
        """(...,) |G|² of an isotropic kernel at frequencies: (39)-(42)."""
        from scipy.special import ive

        n, a, centre = self.dimensions, self.width, self.frequency
        f = np.maximum(np.asarray(f, np.float64), NO_FREQUENCY * centre)  # the limit at 0
        # I(x) exp(-π (f² + F₀²)/a²) with x = 2πF₀f/a²: the scaled Bessel function and the exponent of (f - F₀)².
        x = 2 * np.pi * centre * f / a**2
        scaled = ive(n / 2 - 1, x) * np.exp(-np.pi * (f - centre) ** 2 / a**2)
        g = 2 * np.pi * self.magnitude * centre ** (n / 2) / (a**2 * f ** (n / 2 - 1)) * scaled
        return np.asarray(g**2)

    @property
    def energy(self) -> float:
        """∫g² over all space: (43)-(46) for isotropic kernels."""
        from scipy.special import ive

        k, a, f, n = self.magnitude, self.width, self.frequency, self.dimensions
        if self.direction is not None or n == 1:
            whole = k**2 / (2 * (math.sqrt(2) * a) ** n) * (1 + math.exp(-2 * math.pi * f**2 / a**2))
            return whole if self.direction is not None else 4 * whole
        x = math.pi * f**2 / a**2
        if n == 2:
            return float(2 * math.pi**2 * k**2 * f**2 / a**2 * ive(0, x))
        if n == 3:
            return float(2 * math.sqrt(2) * math.pi * k**2 * f**2 / a * (1 - math.exp(-2 * x)))
        return float(2 * math.pi**3 * k**2 * f**4 / a**2 * ive(1, x))

    def variance(self, density: float) -> float:
        """σ² of noise with λ impulses per unit of space."""
        return density * MEAN_SQUARE_WEIGHT * self.energy

    def envelope_radius(self, level: float) -> float:
        """Where the envelope falls to a value: of an anisotropic kernel (51), of an isotropic one from (47)-(50).

        The paper cuts where it is 5 % of K, and of K 2πF₀ F₀/a for a two-dimensional isotropic kernel.
        """
        from scipy.optimize import brentq

        if not 0 < level < math.inf:
            raise UsageError(f"level is {level}; it is greater than 0")
        least, far = 1e-9 / self.width, FAR / self.width
        if self._envelope(least) <= level:
            return 0.0
        if self._envelope(far) >= level:
            raise UsageError(f"level is {level}; the envelope is {self._envelope(far):.1e} at {far:.4g}, far away")
        return float(brentq(lambda r: math.log(self._envelope(r) / level), least, far, xtol=1e-12))

    def error_of_radius(self, radius: float) -> float:
        """e of (23): rms of what cutting at a radius leaves away, over that of the noise."""
        return float(np.interp(radius, *self._errors()))

    def radius_of_error(self, error: float) -> float:
        """Where cutting makes a relative error, 0 < e < 1: (23) solved for the radius."""
        if not LEAST_ERROR <= error < 1:
            raise UsageError(f"error is {error}; it is between {LEAST_ERROR:g} and 1")
        r, e = self._errors()
        return float(np.interp(-error, -e, r))

    def impulses_per_kernel(self, density: float, radius: float) -> float:
        """Impulses within a radius, on average: λ times the volume of a ball."""
        n = self.dimensions
        return float(density * math.pi ** (n / 2) / math.gamma(n / 2 + 1) * radius**n)

    @property
    def _harmonic_at_0(self) -> float:
        """The isotropic kernel's wave at 0, over K."""
        f = self.frequency
        return {1: 2.0, 2: 2 * math.pi * f, 3: 4 * math.pi * f**2, 4: 2 * math.pi**2 * f**3}[self.dimensions]

    def _gaussian(self, r: Floats | float) -> Floats:
        return np.asarray(self.magnitude * np.exp(-np.pi * (self.width * np.asarray(r)) ** 2))

    def _envelope(self, r: float) -> float:
        """(47)-(50); an anisotropic kernel's is the Gaussian."""
        from scipy.special import jv, yv

        gaussian = float(self._gaussian(r))
        if self.direction is not None:
            return gaussian
        f, n = self.frequency, self.dimensions
        order, x = n / 2 - 1, 2 * math.pi * f * r
        modulus = math.hypot(jv(order, x), yv(order, x))
        return float(gaussian * 2 * math.pi * f ** (n / 2) * r ** (1 - n / 2) * modulus)

    def _errors(self) -> tuple[Floats, Floats]:
        """Radii and relative errors: the integrals of (23) on shells, of an anisotropic kernel averaged over them."""
        r = np.linspace(0.0, FAR / self.width, STEPS)
        if self.direction is None:
            squared = self.radial(r) ** 2
        else:
            # cos² averages to (1 + the mean of cos over directions of twice the wave)/2.
            mean = _bessel(self.dimensions, 4 * np.pi * self.frequency * r)
            squared = self._gaussian(r) ** 2 * (1 + mean) / 2
        shell = squared * r ** (self.dimensions - 1)
        inside = np.concatenate([[0.0], np.cumsum((shell[1:] + shell[:-1]) / 2)])
        return r, np.sqrt(np.maximum(1 - inside / inside[-1], 0.0))


def gabor_noise(
    kernel: GaborKernel, points: Floats, *, density: float, seed: int, radius: float, level: int = 0
) -> Floats:
    """N at points, every kernel cut at a radius: impulses of hashed cells, the same ones for every radius.

    Args:
        kernel: g.
        points: (N, n).
        density: λ, impulses per unit of space.
        seed: 0 … 2^64 - 1.
        radius: > 0.
        level: another level, other impulses.
    """
    points = _checked(points, kernel.dimensions, seed, density=density, radius=radius)
    return _convolved(kernel.at, points, kernel.dimensions, density, seed, np.full(len(points), radius), level)


def varying_gabor_noise(
    points: Floats, *, magnitude: float, width: Floats, frequency: Floats, impulses: float, seed: int,
    level_share: float = 0.05, even: bool = True,
) -> Floats:  # fmt: skip
    """Isotropic Gabor noise in the plane whose parameters vary, read at the points: section V, Figs 13 to 15.

    A point whose kernel has the radius r, 2^l <= r < 2^(l+1), takes two noises with its own kernel from the impulses of
    two grids, N per π 4^l and per π 4^(l+1), with weights of α = r/2^l - 1.

    Args:
        points: (N, 2).
        magnitude: K.
        width, frequency: (N,) a and F₀ at the points, or one number.
        impulses: N per kernel's area.
        level_share: of the envelope's height where kernels end; as in `GaborKernel.envelope_radius`.
        even: weights that keep the variance, √(1-α)/(1+α) and 2√α/(1+α); else the paper's (25) and (26), with which it
            falls to half at α = ⅓.
    """
    from scipy.special import j0

    points = _checked(points, 2, seed, impulses=impulses, magnitude=magnitude)
    for name, value in (("width", width), ("frequency", frequency)):
        if np.shape(value) not in ((), (1,), (len(points),)):
            raise UsageError(
                f"{name} has the shape {np.shape(value)}; it is one number, or one for each of {len(points)} points"
            )
    width, frequency = (np.broadcast_to(np.asarray(v, np.float64), len(points)) for v in (width, frequency))
    if not (np.all(width > 0) and np.all(frequency > 0) and 0 < level_share < 1):
        raise UsageError("width and frequency are greater than 0 at every point, and level_share is between 0 and 1")
    radius = np.sqrt(-np.log(level_share) / np.pi) / width
    level = np.floor(np.log2(radius)).astype(int)
    alpha = radius / 2.0**level - 1
    lower, upper = (
        (np.sqrt(1 - alpha) / (1 + alpha), 2 * np.sqrt(alpha) / (1 + alpha))
        if even
        else ((1 - alpha) / (1 + alpha) ** 2, 4 * alpha / (1 + alpha) ** 2)
    )
    total = np.zeros(len(points))
    for step, weight in ((0, lower), (1, upper)):
        for number in np.unique(level + step):
            here = np.flatnonzero((level + step == number) & (weight > 0))
            if not len(here):
                continue
            a, f = width[here], frequency[here]

            def kernel(offsets: Floats, which: NDArray[np.int64], a: Floats = a, f: Floats = f) -> Floats:
                r = np.linalg.norm(offsets, axis=-1)
                wave = 2 * np.pi * f[which] * j0(2 * np.pi * f[which] * r)
                return np.asarray(magnitude * np.exp(-np.pi * (a[which] * r) ** 2) * wave)

            density = impulses / (np.pi * 4.0**number)
            noise = _convolved(kernel, points[here], 2, density, seed, radius[here], int(number), which=True)
            total[here] += weight[here] * noise
    return total


def _checked(points: Floats, dimensions: int, seed: int, **positive: float) -> Floats:
    """(N, n) points, at least one, of good arguments."""
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != dimensions or not len(points) or not np.isfinite(points).all():
        raise UsageError(f"points have the shape {points.shape}; they are (N, {dimensions}) finite numbers, N > 0")
    if not isinstance(seed, Integral) or not 0 <= int(seed) < 1 << 64:
        raise UsageError(f"seed is {seed!r}; it is a whole number from 0 to 2^64 - 1")
    for name, value in positive.items():
        if not isinstance(value, Real) or not 0 < value < math.inf:
            raise UsageError(f"{name} is {value!r}; it is a number greater than 0")
    return points


def _bessel(dimensions: int, x: Floats) -> Floats:
    """The mean of cos(x·u) over unit vectors u: cos, J₀, sin x/x, 2J₁(x)/x."""
    from scipy.special import j0, j1

    if dimensions == 1:
        return np.cos(x)
    if dimensions == 2:
        return np.asarray(j0(x))
    if dimensions == 3:
        return np.sinc(x / np.pi)
    safe = np.where(x > 0, x, 1.0)
    return np.where(x > 0, 2 * j1(safe) / safe, 1.0)


def _convolved(
    kernel: Callable[..., Floats], points: Floats, dimensions: int, density: float, seed: int, radius: Floats,
    level: int, *, which: bool = False,
) -> Floats:  # fmt: skip
    """Σ w_i g(x - x_i) over the impulses within each point's radius.

    Args:
        which: the kernel takes the numbers of the points too.
    """
    from scipy.spatial import cKDTree

    points = np.asarray(points, np.float64).reshape(-1, dimensions)
    farthest = float(radius.max())
    places, weights = _impulses(points.min(axis=0) - farthest, points.max(axis=0) + farthest, density, seed, level)
    tree, total = cKDTree(places), np.zeros(len(points))
    expected = density * (2 * farthest) ** dimensions
    for first in range(0, len(points), max(1, int(PAIRS_AT_ONCE / max(expected, 1)))):
        some = slice(first, first + max(1, int(PAIRS_AT_ONCE / max(expected, 1))))
        near = cKDTree(points[some]).sparse_distance_matrix(tree, farthest, output_type="ndarray")
        near = near[near["v"] < radius[some][near["i"]]]
        i, j = near["i"].astype(np.int64), near["j"].astype(np.int64)
        offsets = points[some][i] - places[j]
        values = kernel(offsets, i + first) if which else kernel(offsets)
        total[some] += np.bincount(i, weights[j] * values, minlength=len(points[some]))
    return total


def _impulses(low: Floats, high: Floats, density: float, seed: int, level: int) -> tuple[Floats, Floats]:
    """Places (N, n) and weights (N,) of the impulses of all cells that meet a box."""
    dimensions = len(low)
    side = (PER_CELL / density) ** (1 / dimensions)
    ranges = [range(math.floor(a / side), math.floor(b / side) + 1) for a, b in zip(low, high, strict=True)]
    cells = np.array(list(product(*ranges)), np.int64)
    four = np.zeros((len(cells), 4), np.int64)
    four[:, :dimensions] = cells
    places, weights = [], []
    for m in range(PER_CELL):
        # A counter has four words: x, y, z, and the fourth coordinate (16 bits), level (8) and number (8) in one.
        last = ((four[:, 3] & 0xFFFF) << 16) | ((level & 0xFF) << 8) | (2 * m)
        words = [
            philox4x32(np.column_stack([four[:, :3], last + part]), (seed & WORD_MASK, seed >> WORD_BITS))
            for part in (0, 1)
        ]
        share = np.concatenate(words, axis=-1) / 2.0**WORD_BITS
        places.append((cells + share[:, :dimensions]) * side)
        weights.append(2 * share[:, 4] - 1)
    return np.concatenate(places), np.concatenate(weights)
