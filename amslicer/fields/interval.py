"""Interval arithmetic: between which two numbers an expression stays, whatever the point.

A result's interval holds every value that float64 evaluation can give at points of the arguments' intervals; NaN is
no value. Sums, products, quotients and roots round the same way everywhere and keep their order, so their ends are
exact; functions of NumPy are some ulp off, and their ends are moved outward.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, TypeAlias

import numpy as np

Interval: TypeAlias = tuple[float, float]

WHOLE: Interval = (-math.inf, math.inf)
ULPS = 4  # NumPy's float64 functions promise no more than 4 ulp
FAR = 1e6  # beyond, an argument's own rounding blurs where in its period it lies
PERIOD_SLACK = 1e-9  # how near an extremum or a pole counts as reached; far above the rounding of arguments up to FAR


def increasing(function: Callable[[Any], Any], *, domain: Interval = WHOLE, exact: bool = False) -> Any:
    """The bound of a function that never falls; `exact` where it is correctly rounded."""

    def bound(a: Interval) -> Interval:
        low, high = max(a[0], domain[0]), min(a[1], domain[1])
        if low > high:
            return WHOLE  # defined nowhere: no value to bound
        ends = _ordered(function(low), function(high))
        return ends if exact else _outward(*ends)

    return bound


def plus(a: Interval, b: Interval) -> Interval:
    """a + b."""
    return _ordered(np.add(a[0], b[0]), np.add(a[1], b[1]))


def minus(a: Interval, b: Interval) -> Interval:
    """a - b."""
    return _ordered(np.subtract(a[0], b[1]), np.subtract(a[1], b[0]))


def negative(a: Interval) -> Interval:
    """-a."""
    return -a[1], -a[0]


def times(a: Interval, b: Interval) -> Interval:
    """a · b; 0 · ∞ counts as 0, the limit of what lies beside it."""
    corners = np.multiply.outer(a, b).ravel()
    return _hull(np.where(np.isnan(corners), 0.0, corners))


def over(a: Interval, b: Interval) -> Interval:
    """a / b; anything where b may be 0."""
    if b[0] <= 0 <= b[1]:
        return WHOLE
    corners = np.divide.outer(a, b).ravel()
    return WHOLE if np.isnan(corners).any() else _hull(corners)


def power(base: Interval, exponent: Interval) -> Interval:
    """base ** exponent; tight for a whole exponent that is the same everywhere."""
    if exponent[0] == exponent[1]:
        if exponent[0] % 1 == 0:
            return _whole_power(base, exponent[0])
        base = max(base[0], 0.0), base[1]  # NaN below 0
        if base[1] < 0:
            return WHOLE
    elif base[0] < 0 or (base[0] == 0 and exponent[0] < 0):  # some exponents give either sign (that of -0 too)
        return WHOLE
    # Monotone in each argument alone where the base is not negative: extremes at the corners.
    return _outward(*_hull(np.power.outer(base, exponent).ravel()))


def _whole_power(base: Interval, exponent: float) -> Interval:
    if exponent == 0:
        return 1.0, 1.0
    if exponent < 0:
        return _outward(*over((1.0, 1.0), _whole_power(base, -exponent)))
    ends = magnitude(base) if exponent % 2 == 0 else base
    low, high = (float(np.power(end, exponent)) for end in ends)
    wide = _outward(low, high)
    # 0 and ±1 stay what they are in any power.
    return low if abs(ends[0]) in (0, 1) else wide[0], high if abs(ends[1]) in (0, 1) else wide[1]


def magnitude(a: Interval) -> Interval:
    """|a|."""
    low, high = sorted((abs(a[0]), abs(a[1])))
    return (0.0 if a[0] <= 0 <= a[1] else low), high


def least(*intervals: Interval) -> Interval:
    """The smallest of some."""
    return reduce(lambda a, b: (min(a[0], b[0]), min(a[1], b[1])), intervals)


def greatest(*intervals: Interval) -> Interval:
    """The largest of some."""
    return reduce(lambda a, b: (max(a[0], b[0]), max(a[1], b[1])), intervals)


def sine(a: Interval) -> Interval:
    """sin a, by its extrema."""
    return _wave(a, np.sin, peak=math.pi / 2, trough=-math.pi / 2)


def cosine(a: Interval) -> Interval:
    """cos a, by its extrema."""
    return _wave(a, np.cos, peak=0.0, trough=math.pi)


def tangent(a: Interval) -> Interval:
    """tan a; anything where there is a pole."""
    if _reaches(a, math.pi / 2, math.pi):
        return WHOLE
    return _outward(*_ordered(np.tan(a[0]), np.tan(a[1])))


def angle(y: Interval, x: Interval) -> Interval:
    """atan2(y, x)."""
    if x[0] <= 0 and y[0] <= 0 <= y[1]:  # on the cut, or at the origin, where the signs of zeros matter
        return _outward(-math.pi, math.pi)
    # The rectangle sees the origin from one side: extremes at the corners.
    return _outward(*_hull(np.arctan2.outer(y, x).ravel()))


def distance(a: Interval, b: Interval) -> Interval:
    """hypot(a, b)."""
    (low_a, high_a), (low_b, high_b) = magnitude(a), magnitude(b)
    low, high = _outward(*_ordered(np.hypot(low_a, low_b), np.hypot(high_a, high_b)))
    return max(low, 0.0), high


def choice(condition: Interval, a: Interval, b: Interval) -> Interval:
    """a where the condition is not 0, b where it is."""
    if condition == (0, 0):
        return b
    if not condition[0] <= 0 <= condition[1]:
        return a
    return min(a[0], b[0]), max(a[1], b[1])


def below(a: Interval, b: Interval) -> Interval:
    """a < b, as 0 or 1."""
    return float(a[1] < b[0]), float(a[0] < b[1])


def not_above(a: Interval, b: Interval) -> Interval:
    """a <= b, as 0 or 1."""
    return float(a[1] <= b[0]), float(a[0] <= b[1])


def equal(a: Interval, b: Interval) -> Interval:
    """a == b, as 0 or 1."""
    return float(a[0] == a[1] == b[0] == b[1]), float(a[0] <= b[1] and b[0] <= a[1])


def opposite(a: Interval) -> Interval:
    """1 - a."""
    return 1 - a[1], 1 - a[0]


def _wave(a: Interval, function: Callable[[Any], Any], peak: float, trough: float) -> Interval:
    low, high = _outward(*_hull([function(end) if math.isfinite(end) else 0.0 for end in a]))
    turn = 2 * math.pi
    return (
        -1.0 if _reaches(a, trough, turn) else max(low, -1.0),
        1.0 if _reaches(a, peak, turn) else min(high, 1.0),
    )


def _reaches(a: Interval, place: float, period: float) -> bool:
    """Whether an interval holds one of the places that repeat with a period."""
    if max(abs(a[0]), abs(a[1])) > FAR:
        return True
    first = math.ceil((a[0] - PERIOD_SLACK - place) / period)
    return place + first * period <= a[1] + PERIOD_SLACK


def _ordered(low: float, high: float) -> Interval:
    return WHOLE if math.isnan(low) or math.isnan(high) else (float(low), float(high))


def _hull(values: Sequence[float] | Any) -> Interval:
    return float(min(values)), float(max(values))


def _outward(low: float, high: float) -> Interval:
    for _ in range(ULPS):
        low, high = math.nextafter(low, -math.inf), math.nextafter(high, math.inf)
    return low, high
