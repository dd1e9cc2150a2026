"""Several directions at a place: each kernel takes one of the lobes, its painted normal turned by the lobe's angle.

A noise whose kernels have several directions is a sum of noises of one direction each (Tricard et al. 2019, 3.2.1). A
lobe's weight is its share of the kernels, and so of the power.

The phase of the sum depends on which way each direction points: the spectrum of variance of the phasor sine has
Gaussians at ±(u_k + u_m), those at ±(u_k - u_m) are gone; with one direction reversed – the dual form – it is the other
way round. So directions are reversed such that the smallest u_k·u_m is as large as it can be: of two lobes never below
0, and nothing comes near the middle of the spectrum.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST = 8  # lobes: 2^7 ways to point
NORMALS_AT_ONCE = 1 << 14
TIED = 1e-9  # ways to point that are as good as each other: the first is taken, so that rounding decides nothing


@dataclass(frozen=True, eq=False)
class Lobes:
    """Relative directions and their weights.

    Attributes:
        turns: (L, 3, 3) rotations of the painted normal.
        shares: (L,) of the kernels, which sum to 1.
    """

    turns: Floats
    shares: Floats

    def directions(self, normal: Floats, choice: Floats) -> Floats:
        """(N, 3) directions of kernels.

        Args:
            normal: (N, 3) painted normals.
            choice: (N,) random numbers, 0 <= choice < 1.
        """
        lobe = np.searchsorted(np.cumsum(self.shares)[:-1], choice, side="right")
        out = np.einsum("nij,nj->ni", self.turns[lobe], normal)
        return np.asarray(out * np.take_along_axis(self._signs(normal), lobe[:, None], axis=1))

    def all_directions(self, normal: Floats) -> Floats:
        """(N, L, 3) directions of all lobes at places with these (N, 3) painted normals, as they point."""
        return np.asarray(np.einsum("lij,nj->nli", self.turns, normal) * self._signs(normal)[..., None])

    def _signs(self, normal: Floats) -> Floats:
        """(N, L) ±1: which way each lobe points."""
        count = len(self.shares)
        ways = np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=count - 1)])
        out = np.empty((len(normal), count))
        for first in range(0, len(normal), NORMALS_AT_ONCE):
            turned = np.einsum("lij,nj->nli", self.turns, normal[first : first + NORMALS_AT_ONCE])
            cosine = np.einsum("nli,nmi->nlm", turned, turned)
            least = np.stack([(cosine * (way[:, None] * way)).min(axis=(1, 2)) for way in ways], axis=-1)
            best = np.argmax(least >= least.max(axis=1, keepdims=True) - TIED, axis=1)
            out[first : first + NORMALS_AT_ONCE] = ways[best]
        return out


def make_lobes(angles_rad: Floats, axes: Floats, weights: Floats) -> Lobes:
    """Lobes by their angles about (L, 3) unit axes, and their weights > 0."""
    x, y, z = np.moveaxis(axes, -1, 0)
    none = np.zeros_like(x)
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(-1, 3, 3)
    sine, cosine = (f(angles_rad)[:, None, None] for f in (np.sin, np.cos))
    turns = np.eye(3) + sine * cross + (1 - cosine) * cross @ cross  # Rodrigues
    return Lobes(turns, weights / weights.sum())
