"""Wave noise in plain float64 NumPy, wave by wave: the readable definition, which tests run every device against.

Written from the mathematics (Guehl et al. 2025, sections 4 and 5) and sharing no code with what it checks. Lengths in
mm, angles in rad.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from amslicer.reference import WORD_BITS, WORD_MASK, philox4x32

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Field = float | Callable[[Floats], Floats]
    # Amplitudes at frequencies in 1/period.
    Amplitude = Callable[[Floats], Floats]

FOURTH = 0x10000000  # the last word of the counters; the third says what for:
SLICE, PART, PHASE, SPEED = 0, 1, 2, 3


def wave(
    x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: Field, bandwidth: float, dimensions: int, seed: int,
    normal: Callable[[Floats], Floats], isotropy: Field = 0.0, directions: int, length_mm: float, samples: int,
    periods: ArrayLike, amplitude: Amplitude, band: tuple[float, float], table: Complexes | None = None,
    time: float = 0.0, fourth: float = 0.0, along: Callable[[Floats, Floats], Floats] | None = None,
    rise: float | None = None, fading: bool = False,
) -> Complexes:  # fmt: skip
    """G at any points, each wave with the sign that puts it on the normal's side.

    Args:
        x, y, z: mm, which broadcast; z is ignored in 2D.
        period: p in mm at the points, between the first and the last of `periods`.
        bandwidth: B, of the lobe of directions.
        normal: (N, 3) places to (N, 3) unit normals.
        isotropy: s at the points, 0…1. One that varies is interpolated between 33 values.
        directions: N.
        length_mm, samples: of a table.
        periods: of the tables, mm, rising; between two they are mixed in the place of the period among them.
        amplitude, band: A over frequencies in 1/period, and the lowest and highest of them.
        table: a waveform instead, read in all directions alike.
        along: A over (3,) directions and frequencies instead: a table for each part, of the mean power of nine (in 2D
            three) directions in it, no lobe and no normal. The mean of the tables' powers is 1.
        fading: of waves within 5° of the plane across the normal, where it turns.
        rise: exponent of the frequency beside A; default: (dimensions - 1)/2.
        time, fourth: how far waves have moved, in the shortest period.
    """
    shape = np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(z))
    places = np.stack([np.broadcast_to(np.asarray(c, float), shape).ravel() for c in (x, y, z)], axis=-1)
    if dimensions == 2:
        places[:, 2] = 0.0
    rows = np.asarray(periods, float)
    rise = (dimensions - 1) / 2 if rise is None else rise
    powers = np.ones(directions)
    tables = [] if table is None else [table]
    if table is None and along is None:
        tables = [_table(p, length_mm, samples, amplitude, band, rise, seed)[0] for p in rows]
    row = np.zeros(len(places))
    if len(rows) > 1:
        row = np.interp(_at(period, places), rows, np.arange(len(rows)))
    n = normal(places)
    weight_at = _weights(isotropy, places, bandwidth, dimensions, fading) if table is None and along is None else _alike
    if along is not None:
        places_of = [(u / 6, v / 6) for u in (1, 3, 5) for v in ((1, 3, 5) if dimensions == 3 else (3,))]
        each = []
        for k in range(directions):
            looks = [_direction(k, u, v, directions, dimensions) for u, v in places_of]
            of_part_alone = partial(_mean_amplitude, along, looks)
            each.append(_table(rows[0], length_mm, samples, of_part_alone, band, rise, seed, unit=False))
        mean = sum(power for _, power in each) / directions
        powers = np.array([power / mean for _, power in each])
        of_part = [values / math.sqrt(mean) for values, _ in each]
    thickness = length_mm / 2.4
    total: Complexes = np.zeros(len(places), np.complex128)
    power = np.zeros(len(places))
    for part in range(directions):
        axis, begin = _cut(part, directions, dimensions, seed)
        s = places @ axis / thickness + begin
        forth = 1.0 if _share(part, 0, SPEED, seed)[3] < 0.5 else -1.0
        for number in range(math.floor(s.min()) - 1, math.floor(s.max()) + 3):
            words = _share(part, number, SLICE, seed)
            low = number - 1 + 0.3 + 0.4 * _share(part, number - 1, SLICE, seed)[3]
            high = number + 0.3 + 0.4 * words[3]
            inside = _faded(s - low) * _faded(high - s)
            here = np.flatnonzero(inside > 0)
            if not len(here):
                continue
            omega = _direction(part, words[0], words[1], directions, dimensions)
            cosine = n[here] @ omega
            weight = weight_at(np.abs(cosine), here) * inside[here]
            moved = forth * time + (2 * _share(part, number, SPEED, seed)[0] - 1) * fourth
            at = (places[here] @ omega / length_mm + words[2] - moved * rows[0] / length_mm) % 1.0
            value = _read(tables if along is None else [of_part[part]], row[here], at)
            total[here] += weight * (value if along is not None else np.where(cosine < 0, value.conj(), value))
            power[here] += weight**2 * powers[part]
    return np.asarray(total / np.sqrt(np.where(power > 0, power, 1.0))).reshape(shape)


def _mean_amplitude(along: Callable[[Floats, Floats], Floats], looks: list[Floats], frequency: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean([along(omega, frequency) ** 2 for omega in looks], axis=0)))


def _at(field: Field, places: Floats) -> Floats:
    return np.broadcast_to(np.asarray(field(places) if callable(field) else field, float), (len(places),))


def _share(first: int, second: int, use: int, seed: int) -> Floats:
    """(4,) uniform in [0, 1)."""
    counter = np.array([first, second, use, FOURTH]) & WORD_MASK
    return np.asarray(philox4x32(counter, (seed & WORD_MASK, seed >> WORD_BITS)) / 2.0**WORD_BITS)


def _faded(past_border: Floats) -> Floats:
    """One of two slices that are blended over a fifth of their thickness: u/√(u² + (1-u)²)."""
    t = np.clip(past_border / 0.2 + 0.5, 0.0, 1.0)
    u = t * t * (3 - 2 * t)
    return np.asarray(u / np.sqrt(u**2 + (1 - u) ** 2))


def _direction(part: int, u: float, v: float, directions: int, dimensions: int) -> Floats:
    """A unit vector at shares u, v of one of N equal parts: sectors of the half circle; in space parts of rings."""
    if dimensions == 2:
        alpha = math.pi * (part + u) / directions
        return np.array([math.cos(alpha), math.sin(alpha), 0.0])
    rings = max(1, round(math.pi / 2 / math.sqrt(2 * math.pi / directions)))
    ends = [round(directions * (1 - math.cos(math.pi / 2 * k / rings))) for k in range(rings + 1)]
    ring = next(k for k in range(rings) if part < ends[k + 1])
    first, count = ends[ring], ends[ring + 1] - ends[ring]
    z = 1 - ends[ring + 1] / directions + v * count / directions
    alpha = 2 * math.pi * (part - first + u) / count
    flat = math.sqrt(max(0.0, 1 - z * z))
    return np.array([flat * math.cos(alpha), flat * math.sin(alpha), z])


def _cut(part: int, directions: int, dimensions: int, seed: int) -> tuple[Floats, float]:
    """The axis along which a wave is cut into slices, 45° from the middle of its part, and where slice 0 begins."""
    u, begin = _share(part, 0, PART, seed)[:2]
    middle = _direction(part, 0.5, 0.5, directions, dimensions)
    if dimensions == 2:
        across = (1.0 if u < 0.5 else -1.0) * np.array([-middle[1], middle[0], 0.0])
    else:
        first = np.cross(middle, (0.0, 0.0, 1.0) if abs(middle[2]) < 0.5 else (1.0, 0.0, 0.0))
        first /= np.linalg.norm(first)
        across = math.cos(2 * math.pi * u) * first + math.sin(2 * math.pi * u) * np.cross(middle, first)
    return (middle + across) / math.sqrt(2), float(begin)


def _table(
    period: float, length_mm: float, samples: int, amplitude: Amplitude, band: tuple[float, float], rise: float,
    seed: int, *, unit: bool = True,
) -> tuple[Complexes, float]:  # fmt: skip
    """T, of mean power 1 if unit: Σ A(f) f^rise exp(i(2π l j/Nx + φ_l)), f = l p/L; and the power of the sum."""
    out, power = np.zeros(samples, complex), 0.0
    j = np.arange(samples)
    for order in range(max(1, math.ceil(band[0] * length_mm / period)), int(band[1] * length_mm / period) + 1):
        f = order * period / length_mm
        a = float(amplitude(np.array([f]))[0]) * f**rise
        phase = 2 * math.pi * _share(order, 0, PHASE, seed)[0]
        out += a * np.exp(1j * (2 * math.pi * (order * j % samples) / samples + phase))
        power += a * a
    return np.asarray(out / math.sqrt(power) if unit else out), power


def _read(tables: list[Complexes], row: Floats, at: Floats) -> Complexes:
    """Values at shares 0…1 of a table, linear between samples and between tables."""
    lower = np.minimum(row.astype(int), max(len(tables) - 2, 0))

    def of(which: NDArray[np.int64]) -> Complexes:
        stack = np.stack(tables)
        place = at * stack.shape[1]
        below = np.floor(place).astype(int)
        part = place - below
        size = stack.shape[1]
        return np.asarray((1 - part) * stack[which, below % size] + part * stack[which, (below + 1) % size])

    if len(tables) == 1:
        return of(lower)
    mix = row - lower
    return np.asarray((1 - mix) * of(lower) + mix * of(lower + 1))


def _alike(cosine: Floats, here: NDArray[np.int64]) -> Floats:
    return np.ones(len(here))


def _weights(
    isotropy: Field, places: Floats, bandwidth: float, dimensions: int, fading: bool
) -> Callable[[Floats, NDArray[np.int64]], Floats]:
    """A function from |cos γ| and the numbers of places to the amplitudes there."""
    grid = np.linspace(0.0, 1.0, 4097)
    if not callable(isotropy):
        only = _lobe(grid, isotropy, bandwidth, dimensions, fading)
        return lambda cosine, here: np.interp(cosine, grid, only)
    rows = np.stack([_lobe(grid, s, bandwidth, dimensions, fading) for s in np.linspace(0.0, 1.0, 33)])
    level = np.clip(_at(isotropy, places), 0.0, 1.0) * 32

    def mixed(cosine: Floats, here: NDArray[np.int64]) -> Floats:
        low = np.minimum(level[here].astype(int), 31)
        part = level[here] - low
        place = np.minimum(cosine, 1.0) * 4096
        c = np.minimum(place.astype(int), 4095)
        t = place - c
        one, other = ((1 - t) * rows[r, c] + t * rows[r, c + 1] for r in (low, low + 1))
        return np.asarray((1 - part) * one + part * other)

    return mixed


def _lobe(cosine: Floats, isotropy: float, bandwidth: float, dimensions: int, fading: bool) -> Floats:
    """√ of exp(-4π (1 - cos γ)/B²) averaged over the sector or cap that isotropy spreads the normal over, and over ±ω;
    less 0.02 of its largest, and where it turns faded out within 5° of the plane across the normal."""
    kappa, reach = 4 * math.pi / bandwidth**2, isotropy * math.pi / 2
    node, share = np.polynomial.legendre.leggauss(400 if reach else 1)
    sine = np.sqrt(1 - cosine**2)
    power = np.zeros(len(cosine))
    if dimensions == 2:
        for angle, part in zip(reach * node, share, strict=True):
            along = cosine * math.cos(angle) + sine * math.sin(angle)
            power += part * (np.exp(-kappa * (1 - along)) + np.exp(-kappa * (1 + along)))
    else:
        turn = 2 * np.pi * (np.arange(256) + 0.5) / 256
        heights = 1 - (node + 1) / 2 * (1 - math.cos(reach)) if reach else np.ones(1)
        for height, part in zip(heights, share, strict=True):
            along = cosine[:, None] * height + sine[:, None] * math.sqrt(max(0.0, 1 - height**2)) * np.cos(turn)
            power += part * (np.exp(-kappa * (1 - along)) + np.exp(-kappa * (1 + along))).mean(axis=1)
    amplitude = np.maximum(0.0, np.sqrt(power / power.max()) - 0.02) / 0.98
    edge = np.minimum(1.0, cosine / math.sin(math.radians(5.0))) if fading else np.ones(len(cosine))
    return np.asarray(amplitude * edge * edge * (3 - 2 * edge))
