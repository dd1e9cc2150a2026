"""Where the part stands: scale, rotation and bed, and the way back from printer to field coordinates.

Three frames, all right-handed, mm, z up:

- field frame: the part's file times its unit, relative to its bounding box minimum. Painted fields live here.
- pattern frame: the printer's axes, relative to the placed part's bounding box minimum. Noise and slicing
  happen here, so that moving a part changes no byte.
- printer frame: the pattern frame plus `Placement.origin_mm`. Only manifests speak of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from amslicer.mesh import Mesh

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Placement:
    """A rotation, a scale and a shift between the field frame and the pattern frame.

    Attributes:
        rotation: (3, 3), file axes to printer axes.
        scale: factor on all lengths, > 0.
        low_mm: (3,) bounding box minimum of the turned and scaled field-frame part.
        size_mm: (3,) its bounding box size in printer axes.
        origin_mm: (3,) bounding box minimum in the printer frame.
        file_minimum_mm: (3,) bounding box minimum in the part's file.
        lifted_mm: how far on_bed moved the part in z.
    """

    rotation: Floats
    scale: float
    low_mm: Floats
    size_mm: Floats
    origin_mm: Floats
    file_minimum_mm: Floats
    lifted_mm: float

    def to_field(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats]:
        """Field-frame coordinates (mm) of pattern-frame ones.

        The arrays broadcast; a coordinate that does not depend on one of them stays small (an unturned part's
        field x is as long as x), which keeps fields on a pixel grid cheap.
        """
        sides = (x + self.low_mm[0], y + self.low_mm[1], z + self.low_mm[2])
        inverse = self.rotation.T / self.scale
        out = []
        for row in inverse:
            terms = [side * factor if factor != 1 else side for factor, side in zip(row, sides, strict=True) if factor]
            total = terms[0]
            for term in terms[1:]:
                total = total + term
            out.append(np.asarray(total, np.float64))
        return out[0], out[1], out[2]

    def to_pattern(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats]:
        """Pattern-frame coordinates (mm) of field-frame ones; the arrays broadcast, and stay small as in to_field."""
        out = []
        for row, low in zip(self.rotation * self.scale, self.low_mm, strict=True):
            terms = [
                side * factor if factor != 1 else side for factor, side in zip(row, (x, y, z), strict=True) if factor
            ]
            out.append(np.asarray(sum(terms[1:], terms[0]) - low, np.float64))
        return out[0], out[1], out[2]

    def turn(self, directions: Floats) -> Floats:
        """Printer-axes directions of field-frame ones, (N, 3) to (N, 3)."""
        return directions if np.array_equal(self.rotation, np.eye(3)) else directions @ self.rotation.T

    def depends_on_z(self, varies: tuple[bool, bool, bool]) -> bool:
        """Whether something that varies along these field axes varies along the printer's z."""
        return any(v and self.rotation[2, axis] != 0 for axis, v in enumerate(varies))

    def transform(self) -> list[list[float]]:
        """(4, 4) matrix from file coordinates (mm) to the printer frame."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation * self.scale
        matrix[:3, 3] = self.origin_mm - self.low_mm - matrix[:3, :3] @ self.file_minimum_mm
        return [[float(v) for v in row] for row in matrix]


def place(
    mesh: Mesh, *, scale: float = 1.0, rotate_deg: Sequence[float] = (0.0, 0.0, 0.0), on_bed: bool = True
) -> tuple[Placement, Floats]:
    """Scales, turns (about the file's x, then y, then z axis) and puts a part on the bed.

    Returns:
        The placement, and the part's vertices in the pattern frame, (V, 3) float64.
    """
    rotation = rotation_matrix(rotate_deg)
    turned = mesh.vertices @ (rotation * scale).T if rotation_matters(rotation, scale) else mesh.vertices
    low, high = turned.min(axis=0), turned.max(axis=0)
    origin = rotation @ mesh.minimum_mm * scale + low
    lifted = 0.0
    if on_bed:
        lifted = float(-origin[2])
        origin[2] = 0.0
    placement = Placement(rotation, scale, low, high - low, origin, mesh.minimum_mm, lifted)
    return placement, turned - low


def rotation_matters(rotation: Floats, scale: float) -> bool:
    """Whether turning and scaling would change anything."""
    return scale != 1 or not np.array_equal(rotation, np.eye(3))


def rotation_matrix(rotate_deg: Sequence[float]) -> Floats:
    """(3, 3) rotation about x, then y, then z (degrees); exact for multiples of 90°."""
    matrix = np.eye(3)
    for axis, angle_deg in enumerate(rotate_deg):
        cosine, sine = _exact_cos_sin(angle_deg)
        turn = np.eye(3)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turn[a, a] = turn[b, b] = cosine
        turn[b, a], turn[a, b] = sine, -sine
        matrix = turn @ matrix
    return matrix


def _exact_cos_sin(angle_deg: float) -> tuple[float, float]:
    quarter, rest = divmod(angle_deg, 90.0)
    if rest == 0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    angle = np.deg2rad(angle_deg)
    return float(np.cos(angle)), float(np.sin(angle))
