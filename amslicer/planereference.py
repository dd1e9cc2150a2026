"""The readable definition of the patterns of random hyperplanes, in plain float64 NumPy: the device is run against it.

Shares the numbers of the random words with noise/hyperplanes.py, and no code. Lengths in mm; "planes" are lines in 2D.
A family is a stack of parallel planes, which cut space into slices, with another stack of parallel planes in each
slice. Plane i of a stack lies where ω·x/W + o = i + 0.3 + 0.4 r_i (Guehl et al. 2025, "Wave noise", Algorithm 2).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from amslicer.reference import philox4x32

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Words = NDArray[np.uint32]
    Codes = NDArray[np.uint64]

# Fourth words of the counters: (0, 0, family) direction and offset of slices; (slice, 0, family) plane, direction and
# offset of waves; (wave, slice, family) plane, and code; (code, code, level) number of a cell.
FAMILY, SLICE, WAVE, CELL = 0x20000000, 0x20000001, 0x20000002, 0x20000003
FIRST_PLACE, PLACES = 0.3, 0.4  # of a plane, in spacings
FAMILIES_PER_LEVEL = 256


def values(
    kind: str, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: float, dimensions: int, seed: int, directions: int,
    probability: float = 0.7, depth: int = 4,
) -> tuple[Floats, Codes]:  # fmt: skip
    """The value at points, and the code of the cell that they are in.

    Args:
        kind: "cellular", "polytope" or "stit".
        x, y, z: coordinates in mm, which broadcast; z is ignored in 2D.
        period: mean distance from wall to wall along a line in a random direction, mm.
        directions: families of planes; of "stit", at each level.
        probability, depth: of "stit": that a cell is divided further, and how often at most.

    Returns:
        Minus the distance to the nearest wall in mm, or minus a cell's number in 0…1 ("polytope"); codes.
    """
    point = np.stack(np.broadcast_arrays(*(np.asarray(c, np.float64) for c in (x, y, z))), axis=-1)
    shape, point = point.shape[:-1], point.reshape(-1, 3)
    levels = depth + 1 if kind == "stit" else 1
    sizes = sum(probability**level for level in range(levels))  # of a random line, the share that each level divides
    cosine = 2 / math.pi if dimensions == 2 else 0.5  # mean |cos| between a line and the normals of planes
    spacing = 2 * directions * sizes * cosine * period
    distance = np.full(len(point), np.inf)
    code = np.zeros(len(point), np.uint64)
    divided = np.ones(len(point), bool)
    number = np.zeros(len(point))
    for level in range(levels):
        for family in range(directions):
            name = FAMILIES_PER_LEVEL * level + family
            near, own = _family(point[divided], spacing, seed, name, family, directions, dimensions)
            distance[divided] = np.minimum(distance[divided], near)
            code[divided] ^= own
        number[divided] = _numbers(code[divided], level, seed)
        divided &= number < probability
    value = -number if kind == "polytope" else -distance
    return value.reshape(shape), code.reshape(shape)


def _family(
    point: Floats, spacing: float, seed: int, name: int, family: int, directions: int, dimensions: int
) -> tuple[Floats, Codes]:
    """(N,) distances to the nearest plane of a family, (N,) random codes of the cells that it makes."""
    if not len(point):
        return np.zeros(0), np.zeros(0, np.uint64)
    around, upright, offset, _ = _words(0, 0, name, FAMILY, seed) / 2.0**32
    place = point @ _direction(around, upright, family, directions, dimensions) / spacing + offset
    number = np.arange(math.floor(place.min()) - 1, math.floor(place.max()) + 3)
    words = _words(number, 0, name, SLICE, seed)
    planes = number + FIRST_PLACE + PLACES * words[:, 0] / 2.0**32
    below = np.searchsorted(planes, place, side="right") - 1  # of the planes, which a slice is named after
    near = np.minimum(place - planes[below], planes[below + 1] - place)

    _, around, upright, offset = words.T / 2.0**32
    direction = _direction(around, upright, family, directions, dimensions)
    place = np.sum(point * direction[below], axis=-1) / spacing + offset[below]
    wave = np.arange(math.floor(place.min()) - 1, math.floor(place.max()) + 3)
    words = _words(wave, number[:, None], name, WAVE, seed)  # (slices, waves, 4)
    planes = wave + FIRST_PLACE + PLACES * words[..., 0] / 2.0**32
    left = np.floor(place).astype(np.int64) - wave[0]
    left -= planes[below, left] > place
    near = np.minimum(near, np.minimum(place - planes[below, left], planes[below, left + 1] - place))
    code = words[..., 1].astype(np.uint64) << np.uint64(32) | words[..., 2]
    return near * spacing, code[below, left]


def _direction(around: ArrayLike, upright: ArrayLike, family: int, directions: int, dimensions: int) -> Floats:
    """(..., 3) random directions of a family's part of the half circle, or half sphere (section 4.2)."""
    around, upright = np.asarray(around), np.asarray(upright)
    if dimensions == 2:
        angle = math.pi * (family + around) / directions
        return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    rings = max(r for r in range(1, directions + 1) if directions % r == 0 and (2 * r * r <= directions or r == 1))
    azimuth = 2 * math.pi * (family // rings + around) / (directions // rings)
    cosine = (family % rings + upright) / rings
    sine = np.sqrt(1 - cosine * cosine)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1)


def _words(first: ArrayLike, second: ArrayLike, third: int, fourth: int, seed: int) -> Words:
    """(..., 4) random words of counters; the first two words broadcast."""
    counter = np.stack(np.broadcast_arrays(np.asarray(first, np.int64), second, third, fourth), axis=-1)
    return philox4x32(counter & 0xFFFFFFFF, (seed & 0xFFFFFFFF, seed >> 32))


def _numbers(code: Codes, level: int, seed: int) -> Floats:
    """(N,) numbers of cells, uniform in [0, 1), multiples of 2^-24."""
    cells, cell = np.unique(code, return_inverse=True)
    halves = (cells >> np.uint64(32)).astype(np.int64), (cells & np.uint64(0xFFFFFFFF)).astype(np.int64)
    counter = np.stack([*halves, np.full(len(cells), level), np.full(len(cells), CELL)], axis=-1)
    words = philox4x32(counter, (seed & 0xFFFFFFFF, seed >> 32))
    return np.asarray((words[:, 0] >> 8)[cell] / 2.0**24)
