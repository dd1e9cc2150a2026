"""A waveform as a profile: a material is where the waveform is among its highest values, as many as the ratio asks for.

The phase is uniform, so the share of a turn where f is higher than f(ϕ), the rank r(ϕ), is uniform too, and material m
where c(m-1) <= r < c(m) has its ratio, whatever the waveform. Places of equal f follow each other from where a smoothed
f is highest, then by their distance from ϕ = 0: a plateau fills up from its middle. Values of Gaussian noises stand for
phases from 0 to π: the share of all values above one is |ϕ|/π.

The device looks ranks up (cl/deposit.h), by a stand-in for the angle that takes one division: with s = |Re| + |Im|,
d = 1 - Re/s where Im >= 0, else 3 + Re/s, from 0 to 4 over the turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.profiles.profile import RankTable, plain_fills

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from amslicer.noise import Noise
    from amslicer.profiles.waveforms import Waveform

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

SAMPLES = 8192  # of a turn: an edge is off by at most 1/12868 of a period, half the widest step of the stand-in
BLENDS = 129  # levels of a blend; in between the nearest is taken, so that each has exactly the ratios asked for
VALUE_REACH = 6.0  # standard deviations of values
SMOOTH = 16  # harmonics that are left of a smoothed waveform, the h-th times exp(-h²/SMOOTHING)
SMOOTHING = 8.0
DECIMALS = 9  # of values, as shares of their range: closer ones are equal
EVEN = 1e-4  # of the range: two sides of an even waveform differ by no more
PROBES = 61  # places where a waveform is first asked whether it is even
LOOKED_AT = 5  # levels of a blend whose largest Fourier coefficients stand for all
COARSE = 2048  # samples of a turn for Fourier coefficients
ALWAYS, NEVER = np.float32(2.0), np.float32(-1.0)  # beyond 0…1


@dataclass(frozen=True, eq=False)
class RankProfile:
    """The profile of a waveform, or of a blend of two.

    Attributes:
        waves: one or two waveforms, turned so that they are even, f(ϕ) = f(-ϕ), if they can be.
        arrows: whether they are not, so that the sign of the phase counts.
    """

    waves: tuple[Waveform, ...]
    arrows: bool

    @property
    def humps(self) -> int:
        """As of Profile; of a blend the larger number."""
        most = 1
        for wave in self.waves:
            values = wave(np.arange(COARSE) / COARSE)
            steps = np.diff(values, append=values[:1])
            steps = steps[np.abs(steps) > EVEN * np.ptp(values) / COARSE]
            most = max(most, int(np.count_nonzero((steps > 0) & (np.roll(steps, -1) < 0))))
        return most

    @property
    def blends(self) -> Floats:
        """The levels of the blend, 0…1; 0 alone where there is none."""
        return np.linspace(0.0, 1.0, BLENDS if len(self.waves) > 1 else 1)

    def rank_table(self, noise: Noise) -> RankTable:
        """Ranks over the stand-in for the angle, or over values."""
        if noise.reads == "phase":
            edges = np.unwrap(turn_of(np.linspace(0.0, 4.0, SAMPLES + 1)), period=1.0)
            return RankTable(self._ranks(edges).astype(np.float32), 0.0)
        reach, edges = value_edges(noise)
        return RankTable(self._ranks(edges)[:, ::-1].astype(np.float32), reach)

    def thresholds(self, cumulative: NDArray[Any]) -> NDArray[np.float32]:
        """The ratios themselves, and plain fills."""
        c = np.ascontiguousarray(cumulative, np.float64)
        return plain_fills(c, c.astype(np.float32), NEVER, ALWAYS)

    def amplitudes(self, low: ArrayLike, high: ArrayLike, harmonics: int) -> Floats:
        """As of Profile; of a blend the largest of some levels."""
        h = np.arange(1, harmonics + 1)
        turn = (np.arange(COARSE) + 0.5) / COARSE
        waves = np.exp(-2j * np.pi * h * turn[:, None])
        found = [self.of_ranks(rank, waves, low, high) for rank in self._some_ranks]
        return np.asarray(2 * np.max(np.abs(found), axis=0))

    def levels(self, shares: Floats, blend: float = 0.0) -> Floats:
        """As of Profile: the mean of e^{iϕ} over each material, along the line through 0 that is nearest to all."""
        until = np.cumsum(shares)
        rank = self._some_ranks[round(blend * (len(self._some_ranks) - 1))]
        turn = (np.arange(COARSE) + 0.5) / COARSE
        mean = self.of_ranks(rank, np.exp(2j * np.pi * turn)[:, None], until - shares, until)[:, 0]
        mean = mean / np.where(shares > 0, shares, 1.0)
        axis = np.angle(np.sum(shares * mean**2)) / 2
        return np.asarray((mean * np.exp(-1j * axis)).real)

    def over_values(self, until: Callable[[Floats], Floats], low: ArrayLike, high: ArrayLike) -> Floats:
        """As of Profile: at some levels of a blend."""
        grown = np.diff(until(np.linspace(0.0, 1.0, COARSE + 1)), axis=0) * COARSE
        ranks = self._ranks(np.linspace(0.0, 0.5, COARSE + 1), LOOKED_AT)
        return np.stack([self.of_ranks(rank, grown, low, high) for rank in ranks])

    @staticmethod
    def of_ranks(rank: Floats, values: NDArray[Any], low: ArrayLike, high: ArrayLike) -> NDArray[Any]:
        """(..., n) means over a turn of (samples, n) values times the indicator low <= rank < high."""
        order = np.argsort(rank, kind="stable")
        count = len(rank)
        until = np.concatenate([np.zeros((1, values.shape[1]), values.dtype), np.cumsum(values[order], axis=0)]) / count
        low, high = np.broadcast_arrays(low, high)

        def at(c: NDArray[Any]) -> NDArray[Any]:
            place = np.clip(c, 0.0, 1.0) * count
            below = np.minimum(place.astype(np.int64), count - 1)
            part = (place - below)[..., None]
            return np.asarray(until[below] * (1 - part) + until[below + 1] * part)

        return np.asarray(at(high) - at(low))

    @cached_property
    def _some_ranks(self) -> Floats:
        return self._ranks(np.linspace(0.0, 1.0, COARSE + 1), LOOKED_AT)

    def _ranks(self, edges: Floats, most: int | None = None) -> Floats:
        """(levels, N) ranks of the cells between (N + 1,) rising shares of a turn, a whole one or the first half.

        Args:
            most: levels of the blend, fewer than all.
        """
        blends = self.blends if most is None or len(self.waves) == 1 else np.linspace(0.0, 1.0, most)
        middle, measure = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / (edges[-1] - edges[0])
        within = [np.asarray(wave(np.arange(COARSE) / COARSE), np.float64) for wave in self.waves]
        scale = 1 / max(float(np.ptp(some)) for some in within)
        values = [scale * (wave(middle) - some.min()) for wave, some in zip(self.waves, within, strict=True)]
        smooth = [scale * smoothed(wave)(middle) for wave in self.waves]
        aside = np.abs(middle - np.round(middle))
        out = np.empty((len(blends), len(middle)))
        for row, t in zip(out, blends, strict=True):
            value, softer = (_between(pair, t) for pair in (values, smooth))
            order = np.lexsort((aside.round(DECIMALS), -softer.round(DECIMALS), -value.round(DECIMALS)))
            row[order] = np.cumsum(measure[order]) - measure[order] / 2
        if not self.arrows and edges[-1] - edges[0] > 0.75:  # a whole turn: the same to the last bit for ϕ and -ϕ
            out = (out + out[:, ::-1]) / 2
        return out


def rank_profile(waves: Sequence[Waveform], axes: Sequence[float] = (0.0,)) -> RankProfile:
    """The profile of one waveform, or of a blend of two, turned together so that they are even where they can be.

    Args:
        axes: shares of a turn about which they may be even.
    """
    probes = np.arange(1, PROBES + 1) / (2 * PROBES + 1)
    turn = np.arange(COARSE) / COARSE
    ranges = [np.ptp(wave(turn)) for wave in waves]

    def even(start: float, at: Floats) -> bool:
        pairs = zip(waves, ranges, strict=True)
        return all(np.abs(wave(start + at) - wave(start - at)).max() <= EVEN * size for wave, size in pairs)

    for start in axes:
        if even(start, probes) and even(start, turn):
            return RankProfile(tuple(_turned(wave, start) for wave in waves), arrows=False)
    return RankProfile(tuple(waves), arrows=True)


def _turned(wave: Waveform, start: float) -> Waveform:
    return wave if start == 0 else lambda t: wave(t + start)


def _between(pair: Sequence[Floats], t: float) -> Floats:
    return pair[0] if len(pair) == 1 else (1 - t) * pair[0] + t * pair[1]


def smoothed(wave: Waveform) -> Waveform:
    """The waveform without its fast harmonics."""
    spectrum = np.fft.rfft(wave(np.arange(COARSE) / COARSE)) / COARSE
    h = np.arange(1, SMOOTH + 1)
    part = 2 * spectrum[1 : SMOOTH + 1] * np.exp(-(h**2) / SMOOTHING)
    return lambda t: (part * np.exp(2j * np.pi * h * np.asarray(t)[..., None])).sum(axis=-1).real


def turn_of(diamond: Floats) -> Floats:
    """Share of a turn of the stand-in d for the angle, 0…4."""
    upper = diamond <= 2
    re = np.where(upper, 1 - diamond, diamond - 3)
    im = np.where(upper, 1, -1) * (1 - np.abs(re))
    return np.asarray(np.arctan2(im, re) / (2 * np.pi) % 1)


def value_edges(noise: Noise) -> tuple[float, Floats]:
    """How far values are looked up, ± reach, and the shares of half a turn at SAMPLES + 1 values from high to low."""
    from scipy.special import ndtr

    share = ndtr(np.linspace(-8.0, 8.0, 4 * SAMPLES + 1))
    value = np.maximum.accumulate(noise.levels_of(share)[::-1])
    reach = VALUE_REACH * float(noise.levels_of(np.array(ndtr(-1.0))))
    edges = np.linspace(reach, -reach, SAMPLES + 1)
    above = np.interp(edges, value, share[::-1])
    above[0], above[-1] = 0.0, 1.0
    return reach, above / 2
