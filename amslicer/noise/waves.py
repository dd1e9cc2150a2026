"""Wave noise (Guehl et al. 2025, "Multi-Dimensional Procedural Wave Noise"): G is a sum of plane waves.

    G(x) = Σ_k w_k T[x·ω_k/L + ζ_k mod 1] / √(Σ_k w_k²),
    T[j] = Σ_l A(f_l) f_l^((n-1)/2) exp(i(2π l j/Nx + φ_l)),   f_l = l/L

with one direction ω_k in each of N equal parts of the half circle (half sphere in space) and one table T of waves of
all frequencies that travel together, with random phases, read with linear interpolation (section 4.2; the exponent on
the amplitude is (n-1)/2, so that A² is the power's density). Each wave is cut into slices along an axis of its own, 45°
from its direction: each has a direction of the same part and an offset ζ of its own, so that nothing repeats, and two
neighbours are blended with ((1-u) T_a + u T_b)/√(u² + (1-u)²), which keeps the variance (Algorithm 1, corrected).

The painted direction and isotropy are weights w_k at the place where G is asked for. The power of a laminate's kernels,
exp(-2π |f - n/p|²/b²), is nearly a ring of width b times a lobe exp(-4π (1 - cos γ)/B²) about the normal: the ring is
the table's, the lobe w². Isotropy spreads the lobe evenly over ±90° s, or the cap of half-angle 90° s. Of ω and -ω,
which are one wave, the one counts that lies on the normal's side: from one to the other is a conjugation. So arg G is
uniform at every place and the expected ratio the painted one, as of phasor noise. Where the period is painted, there is
a table for each of some periods, with the same phases, and neighbours are interpolated (section 4.3).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from math import ceil, log, log2, pi, radians, sin, sqrt
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import numpy as np

from amslicer.errors import JobError
from amslicer.likeness import of_lines
from amslicer.noise import philox
from amslicer.noise.bands import Band, TabledBand
from amslicer.noise.kernels import WORD
from amslicer.noise.spectra import (
    IMPULSE_WIDTH,
    IMPULSES,
    STEPS,
    Directional,
    Laminate,
    Spectrum,
    Waveform,
    make_spectrum,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.likeness import Likeness
    from amslicer.noise.setting import Setting
    from amslicer.specification import Pattern

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

WAVES = 1 << 28  # fourth word of the counters (amslicer/noise/kernels.py)
SLICES, PARTS, PHASES, SPEEDS, FORMS = range(5)  # their third word: what the random words are for
# Directions, at the least and times 1/B^(dimensions - 1): a lobe's width apart (MATH: 22 and 300 at B = 0.5).
DIRECTIONS = {2: (22, 11.0), 3: (300, 75.0)}
MAX_DIRECTIONS = 20_000  # more take minutes
LENGTH_PERIODS = 64.0  # of a table: enough frequencies in a laminate's band for values to be Gaussian
LENGTH_WAVES = 16.0  # or of a broad spectrum, in its longest waves
SAMPLES_PER_WAVE = 32  # of the shortest: linear interpolation is then within 0.5 %
# Slices' mean thickness, in tables: along its direction none is longer than √2 × 1.6/2.4 = 0.94 tables.
SLICE_LENGTH = 1 / 2.4
JITTER = (0.3, 0.4)  # border i lies at i + 0.3 … i + 0.7
BLEND = 0.1  # half of the width over which two slices are blended, in slices
CUT = 0.02  # of the lobe's amplitude: weaker waves count as nothing
# Waves across the normal change sides where it turns; they fade out before, so that G does not jump.
EQUATOR = sin(radians(5.0))
COSINES, ISOTROPIES = 4096, 33  # of the table of weights
LOBE_NODES = 4  # of the quadrature over the isotropy's spread, per width of the lobe
PERIOD_STEP = 0.5  # between tables of a painted period, in standard deviations of the laminate's ring
# Directions, frequencies of each, and lines of both that stand for all where it counts how alike places are.
MOST_DIRECTIONS, FEW_LINES, MOST_LINES, FAINT = 100, (8, 64), 900, 1e-3
MAX_TABLE_BYTES = 256 << 20
PAINTED_BAND = 2.0  # times the bandwidth: 90° in 14 periods change 0.02 % of the pixels, as 360° do
LEAST_STEP = 1e-3  # between the periods of tables
LOOKS = 3  # per side of a part, over which amplitudes that depend on the direction are averaged
ALIKE_TABLES = 0.98  # correlation of tables of neighbouring periods, at the least: mixing them keeps the variance
WAVEFORM_DIRECTIONS = {2: 22, 3: 40}
READS = {"phase": "phase", "real": "value", "modulus": "power"}  # the job file's words


@dataclass(frozen=True)
class Waves:
    """M slices of plane waves.

    Attributes:
        direction: (M, 3) unit vectors ω.
        offset: (M,) ζ, in tables, time included.
        axis: (M, 3) unit vectors along which the waves are cut.
        low_mm, high_mm: (M,) where the slices begin and end along it.
        part: (M,) which part of the half circle or half sphere they are of.
    """

    direction: Floats
    offset: Floats
    axis: Floats
    low_mm: Floats
    high_mm: Floats
    part: Ints

    def take(self, chosen: NDArray[Any]) -> Waves:
        """The chosen ones, in the same order."""
        return Waves(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Wave:
    """Wave noise with its parameters.

    Attributes:
        periods_mm: the shortest and the longest painted period.
        bandwidth: B, of the lobe (and of the laminate's ring), relative to 1/p.
        dimensions: 2 or 3.
        seed: 0 … 2^64 - 1.
        directions: N.
        spectrum: amplitudes, or a waveform.
        reads: "phase", "value" or "power": materials follow from arg G, Re G or |G|².
        time: how far each wave has travelled, in shortest periods, half of them forth and half back.
        isotropy, normal: the lowest and the first that are painted; what is expected of windows follows from them.
        painted: whether direction or isotropy change, and weights with them: they make the band wider.
        turns: whether the painted direction does, so that waves fade before they change sides.
        fourth: another coordinate, in shortest periods: waves move with it at speeds of their own, -1 … 1.
    """

    periods_mm: tuple[float, float]
    bandwidth: float
    dimensions: int
    seed: int
    directions: int = 0
    spectrum: Spectrum | Directional | Waveform = field(default_factory=Laminate)
    reads: str = "phase"
    time: float = 0.0
    fourth: float = 0.0
    isotropy: float = 0.0
    normal: tuple[float, float, float] = (1.0, 0.0, 0.0)
    turns: bool = False
    painted: bool = False
    made_of: ClassVar[str] = "waves"
    keys: ClassVar[frozenset[str]] = frozenset({"directions", "spectrum", "reads", "time", "fourth"})

    @classmethod
    def of_pattern(cls, pattern: Pattern, setting: Setting) -> Self:
        """The noise that a job's pattern asks for."""
        return cls(
            periods_mm=setting.periods_mm, bandwidth=pattern.bandwidth, dimensions=pattern.dimensions,
            seed=pattern.seed, directions=pattern.directions or 0, spectrum=make_spectrum(pattern.spectrum),
            reads=cls.read_by(pattern),
            time=pattern.time, fourth=pattern.fourth, isotropy=setting.isotropy, normal=setting.normal,
            turns=setting.turns, painted=setting.painted,
        )  # fmt: skip

    @classmethod
    def read_by(cls, pattern: Pattern) -> str:
        """What of G a job's pattern reads: its phase, or the value of waveforms, where it does not say."""
        default = "real" if isinstance(make_spectrum(pattern.spectrum), Waveform) else "phase"
        return READS[pattern.reads or default]

    @classmethod
    def follows(cls, pattern: Pattern) -> bool:
        """Whether a job's pattern follows the painted direction."""
        spectrum = make_spectrum(pattern.spectrum)
        return not isinstance(spectrum, Waveform) and not hasattr(spectrum, "amplitude_along")

    def __post_init__(self) -> None:
        if not self.directions:
            count = default_directions(self.bandwidth, self.dimensions)
            if isinstance(self.spectrum, Waveform):
                count = WAVEFORM_DIRECTIONS[self.dimensions]
            object.__setattr__(self, "directions", count)

    @property
    def band(self) -> Band | TabledBand | None:
        """The frequencies of G; None of waveforms, which have no highest one."""
        if isinstance(self.spectrum, Waveform):
            return None
        if isinstance(self.spectrum, Laminate):
            return Band(self.periods_mm, min(2.0, PAINTED_BAND * self.bandwidth) if self.painted else self.bandwidth)
        frequency, power = self._line
        return TabledBand(frequency, power, self.periods_mm)

    @property
    def directed(self) -> bool:
        """Whether weights follow the painted direction: not of waveforms, the law of whose values needs all alike."""
        return not isinstance(self.spectrum, Waveform) and not self.by_part

    @property
    def by_part(self) -> bool:
        """Whether each part of the half circle or half sphere has a table of its own."""
        return hasattr(self.spectrum, "amplitude_along")

    @property
    def length_mm(self) -> float:
        """L: after this a table begins anew."""
        longest = self.periods_mm[1]
        if isinstance(self.spectrum, Laminate | Waveform):
            return LENGTH_PERIODS * longest
        if self.by_part and cast("Directional", self.spectrum).length_periods is not None:
            return longest * cast("Directional", self.spectrum).length_periods  # type: ignore[operator]
        low, _ = self.spectrum.band(self.bandwidth)
        return longest * max(LENGTH_PERIODS, LENGTH_WAVES / max(low, LENGTH_WAVES / (8 * LENGTH_PERIODS)))

    @property
    def slice_mm(self) -> float:
        """Mean thickness of a slice."""
        return SLICE_LENGTH * self.length_mm

    @property
    def blend_mm(self) -> float:
        """Half of the width over which two slices are blended."""
        return BLEND * self.slice_mm

    @cached_property
    def table_periods_mm(self) -> Floats:
        """(R,) the periods that there are tables for, from the shortest to the longest."""
        shortest, longest = self.periods_mm
        if shortest == longest:
            return np.array([shortest])
        ratio = 1 + PERIOD_STEP * min(self.bandwidth, 0.5) / sqrt(4 * pi)
        if not isinstance(self.spectrum, Laminate | Waveform) and not self.by_part:
            while ratio > 1 + LEAST_STEP and self._likeness_of_tables(ratio) < ALIKE_TABLES:
                ratio = sqrt(ratio)
        return np.geomspace(shortest, longest, ceil(log(longest / shortest) / log(ratio)) + 1)

    def _likeness_of_tables(self, ratio: float) -> float:
        """Correlation of the tables of two periods."""
        spectrum = cast("Spectrum", self.spectrum)
        low, high = spectrum.band(self.bandwidth)
        f = np.linspace(low / ratio, high, 20_001)
        one, other = (
            spectrum.amplitude(f * k, self.bandwidth) * f ** ((self.dimensions - 1) / 2) for k in (1.0, ratio)
        )
        return float(one @ other / sqrt(float(one @ one) * float(other @ other)))

    @property
    def samples(self) -> int:
        """Nx, a power of two."""
        high = 1 / IMPULSE_WIDTH
        if not isinstance(self.spectrum, Waveform):
            high = self.spectrum.band(self.bandwidth)[1]
        return 1 << ceil(log2(SAMPLES_PER_WAVE * high * self.length_mm / self.periods_mm[0]))

    @property
    def table_bytes(self) -> int:
        """Of all tables."""
        return (len(self._part_modes) if self.by_part else len(self.table_periods_mm)) * self.samples * 8

    @cached_property
    def tables(self) -> NDArray[np.complex128]:
        """(R, Nx) T of each period, of mean power 1; or of each part, of the powers `powers`."""
        if isinstance(self.spectrum, Waveform):
            return self._waveform(self.spectrum)[None].astype(np.complex128)
        modes = self._part_modes if self.by_part else (self._modes(float(p)) for p in self.table_periods_mm)
        tables = []
        for order, amplitude, phase in modes:
            spectrum = np.zeros(self.samples, np.complex128)
            spectrum[order] = amplitude * np.exp(1j * phase)
            tables.append(np.fft.ifft(spectrum) * self.samples)
        return np.stack(tables)

    @cached_property
    def powers(self) -> Floats:
        """(R,) mean power of each table."""
        if not self.by_part:
            return np.ones(len(self.tables))
        return np.array([np.sum(amplitude**2) for _, amplitude, _ in self._part_modes])

    @cached_property
    def rows(self) -> Ints:
        """(N,) which table is each part's; the last one is empty."""
        used = np.flatnonzero(self._part_amplitudes[1].any(axis=1))
        rows = np.full(self.directions, len(used))
        rows[used] = np.arange(len(used))
        return rows

    @cached_property
    def _part_amplitudes(self) -> tuple[Ints, Floats]:
        """Harmonics, and (N, harmonics) amplitudes: √ of the mean power of LOOKS directions of each part."""
        spectrum, period = cast("Directional", self.spectrum), self.periods_mm[0]
        low, high = (f / period * self.length_mm for f in spectrum.band(self.bandwidth))
        order = np.arange(max(1, ceil(low)), int(high) + 1)
        frequency: Floats = np.asarray(order * (period / self.length_mm), np.float64)
        rise = frequency ** ((getattr(spectrum, "dimensions", self.dimensions) - 1) / 2)
        look = (np.arange(LOOKS) + 0.5) / LOOKS
        shares = np.stack(np.meshgrid(look, look if self.dimensions == 3 else [0.5]), axis=-1).reshape(-1, 2)
        power = np.zeros((self.directions, len(order)))
        for share in shares:
            omegas = self.parts.directions(np.tile(share, (self.directions, 1)), np.arange(self.directions))
            for part, omega in enumerate(omegas):
                power[part] += spectrum.amplitude_along(omega, frequency, self.bandwidth) ** 2
        amplitude = np.sqrt(power / len(shares)) * rise
        total = float(np.sum(amplitude**2))
        if not total > 0:
            raise JobError(
                "pattern.spectrum: no wave of any direction has an amplitude", hint="widen its band, or its sectors"
            )
        return order, amplitude / sqrt(total / self.directions)

    @cached_property
    def _part_modes(self) -> list[tuple[Ints, Floats, Floats]]:
        """As _modes, of each part that has power, and of one that has none."""
        order, amplitudes = self._part_amplitudes
        phase = self._shares(order, 0, PHASES)[:, 0] * (2 * pi)
        return [(order, a, phase) for a in [*amplitudes[amplitudes.any(axis=1)], np.zeros(len(order))]]

    def _modes(self, period_mm: float) -> tuple[Ints, Floats, Floats]:
        """Harmonics l of the table of a period, their amplitudes with Σ² = 1, and phases."""
        spectrum = cast("Spectrum", self.spectrum)
        low, high = (f / period_mm * self.length_mm for f in spectrum.band(self.bandwidth))
        order = np.arange(max(1, ceil(low)), int(high) + 1)
        frequency: Floats = np.asarray(order * (period_mm / self.length_mm), np.float64)
        amplitude = spectrum.amplitude(frequency, self.bandwidth) * frequency ** ((self.dimensions - 1) / 2)
        phase = self._shares(order, 0, PHASES)[:, 0] * (2 * pi)
        total = float(np.sum(amplitude**2))
        if not 0 < total < np.inf:
            raise JobError(
                f"pattern.spectrum: no wave of a table of {self.length_mm:.4g} mm has an amplitude",
                hint="widen its band: low and high, width, or the table's frequencies",
            )
        return order, amplitude / sqrt(total), phase

    @property
    def _line(self) -> tuple[Floats, Floats]:
        """Frequencies (1/mm) and powers of the finest table's waves."""
        if self.by_part:
            found, amplitudes = self._part_amplitudes
            return found / self.length_mm, np.mean(amplitudes**2, axis=0)
        order, amplitude, _ = self._modes(self.periods_mm[0])
        return order / self.length_mm, amplitude**2

    def _waveform(self, form: Waveform) -> Floats:
        """(Nx,) steps or impulses at random places, of mean 0 and variance 1."""
        count = round(LENGTH_PERIODS * (STEPS if form.steps else IMPULSES))
        place, height = self._shares(np.arange(count), 0, FORMS)[:, :2].T
        order = np.argsort(place)
        place, height = place[order], height[order] * 2 - 1
        x = (np.arange(self.samples) + 0.5) / self.samples
        if form.steps:
            wave = height[np.searchsorted(place, x) % count]
        else:
            distance = np.abs((x[:, None] - place + 0.5) % 1 - 0.5) * (self.length_mm / self.periods_mm[1])
            wave = 1 / (1 + distance.min(axis=1) / IMPULSE_WIDTH)
        wave = wave - wave.mean()
        return np.asarray(wave / np.sqrt(np.mean(wave**2)))

    def _shares(self, first: Any, second: Any, use: int) -> Floats:
        """(..., 4) uniform in [0, 1)."""
        return np.asarray(philox.words(first, second, use, WAVES, seed=self.seed) * WORD)

    @cached_property
    def parts(self) -> Parts:
        """The N parts of the half circle or half sphere."""
        return half_circle(self.directions) if self.dimensions == 2 else half_sphere(self.directions)

    @cached_property
    def _cuts(self) -> tuple[Floats, Floats]:
        """(N, 3) the axes along which the parts' waves are cut, and (N,) where slice 0 begins, in slices."""
        words = self._shares(np.arange(self.directions), 0, PARTS)
        middle = self.parts.directions(np.full((self.directions, 2), 0.5), np.arange(self.directions))
        if self.dimensions == 2:
            side = np.where(words[:, :1] < 0.5, 1.0, -1.0)
            across = side * np.stack([-middle[:, 1], middle[:, 0], np.zeros(self.directions)], axis=-1)
        else:
            helper = np.where(np.abs(middle[:, 2:]) < 0.5, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
            first = np.cross(middle, helper)
            first /= np.linalg.norm(first, axis=1, keepdims=True)
            angle = 2 * pi * words[:, :1]
            across = np.cos(angle) * first + np.sin(angle) * np.cross(middle, first)
        return (middle + across) / sqrt(2), words[:, 1]

    def waves(self, low_mm: Floats, high_mm: Floats) -> Waves:
        """All slices that reach a box.

        Args:
            low_mm, high_mm: (3,) its corners, pattern frame.
        """
        axis, begin = self._cuts
        corners = np.stack([low_mm, high_mm])
        ends = np.minimum(axis * corners[0], axis * corners[1]), np.maximum(axis * corners[0], axis * corners[1])
        first, last = (np.floor(end.sum(axis=1) / self.slice_mm + begin).astype(np.int64) for end in ends)
        first, last = first - 1, last + 2  # borders are jittered and blended by less than one slice
        part = np.repeat(np.arange(self.directions), last - first + 1)
        number = np.arange(len(part)) - np.repeat(
            np.cumsum(last - first + 1) - (last - first + 1) - first, last - first + 1
        )
        words, speeds = self._shares(part, number, SLICES), self._shares(part, number, SPEEDS)
        below = self._shares(part, number - 1, SLICES)[:, 3]
        start, width = JITTER
        borders = [
            (n + start + width * r - begin[part]) * self.slice_mm
            for n, r in ((number - 1, below), (number, words[:, 3]))
        ]
        direction = self.parts.directions(words[:, :2], part)
        forth = np.where(self._shares(part, 0, SPEEDS)[:, 3] < 0.5, 1.0, -1.0)
        moved = (forth * self.time + (2 * speeds[:, 0] - 1) * self.fourth) * self.periods_mm[0] / self.length_mm
        found = Waves(direction, (words[:, 2] - moved) % 1.0, axis[part], borders[0], borders[1], part)
        low, high = (end.sum(axis=1)[part] for end in ends)
        return found.take((found.low_mm - self.blend_mm < high) & (found.high_mm + self.blend_mm > low))

    def weights(self, isotropy: Floats) -> Floats:
        """(S, COSINES + 1) w of waves whose direction has the cosine 0 … 1 to the normal, for (S,) isotropies."""
        if not self.directed:  # also where each part has a table of its own
            return np.ones((len(isotropy), COSINES + 1))
        return lobes(np.linspace(0.0, 1.0, COSINES + 1), isotropy, self.bandwidth, self.dimensions, fading=self.turns)

    @property
    def likeness(self) -> Likeness | None:
        """By the waves' frequencies and powers; None of a laminate's phase or value, of which more is known."""
        if isinstance(self.spectrum, Laminate) and self.reads != "power":
            return None
        few = np.unique(np.linspace(0, self.directions - 1, MOST_DIRECTIONS).round().astype(int))
        part = np.repeat(few, LOOKS)
        look = np.tile((np.arange(LOOKS) + 0.5) / LOOKS, len(few))
        directions = self.parts.directions(np.stack([look, look[::-1]], axis=-1), part)
        cosine = directions @ np.array(self.normal)
        weight = np.interp(
            np.abs(cosine), np.linspace(0.0, 1.0, COSINES + 1), self.weights(np.array([self.isotropy]))[0]
        )
        directions = directions * np.where(cosine < 0, -1.0, 1.0)[:, None]
        share = weight**2 * (self.powers[self.rows][part] if self.by_part else 1.0)
        kept = share > FAINT * share.max()
        frequency, power = self._few_lines(int(np.clip(MOST_LINES // np.count_nonzero(kept), *FEW_LINES)))
        waves = (directions[kept, None] * frequency[:, None]).reshape(-1, 3)
        lines = (share[kept, None] / share[kept].sum() * power).reshape(-1)
        return of_lines(waves, lines, modulus=self.reads == "power")

    def _few_lines(self, count: int) -> tuple[Floats, Floats]:
        """Frequencies (1/mm) that stand for about equal powers, and these, Σ 1: of the finest table."""
        if isinstance(self.spectrum, Waveform):
            power = np.abs(np.fft.rfft(self.tables[0].real))[1:] ** 2
            frequency: Floats = np.arange(1, len(power) + 1) / self.length_mm
        else:
            frequency, power = self._line
        until = np.cumsum(power) / power.sum()
        starts = np.unique(np.searchsorted(until, np.arange(count) / count, side="right"))
        total = np.add.reduceat(power, starts)
        return np.add.reduceat(power * frequency, starts) / np.where(total > 0, total, 1.0), total / total.sum()

    def levels_of(self, cumulative: NDArray[Any]) -> Floats:
        """The values of Re G, or of |G|², that shares of all values lie above: -∞ (0) for 1, +∞ for 0.

        Sums of waves are Gaussian: |G|² is exponential. Of waveforms the law of the sum of N independent ones follows
        from the law of one, by its characteristic function (Gil-Pelaez 1951).
        """
        from scipy.special import ndtri

        c = np.asarray(cumulative, np.float64)
        if isinstance(self.spectrum, Waveform):
            values, above = self._distribution
            return np.where(c <= 0, np.inf, np.where(c >= 1, -np.inf, np.interp(-c, -above, values)))
        if self.reads == "power":
            with np.errstate(divide="ignore"):
                return np.asarray(np.where(c >= 1, -np.inf, -np.log(c)))
        return np.asarray(-sqrt(0.5) * ndtri(c))

    @cached_property
    def _distribution(self) -> tuple[Floats, Floats]:
        """Values of Re G of waveforms, rising, and the shares of all values above them."""
        from amslicer.noise.distribution import above_of_sum

        table = self.tables[0].real
        read = np.concatenate([table, (table + np.roll(table, -1)) / 2])  # between samples it is interpolated
        return above_of_sum(read / sqrt(self.directions), self.directions)


def default_directions(bandwidth: float, dimensions: int) -> int:
    """Directions that are no further apart than a lobe is wide."""
    least, per = DIRECTIONS[dimensions]
    return min(MAX_DIRECTIONS, max(least, ceil(per / bandwidth ** (dimensions - 1))))


def lobes(cosine: Floats, isotropies: Floats, bandwidth: float, dimensions: int, *, fading: bool) -> Floats:
    """(S, C) amplitudes, at most 1, of waves whose direction (or its opposite) has (C,) cosines, 0 … 1, to the normal.

    exp(-4π (1 - cos γ)/B²), averaged over ±90° s of the plane or the cap of half-angle 90° s, of both ω and -ω.

    Args:
        isotropies: (S,) s, rising: what the normal is spread over grows from each to the next.
        fading: towards waves across the normal, so that none changes sides at once where it turns.
    """
    theta = np.arccos(np.clip(cosine, 0.0, 1.0))
    width, reach, power = bandwidth / sqrt(4 * pi), 0.0, np.zeros(len(theta))
    rows = []
    for end in isotropies * (pi / 2):
        if end == 0:
            rows.append(_ring(theta, 0.0, bandwidth, dimensions))
            continue
        nodes, shares = np.polynomial.legendre.leggauss(ceil((end - reach) / width * LOBE_NODES) + LOBE_NODES)
        for node, share in zip(nodes, shares, strict=True):
            beta = reach + (end - reach) * (node + 1) / 2
            power = power + (end - reach) * share * _ring(theta, beta, bandwidth, dimensions)
        rows.append(power)
        reach = end
    amplitude = np.sqrt([row / row.max() for row in rows])
    edge = np.clip(np.asarray(cosine) / EQUATOR, 0.0, 1.0) if fading else np.ones(len(cosine))
    return np.asarray(np.maximum(0.0, (amplitude - CUT) / (1 - CUT)) * edge**2 * (3 - 2 * edge))


def _ring(theta: Floats, beta: float, bandwidth: float, dimensions: int) -> Floats:
    """The lobe's power at angles θ to the normal, turned by ±β in the plane, or all around it in space; of ±ω.

    In space the mean over the ring is exp(-κ (1 - cos θ cos β)) I0(κ sin θ sin β), times the ring's length.
    """
    from scipy.special import ive

    kappa = 4 * pi / bandwidth**2
    near, far = (np.exp(-kappa * (1 - np.cos(theta - beta))), np.exp(-kappa * (1 + np.cos(theta + beta))))
    if dimensions == 2:
        return np.asarray(
            near + far + np.exp(-kappa * (1 - np.cos(theta + beta))) + np.exp(-kappa * (1 + np.cos(theta - beta)))
        )
    if beta == 0:
        return near + far
    return np.asarray(sin(beta) * ive(0, kappa * np.sin(theta) * sin(beta)) * (near + far))


@dataclass(frozen=True)
class Parts:
    """Equal parts of a half circle or half sphere: rectangles in azimuth and cosine of the polar angle.

    Attributes:
        azimuth: (N, 2) where each begins, and how wide it is, rad.
        height: (N, 2) likewise, of the cosine; 0 in the plane.
    """

    azimuth: Floats
    height: Floats

    def directions(self, share: Floats, part: Ints) -> Floats:
        """(M, 3) unit vectors at (M, 2) shares, 0…1, of parts."""
        azimuth = self.azimuth[part, 0] + self.azimuth[part, 1] * share[:, 0]
        z = self.height[part, 0] + self.height[part, 1] * share[:, 1]
        flat = np.sqrt(np.maximum(0.0, 1 - z**2))
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], axis=-1)


def half_circle(count: int) -> Parts:
    """Equal sectors (section 5.1)."""
    width = pi / count
    azimuth = np.stack([width * np.arange(count), np.full(count, width)], axis=-1)
    return Parts(azimuth, np.zeros((count, 2)))


def half_sphere(count: int) -> Parts:
    """Rings of about square parts, all of the same solid angle: unlike the paper's, none is long and narrow."""
    rings = max(1, round(pi / 2 / sqrt(2 * pi / count)))
    edges = np.rint(count * (1 - np.cos(np.linspace(0, pi / 2, rings + 1)))).astype(int)
    azimuth, height = [], []
    for low, high in pairwise(edges):
        number = high - low
        width = 2 * pi / max(number, 1)
        azimuth.append(np.stack([width * np.arange(number), np.full(number, width)], axis=-1))
        height.append(np.tile([1 - high / count, number / count], (number, 1)))
    return Parts(np.concatenate(azimuth), np.concatenate(height))
