"""A field painted as a picture, stretched over the part seen from above, or along another axis.

    {image: paint/ratio.png, range: [0, 1]}
    {image: paint/angle.png, range: [-90, 90], box: [x0, y0, x1, y1]}     box in mm, file coordinates
    {image: paint/side.png, plane: xz}                                    its box would be [x0, z0, x1, z1]
    {image: paint/tile.png, box: [0, 0, 5, 5], outside: repeat}           or mirror: beyond the box without a seam
    {image: paint/height.png, reads: gradient, smooth_mm: 0.5}            directions: see picturelines.py
    {image: paint/hues.png, reads: hue}
    {image: paint/cos.png, with: paint/sin.png, reads: vector}

Black is range[0], white is range[1]; the first axis of the plane runs along the rows, and the top row is where the
second is largest. Bilinear between texel centres, clamped outside the box unless told otherwise.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from amslicer.errors import JobError
from amslicer.fields.picturelines import LineTexels, PictureLines, read_lines
from amslicer.fields.pictures import read_grey
from amslicer.fields.rectangle import Outside, Rectangle
from amslicer.fields.source import Frame, Inputs, Number, Range, Sampler, Source, blend, check_box

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.orientation import Orientation
    from amslicer.fields.pictures import Texels

    Floats = NDArray[np.float64]

# The axes along a picture's rows and up its columns.
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
UNIT = (0.0, 1.0)  # the default range
NUMBERS = (None, "value")  # what `reads` is of pictures of numbers; None: a job that does not say so stays as it is


class Placed(Source):
    """What pictures of every kind have: a plane, a box and what is beyond it."""

    plane: Literal["xy", "xz", "yz"] = Field(default="xy", description="the plane that the picture lies in")
    box: tuple[Number, Number, Number, Number] | None = Field(
        default=None,
        description="x0, y0, x1, y1 (the plane's axes) in mm, file coordinates; default: the part's bounding box",
    )
    outside: Outside | None = Field(
        default=None, description="beyond the box: its border (clamp, the default), or the picture again, also mirrored"
    )

    @field_validator("box")
    @classmethod
    def _ordered(
        cls, box: tuple[float, float, float, float] | None, info: ValidationInfo
    ) -> tuple[float, float, float, float] | None:
        if box is not None and not (box[0] < box[2] and box[1] < box[3]):
            a, b = info.data.get("plane", "xy")
            raise ValueError(f"must be [{a}0, {b}0, {a}1, {b}1] with {a}0 < {a}1 and {b}0 < {b}1, but is {list(box)}")
        if box is not None:
            check_box(box[:2], box[2:])
        return box

    def rectangle(self, frame: Frame) -> Rectangle:
        """Where the picture lies on a part."""
        axes = PLANES[self.plane]
        minimum = frame.minimum_mm[list(axes)]
        if self.box is None:
            corner, size = minimum, frame.size_mm[list(axes)]
        else:
            corner, size = np.array(self.box[:2]), np.array(self.box[2:]) - np.array(self.box[:2])
        low = corner - minimum
        return Rectangle(
            (float(low[0]), float(low[1])), (float(size[0]), float(size[1])), axes, self.outside or "clamp"
        )


class PictureSource(Placed):
    """Pictures of numbers, or of directions."""

    range: Range = Field(default=UNIT, description="values of black and white")
    reads: Literal["value", "gradient", "hue", "vector"] | None = Field(
        default=None,
        description="what of the picture: grey levels as numbers (value, the default); or as directions in its plane "
        "the way that they rise, hues (all in half a turn), or red and green as cosine and sine of the doubled angle",
    )
    smooth_mm: Annotated[Number, Field(gt=0)] | None = Field(
        default=None, description="of reads: gradient: how far directions are averaged; default: one texel"
    )

    @field_validator("reads")
    @classmethod
    def _without_range(cls, reads: str | None, info: ValidationInfo) -> str | None:
        if reads not in NUMBERS and info.data.get("range", UNIT) != UNIT:
            given = list(info.data["range"])
            raise ValueError(f"{reads} makes directions, to which range {given} means nothing: leave range out")
        return reads

    @field_validator("smooth_mm")
    @classmethod
    def _of_gradients(cls, smooth_mm: float | None, info: ValidationInfo) -> float | None:
        if smooth_mm is not None and info.data.get("reads", "gradient") != "gradient":
            raise ValueError(f"{smooth_mm:g} belongs to reads: gradient, but reads is {info.data['reads'] or 'value'}")
        return smooth_mm

    def values_of(self, name: str, frame: Frame, inputs: Inputs) -> ImageSampler:
        """The numbers of one picture over a part.

        Raises:
            JobError: it cannot be used, or directions are read from it.
        """
        if self.reads not in NUMBERS:
            raise JobError(
                f"the picture '{name}' with reads: {self.reads} makes directions, and numbers are asked for",
                hint="use it as fields.orientation as a whole, or leave out reads",
            )
        levels, full_scale = read_grey(inputs.read(name), name)
        table = blend(np.arange(full_scale + 1) / full_scale, *self.range)
        return ImageSampler(levels[::-1], table, self.rectangle(frame))

    def lines_of(self, name: str, frame: Frame, inputs: Inputs, sines: str | None = None) -> LineTexels:
        """The directions of one picture over a part.

        Args:
            sines: the picture of the second channel of reads: vector.

        Raises:
            JobError: it cannot be used, or shows no direction.
        """
        assert self.reads is not None
        assert self.reads != "value"
        second = None if sines is None else (inputs.read(sines), sines)
        return read_lines((inputs.read(name), name), second, self.reads, self.rectangle(frame), self.smooth_mm)


class ImageSource(PictureSource):
    """A picture over the part's bounding box, or over a box in mm."""

    image: str = Field(min_length=1, description="8 or 16-bit grey PNG or TIFF, relative to the job file; RGB for hues")
    with_: str | None = Field(
        default=None, alias="with", min_length=1, description="of reads: vector: grey picture of the sines, of one size"
    )

    @field_validator("with_")
    @classmethod
    def _of_vectors(cls, second: str | None, info: ValidationInfo) -> str | None:
        if second is not None and info.data.get("reads", "vector") != "vector":
            raise ValueError(f"'{second}' belongs to reads: vector, but reads is {info.data['reads'] or 'value'}")
        return second

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The picture over a part.

        Raises:
            JobError: it cannot be used, or directions are read from it.
        """
        return self.values_of(self.image, frame, inputs)

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The directions over a part; of values, angles in degrees.

        Raises:
            JobError: the picture cannot be used, or shows no direction.
        """
        if self.reads in NUMBERS:
            return super().open_orientation(frame, inputs)
        return PictureLines((self.lines_of(self.image, frame, inputs, self.with_),))

    def paths(self) -> tuple[str, ...]:
        """The pictures' paths."""
        return (self.image,) if self.with_ is None else (self.image, self.with_)

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its pictures elsewhere."""
        second = None if self.with_ is None else renamed.get(self.with_, self.with_)
        return self.model_copy(update={"image": renamed.get(self.image, self.image), "with_": second})


@dataclass(frozen=True, eq=False)
class ImageSampler:
    """Texels over a rectangle of the field frame.

    Attributes:
        levels: (rows, columns), as the file holds them: large pictures stay small. Row 0 is where the second of the
            rectangle's axes is smallest.
        table: the value of each level.
    """

    levels: Texels
    table: Floats
    rectangle: Rectangle

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along its two axes, where there is more than one texel."""
        return self.rectangle.varies(self.levels.shape)

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value of the levels between the lowest and the highest."""
        values = self.table[int(self.levels.min()) : int(self.levels.max()) + 1]
        return (float(values.min()), float(values.max()))

    @property
    def texels(self) -> Hashable:
        """Pictures of the same size on the same rectangle share their texels."""
        return (self.levels.shape, self.rectangle)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Bilinear values; lerp form, so that equal texels give exactly their value."""
        (c0, c1, fx), (r0, r1, fy) = self.rectangle.around((x, y, z), self.levels.shape)
        v, table = self.levels, self.table
        raster = c0.ndim == r0.ndim == 2 and c0.shape[0] == r0.shape[1] == 1
        if raster:  # along its rows once per row of texels
            rows, place = np.unique([r0[:, 0], r1[:, 0]], return_inverse=True)
            some = table[v[rows]]
            left = some[:, c0[0]]
            across = left + fx * (some[:, c1[0]] - left)
            low, high = across[place.reshape(2, -1)]
        else:
            low, high = table[v[r0, c0]], table[v[r1, c0]]
            low = low + fx * (table[v[r0, c1]] - low)
            high = high + fx * (table[v[r1, c1]] - high)
        result: Floats = low + fy * (high - low)
        return result

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The four texels around each point and their bilinear weights."""
        (c0, c1, fx), (r0, r1, fy) = self.rectangle.around((x, y, z), self.levels.shape)
        v = self.levels
        samples = self.table[np.stack([v[r0, c0], v[r0, c1], v[r1, c0], v[r1, c1]])]
        weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
        return samples, weights
