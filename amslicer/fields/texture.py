"""A field with the micro-texture of a picture: grain, not the picture itself.

    {texture: grain.png, mean: 0.4, spread: 0.1, size_mm: 12}
    {texture: grain.png, mean: 0.4, spread: 0.1, size_mm: 12, plane: xz, renew_mm: 3, kind: asymptotic-spot, seed: 2}

A random-phase texture with the picture's spectrum covers the part's box from its lowest corner, without a seam, and
repeats beyond. Its pixels have the given mean and standard deviation and are clipped at three of these on either side;
between their centres it is bilinear. It is the same at all heights along the plane's normal, or renews itself there.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from amslicer.errors import JobError
from amslicer.fields.image import PLANES
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source
from amslicer.randomphase import MOST_PX, STEPS, Frames, Kind, extended_spot, good_side, neighbours, sample_bilinear

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

CLIP = 3.0  # standard deviations: 0.3 % of a Gaussian lie beyond
KEPT_BYTES = 256 << 20  # of textures at several heights
SHORTEST_MM = 1e-3  # shorter sizes are mistakes


class TextureSource(Source):
    """A random-phase texture with the spectrum of a grey picture."""

    texture: str = Field(min_length=1, description="grey PNG or TIFF to imitate, relative to the job file")
    mean: Number = Field(description="mean of the values")
    spread: Annotated[Number, Field(ge=0)] = Field(description="standard deviation of the values, clipped at 3 of them")
    size_mm: Annotated[Number, Field(ge=SHORTEST_MM)] = Field(description="the picture's width, mm in the part's file")
    kind: Kind = Field(default="random-phase", description="keep the picture's spectrum, or roughen it by chance")
    seed: Annotated[int, Field(strict=True, ge=0, le=2**64 - 1)] = Field(
        default=1, description="another seed, another texture of the same kind"
    )
    plane: Literal["xy", "xz", "yz"] = Field(default="xy", description="the plane that the texture lies in")
    renew_mm: Annotated[Number, Field(ge=SHORTEST_MM)] | None = Field(
        default=None, description="a new texture every so many mm along the plane's normal; default: always the same"
    )

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The texture over a part.

        Raises:
            JobError: the picture cannot be used, or has colours.
        """
        # Not on top: it reads pictures as fields do, with this package.
        from amslicer.exemplar import periodic_component, read_exemplar

        exemplar = read_exemplar(inputs.read(self.texture), self.texture)
        if not exemplar.is_grey:
            raise JobError(
                f"the picture '{self.texture}' has {exemplar.values.shape[2]} channels; a field takes grey ones",
                hint="convert it: magick IN -colorspace Gray -depth 16 OUT.png",
            )
        p = periodic_component(exemplar.values[..., 0])
        pixel_mm = self.size_mm / p.shape[1]
        axes = PLANES[self.plane]
        columns, rows = (
            good_side(max(own, min(math.ceil(float(frame.size_mm[axis]) / pixel_mm), MOST_PX)))
            for own, axis in zip(p.shape[::-1], axes, strict=True)
        )
        frames = Frames(extended_spot(p, (rows, columns)), self.kind, self.seed)
        return TextureSampler(frames, (rows, columns), pixel_mm, axes, self.mean, self.spread, self.renew_mm)

    def paths(self) -> tuple[str, ...]:
        """The picture's path."""
        return (self.texture,)

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its picture elsewhere."""
        return self.model_copy(update={"texture": renamed.get(self.texture, self.texture)})


@dataclass(frozen=True, eq=False)
class TextureSampler:
    """A periodic texture along two axes of the field frame from 0 on, renewed along the third or not. In any thread.

    Attributes:
        sides: rows and columns; odd, so that a renewed texture changes without a step.
    """

    frames: Frames
    sides: tuple[int, int]
    pixel_mm: float
    axes: tuple[int, int]
    mean: float
    spread: float
    renew_mm: float | None
    _made: dict[int, Floats] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """In its plane, and where it is renewed along the third axis."""
        x, y, z = (axis in self.axes or self.renew_mm is not None for axis in range(3))
        return x, y, z

    @property
    def bounds(self) -> tuple[float, float]:
        """Three standard deviations around the mean, where the values are clipped."""
        return self.mean - CLIP * self.spread, self.mean + CLIP * self.spread

    @property
    def texels(self) -> Hashable:
        """Textures of the same size in the same place share their texels."""
        return ("texture", self.sides, self.pixel_mm, self.axes, self.renew_mm)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Bilinear values, straight between two heights; clipped."""
        across, up, height = self._place(x, y, z)
        if height.size == 1:
            result = self._between(height, across, up)
        else:  # the points of one step after another
            across, up, height = np.broadcast_arrays(across, up, height)
            result = np.empty(height.shape)
            for chosen in _by_step(height):
                result[chosen] = self._between(height[chosen], across[chosen], up[chosen])
        return np.clip(result, *self.bounds)  # rounding leaves them, too

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The four texels around each point and their bilinear weights; at two heights where it is renewed."""
        across, up, height = np.broadcast_arrays(*self._place(x, y, z))
        c0, c1, fx = neighbours(across, self.sides[1])
        r0, r1, fy = neighbours(up, self.sides[0])
        corners = ((r0, c0), (r0, c1), (r1, c0), (r1, c1))
        weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
        ends = (0,) if self.renew_mm is None else (0, 1)
        samples = np.empty((len(ends), 4, *height.shape))
        for chosen in _by_step(height):
            step = math.floor(height[chosen][0])
            for end in ends:
                texture = self._texture(step + end)
                samples[end][:, chosen] = [texture[r[chosen], c[chosen]] for r, c in corners]
        if self.renew_mm is None:
            return samples[0], weights
        share = height - np.floor(height)
        return samples.reshape(8, -1), np.concatenate([(1 - share) * weights, share * weights])

    def _place(self, *position_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """Along columns and rows in pixels, along the normal in steps."""
        across, up = (position_mm[axis] / self.pixel_mm for axis in self.axes)
        if self.renew_mm is None:
            return across, up, np.zeros(1)
        (normal,) = {0, 1, 2} - set(self.axes)
        return across, up, np.asarray(position_mm[normal]) / self.renew_mm * STEPS

    def _between(self, height: Floats, across: Floats, up: Floats) -> Floats:
        """Values at heights that are all in the same step."""
        step = math.floor(height.flat[0])
        low = sample_bilinear(self._texture(step), across, up)
        share = height - step
        if not share.any():
            return low
        result: Floats = low + share * (sample_bilinear(self._texture(step + 1), across, up) - low)
        return result

    def _texture(self, step: int) -> Floats:
        """The texture at a height; the last few are kept."""
        with self._lock:
            if step not in self._made:
                v = self.frames.at(step / STEPS)
                values = self.mean + self.spread * (v - v.mean()) / v.std()
                self._made[step] = np.clip(values, *self.bounds)
                while len(self._made) > max(2, KEPT_BYTES // v.nbytes):
                    del self._made[next(iter(self._made))]
            return self._made[step]


def _by_step(height: Floats) -> Iterator[NDArray[np.bool_]]:
    """Which points are in each step, from the lowest on."""
    steps = np.floor(height)
    for step in np.unique(steps):
        yield steps == step
