"""Fields that take one of several others at each place, as `where` and `per_body` do: nothing is averaged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.orientation import Orientation
    from amslicer.fields.source import Sampler

    Floats = NDArray[np.float64]
    Axes = tuple[bool, bool, bool]
    Which = Callable[[Floats, Floats, Floats], NDArray[Any]]


def along_any(*axes: Axes) -> Axes:
    """Along which axes any of several things varies."""
    x, y, z = (any(along) for along in zip(*axes, strict=True))
    return x, y, z


@dataclass(frozen=True, eq=False)
class ChoiceSampler:
    """One of several scalar fields at each place.

    Attributes:
        samplers: two or more.
        which: number of the field at places; whole numbers or booleans that broadcast with the coordinates.
        choice_varies: axes along which the number changes.
    """

    samplers: Sequence[Sampler]
    which: Which
    choice_varies: Axes
    texels: None = None

    @property
    def varies(self) -> Axes:
        """Along the axes of the choice, and of any of the fields."""
        return along_any(self.choice_varies, *(sampler.varies for sampler in self.samplers))

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Of all of the fields."""
        lows, highs = zip(*(sampler.bounds for sampler in self.samplers), strict=True)
        return min(lows), max(highs)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points; fields that none of them takes are not asked."""
        number = np.asarray(self.which(x, y, z))
        first, *others = _used(number)
        values = self.samplers[first].scalar(x, y, z)
        for k in others:
            values = np.where(number == k, self.samplers[k].scalar(x, y, z), values)
        return values

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The samples behind the field that each point takes."""
        number = np.asarray(self.which(x, y, z))
        first, *others = _used(number)
        samples, weights = self.samplers[first].taps(x, y, z)
        for k in others:
            own = self.samplers[k].taps(x, y, z)
            count = max(len(weights), len(own[1]))
            samples, weights = (
                np.where(number == k, *pair)
                for pair in zip(_padded(own, count), _padded((samples, weights), count), strict=True)
            )
        return samples, weights


@dataclass(frozen=True, eq=False)
class ChoiceOfLines:
    """One of several directions at each place; the attributes are those of a ChoiceSampler."""

    orientations: Sequence[Orientation]
    which: Which
    choice_varies: Axes

    @property
    def varies(self) -> Axes:
        """Along the axes of the choice, and of any of the directions."""
        return along_any(self.choice_varies, *(orientation.varies for orientation in self.orientations))

    @property
    def turns(self) -> bool:
        """Whether any of them turns, or they are not the same."""
        return not all_equal(self.orientations)

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""
        number = np.broadcast_to(np.asarray(self.which(x, y, z)), x.shape)
        first, *others = _used(number)
        normals = self.orientations[first].normals(x, y, z)
        for k in others:
            normals = np.where((number == k)[:, None], self.orientations[k].normals(x, y, z), normals)
        return normals


def all_equal(orientations: Sequence[Orientation]) -> bool:
    """Whether none of several directions turns, and all are the same."""
    if any(orientation.turns for orientation in orientations):
        return False
    at = np.zeros(1)
    first, *others = (orientation.normals(at, at, at) for orientation in orientations)
    return all(np.array_equal(first, other) for other in others)


def _used(number: NDArray[Any]) -> list[int]:
    """Which numbers occur; the first one where there are no places."""
    return [int(k) for k in np.flatnonzero(np.bincount(number.ravel().astype(np.int64)))] or [0]


def _padded(taps: tuple[Floats, Floats], count: int) -> tuple[Floats, Floats]:
    """(count, N) samples and weights: the first sample again, with no weight, so that equal samples stay equal."""
    samples, weights = taps
    more = count - len(weights)
    if not more:
        return taps
    return np.concatenate([samples, np.repeat(samples[:1], more, axis=0)]), np.pad(weights, ((0, more), (0, 0)))
