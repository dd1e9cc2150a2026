"""A field given as samples in space: a 3-D array, stretched over the part's box, over another, or where its file says.

    {volume: ratio.npy, range: [0, 1]}                                    axes z, y, x, all ascending
    {volume: ratio.npy, box: [x0, y0, z0, x1, y1, z1]}                    box in mm, file coordinates
    {volume: scan.nrrd, placed: file}                                     by the file's own spacing and origin
    {volume: fields.npz, key: ratio}                                      one of several arrays
    {volume: fibres.npy}                                                  (z, y, x, 3): directions, combined as lines
    {volume: stress.vti, key: stress, principal: 3}                       (z, y, x, 6): tensors' principal directions
    {volume: fibres.npy, component: magnitude}                            numbers from vectors or tensors

npy, npz, nrrd, TIFF stacks and vti. Unsigned integers count from 0 to their type's largest as 0 to 1 of `range`; floats
are taken as they are. Trilinear between voxel centres, clamped outside. Tensors are xx, yy, zz, xy, yz, xz;
where one is the same all around, its direction is +x.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from amslicer.errors import JobError
from amslicer.fields.orientation import Angles, Lines, Orientation
from amslicer.fields.source import TINY_SHARE, Frame, Inputs, Number, Range, Sampler, Source, check_box
from amslicer.fields.voxels import (
    TENSOR_COMPONENTS,
    VECTOR_COMPONENTS,
    Axis,
    Reader,
    VolumeSampler,
    Voxels,
    scan,
    tensor_directions,
    vector_directions,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from amslicer.volumefiles import Volume

    Floats = NDArray[np.float64]
    Box = tuple[float, float, float, float, float, float]

NAMED = ("x", "y", "z")  # components that have a name


class VolumeSource(Source):
    """A 3-D array over the part's bounding box, over a box in mm, or where its file says."""

    volume: str = Field(min_length=1, description="npy, npz, nrrd, tif or vti file, relative to the job file")
    range: Range = Field(
        default=(0.0, 1.0), description="values of 0 and full scale (the largest integer, 1 of floats)"
    )
    key: str | None = Field(default=None, min_length=1, description="the array's name, in files of several")
    box: tuple[Number, Number, Number, Number, Number, Number] | None = Field(
        default=None, description="x0, y0, z0, x1, y1, z1 in mm, file coordinates; default: the part's bounding box"
    )
    placed: Literal["box", "file"] | None = Field(
        default=None,
        description="box: stretched over the box; file: by the file's spacing and origin (default where it has both)",
    )
    component: Literal["x", "y", "z", "magnitude"] | Annotated[int, Field(strict=True, ge=0, le=5)] | None = Field(
        default=None, description="one number of vectors (x, y, z, magnitude, or 0…2) or of tensors (0…5)"
    )
    principal: Literal[1, 2, 3] | None = Field(
        default=None, description="of tensors: along the largest (1, the default), middle or smallest principal value"
    )

    @field_validator("box")
    @classmethod
    def _ordered(cls, box: Box | None, info: ValidationInfo) -> Box | None:
        if box is not None and not all(box[i] < box[i + 3] for i in range(3)):
            raise ValueError(f"must be [x0, y0, z0, x1, y1, z1] with x0 < x1, y0 < y1 and z0 < z1, but is {list(box)}")
        if box is not None:
            check_box(box[:3], box[3:])
        return box

    @model_validator(mode="after")
    def _one_meaning(self) -> Self:
        if self.placed == "file" and self.box is not None:
            raise ValueError("has a box and placed: file; give one of them")
        if self.principal is not None and self.component is not None:
            raise ValueError("has component (a number) and principal (a direction); give one of them")
        return self

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The volume's numbers over a part.

        Raises:
            JobError: the file cannot be used, or holds vectors or tensors and no component is chosen.
        """
        volume = self._read(inputs)
        if volume.channels is None:
            self._refuse_components()
        elif self.component is None:
            raise JobError(
                f"the volume '{self.volume}' holds {volume.channels} numbers per sample, and one is needed here",
                hint="choose one of them, for example component: 0; only an orientation takes vectors and tensors",
            )
        read = Reader(volume.full_scale, self.range, self._component(volume.channels))
        found = scan(volume.array, read, self.volume)
        return VolumeSampler(self._voxels(volume, frame, found.varies), read, found.bounds)

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The volume's directions over a part: of numbers as angles in degrees, of vectors, or principal ones.

        Raises:
            JobError: the file cannot be used.
        """
        volume = self._read(inputs)
        if volume.channels is None or self.component is not None:
            return Angles(self.open(frame, inputs))
        directions: Callable[[Voxels, Reader, Floats, Floats, Floats], Floats]
        if volume.channels == VECTOR_COMPONENTS and self.principal is None:
            directions = vector_directions
        elif volume.channels == TENSOR_COMPONENTS:
            directions = partial(tensor_directions, which=self.principal or 1)
        else:
            raise JobError(
                f"the volume '{self.volume}' holds {volume.channels} numbers per sample; directions are made of "
                f"{VECTOR_COMPONENTS} (vectors) or {TENSOR_COMPONENTS} (tensors)",
                hint="leave out principal for vectors" if self.principal is not None else "or choose a component",
            )
        read = Reader(volume.full_scale, self.range)
        found = scan(volume.array, read, self.volume)
        voxels = self._voxels(volume, frame, found.varies)
        return Lines(lambda x, y, z: directions(voxels, read, x, y, z), found.varies)

    def paths(self) -> tuple[str, ...]:
        """The volume's path."""
        return (self.volume,)

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its volume elsewhere."""
        return self.model_copy(update={"volume": renamed.get(self.volume, self.volume)})

    def _read(self, inputs: Inputs) -> Volume:
        from amslicer.volumefiles import read_volume

        return read_volume(inputs.map(self.volume), self.volume, self.key)

    def _voxels(self, volume: Volume, frame: Frame, varies: tuple[bool, bool, bool]) -> Voxels:
        """The samples and where they lie in the field frame."""
        placed = self.placed or ("file" if volume.spacing_mm and volume.origin_mm and self.box is None else "box")
        counts = volume.array.shape[2::-1]
        if placed == "file" and volume.spacing_mm is None:
            raise JobError(
                f"the volume '{self.volume}' has placed: file, and the file does not say how far its samples are apart",
                hint="give a box in mm instead: box: [x0, y0, z0, x1, y1, z1]",
            )
        axes = []
        for i, count in enumerate(counts):
            corner = float(frame.minimum_mm[i])
            if placed == "file":
                assert volume.spacing_mm is not None
                step = volume.spacing_mm[i]
                within = 0.0 if volume.at_corners else step / 2
                first = within if volume.origin_mm is None else volume.origin_mm[i] - corner
            else:
                low, high = (0.0, float(frame.size_mm[i])) if self.box is None else (self.box[i], self.box[i + 3])
                low, high = (low, high) if self.box is None else (low - corner, high - corner)
                step = (high - low) / max(count - 1 if volume.at_corners else count, 1)
                first = low if volume.at_corners else low + step / 2
            axes.append(Axis(count, first, step, varies[i]))
            if placed == "file":
                self._check_overlap(i, first + corner, step * (count - 1), step / 2, frame)
        longest = max(axis.step_mm * axis.count for axis in axes)
        if placed == "file" and longest < TINY_SHARE * float(frame.size_mm.max()):
            raise JobError(
                f"the volume '{self.volume}' is tiny beside the part: its longest side is {longest:.4g} mm by its "
                f"file, the part's {float(frame.size_mm.max()):.4g} mm",
                hint="correct the spacing and its unit in the file, or stretch it over the part with placed: box",
            )
        return Voxels(volume.array, (axes[0], axes[1], axes[2]))

    def _check_overlap(self, axis: int, first: float, length: float, half: float, frame: Frame) -> None:
        """Refuses a file that lies beside the part: clamped, it would be the same value all over."""
        low, high = float(frame.minimum_mm[axis]), float(frame.minimum_mm[axis] + frame.size_mm[axis])
        if first - half > high or first + length + half < low:
            name = "xyz"[axis]
            raise JobError(
                f"the volume '{self.volume}' lies at {name} = {first:g} … {first + length:g} mm by its file, "
                f"and the part at {low:g} … {high:g} mm; they do not meet",
                hint="correct the spacing and origin in the file (mm), or stretch it over the part with placed: box",
            )

    def _refuse_components(self) -> None:
        chosen = next((key for key in ("component", "principal") if getattr(self, key) is not None), None)
        if chosen:
            raise JobError(
                f"the volume '{self.volume}' has {chosen}, and holds one number per sample", hint=f"leave out {chosen}"
            )

    def _component(self, channels: int | None) -> int | Literal["magnitude"] | None:
        """Which component the reader takes."""
        if channels is None or self.component is None:
            return None
        named = isinstance(self.component, str)
        index = NAMED.index(self.component) if self.component in NAMED else self.component
        if (named and channels != VECTOR_COMPONENTS) or (isinstance(index, int) and index >= channels):
            raise JobError(
                f"the volume '{self.volume}' has component: {self.component}, and holds {channels} numbers per sample",
                hint=f"components are numbered 0 to {channels - 1}; x, y, z and magnitude are those of vectors (3)",
            )
        return index if isinstance(index, int) else "magnitude"
