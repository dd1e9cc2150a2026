"""Opens field specifications over a part, in its own frame or in the printer's."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError
from amslicer.fields.constant import ConstantSampler
from amslicer.fields.orientation import Angles, Orientation
from amslicer.fields.source import Frame, Inputs, Sampler, Source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.placement import Placement

    Floats = NDArray[np.float64]


def open_field(spec: float | Source, frame: Frame, inputs: Inputs) -> Sampler:
    """The sampler of a validated field specification over one part."""
    if not isinstance(spec, Source):
        return ConstantSampler(float(spec))
    if spec.frame != "bed":
        return spec.open(frame, inputs)
    placement = _placement(spec, frame)
    return BedSampler(spec.open(_bed(placement, frame), inputs), placement)


def open_orientation(spec: float | Source, frame: Frame, inputs: Inputs) -> Orientation:
    """The directions of a validated field specification over one part; a number is an angle in degrees."""
    if not isinstance(spec, Source):
        return Angles(ConstantSampler(float(spec)))
    if spec.frame != "bed":
        return spec.open_orientation(frame, inputs)
    placement = _placement(spec, frame)
    return BedOrientation(spec.open_orientation(_bed(placement, frame), inputs), placement)


def _placement(spec: Source, frame: Frame) -> Placement:
    if frame.placement is None:
        raise JobError(
            "a field with frame: bed stands inside another one, or where only the part's box is known",
            hint="give the outermost field frame: bed: those within it follow",
        )
    if spec.needs_part:
        raise JobError(
            "a field with frame: bed is made from the part itself, which it follows",
            hint="leave out frame: bed",
        )
    return frame.placement


def _bed(placement: Placement, frame: Frame) -> Frame:
    return Frame(placement.origin_mm, placement.size_mm, None, frame.load_part, bed=True)


def _around(placement: Placement, varies: tuple[bool, bool, bool]) -> tuple[bool, bool, bool]:
    """Along which field axes something varies that varies along these printer axes."""
    x, y, z = (any(varies[i] and placement.rotation[i, axis] != 0 for i in range(3)) for axis in range(3))
    return x, y, z


@dataclass(frozen=True, eq=False)
class BedSampler:
    """A field over the printer's axes, from the placed part's lowest corner on, asked in the field frame."""

    sampler: Sampler
    placement: Placement

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the part's axes that have a share of an axis along which the field varies."""
        return _around(self.placement, self.sampler.varies)

    @property
    def bounds(self) -> tuple[float, float]:
        """The field's own."""
        return self.sampler.bounds

    @property
    def texels(self) -> Hashable:
        """The field's own, apart from those that follow the part."""
        return None if self.sampler.texels is None else ("bed", self.sampler.texels)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points."""
        return self.sampler.scalar(*self.placement.to_pattern(x, y, z))

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The field's own, at the places in the printer's axes."""
        return self.sampler.taps(*np.broadcast_arrays(*self.placement.to_pattern(x, y, z)))


@dataclass(frozen=True, eq=False)
class BedOrientation:
    """Directions along the printer's axes, asked in the field frame, and turned into it."""

    orientation: Orientation
    placement: Placement

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """As of a BedSampler."""
        return _around(self.placement, self.orientation.varies)

    @property
    def turns(self) -> bool:
        """As the directions themselves."""
        return self.orientation.turns

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""
        places = np.broadcast_arrays(*self.placement.to_pattern(x, y, z))
        return self.orientation.normals(*places) @ self.placement.rotation
