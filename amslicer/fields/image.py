"""A field painted as a grey picture, stretched over the part seen from above, or along another axis.

    {image: paint/ratio.png, range: [0, 1]}
    {image: paint/angle.png, range: [-90, 90], box: [x0, y0, x1, y1]}     box in mm, file coordinates
    {image: paint/side.png, plane: xz}                                    its box would be [x0, z0, x1, z1]

Black is range[0], white is range[1]; the first axis of the plane runs along the rows, and the top row is where the
second is largest. Bilinear between texel centres, clamped outside.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from amslicer.fields.pictures import read_grey
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source, blend

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


# The axes along a picture's rows and up its columns.
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


class ImageSource(Source):
    """A grey picture over the part's bounding box, or over a box in mm."""

    image: str = Field(min_length=1, description="8 or 16-bit grey PNG or TIFF, relative to the job file")
    range: tuple[Number, Number] = Field(default=(0.0, 1.0), description="values of black and white")
    plane: Literal["xy", "xz", "yz"] = Field(default="xy", description="the plane that the picture lies in")
    box: tuple[Number, Number, Number, Number] | None = Field(
        default=None,
        description="x0, y0, x1, y1 (the plane's axes) in mm, file coordinates; default: the part's bounding box",
    )

    @field_validator("box")
    @classmethod
    def _ordered(
        cls, box: tuple[float, float, float, float] | None, info: ValidationInfo
    ) -> tuple[float, float, float, float] | None:
        if box is not None and not (box[0] < box[2] and box[1] < box[3]):
            a, b = info.data.get("plane", "xy")
            raise ValueError(f"must be [{a}0, {b}0, {a}1, {b}1] with {a}0 < {a}1 and {b}0 < {b}1, but is {list(box)}")
        return box

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The picture over a part."""
        grey, full_scale = read_grey(inputs.read(self.image), self.image)
        texels = blend(grey.astype(np.float64) / full_scale, *self.range)
        axes = PLANES[self.plane]
        minimum = frame.minimum_mm[list(axes)]
        if self.box is None:
            corner, size = minimum, frame.size_mm[list(axes)]
        else:
            corner, size = np.array(self.box[:2]), np.array(self.box[2:]) - np.array(self.box[:2])
        low = corner - minimum
        return ImageSampler(texels[::-1], (float(low[0]), float(low[1])), (float(size[0]), float(size[1])), axes)

    def paths(self) -> tuple[str, ...]:
        """The picture's path."""
        return (self.image,)

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its picture elsewhere."""
        return self.model_copy(update={"image": renamed.get(self.image, self.image)})


@dataclass(frozen=True, eq=False)
class ImageSampler:
    """Texels over a rectangle of the field frame, along two axes; row 0 is where the second is smallest."""

    values: Floats
    low_mm: tuple[float, float]
    size_mm: tuple[float, float]
    axes: tuple[int, int] = PLANES["xy"]

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along its two axes, where there is more than one texel."""
        along = {axis for axis, count in zip(self.axes, self.values.shape[::-1], strict=True) if count > 1}
        return (0 in along, 1 in along, 2 in along)

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest texel."""
        return (float(self.values.min()), float(self.values.max()))

    @property
    def texels(self) -> Hashable:
        """Pictures of the same size on the same rectangle share their texels."""
        return (self.values.shape, self.low_mm, self.size_mm, self.axes)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Bilinear values; lerp form, so that equal texels give exactly their value."""
        c0, c1, fx = self._neighbours((x, y, z)[self.axes[0]], 0)
        r0, r1, fy = self._neighbours((x, y, z)[self.axes[1]], 1)
        v = self.values
        raster = c0.ndim == r0.ndim == 2 and c0.shape[0] == r0.shape[1] == 1
        if raster:  # along its rows once per row of texels
            rows, place = np.unique([r0[:, 0], r1[:, 0]], return_inverse=True)
            some = v[rows]
            across = some[:, c0[0]] + fx * (some[:, c1[0]] - some[:, c0[0]])
            low, high = across[place.reshape(2, -1)]
        else:
            low = v[r0, c0] + fx * (v[r0, c1] - v[r0, c0])
            high = v[r1, c0] + fx * (v[r1, c1] - v[r1, c0])
        result: Floats = low + fy * (high - low)
        return result

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The four texels around each point and their bilinear weights."""
        c0, c1, fx = self._neighbours((x, y, z)[self.axes[0]], 0)
        r0, r1, fy = self._neighbours((x, y, z)[self.axes[1]], 1)
        v = self.values
        samples = np.stack([v[r0, c0], v[r0, c1], v[r1, c0], v[r1, c1]])
        weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
        return samples, weights

    def _neighbours(self, position: Floats, axis: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Texel below, texel above and the share between them, along columns (0) or rows (1)."""
        count = self.values.shape[1 - axis]
        size = self.size_mm[axis]
        along = (position - self.low_mm[axis]) / (size if size else 1.0) * count - 0.5
        along = np.clip(along, 0.0, count - 1.0)
        below = np.minimum(along.astype(np.int64), max(count - 2, 0))
        return below, np.minimum(below + 1, count - 1), along - below
