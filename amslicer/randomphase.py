"""Random-phase textures: what has the spectrum of an exemplar and phases at random, periodic and of any size.

Two processes make them (Galerne, Gousseau and Morel 2011, "Random Phase Textures"): random-phase noise keeps the
modulus of every frequency exactly, asymptotic spot noise multiplies it by Rayleigh noise. Both take the same random
numbers for all channels, so that no colour appears that the exemplar does not have.

Pictures are float64 (rows, columns) or (rows, columns, channels), of any unit; a frequency's random numbers depend on
the seed, the frame and the size alone. They are raw words of NumPy's Philox (a 64-bit Philox: none of them is a word of
the package's own), whose stream is fixed for good, unlike that of NumPy's distributions.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Ints = NDArray[np.int64]

Kind = Literal["random-phase", "asymptotic-spot"]

WORD_MASK = (1 << 64) - 1
UNUSED_BITS, UNIT = 12, 2.0**-52  # half steps between the other bits' numbers are exact in float64: neither 0 nor 1
PHASES, NOISE = 0, 1  # the fourth word of a counter says what the random words are for
FADE = 0.2  # of the spot's side, over which it fades to its mean at either border: α of the paper, its figure 9
FADE_DEVIATIONS = 4  # the fade is a Gaussian of standard deviation α/4
PLASTIC = 1.32471795724474602596  # g³ = g + 1: places i/g, i/g² modulo 1 fill a square evenly
PLACES = 1 << 21  # of a texture, whose values give its quantiles; even at random places they were right to 0.1 %


# 3·11³, the largest odd product of small primes below 4096 pixels: of 128 MiB, made in a second or two. A part that is
# larger sees the texture again.
MOST_PX = 3993
FACTORS = (3, 5, 7, 11)  # sides that are products of these have fast Fourier transforms
STEPS = 16  # textures per renewal, straight in between: half way the spread is 0.2 % too low


def good_side(least: int) -> int:
    """The smallest odd side from there on whose Fourier transform is fast: a renewed texture then changes steadily."""
    return next(n for n in itertools.count(least | 1, 2) if _is_product(n))


def _is_product(n: int) -> bool:
    for factor in FACTORS:
        while n % factor == 0:
            n //= factor
    return n == 1


def uniform_phase(shape: tuple[int, int], seed: int, frame: int = 0) -> Floats:
    """An odd uniform random phase: θ(-ξ) = -θ(ξ), in ]-π, π]; 0 or π where -ξ is ξ, and θ(0) = 0 (definition 3).

    Args:
        shape: rows and columns.
        seed: 0 … 2^64 - 1.
        frame: any integer; another frame, other phases.

    Returns:
        (rows, columns), rad, over the frequencies as the FFT orders them.
    """
    rows, columns = shape
    half = _half_phase(shape, seed, frame)
    known = half.shape[1]
    mirrored = half[-np.arange(rows) % rows][:, columns - np.arange(known, columns)]
    return np.concatenate([half, -mirrored], axis=1)


def random_phase(p: Floats, seed: int, frame: int = 0) -> Floats:
    """Random-phase noise: p, one uniform random phase added to that of every channel (definition 4, section 5.1)."""
    return Frames(p, "random-phase", seed).at(frame)


def asymptotic_spot(p: Floats, seed: int, frame: int = 0) -> Floats:
    """Asymptotic spot noise: m + (p - m) ∗ Y / √(MN), Y Gaussian white noise, the same for each channel (theorem 2)."""
    return Frames(p, "asymptotic-spot", seed).at(frame)


class Frames:
    """A texture that renews itself along an axis: independent textures at integer positions, blended in between.

    Blending their values would lose contrast half way. Random-phase noise turns every phase the shorter way round, and
    so every blend is random-phase noise with the modulus of p; asymptotic spot noise blends the Gaussian white noises
    and keeps their variance at 1. Where a side is even, up to three frequencies are their own conjugates, whose phase
    can only change sign: it does so half way. With odd sides a texture changes without a step.

    Args:
        p: a periodic component, or an extended spot.
        kind: a key of KINDS.
        seed: 0 … 2^64 - 1.
    """

    def __init__(self, p: Floats, kind: Kind, seed: int) -> None:
        from scipy import fft

        self._shape, self._sides, self._seed = p.shape, (p.shape[0], p.shape[1]), seed
        self._draw, self._blend = KINDS[kind]
        self._drawn: dict[int, Floats | Complexes] = {}
        self._spectrum: Complexes = fft.rfft2(p.reshape(*self._sides, -1), axes=(0, 1))

    def at(self, position: float) -> Floats:
        """The texture at a position, in frames: periodic, in the shape of p and with its mean."""
        from scipy import fft

        lower = math.floor(position)
        share = position - lower
        needed = (lower, lower + 1) if share else (lower,)
        self._drawn = {
            i: self._drawn[i] if i in self._drawn else self._draw(self._sides, self._seed, i) for i in needed
        }
        factor = self._blend(self._drawn[needed[0]], self._drawn[needed[-1]], share, self._sides)
        factor[0, 0] = 1.0  # the mean stays
        texture: Floats = fft.irfft2(self._spectrum * factor[..., None], s=self._sides, axes=(0, 1))
        return texture.reshape(self._shape)


def extended_spot(p: Floats, shape: tuple[int, int]) -> Floats:
    """A larger spot whose textures look like p's: p in the middle, fading to its mean m at its borders (section 5.3).

    It is m + g ((p - m) φ - c) with the paper's window φ. Each channel has its own c, which makes the mean exactly m,
    and its own g, which makes the variance exactly p's (the paper's factor √(M2 N2 / M1 N1) and the norm of φ are in
    it). Neither moves a channel's phases against another's: c touches frequency 0 alone, and g is positive and the same
    at all frequencies.

    Args:
        p: a periodic component.
        shape: rows and columns. Along an axis where it is not larger, p keeps its own size and does not fade, for it is
            periodic there: a texture may be cropped, its spot may not.

    Returns:
        At least (rows, columns), with the channels of p.
    """
    own = p.shape[:2]
    sides = tuple(max(pair) for pair in zip(own, shape, strict=True))
    window = np.ones((1, 1))
    for axis in (0, 1):
        if sides[axis] > own[axis]:
            window = window * np.expand_dims(_fade(own[axis]), 1 - axis)
    values = p.reshape(*own, -1)
    mean = values.mean(axis=(0, 1))
    spot = np.zeros((*sides, values.shape[2]))
    top, left = ((side - length) // 2 for side, length in zip(sides, own, strict=True))
    spot[top : top + own[0], left : left + own[1]] = (values - mean) * window[..., None]
    spot -= spot.mean(axis=(0, 1))
    found = spot.std(axis=(0, 1))
    gain = values.std(axis=(0, 1)) / np.where(found > 0, found, 1.0)
    result: Floats = (mean + gain * spot).reshape(*sides, *p.shape[2:])
    return result


def neighbours(position_px: ArrayLike, count: int) -> tuple[Ints, Ints, Floats]:
    """Along an axis of a periodic texture: pixel below each position, pixel above, and the share between their centres.

    Args:
        position_px: pixel i has its centre at i + ½.
        count: pixels along the axis.
    """
    along = np.asarray(position_px, np.float64) - 0.5
    floor = np.floor(along)
    below = np.mod(floor, count).astype(np.int64)
    return below, (below + 1) % count, along - floor


def sample_bilinear(texture: Floats, x_px: ArrayLike, y_px: ArrayLike) -> Floats:
    """Values of a periodic texture between its pixels, in the coordinates' common shape (and channels).

    Args:
        x_px, y_px: along columns and rows, any real numbers, which broadcast; pixel (row r, column c) has its centre at
            (c + ½, r + ½).
    """
    c0, c1, fx = neighbours(x_px, texture.shape[1])
    r0, r1, fy = neighbours(y_px, texture.shape[0])
    if texture.ndim == 3:
        fx, fy = fx[..., None], fy[..., None]
    raster = c0.ndim == r0.ndim == 2 and c0.shape[0] == r0.shape[1] == 1
    if raster:  # along its rows once per row of the texture
        rows, place = np.unique([r0[:, 0], r1[:, 0]], return_inverse=True)
        some = texture[rows]
        across = some[:, c0[0]] + fx * (some[:, c1[0]] - some[:, c0[0]])
        low, high = across[place.reshape(2, -1)]
    else:
        low = texture[r0, c0] + fx * (texture[r0, c1] - texture[r0, c0])
        high = texture[r1, c0] + fx * (texture[r1, c1] - texture[r1, c0])
    result: Floats = low + fy * (high - low)
    return result


def quantiles(texture: Floats, shares: ArrayLike) -> Floats:
    """Levels that given shares of a bilinearly interpolated periodic texture lie above: right to 0.1 % of the area.

    From its values at two million places that fill it evenly. Of a share of 0 it is the largest pixel, of 1 the next
    number below the smallest: nothing and everything is above them.

    Args:
        texture: (rows, columns).
        shares: any shape, 0…1.
    """
    rows, columns = texture.shape
    number = np.arange(PLACES)
    values = np.sort(sample_bilinear(texture, number / PLASTIC % 1.0 * columns, number / PLASTIC**2 % 1.0 * rows))
    share = np.clip(np.asarray(shares, np.float64), 0.0, 1.0)
    # Place i of the sorted ones has i + ½ of them below it, on average.
    level = np.interp((1 - share) * PLACES - 0.5, np.arange(PLACES), values)
    level = np.where(share == 0, texture.max(), level)
    result: Floats = np.where(share == 1, np.nextafter(texture.min(), -np.inf), level)
    return result


def _uniform(count: int, seed: int, frame: int, purpose: int) -> Floats:
    """Random numbers in ]0, 1[; a frame below 0 counts as its two's complement."""
    counter = np.array([0, frame & WORD_MASK, 0, purpose], np.uint64)  # the first word counts the words, four at a time
    bits = np.random.Philox(key=np.array([seed, 0], np.uint64), counter=counter)
    words = np.asarray(bits.random_raw(count), np.uint64)
    result: Floats = ((words >> np.uint64(UNUSED_BITS)).astype(np.float64) + 0.5) * UNIT
    return result


def _own_conjugates(side: int) -> tuple[int, ...]:
    """Frequencies along an axis that are their own negatives."""
    return (0, side // 2) if side % 2 == 0 else (0,)


def _half_phase(shape: tuple[int, int], seed: int, frame: int) -> Floats:
    """(rows, columns // 2 + 1) of a uniform random phase: the frequencies of a real FFT."""
    rows, columns = shape
    share = _uniform(rows * (columns // 2 + 1), seed, frame, PHASES).reshape(rows, -1)
    theta: Floats = np.pi * (1.0 - 2.0 * share)
    for column in _own_conjugates(columns):  # both ξ and -ξ are in them
        theta[rows // 2 + 1 :, column] = -theta[1 : (rows + 1) // 2, column][::-1]
        for row in _own_conjugates(rows):
            theta[row, column] = np.pi if theta[row, column] > 0 else 0.0
    theta[0, 0] = 0.0
    return theta


def _blend_phases(a: Floats, b: Floats, share: float, sides: tuple[int, int]) -> Complexes:
    turns = (b - a) / (2 * np.pi)
    theta = a + share * 2 * np.pi * (turns - np.round(turns))
    for at in product(*(_own_conjugates(side) for side in sides)):
        theta[at] = (a if share < 0.5 else b)[at]  # a phase between 0 and π would not be that of a real picture
    result: Complexes = np.exp(1j * theta)
    return result


def _white_noise(shape: tuple[int, int], seed: int, frame: int) -> Complexes:
    """(rows, columns // 2 + 1) spectrum of Gaussian white noise, of mean square 1."""
    from scipy import fft
    from scipy.special import ndtri

    pixels = math.prod(shape)
    noise = ndtri(_uniform(pixels, seed, frame, NOISE)).reshape(shape)
    spectrum: Complexes = fft.rfft2(noise) / math.sqrt(pixels)
    return spectrum


def _blend_noises(a: Complexes, b: Complexes, share: float, sides: tuple[int, int]) -> Complexes:
    return ((1 - share) * a + share * b) / math.hypot(1 - share, share)


def _fade(count: int) -> Floats:
    """(count,) φ along an axis: 1 in the middle, a Gaussian's flank over FADE at either end."""
    place = (np.arange(count) + 0.5) / count
    beyond = np.maximum(FADE - np.minimum(place, 1 - place), 0.0) / (FADE / FADE_DEVIATIONS)
    return np.exp(-0.5 * beyond**2)


# What is drawn at random for each frame, and the factor of the spectrum between two frames.
KINDS: dict[str, tuple[Callable[..., Any], Callable[..., Complexes]]] = {
    "random-phase": (_half_phase, _blend_phases),
    "asymptotic-spot": (_white_noise, _blend_noises),
}
