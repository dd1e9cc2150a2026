"""The painted direction of the laminate's normal, as unit vectors.

A laminate's normal is a line, not an arrow: n and -n are the same laminate. Samples of a picture are
therefore combined as lines: angles in the plane through the doubled angle, normals in space through n nᵀ.
Constants, gradients and expressions are plain numbers until they become a direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.source import Sampler

    Floats = NDArray[np.float64]

POWER_STEPS = 4
SETTLED, LARGEST = 1e-15, 0.75  # a residual of rounding alone; more than half of the trace: there is no larger one


class Orientation(Protocol):
    """A field of directions.

    Attributes:
        varies: whether the direction depends on x, y, z (field frame).
        turns: whether it is not the same everywhere.
    """

    @property
    def varies(self) -> tuple[bool, bool, bool]: ...

    @property
    def turns(self) -> bool: ...

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""


class OfSamplers:
    """Directions made of scalar fields: they vary and turn where one of these does."""

    @property
    def samplers(self) -> tuple[Sampler, ...]:
        """The scalar fields."""
        raise NotImplementedError

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the axes that any of the fields varies along."""
        x, y, z = (any(sampler.varies[axis] for sampler in self.samplers) for axis in range(3))
        return x, y, z

    @property
    def turns(self) -> bool:
        """Whether the bounds of any of the fields are apart."""
        return any(low != high for low, high in (sampler.bounds for sampler in self.samplers))


@dataclass(frozen=True)
class Angles(OfSamplers):
    """Azimuth from +x towards +y and elevation above the xy plane, both fields in degrees.

    Attributes:
        elevation: None in the plane.
    """

    azimuth: Sampler
    elevation: Sampler | None = None

    @property
    def samplers(self) -> tuple[Sampler, ...]:
        """One or two angles."""
        return (self.azimuth,) if self.elevation is None else (self.azimuth, self.elevation)

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""
        if self.elevation is None:
            return _flat(_line_angle(*self.azimuth.taps(x, y, z)))
        (azimuths, elevations), weights = joint_taps((self.azimuth, self.elevation), x, y, z)
        return _line_mean(_unit(azimuths, elevations), weights)


@dataclass(frozen=True)
class Vector(OfSamplers):
    """Three components along the file's axes, of any length; where all are 0, the direction is +x."""

    components: tuple[Sampler, Sampler, Sampler]

    @property
    def samplers(self) -> tuple[Sampler, ...]:
        """The three components."""
        return self.components

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""
        values, weights = joint_taps(self.components, x, y, z)
        vectors = np.stack(values, axis=-1)
        return _line_mean(unit_vectors(vectors), weights)


@dataclass(frozen=True, eq=False)
class Lines:
    """Directions by a function of the place, which has seen to it that lines are never averaged as numbers.

    Attributes:
        function: (N, 3) vectors along the file's axes, of any length, at (N,) field-frame coordinates; where one is 0,
            the direction is +x. Their sign means nothing.
        varies: whether they depend on x, y, z.
    """

    function: Callable[[Floats, Floats, Floats], Floats]
    varies: tuple[bool, bool, bool] = (True, True, True)

    @property
    def turns(self) -> bool:
        """Wherever they may vary."""
        return any(self.varies)

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""
        return unit_vectors(self.function(x, y, z))


def unit_vectors(vectors: Floats) -> Floats:
    """(…, 3) of length 1, of vectors of any length; +x for those of none."""
    # The largest component first: the length of (1e-200, 0, 0) is not 0, that of (1e200, 0, 0) not infinite.
    largest = np.abs(vectors).max(axis=-1, keepdims=True)
    zero = largest == 0
    scaled = np.where(zero, (1.0, 0.0, 0.0), vectors / np.where(zero, 1.0, largest))
    unit: Floats = scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)
    return unit


# Components of a symmetric tensor, as arrays of six hold them.
TENSOR = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def tensors_of(vectors: Floats) -> Floats:
    """(N, 6) components xx, yy, zz, xy, yz, xz of n nᵀ for (N, 3) unit vectors: lines that may be averaged."""
    return np.stack([vectors[..., i] * vectors[..., j] for i, j in TENSOR], axis=-1)


