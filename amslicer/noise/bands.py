"""The frequencies of band-limited noises, as a lattice needs them: their covariance along an axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PERIODS = 5  # that a covariance averages over, of a graded period
LINES = 40  # of a spectrum, at most


@dataclass(frozen=True)
class Band:
    """Kernels' waves of the period as wide as Gaussians of the bandwidth make them.

    Attributes:
        periods_mm: the finest and the coarsest period of the job.
        bandwidth: relative to 1/period.
    """

    periods_mm: tuple[float, float]
    bandwidth: float

    def covariance(self, distance_mm: Floats, cosines: Floats, *, finest: bool = False) -> Floats:
        """Of G along an axis: the mean over periods and directions of cos(2π d c/p) exp(-π b² d²/2).

        Args:
            distance_mm: any shape.
            cosines: between axis and waves.
            finest: of the finest period alone.
        """
        d = distance_mm[..., None, None] / averaged(self.periods_mm, finest=finest)[:, None]
        waves = np.cos(2 * np.pi * d * cosines) * np.exp(-np.pi / 2 * (self.bandwidth * d) ** 2)
        return np.asarray(waves.mean(axis=(-1, -2)))


class TabledBand:
    """Waves of any frequencies.

    Args:
        frequency: (L,) 1/mm, at the finest period.
        power: (L,) of each.
        periods_mm: the finest and the coarsest; frequencies go with 1/period.
    """

    def __init__(self, frequency: Floats, power: Floats, periods_mm: tuple[float, float]) -> None:
        starts = np.unique(np.linspace(0, len(frequency), LINES, endpoint=False).astype(int))
        self._power = np.add.reduceat(power, starts) / power.sum()
        moment = np.add.reduceat(power * frequency, starts) / power.sum()
        # A line's highest frequency stands for it: a lattice that serves it serves the others.
        highest = np.maximum.reduceat(np.where(power > 0, frequency, 0.0), starts)
        self._frequency = np.maximum(highest, moment / np.where(self._power > 0, self._power, 1.0))
        self._periods_mm = periods_mm

    def covariance(self, distance_mm: Floats, cosines: Floats, *, finest: bool = False) -> Floats:
        """As of Band: Σ power cos(2π d c f)."""
        shrink = self._periods_mm[0] / averaged(self._periods_mm, finest=finest)
        angles = 2 * np.pi * distance_mm[..., None, None] * shrink[:, None] * cosines
        total = np.zeros(distance_mm.shape)
        for frequency, power in zip(self._frequency, self._power, strict=True):
            total += power * np.cos(angles * frequency).mean(axis=(-1, -2))
        return total


def averaged(periods_mm: tuple[float, float], *, finest: bool) -> Floats:
    """The periods that stand for all between two."""
    shortest, longest = periods_mm
    return np.array([shortest]) if finest or shortest == longest else np.geomspace(shortest, longest, PERIODS)
