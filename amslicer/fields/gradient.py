"""A field that grows linearly: along one axis of the part's file, or with the distance from a centre.

{gradient: {axis: x, from: 0.1, to: 0.9}}                        over the part's bounding box
{gradient: {axis: x, from: 0.1, to: 0.9, start: 5, end: 40}}     between two places in mm (file coordinates)
{gradient: {center: [x, y, z], radius: 8, from: 0.1, to: 0.9}}   around a point in mm (file coordinates)
{gradient: {center: [x, y], radius: 8, from: 0.1, to: 0.9}}      around a line along z
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator, model_validator

from amslicer.errors import JobError
from amslicer.fields.raster import Raster, raster_of
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source, blend, one_tap

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

AXES = ("x", "y", "z")
LINEAR_KEYS = ("axis", "start", "end")
RADIAL_KEYS = ("center", "radius")


class LinearGradient(BaseModel):
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

    def open(self, frame: Frame) -> Sampler:
        """The gradient over a part."""
        axis = AXES.index(self.axis)
        low = 0.0 if self.start is None else self.start - float(frame.minimum_mm[axis])
        high = float(frame.size_mm[axis]) if self.end is None else self.end - float(frame.minimum_mm[axis])
        if low >= high and (self.start is None) != (self.end is None):
            raise JobError(
                f"a gradient along {self.axis} starts at {low + float(frame.minimum_mm[axis]):g} mm and ends at "
                f"{high + float(frame.minimum_mm[axis]):g} mm (file coordinates): the other end is the part's own",
                hint="give both start and end, within the part's box",
            )
        return GradientSampler(axis, low, high, self.from_, self.to)


class RadialGradient(BaseModel):
    """Centre and radius, and the values at the centre and at the radius."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    center: tuple[Number, ...] = Field(
        min_length=2, max_length=3, description="x, y, z in mm, file coordinates; or x, y: the same at every height"
    )
    radius: Annotated[Number, Field(gt=0)] = Field(description="mm; beyond it the value stays")
    from_: Number = Field(alias="from", description="value at the centre")
    to: Number = Field(description="value at the radius")

    def open(self, frame: Frame) -> Sampler:
        """The gradient over a part."""
        center = np.array(self.center) - frame.minimum_mm[: len(self.center)]
        return RadialSampler(center, self.radius, self.from_, self.to, frame)


def _shape(value: Any) -> str:
    if isinstance(value, RadialGradient) or (isinstance(value, dict) and set(RADIAL_KEYS) & set(value)):
        return "radial"
    return "linear"


class GradientSource(Source):
    """Linear between two places along an axis, or from a centre outwards; constant beyond."""

    gradient: Annotated[
        Annotated[LinearGradient, Tag("linear")] | Annotated[RadialGradient, Tag("radial")], Discriminator(_shape)
    ] = Field(description="linear between two places along an axis, or from a centre outwards")

    @field_validator("gradient", mode="before")
    @classmethod
    def _one_shape(cls, value: Any) -> Any:
        if isinstance(value, dict) and _shape(value) == "radial":
            mixed = [key for key in LINEAR_KEYS if key in value]
            if mixed:
                around = [key for key in RADIAL_KEYS if key in value]
                raise ValueError(
                    f"has {' and '.join(mixed)} together with {' and '.join(around)}; axis goes with start and end, "
                    "center with radius"
                )
        return value

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The gradient over a part."""
        return self.gradient.open(frame)


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

    def raster(self, x: Floats, y: Floats, z: Floats) -> Raster:
        """Along z one value for the whole height, along x or y one for each column or row."""
        values = self.scalar(x, y, z)
        rows, columns = (y.shape[0] if self.axis == 1 else 1), (x.shape[1] if self.axis == 0 else 1)
        return raster_of(np.broadcast_to(values, (rows, columns))).spread(y.shape[0], x.shape[1])

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point: a gradient of an angle is a plain number."""
        return one_tap(self.scalar(x, y, z), x)


@dataclass(frozen=True, eq=False)
class RadialSampler:
    """from_ at the centre (field frame), to at radius_mm around it; outside the box as at the box's nearest point."""

    center_mm: Floats
    radius_mm: float
    from_: float
    to: float
    frame: Frame
    texels: None = None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """In x and y, and in z around a point."""
        return (True, True, len(self.center_mm) == 3)

    @property
    def bounds(self) -> tuple[float, float]:
        """The values at the box's nearest and farthest point."""
        size = self.frame.size_mm[: len(self.center_mm)]
        near = np.clip(self.center_mm, 0.0, size)
        far = np.where(np.abs(size - self.center_mm) > np.abs(self.center_mm), size, 0.0)
        ends = sorted(float(self._value(*(np.asarray(p) for p in point))) for point in (near, far))
        return ends[0], ends[1]

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points; independent of z around a line."""
        inside = [self.frame.nearest(axis, p) for axis, p in enumerate((x, y, z)[: len(self.center_mm)])]
        return self._value(*inside)

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point: a gradient of an angle is a plain number."""
        return one_tap(self.scalar(x, y, z), x)

    def _value(self, *inside: Floats) -> Floats:
        # Sum and root, not hypot: they never fall as the distance along an axis grows, and so bounds are exact.
        with np.errstate(over="ignore"):  # a centre at 1e300 mm is beyond any radius
            squares = [(p - c) * (p - c) for p, c in zip(inside, self.center_mm, strict=True)]
            t = np.sqrt(sum(squares[1:], squares[0])) / self.radius_mm
        return blend(np.clip(t, 0.0, 1.0), self.from_, self.to)
