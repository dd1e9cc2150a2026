"""The painted direction of the laminate's normal, as unit vectors.

A laminate's normal is a line, not an arrow: n and -n are the same laminate. Samples of a picture are
therefore combined as lines: angles in the plane through the doubled angle, normals in space through n nᵀ.
Constants and gradients are plain numbers until they become a direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.source import Sampler

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Orientation:
    """Azimuth from +x towards +y and elevation above the xy plane, both fields in degrees.

    Attributes:
        elevation: None in the plane.
    """

    azimuth: Sampler
    elevation: Sampler | None = None

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""
        azimuths, weights = self.azimuth.taps(x, y, z)
        if self.elevation is None:
            return _flat(_line_angle(azimuths, weights))
        elevations, elevation_weights = self.elevation.taps(x, y, z)
        if len(azimuths) > 1 and self.azimuth.texels == self.elevation.texels:
            return _line_mean(_unit(azimuths, elevations), weights)
        samples = _unit(azimuths[:, None], elevations[None, :])
        both = weights[:, None] * elevation_weights[None, :]
        return _line_mean(samples.reshape(-1, *samples.shape[2:]), both.reshape(-1, both.shape[-1]))


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
    mean = np.linalg.eigh(tensor)[1][:, :, -1]
    sign = np.where(np.einsum("ni,ni->n", mean, heaviest) < 0, -1.0, 1.0)
    result: Floats = np.where(agree[:, None], heaviest, mean * sign[:, None])
    return result
