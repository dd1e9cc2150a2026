"""A field painted as several pictures, one above the other: linear between their heights, clamped beyond.

    {stack: {"0": paint/bottom.png, "10": paint/top.png}, range: [0, 1]}
    {stack: {"0": a.png, "4": b.png, "5.5": c.png}, plane: xz, reads: hue}     heights along y

Heights are mm along the plane's normal, in file coordinates. Each picture is one of {image: …}, of any size; directions
are combined as lines.
"""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from amslicer.fields.image import NUMBERS, ImageSampler, PictureSource
from amslicer.fields.picturelines import PictureLines, between, place_between
from amslicer.fields.source import Frame, Inputs, Sampler, Source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.orientation import Orientation

    Floats = NDArray[np.float64]

MOST_PICTURES = 1000  # one per layer of a small part: beyond, volumes are meant
HEIGHT = r"^\s*[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\s*$"
HINT = "keys are heights in mm along the plane's normal"


class StackSource(PictureSource):
    """Pictures at heights along their plane's normal."""

    stack: dict[float, Annotated[str, Field(min_length=1)]] = Field(
        min_length=1,
        max_length=MOST_PICTURES,
        description="pictures by their heights: mm along the plane's normal, file coordinates",
        json_schema_extra={"propertyNames": {"pattern": HEIGHT}},
    )

    @field_validator("stack", mode="before")
    @classmethod
    def _heights(cls, stack: Any) -> Any:
        if not isinstance(stack, Mapping):
            return stack
        found: dict[float, tuple[Any, Any]] = {}
        for key, path in stack.items():
            height = _height(key)
            if height in found:
                raise ValueError(f"has two pictures at {height:g} mm (keys {found[height][0]} and {key})")
            found[height] = (key, path)
        return {height: found[height][1] for height in sorted(found)}

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The pictures over a part.

        Raises:
            JobError: one cannot be used, or directions are read from them.
        """
        return StackSampler(
            tuple(self.values_of(name, frame, inputs) for name in self.stack.values()), self._heights_mm(frame)
        )

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The directions over a part; of values, angles in degrees.

        Raises:
            JobError: a picture cannot be used, or shows no direction.
        """
        if self.reads in NUMBERS:
            return super().open_orientation(frame, inputs)
        lines = tuple(self.lines_of(name, frame, inputs) for name in self.stack.values())
        return PictureLines(lines, self._heights_mm(frame))

    def paths(self) -> tuple[str, ...]:
        """The pictures' paths."""
        return tuple(self.stack.values())

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its pictures elsewhere."""
        return self.model_copy(update={"stack": {h: renamed.get(path, path) for h, path in self.stack.items()}})

    def _heights_mm(self, frame: Frame) -> tuple[float, ...]:
        low = float(frame.minimum_mm[self.rectangle(frame).normal])
        return tuple(height - low for height in self.stack)


def _height(key: Any) -> float:
    number = isinstance(key, int | float) and not isinstance(key, bool)
    if not number and not (isinstance(key, str) and re.match(HEIGHT, key)):
        raise ValueError(f"{key!r} is not a height; {HINT}")
    try:
        height = float(key)
    except OverflowError:
        height = math.inf
    if not math.isfinite(height):
        raise ValueError(f"{key} is no finite height; {HINT}")
    return height + 0.0  # -0 is 0


@dataclass(frozen=True, eq=False)
class StackSampler:
    """Pictures at ascending heights.

    Attributes:
        heights_mm: of each picture, field frame.
    """

    pictures: tuple[ImageSampler, ...]
    heights_mm: tuple[float, ...]

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the plane's axes where there are texels, and along its normal where there are pictures."""
        x, y, z = (
            any(picture.varies[axis] for picture in self.pictures) or (axis == self._normal and len(self.pictures) > 1)
            for axis in range(3)
        )
        return x, y, z

    @property
    def bounds(self) -> tuple[float, float]:
        """Of all pictures."""
        ends = [picture.bounds for picture in self.pictures]
        return min(low for low, _ in ends), max(high for _, high in ends)

    @property
    def texels(self) -> Hashable:
        """Stacks of pictures of the same sizes at the same heights share their texels."""
        return ("stack", self.heights_mm, tuple(picture.texels for picture in self.pictures))

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Bilinear in the pictures, linear between them."""
        return between(
            self.heights_mm, (x, y, z)[self._normal], (x, y, z), lambda k, *place: self.pictures[k].scalar(*place)
        )

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The four texels of the picture below and of the one above, and their weights."""
        last, share = place_between(self.heights_mm, (x, y, z)[self._normal])
        samples, weights = np.empty((2, 4, len(x))), np.empty((2, 4, len(x)))
        for k in np.unique(last):
            chosen = last == k
            for end in (0, 1):
                picture = self.pictures[min(k + end, len(self.pictures) - 1)]
                found, own = picture.taps(x[chosen], y[chosen], z[chosen])
                samples[end][:, chosen] = found
                weights[end][:, chosen] = own * (share[chosen] if end else 1 - share[chosen])
        return samples.reshape(8, -1), weights.reshape(8, -1)

    @property
    def _normal(self) -> int:
        return self.pictures[0].rectangle.normal