def principal_lines(tensors: Floats, which: int = 1) -> Floats:
    """(N, 3) unit eigenvectors of (N, 6) symmetric tensors xx, yy, zz, xy, yz, xz.

    Args:
        which: 1: of the largest eigenvalue, 2: of the middle one, 3: of the smallest.
    """
    matrix = np.empty((*tensors.shape[:-1], 3, 3))
    for k, (i, j) in enumerate(TENSOR):
        matrix[..., i, j] = matrix[..., j, i] = tensors[..., k]
    found: Floats = np.linalg.eigh(matrix)[1][..., :, 3 - which]
    return found


def joint_taps(samplers: Sequence[Sampler], x: Floats, y: Floats, z: Floats) -> tuple[list[Floats], Floats]:
    """Samples of several fields, combined: K tuples of values behind each point, and their weights.

    Fields with the same texels are combined texel by texel, others each sample of one with each of the other.

    Returns:
        Per field (K, N) values; (K, N) weights.
    """
    values: list[Floats] = []
    weights: Floats = np.ones((1, len(x)))
    grids: list[tuple[object, int, int]] = []  # texels, and which axis of the samples they are: stride and count
    for sampler in samplers:
        own, own_weights = sampler.taps(x, y, z)
        known = next((grid for grid in grids if grid[0] is not None and grid[0] == sampler.texels), None)
        total = len(weights)
        if known:
            stride, count = known[1:]
            values.append(own[np.arange(total) // stride % count])
            continue
        count = len(own)
        values = [np.repeat(v, count, axis=0) for v in values]
        grids = [(texels, stride * count, n) for texels, stride, n in grids]
        grids.append((sampler.texels, 1, count))
        weights = np.repeat(weights, count, axis=0) * np.tile(own_weights, (total, 1))
        values.append(np.tile(own, (total, 1)))
    return values, weights


def _line_angle(angles_deg: Floats, weights: Floats) -> Floats:
    """Mean of (K, N) angles as lines, radians; where all samples agree, their own value and sign."""
    doubled = np.deg2rad(2 * angles_deg)
    mean = 0.5 * np.arctan2((weights * np.sin(doubled)).sum(axis=0), (weights * np.cos(doubled)).sum(axis=0))
    agree = np.all(angles_deg == angles_deg[0], axis=0)
    result: Floats = np.where(agree, np.deg2rad(angles_deg[0]), mean)
    return result


def _flat(angle_rad: Floats) -> Floats:
    return np.stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)], axis=-1)


def _unit(azimuth_deg: Floats, elevation_deg: Floats) -> Floats:
    azimuth, elevation = np.broadcast_arrays(np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


def _line_mean(normals: Floats, weights: Floats) -> Floats:
    """Mean of (K, N, 3) normals as lines: the largest eigenvector of Σ w n nᵀ, with the heaviest sample's sign."""
    heaviest: Floats = normals[np.argmax(weights, axis=0), np.arange(normals.shape[1])]
    agree = np.all(normals == normals[0], axis=(0, 2))
    if agree.all():
        return heaviest
    tensor = np.einsum("kn,kni,knj->nij", weights, normals, normals)
    mean = _largest_eigenvectors(tensor, heaviest)
    sign = np.where(np.einsum("ni,ni->n", mean, heaviest) < 0, -1.0, 1.0)
    result: Floats = np.where(agree[:, None], heaviest, mean * sign[:, None])
    return result


def _largest_eigenvectors(tensor: Floats, guess: Floats) -> Floats:
    """(N, 3) of (N, 3, 3) symmetric tensors of trace 1, from a guess.

    Samples that nearly agree leave the other eigenvalues tiny, so a few products with the tensor are as good as a
    decomposition, and quicker; what they do not settle is decomposed.
    """
    found = guess
    for _ in range(POWER_STEPS):
        found = np.einsum("nij,nj->ni", tensor, found)
        found = found / np.maximum(np.sqrt(np.einsum("ni,ni->n", found, found)), np.finfo(float).tiny)[:, None]
    product = np.einsum("nij,nj->ni", tensor, found)
    value = np.einsum("ni,ni->n", product, found)
    off = np.abs(product - value[:, None] * found).max(axis=1)
    open_ = np.flatnonzero((off > SETTLED) | (value < LARGEST))
    if len(open_):
        found[open_] = np.linalg.eigh(tensor[open_])[1][:, :, -1]
    return np.asarray(found)
