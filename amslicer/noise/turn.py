"""Isotropy: turns each kernel's painted normal by a random angle that neighbours share.

With w(x) = Σ_m γ_m g_m(x) / √(Σ_m g_m(x)²), g_m(x) = exp(-π b_f² |x - y_m|²), over hashed points y_m with
γ_m ~ N(0, 1) and b_f = b/2, w is exactly N(0, 1) at every x and changes over about two envelopes' widths:

    2D:  n' = R(δ) n,  δ = s·90°·(2Φ(w) - 1)                                  uniform in ±90° s
    3D:  w⊥ = w - (w·n)n,  U = 1 - exp(-|w⊥|²/2),  cos β = 1 - U(1 - cos(s·90°)),
         n' = cos β n + sin β (w⊥/|w⊥|) × n                                   uniform in the cap of half-angle 90° s

Both are odd under n -> -n and need no frame. s = 0 leaves the laminate as it is, s = 1 is isotropic: the paper's sum of
random directions (Tricard et al. 2019, 3.2.2) concentrates as its density grows instead. Since b may vary, w is blended
from dyadic widths b_l = 2^l <= b_f < 2 b_l: √(1-α) w_l + √α w_{l+1} is N(0, 1) too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer.noise.kernels import TURN_PLACES, TURN_WEIGHTS, WORD

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.kernels import Generator

    Floats = NDArray[np.float64]

WIDTH_SHARE = 0.5  # b_f/b: directions agree over about two envelopes
PER_CELL = 4  # points in a cell of side 1/b_l: dense enough that no place is without points
REACH_CELLS = 2  # cl/normal_fields.cl: points further than this many cells count for nothing (exp(-4π) = 3e-6)
LEVEL_BITS = 0xFF  # of the counter's number: levels -128 … 127, from 1e-38 to 1e38 per mm


def turned(
    normal: Floats, isotropy: Floats, place: Floats, width: Floats, dimensions: int, seed: int, draw: Generator
) -> Floats:
    """Directions of kernels: their painted normals, turned as isotropy says.

    Args:
        normal: (N, 3) unit normals.
        isotropy: (N,) s, 0…1.
        place: (N, 3) centres, mm.
        width: (N,) b of their envelopes, 1/mm.
        dimensions: 2 or 3.

    Returns:
        (N, 3) unit vectors, exactly `normal` where s is 0.
    """
    out = normal.copy()
    some = np.flatnonzero(isotropy > 0)
    if len(some):
        w = _normal_fields(place[some], WIDTH_SHARE * width[some], dimensions, seed, draw)
        turn = _turn_flat if dimensions == 2 else _turn_in_space
        out[some] = turn(normal[some], isotropy[some], w)
    return out


def _turn_flat(normal: Floats, isotropy: Floats, w: Floats) -> Floats:
    from scipy.special import ndtr

    delta = isotropy * (np.pi / 2) * (2 * ndtr(w[:, 0]) - 1)
    x, y = normal[:, 0], normal[:, 1]
    cosine, sine = np.cos(delta), np.sin(delta)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, np.zeros_like(x)], axis=-1)


def _turn_in_space(normal: Floats, isotropy: Floats, w: Floats) -> Floats:
    across = w - np.einsum("ni,ni->n", w, normal)[:, None] * normal
    squared = np.einsum("ni,ni->n", across, across)
    share = -np.expm1(-squared / 2)
    cosine = 1 - share * (1 - np.cos(isotropy * (np.pi / 2)))
    sine = np.sqrt(np.maximum(0.0, 1 - cosine**2))
    axis = across / np.sqrt(np.where(squared > 0, squared, 1.0))[:, None]
    turned = cosine[:, None] * normal + sine[:, None] * np.cross(axis, normal)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _normal_fields(place: Floats, width: Floats, dimensions: int, seed: int, draw: Generator) -> Floats:
    """(N, 3) independent fields, N(0, 1) at each place."""
    octave = np.log2(width)
    level = np.floor(octave).astype(int)
    alpha = octave - level
    out = np.zeros((len(place), 3))
    for upper, share in ((0, np.sqrt(1 - alpha)), (1, np.sqrt(alpha))):
        for number in np.unique(level):
            here = np.flatnonzero((level == number) & (share > 0))
            if len(here):
                out[here] += share[here, None] * _level(place[here], int(number) + upper, dimensions, seed, draw)
    return out


def _level(place: Floats, level: int, dimensions: int, seed: int, draw: Generator) -> Floats:
    """(N, 3) fields of the width 2^level per mm."""
    inside = place * 2.0**level
    cell = np.floor(inside).astype(np.int64)
    inside -= cell
    beyond = np.array([REACH_CELLS, REACH_CELLS, REACH_CELLS if dimensions == 3 else 0])
    first = cell.min(axis=0) - beyond
    x, y, z = (int(n) for n in cell.max(axis=0) + beyond + 1 - first)
    box = (int(first[0]), int(first[1]), int(first[2])), (x, y, z), PER_CELL, seed
    offset = (level & LEVEL_BITS) << 8
    points = (draw.words(*box, TURN_PLACES + offset)[..., :3] * WORD).astype(np.float32)
    if dimensions == 2:
        points[..., 2] = 0.0
        inside[:, 2] = 0.0
    weights = _normal_numbers(draw.words(*box, TURN_WEIGHTS + offset))
    return draw.normal_fields(inside, cell - first, points, weights)[:, :3].astype(np.float64)


def _normal_numbers(words: NDArray[np.uint32]) -> NDArray[np.float32]:
    """(…, 4) N(0, 1) numbers of (…, 4) random words (Box and Muller 1958)."""
    radius = np.sqrt(-2 * np.log((words[..., :2] + 0.5) * WORD))
    angle = words[..., 2:] * (WORD * 2 * np.pi)
    return np.concatenate([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).astype(np.float32)
