"""A field written as a formula.

    {expression: "0.5 + 0.4*sin(2*pi*x/20)"}

x, y, z are mm in file coordinates, u, v, w go from 0 to 1 over the part's bounding box. Angles inside sin and cos are
radians. Outside the box a point has the value of the box's nearest point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, field_validator

from amslicer.errors import JobError
from amslicer.fields.constant import ConstantSampler
from amslicer.fields.formula import Node, Number, bound, evaluate, variables
from amslicer.fields.formula_reader import read_formula, shortened
from amslicer.fields.source import Frame, Inputs, Sampler, Source, one_tap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.interval import Interval

    Floats = NDArray[np.float64]

# Which axis each variable runs along.
MILLIMETRES = {"x": 0, "y": 1, "z": 2}
SHARES = {"u": 0, "v": 1, "w": 2}


class ExpressionSource(Source):
    """A formula of the place."""

    expression: str = Field(description="a formula of x, y, z (mm, file coordinates) and u, v, w (0 to 1 over the box)")

    @field_validator("expression")
    @classmethod
    def _readable(cls, text: str) -> str:
        formula = read_formula(text)
        if isinstance(formula, Number) and not np.isfinite(formula.value):
            raise ValueError(f"the expression is {formula.value} everywhere")
        return text

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The formula over a part."""
        formula = read_formula(self.expression)
        if isinstance(formula, Number):
            return ConstantSampler(formula.value)
        return ExpressionSampler(self.expression, formula, frame)


@dataclass(frozen=True, eq=False)
class ExpressionSampler:
    """A formula with variables, over a part's box."""

    text: str
    formula: Node
    frame: Frame
    texels: None = None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the axes of the variables that occur."""
        axes = {(MILLIMETRES | SHARES)[name] for name in variables(self.formula)}
        return (0 in axes, 1 in axes, 2 in axes)

    @property
    def bounds(self) -> Interval:
        """By interval arithmetic over the part's box; infinite where a quotient or power has no bound."""
        intervals: dict[str, Interval] = {}
        for axis, (name, share) in enumerate(zip(MILLIMETRES, SHARES, strict=True)):
            low, size = float(self.frame.minimum_mm[axis]), float(self.frame.size_mm[axis])
            intervals[name] = low, low + size
            intervals[share] = 0.0, float(size > 0)
        with np.errstate(all="ignore"):
            return bound(self.formula, intervals)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points; as small as the coordinates that occur.

        Raises:
            JobError: the formula is NaN or infinite at one of the points.
        """
        inside = [self.frame.nearest(axis, position) for axis, position in enumerate((x, y, z))]
        values = {}
        for name in variables(self.formula):
            if name in MILLIMETRES:
                axis = MILLIMETRES[name]
                values[name] = inside[axis] + self.frame.minimum_mm[axis]
            else:
                axis = SHARES[name]
                values[name] = inside[axis] / (self.frame.size_mm[axis] or 1.0)
        with np.errstate(all="ignore"):
            result = evaluate(self.formula, values)
        wrong = ~np.isfinite(result)
        if wrong.any():
            raise self._undefined(result, *inside)
        return result

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point: an expression of an angle is a plain number."""
        return one_tap(self.scalar(x, y, z), x)

    def _undefined(self, result: Floats, *inside: Floats) -> JobError:
        values, *places = np.broadcast_arrays(result, *inside)
        first = tuple(np.argwhere(~np.isfinite(values))[0])
        at = ", ".join(
            f"{axis} = {place[first] + low:.2f}"
            for axis, place, low in zip(MILLIMETRES, places, self.frame.minimum_mm, strict=True)
        )
        return JobError(
            f'the expression "{shortened(self.text)}" is {values[first]} at {at} mm (file coordinates)',
            hint="keep it finite in the whole of the part's bounding box, with where(…), max(…) or clip(…)",
        )
