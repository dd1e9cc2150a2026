"""What expressions are made of: each operator and function, how it is evaluated, and how it is bounded.

A condition that is NaN gives NaN, never a quiet 0 or 1: what an expression does not define must come to light.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.fields import interval
from amslicer.fields.interval import Interval

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Operation:
    """One operator or function.

    Attributes:
        evaluate: from float64 arrays that broadcast to another.
        bound: from the arguments' intervals to the result's.
        least, most: how many arguments it takes.
    """

    evaluate: Callable[..., Any]
    bound: Callable[..., Interval]
    least: int
    most: int | None = None

    @property
    def arity(self) -> str:
        """How many arguments it takes, in words."""
        if self.most is None:
            return f"{self.least} or more arguments"
        return "1 argument" if self.most == 1 else f"{self.most} arguments"


def _where(condition: Floats, a: Floats, b: Floats) -> Floats:
    return np.where(np.isnan(condition), np.nan, np.where(condition != 0, a, b))


def _clip(value: Floats, low: Floats, high: Floats) -> Any:
    return np.minimum(np.maximum(value, low), high)


def _clip_bound(value: Interval, low: Interval, high: Interval) -> Interval:
    return interval.least(interval.greatest(value, low), high)


def _compared(compare: Callable[..., Any]) -> Callable[..., Any]:
    def evaluate(a: Floats, b: Floats) -> Floats:
        return np.where(np.isnan(a) | np.isnan(b), np.nan, compare(a, b).astype(np.float64))

    return evaluate


FUNCTIONS = {
    "where": Operation(_where, interval.choice, 3, 3),
    "min": Operation(lambda *a: reduce(np.minimum, a), interval.least, 2),
    "max": Operation(lambda *a: reduce(np.maximum, a), interval.greatest, 2),
    "abs": Operation(np.abs, interval.magnitude, 1, 1),
    "sqrt": Operation(np.sqrt, interval.increasing(np.sqrt, domain=(0.0, np.inf), exact=True), 1, 1),
    "exp": Operation(np.exp, interval.increasing(np.exp), 1, 1),
    "log": Operation(np.log, interval.increasing(np.log, domain=(0.0, np.inf)), 1, 1),
    "sin": Operation(np.sin, interval.sine, 1, 1),
    "cos": Operation(np.cos, interval.cosine, 1, 1),
    "tan": Operation(np.tan, interval.tangent, 1, 1),
    "atan2": Operation(np.arctan2, interval.angle, 2, 2),
    "hypot": Operation(np.hypot, interval.distance, 2, 2),
    "floor": Operation(np.floor, interval.increasing(np.floor, exact=True), 1, 1),
    "clip": Operation(_clip, _clip_bound, 3, 3),
}
CONSTANTS = {"pi": float(np.pi)}

NEGATIVE = Operation(np.negative, interval.negative, 1, 1)
POWER = Operation(np.power, interval.power, 2, 2)
OPERATORS: dict[type[ast.operator], Operation] = {
    ast.Add: Operation(np.add, interval.plus, 2, 2),
    ast.Sub: Operation(np.subtract, interval.minus, 2, 2),
    ast.Mult: Operation(np.multiply, interval.times, 2, 2),
    ast.Div: Operation(np.divide, interval.over, 2, 2),
    ast.Pow: POWER,
}
COMPARISONS: dict[type[ast.cmpop], Operation] = {
    ast.Lt: Operation(_compared(np.less), interval.below, 2, 2),
    ast.LtE: Operation(_compared(np.less_equal), interval.not_above, 2, 2),
    ast.Gt: Operation(_compared(np.greater), lambda a, b: interval.below(b, a), 2, 2),
    ast.GtE: Operation(_compared(np.greater_equal), lambda a, b: interval.not_above(b, a), 2, 2),
    ast.Eq: Operation(_compared(np.equal), interval.equal, 2, 2),
    ast.NotEq: Operation(_compared(np.not_equal), lambda a, b: interval.opposite(interval.equal(a, b)), 2, 2),
}


def comparison_chain(links: Sequence[Operation]) -> Operation:
    """a < b <= c …: 1 where every link holds. One operation, so that no operand is evaluated twice."""

    def joined(combine: Callable[[Any, Any], Any], each: Callable[[Operation], Callable[..., Any]]) -> Any:
        def apply(*operands: Any) -> Any:
            pairs = zip(links, operands, operands[1:], strict=False)
            return reduce(combine, (each(link)(a, b) for link, a, b in pairs))

        return apply

    count = len(links) + 1
    return Operation(
        joined(np.multiply, lambda link: link.evaluate), joined(interval.times, lambda link: link.bound), count, count
    )
