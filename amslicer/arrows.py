"""Whether a painted direction is an arrow: a field of n that never turns into -n from one place to the next.

A laminate's normal is a line, and a picture of angles says -90° and 90° for the same one. The symmetric profiles do not
see the difference; a cyclic one reverses its order of materials there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.painted import Painted

    Floats = NDArray[np.float64]

STEP_PERIODS = 0.5  # between two samples: a field that turns faster makes no laminate
CALM_STEPS = 3  # between two places whose directions are compared
CALM_SAMPLES = 1 << 17
MAX_SAMPLES = 1 << 20  # beyond, samples are further apart
# Two neighbours whose arrows point more than 135° apart: across the core of a defect they do too, but not beside it.
OPPOSITE = -float(np.sqrt(0.5))


def sample_shape(painted: Painted, step_mm: float, most: int = MAX_SAMPLES) -> tuple[int, int, int]:
    """How many places along x, y and z stand for the part: at most so many, about step_mm apart."""
    size = painted.placement.size_mm * (1.0, 1.0, 0.0 if painted.dimensions == 2 else 1.0)
    counts = np.maximum(1, np.ceil(size / step_mm))
    while np.prod(counts) > most:
        counts = np.maximum(1, np.ceil(counts * 0.9))
    return int(counts[0]), int(counts[1]), int(counts[2])


def sample_places(painted: Painted, step_mm: float, most: int = MAX_SAMPLES) -> Floats:
    """(nx, ny, nz, 3) places in the part's box, pattern frame, mm: the middles of equal cells."""
    shape = sample_shape(painted, step_mm, most)
    axes = [(np.arange(n) + 0.5) / n * size for n, size in zip(shape, painted.placement.size_mm, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def turns_little(painted: Painted, distance_mm: float, degrees: float) -> bool:
    """Whether the painted direction, as a line, turns by no more than this between places so far apart.

    Looked at between neighbours of a lattice, whose turns are added up along its axes.
    """
    if not any(painted.orientation.varies):
        return True
    places = sample_places(painted, distance_mm / CALM_STEPS, CALM_SAMPLES)
    steps_mm = (painted.placement.size_mm / places.shape[:3])[: painted.dimensions]
    if np.any(steps_mm > distance_mm):
        return False  # too large a part to be looked at closely
    normals = painted.normals(places.reshape(-1, 3)).reshape(places.shape)
    turned = 0.0
    for axis in range(3):
        a, b = (np.moveaxis(normals, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        if a.size:
            cosine = np.abs(np.einsum("abcd,abcd->abc", a, b)).min()
            turned += np.degrees(np.arccos(min(1.0, float(cosine)))) * distance_mm / steps_mm[axis]
    return turned <= degrees


def refuse_lines(painted: Painted, profile: str) -> None:
    """Looks for a wall across which the painted direction turns into its opposite.

    Raises:
        JobError: there is one; the message says where.
    """
    places = sample_places(painted, STEP_PERIODS * painted.period_bounds_mm[0])
    shape = places.shape[:3]
    normals = painted.normals(places.reshape(-1, 3)).reshape(*shape, 3)
    for axis in range(3):
        a, b = (np.moveaxis(normals, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        wall = _walls(np.einsum("abcd,abcd->abc", a, b) < OPPOSITE)
        if wall.any():
            pair = np.argwhere(wall)[0]
            x, y, z = np.moveaxis(places, axis, 0)[tuple(pair)]
            raise JobError(
                f"pattern.profile: {profile} needs arrows, but fields.orientation turns into its opposite near "
                f"x = {x:.1f}, y = {y:.1f}, z = {z:.1f} mm from the part's corner: it would reverse the order of the "
                "materials there",
                hint="use profile: symmetric, or paint a direction that does not jump by 180° (a gradient, an "
                "expression, a vector; not an angle that wraps)",
            )


def _walls(opposite: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pairs of neighbours along the first axis that are opposite together with those beside them."""
    wide = opposite.copy()  # a wall may be oblique
    wide[1:] |= opposite[:-1]
    wide[:-1] |= opposite[1:]
    out = opposite.copy()
    for axis in (1, 2):
        if opposite.shape[axis] >= 3:
            beside = np.zeros_like(opposite)
            rows = [slice(None)] * 3
            lower, upper = list(rows), list(rows)
            rows[axis], lower[axis], upper[axis] = slice(1, -1), slice(None, -2), slice(2, None)
            beside[tuple(rows)] = wide[tuple(lower)] & wide[tuple(upper)]
            out &= beside
    return out
