"""Fields made of others: mixed, clipped, passed through a curve, or one here and another there.

    {mix: {a: FIELD, b: FIELD, by: FIELD}}                           a where `by` is 0, b where it is 1
    {clip: {field: FIELD, from: 0.1, to: 0.9}}
    {remap: {field: FIELD, curve: [[0, 0.1], [0.4, 0.5], [1, 0.9]]}} straight between the points, flat beyond
    {remap: {field: FIELD, curve: [[0, 0.1], [1, 0.9]], smooth: true}}
    {where: {mask: FIELD, above: 0.5, then: FIELD, else: FIELD}}     `then` where the mask is above

As fields.orientation a mix is one of lines, and `where` takes one of two directions; the others make angles of numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from amslicer.errors import JobError
from amslicer.fields.choice import ChoiceOfLines, ChoiceSampler, all_equal, along_any
from amslicer.fields.opening import open_field, open_orientation
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source, find_sources, one_tap
from amslicer.fields.tables import LARGEST

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import NDArray

    from amslicer.fields import FieldSpec
    from amslicer.fields.choice import Which
    from amslicer.fields.orientation import Orientation

    Floats = NDArray[np.float64]

ROUNDING = 1e-9  # how far interpolation may leave 0…1
LOOKED_AT = 9  # places along each axis where a mix is looked at before anything is sliced
LEAST_STEP = 1e-9  # of a curve, from one point to the next: less has no slope in numbers
MOST_POINTS = 1000  # of a curve: more are a picture's job


class Content(BaseModel):
    """Base of what stands under a source's name."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Mix(Content):
    """Two fields, and how much of the second."""

    a: FieldSpec = Field(description="the field where `by` is 0")
    b: FieldSpec = Field(description="the field where `by` is 1")
    by: FieldSpec = Field(description="share of b, 0 to 1; a field")


class Clip(Content):
    """A field and its limits."""

    field: FieldSpec = Field(description="the field to clip")
    from_: Number = Field(alias="from", default=0.0, description="lower values become this one")
    to: Number = Field(default=1.0, description="higher values become this one")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.from_ > self.to:
            raise ValueError(f"from {self.from_:g} is above to {self.to:g}; from is the lower limit")
        return self


