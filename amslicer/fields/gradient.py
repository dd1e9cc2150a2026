"""A field that grows linearly along one axis of the part's file.

{gradient: {axis: x, from: 0.1, to: 0.9}}                        over the part's bounding box
{gradient: {axis: x, from: 0.1, to: 0.9, start: 5, end: 40}}     between two places in mm (file coordinates)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from amslicer.errors import JobError
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source, blend

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

AXES = ("x", "y", "z")


class GradientParameters(BaseModel):
    """Axis, values at both ends, and where the ends are (default: the part's bounding box)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    axis: Literal["x", "y", "z"] = Field(description="axis of the part's file")
    from_: Number = Field(alias="from", description="value at the start")
    to: Number = Field(description="value at the end")
    start: Number | None = Field(default=None, description="mm, file coordinates; default: the box's lower side")
    end: Number | None = Field(default=None, description="mm, file coordinates; default: the box's upper side")

    @model_validator(mode="after")
    def _distinct_ends(self) -> Self:
        if self.start is not None and self.start == self.end:
            raise ValueError(f"start and end are the same place ({self.start} mm); a gradient needs two")
        return self


class GradientSource(Source):
    """Linear between two places along an axis, constant beyond them."""

    gradient: GradientParameters = Field(description="linear between two places along an axis")

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The gradient over a part."""
        g = self.gradient
        axis = AXES.index(g.axis)
        low = 0.0 if g.start is None else g.start - float(frame.minimum_mm[axis])
        high = float(frame.size_mm[axis]) if g.end is None else g.end - float(frame.minimum_mm[axis])
        if low >= high and (g.start is None) != (g.end is None):
            raise JobError(
                f"a gradient along {g.axis} starts at {low + float(frame.minimum_mm[axis]):g} mm and ends at "
                f"{high + float(frame.minimum_mm[axis]):g} mm (file coordinates): the other end is the part's own",
                hint="give both start and end, within the part's box",
            )
        return GradientSampler(axis, low, high, g.from_, g.to)


@dataclass(frozen=True)
class GradientSampler:
    """from_ at low_mm, to at high_mm (field frame) along one axis."""

    axis: int
    low_mm: float
    high_mm: float
    from_: float
    to: float
    texels: None = None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Only along its axis."""
        return (self.axis == 0, self.axis == 1, self.axis == 2)

    @property
    def bounds(self) -> tuple[float, float]:
        """Both ends' values."""
        return (min(self.from_, self.to), max(self.from_, self.to))

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points; as small as the axis' own coordinate array."""
        length = self.high_mm - self.low_mm
        t = ((x, y, z)[self.axis] - self.low_mm) / (length if length else 1.0)
        return blend(np.clip(t, 0.0, 1.0), self.from_, self.to)

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point: a gradient of an angle is a plain number."""
        values = np.broadcast_to(self.scalar(x, y, z), x.shape)[None]
        return values, np.ones(values.shape)
