"""Symmetric tensors of a field: components xx, yy, zz, xy, yz, xz to principal directions and numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer.fields.orientation import TENSOR, principal_lines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

ISOTROPIC = 1e-9  # of a tensor's size: what rounding leaves between equal eigenvalues


def matrices(tensors: Floats) -> Floats:
    """(N, 3, 3) of (N, 6) symmetric tensors."""
    matrix = np.empty((len(tensors), 3, 3))
    for k, (i, j) in enumerate(TENSOR):
        matrix[:, i, j] = matrix[:, j, i] = tensors[:, k]
    return matrix


def von_mises(stress: Floats) -> Floats:
    """(N,) von Mises stress of (N, 6) stress tensors: √(3/2) of the deviator's norm."""
    xx, yy, zz, xy, yz, xz = np.moveaxis(stress, -1, 0)
    shear = xy**2 + yz**2 + xz**2
    return np.asarray(np.sqrt(((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2 + 3 * shear))


def eigenlines(tensors: Floats, which: int) -> Floats:
    """(N, 3) unit eigenvectors of (N, 6) tensors, as `principal_lines`; 0 where a tensor has no direction."""
    mean = tensors[:, :3].mean(axis=1, keepdims=True)
    deviator = np.abs(np.column_stack([tensors[:, :3] - mean, tensors[:, 3:]])).max(axis=1)
    directed = deviator > ISOTROPIC * np.abs(tensors).max(axis=1)
    lines: Floats = np.where(directed[:, None], principal_lines(tensors, which), 0.0)
    return lines
