"""What noises draw, in plain NumPy on the host: amslicer.noise.kernels.Generator without a device.

Numbers are those that the device draws (float64 where it has float32), so that what is made of them before any device
is open, the part's own shape among it, is the same on all devices.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from amslicer.noise import philox

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.alignment import Neighbours

    Floats = NDArray[np.float64]

REACH = 2  # cells on each side of a place whose points count, and the squared distance up to which they do:
CUT = 4.0  # as cl/normal_fields.cl
PLACES_AT_ONCE = 1 << 16


class HostGenerator:
    """amslicer.noise.kernels.Generator."""

    def words(
        self, first: tuple[int, int, int], count: tuple[int, int, int], per_cell: int, seed: int, number: int
    ) -> NDArray[np.uint32]:
        """(cells z, cells y, cells x, per_cell, 4) random words of a box of cells."""
        x, y, z = (low + np.arange(n) for low, n in zip(first, count, strict=True))
        return philox.words(
            x[None, None, :, None], y[None, :, None, None], z[:, None, None, None],
            (number + np.arange(per_cell))[None, None, None, :], seed=seed,
        )  # fmt: skip

    def normal_fields(
        self, places: Floats, cells: NDArray[np.int64], points: NDArray[np.float32], weights: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """(N, 4) fields that are N(0, 1) at each place."""
        out = np.empty((len(places), 4), np.float32)
        upwards = range(-REACH, REACH + 1) if len(points) > 1 else range(1)
        across = range(-REACH, REACH + 1)
        for first in range(0, len(places), PLACES_AT_ONCE):
            some = slice(first, first + PLACES_AT_ONCE)
            place, cell = places[some, None], cells[some]
            total, power = np.zeros((len(cell), 4)), np.zeros(len(cell))
            for z, y, x in product(upwards, across, across):
                near = cell[:, 2] + z, cell[:, 1] + y, cell[:, 0] + x
                d = points[near] + (float(x), float(y), float(z)) - place
                squared = np.einsum("nmi,nmi->nm", d, d)
                g = np.where(squared < CUT, np.exp(-np.pi * squared), 0.0)
                total += np.einsum("nm,nmi->ni", g, weights[near])
                power += np.einsum("nm,nm->n", g, g)
            out[some] = total / np.sqrt(power)[:, None]
        return out

    def aligned(
        self, neighbours: Neighbours, z: NDArray[np.complex64], known: NDArray[np.bool_], sweeps: int
    ) -> NDArray[np.complex64]:
        """exp(iφ) of kernels after phase alignment: as amslicer/noise/alignment.py, cl/sweep.cl."""
        from scipy.sparse import csr_array

        i, j, overlap, same = _overlaps(neighbours)
        shape = len(z), len(z)
        alike, opposite = (csr_array((overlap[s], (i[s], j[s])), shape=shape) for s in (same, ~same))
        own = z.astype(np.complex128)
        for number in range(sweeps + 1):
            giving = np.where(known, own, 0) if number == 0 else own
            total = np.asarray(alike @ giving + opposite @ giving.conj()) + (0 if number == 0 else own)
            size = np.abs(total)
            new = np.where(size > 0, total / np.where(size > 0, size, 1.0), own)
            own = np.where(known, own, new) if number == 0 else new
        return own.astype(np.complex64)


def _overlaps(n: Neighbours) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.complex128], NDArray[np.bool_]]:
    """Kernels i, their neighbours j, w exp(iθ) of each pair, and whether their normals point the same way."""
    from scipy.spatial import cKDTree

    place, squared = n.places[:, :3].astype(np.float64), n.places[:, 3].astype(np.float64)
    wave, normal = n.waves[:, :3].astype(np.float64), n.normals[:, :3].astype(np.float64)
    pairs = cKDTree(place).query_pairs(float(n.reaches.max()), output_type="ndarray").astype(np.int64)
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    same = np.einsum("ni,ni->n", normal[i], normal[j]) >= 0
    d, other = place[i] - place[j], np.where(same, 1.0, -1.0)[:, None] * wave[j]
    total, both = squared[i] + squared[j], squared[i] * squared[j]
    apart = wave[i] - other
    far = np.pi * both * np.einsum("ni,ni->n", d, d) + np.einsum("ni,ni->n", apart, apart) / (4 * np.pi)
    size = n.dimensions / 4 * np.log(4 * both / total**2) - far / total
    angle = np.einsum("ni,ni->n", squared[i, None] * other + squared[j, None] * wave[i], d) / total
    kept = np.flatnonzero(size > n.least)
    return i[kept], j[kept], np.exp(size[kept] + 1j * angle[kept]), same[kept]
