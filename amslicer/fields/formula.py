"""An expression as a tree of numbers, coordinates and operations; evaluated and bounded from the leaves up.

What is the same everywhere is one number: it is folded by the arithmetic that would evaluate it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from amslicer.fields.interval import WHOLE, Interval
from amslicer.fields.operations import Operation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Number:
    """The same value everywhere."""

    value: float


@dataclass(frozen=True)
class Variable:
    """A coordinate."""

    name: str


@dataclass(frozen=True)
class Call:
    """An operation on some results."""

    operation: Operation
    arguments: tuple[Node, ...]


Node: TypeAlias = Number | Variable | Call


def evaluate(node: Node, values: Mapping[str, Floats]) -> Floats:
    """The value where the variables have these values, which broadcast; the answer is no larger than it must be."""
    if isinstance(node, Number):
        return np.asarray(node.value, np.float64)
    if isinstance(node, Variable):
        return values[node.name]
    return np.asarray(node.operation.evaluate(*(evaluate(a, values) for a in node.arguments)), np.float64)


def bound(node: Node, intervals: Mapping[str, Interval]) -> Interval:
    """Between which numbers the value stays while the variables stay in their intervals."""
    if isinstance(node, Number):
        return WHOLE if math.isnan(node.value) else (node.value, node.value)
    if isinstance(node, Variable):
        return intervals[node.name]
    return node.operation.bound(*(bound(a, intervals) for a in node.arguments))


def variables(node: Node) -> frozenset[str]:
    """The variables that occur."""
    if isinstance(node, Variable):
        return frozenset((node.name,))
    return frozenset().union(*(variables(a) for a in node.arguments)) if isinstance(node, Call) else frozenset()


def call(operation: Operation, *arguments: Node) -> Node:
    """The operation on its arguments; folded into a number where all of them are."""
    if all(isinstance(a, Number) for a in arguments):
        result: Any = evaluate(Call(operation, arguments), {})
        return Number(float(result))
    return Call(operation, arguments)