class Remap(Content):
    """A field and a curve."""

    field: FieldSpec = Field(description="the field whose values go through the curve")
    curve: tuple[tuple[Number, Number], ...] = Field(
        min_length=2, max_length=MOST_POINTS, description="points [value of the field, value to take], ascending"
    )
    smooth: Annotated[bool, Field(strict=True)] = Field(
        default=False, description="a smooth curve through the points that rises and falls where they do"
    )

    @field_validator("curve")
    @classmethod
    def _ascending(cls, curve: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for (before, _), (after, _) in pairwise(curve):
            if not before < after:
                raise ValueError(
                    f"the first numbers must ascend, but {after:g} follows {before:g}; `where` makes steps"
                )
            # Of the larger number too: the differences of huge ones are rounding.
            if not after - before >= LEAST_STEP * max(1.0, abs(before), abs(after)):
                raise ValueError(f"{after:.17g} follows {before:.17g} too closely; `where` makes steps")
        for number in (number for point in curve for number in point):
            if abs(number) > LARGEST:
                raise ValueError(f"has the number {number:g}; at most ±{LARGEST:g} is taken")
        return curve


class Where(Content):
    """A mask and two fields."""

    mask: FieldSpec = Field(description="decides between the two")
    above: Number = Field(default=0.5, description="where the mask is greater than this, `then` counts")
    then: FieldSpec = Field(description="the field there")
    else_: FieldSpec = Field(alias="else", description="the field elsewhere")


class MixSource(Source):
    """Between two fields, as a third one says."""

    mix: Mix = Field(description="{a: FIELD, b: FIELD, by: FIELD}: a where `by` is 0, b where it is 1")

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The mixed numbers over a part.

        Raises:
            JobError: the share leaves 0…1, or one of the fields cannot be used.
        """
        a, b, by = (open_field(spec, frame, inputs) for spec in (self.mix.a, self.mix.b, self.mix.by))
        for key, field in (("a", a), ("b", b)):
            low, high = field.bounds
            if np.isfinite([low, high]).all() and max(abs(low), abs(high)) > LARGEST:
                raise JobError(
                    f"mix.{key} has values from {low:g} to {high:g}; at most ±{LARGEST:g} is mixed",
                    hint="change its numbers, or clip it",
                )
        return MixSampler(a, b, _looked_at(Share(by, frame)))

    @property
    def mixes_numbers(self) -> bool:
        """Where one of the two fields does; the share is no angle."""
        return any(source.mixes_numbers for source in find_sources((self.mix.a, self.mix.b)))

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The mixed directions over a part; raises as open does."""
        a, b = (open_orientation(spec, frame, inputs) for spec in (self.mix.a, self.mix.b))
        return MixedLines(a, b, _looked_at(Share(open_field(self.mix.by, frame, inputs), frame)))


class ClipSource(Source):
    """A field that does not leave two limits."""

    clip: Clip = Field(description="{field: FIELD, from: 0, to: 1}: values below and above become the limits")

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The clipped numbers over a part."""
        field, low, high = open_field(self.clip.field, frame, inputs), self.clip.from_, self.clip.to
        least, most = (float(np.clip(end, low, high)) for end in field.bounds)
        return MappedSampler(field, lambda values: np.clip(values, low, high), (least, most))


class RemapSource(Source):
    """A field's values, passed through a curve."""

    remap: Remap = Field(description="{field: FIELD, curve: [[in, out], ...]}: straight between the points, or smooth")

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The numbers over a part."""
        field = open_field(self.remap.field, frame, inputs)
        given, taken = np.array(self.remap.curve).T
        if self.remap.smooth:
            from scipy.interpolate import PchipInterpolator

            smooth = PchipInterpolator(given, taken)

            def curve(values: Floats) -> Floats:
                out: Floats = smooth(np.clip(values, given[0], given[-1]))
                return out
        else:

            def curve(values: Floats) -> Floats:
                straight: Floats = np.interp(values, given, taken)
                return straight

        # Both curves rise or fall from each point to the next: nothing is beyond the ends and the points between them.
        low, high = field.bounds
        ends = np.concatenate([curve(np.array([low, high])), taken[(given > low) & (given < high)]])
        least, most = float(ends.min()), float(ends.max())
        return MappedSampler(field, lambda values: np.clip(curve(values), least, most), (least, most))


class WhereSource(Source):
    """One of two fields, as a mask says."""

    where: Where = Field(description="{mask: FIELD, above: 0.5, then: FIELD, else: FIELD}: one of two fields")

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The chosen numbers over a part."""
        mask = open_field(self.where.mask, frame, inputs)
        then, other = (open_field(spec, frame, inputs) for spec in (self.where.then, self.where.else_))
        always = self._always(mask)
        if always is not None:
            return then if always else other
        return ChoiceSampler((other, then), self._chosen(mask), mask.varies)

    @property
    def mixes_numbers(self) -> bool:
        """Where one of the two fields does; the mask is no angle."""
        return any(source.mixes_numbers for source in find_sources((self.where.then, self.where.else_)))

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The chosen directions over a part."""
        mask = open_field(self.where.mask, frame, inputs)
        then, other = (open_orientation(spec, frame, inputs) for spec in (self.where.then, self.where.else_))
        always = self._always(mask)
        if always is not None:
            return then if always else other
        return ChoiceOfLines((other, then), self._chosen(mask), mask.varies)

    def _always(self, mask: Sampler) -> bool | None:
        """Whether the mask is above everywhere or nowhere; None where it is not known."""
        low, high = mask.bounds
        return True if low > self.where.above else False if high <= self.where.above else None

    def _chosen(self, mask: Sampler) -> Which:
        def chosen(x: Floats, y: Floats, z: Floats) -> NDArray[np.bool_]:
            return np.asarray(mask.scalar(x, y, z) > self.where.above)

        return chosen


@dataclass(frozen=True, eq=False)
class Share:
    """The field `by` of a mix, which is refused where it leaves 0…1."""

    by: Sampler
    frame: Frame

    def at(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Shares at points, 0…1.

        Raises:
            JobError: with the first place, and how much it is there.
        """
        values = self.by.scalar(x, y, z)
        wrong = ~((values >= -ROUNDING) & (values <= 1 + ROUNDING))
        if wrong.any():
            shown, *places = np.broadcast_arrays(values, x, y, z)
            first = tuple(np.argwhere(~((shown >= -ROUNDING) & (shown <= 1 + ROUNDING)))[0])
            where = ", ".join(
                f"{axis} = {place[first] + low:.2f}"
                for axis, place, low in zip("xyz", places, self.frame.minimum_mm, strict=True)
            )
            raise JobError(
                f"mix.by is {shown[first]:.4g} at {where} mm ({self.frame.coordinates}); a share is between 0 and 1",
                hint="change the field's range (or from and to), or give by: {clip: {field: …}}; a thin plate "
                "overshoots its points, unless it has within: [0, 1]",
            )
        return np.clip(values, 0.0, 1.0)

    @property
    def bounds(self) -> tuple[float, float]:
        """Within 0…1, since others are refused."""
        low, high = (float(np.clip(end, 0.0, 1.0)) for end in self.by.bounds)
        return low, high


def _looked_at(share: Share) -> Share:
    """The share, after a look at some places where it may leave 0…1: better now than in the last layer."""
    low, high = share.by.bounds
    if not (low >= -ROUNDING and high <= 1 + ROUNDING):
        along = [np.linspace(0.0, float(side), LOOKED_AT) for side in share.frame.size_mm]
        share.at(along[0][None, :, None], along[1][:, None, None], along[2][None, None, :])
    return share


@dataclass(frozen=True, eq=False)
class MixSampler:
    """a + t(b - a), exactly b where the share t is 1."""

    a: Sampler
    b: Sampler
    share: Share
    texels: None = None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the axes of any of the three."""
        return along_any(self.a.varies, self.b.varies, self.share.by.varies)

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """The extremes of a function that is linear in each of the three: at their bounds."""
        ends = (*self.a.bounds, *self.b.bounds)
        if not np.isfinite(ends).all():
            return min(ends), max(ends)
        corners = [float(_mixed(*np.array(c))) for c in product(self.a.bounds, self.b.bounds, self.share.bounds)]
        return min(corners), max(corners)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points."""
        values = _mixed(self.a.scalar(x, y, z), self.b.scalar(x, y, z), self.share.at(x, y, z))
        return np.clip(values, *self.bounds)  # rounding may leave them

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point: a mix of angles as numbers is a plain number."""
        return one_tap(self.scalar(x, y, z), x)


def _mixed(a: Floats, b: Floats, share: Floats) -> Floats:
    return np.where(share == 1, b, a + share * (b - a))


@dataclass(frozen=True, eq=False)
class MixedLines:
    """The line between two: the principal one of (1-t) n nᵀ of the first and t n nᵀ of the second."""

    a: Orientation
    b: Orientation
    share: Share

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the axes of any of the three."""
        return along_any(self.a.varies, self.b.varies, self.share.by.varies)

    @property
    def turns(self) -> bool:
        """Whether either does, or two different ones are mixed differently from place to place."""
        low, high = self.share.bounds
        return self.a.turns or self.b.turns or (low != high and not all_equal((self.a, self.b)))

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points; signs as of the larger share."""
        share = np.broadcast_to(self.share.at(x, y, z), x.shape)
        return mix_lines(self.a.normals(x, y, z), self.b.normals(x, y, z), share)


def mix_lines(a: Floats, b: Floats, share: Floats) -> Floats:
    """(N, 3) the lines between unit vectors a and b, (N, 3) each: a at share 0, b at 1; of perpendicular ones at ½, a.

    In the plane of both, with b at the angle θ from a, the principal line is at half the angle of the mean of the
    doubled angles 0 and 2θ.
    """
    cosine = np.einsum("ni,ni->n", a, b)
    sign = np.where(cosine < 0, -1.0, 1.0)
    near = sign[:, None] * b  # the end of b's line within 90° of a
    aside = near - np.abs(cosine)[:, None] * a
    sine = np.linalg.norm(aside, axis=1)
    theta = np.arctan2(sine, np.abs(cosine))
    turn = 0.5 * np.arctan2(share * np.sin(2 * theta), (1 - share) + share * np.cos(2 * theta))
    unit = aside / np.where(sine == 0, 1.0, sine)[:, None]
    mean = np.cos(turn)[:, None] * a + np.sin(turn)[:, None] * unit
    mean = np.where(share > 0.5, sign, 1.0)[:, None] * mean
    same = (a == b).all(axis=1)
    return np.where((same | (share == 0))[:, None], a, np.where((share == 1)[:, None], b, mean))


@dataclass(frozen=True, eq=False)
class MappedSampler:
    """A function of another field's values.

    Attributes:
        bounds: of the function over the field's bounds.
    """

    field: Sampler
    function: Callable[[Floats], Floats]
    bounds: tuple[float, float]

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """As the field itself."""
        return self.field.varies

    @property
    def texels(self) -> Hashable | None:
        """As the field itself."""
        return self.field.texels

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points."""
        return self.function(self.field.scalar(x, y, z))

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The function of each of the field's samples: angles are made before they are combined as lines."""
        samples, weights = self.field.taps(x, y, z)
        return self.function(samples), weights
