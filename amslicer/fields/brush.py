"""Paints strokes of a brush on places: how far they are from the paths, how much they get, and of what."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError
from amslicer.fields.orientation import tensors_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

SMOOTH = 1e-3  # of the radius, or of the values' range: how far a path that is drawn with fewer places may be from it
# Combing: paths nearer than the nearest one and this share of the radius count, less the farther they are. At half,
# a path's own corner (a square's diagonal is 0.41 farther than its sides) decides wherever two sides would draw.
CLOSENESS = 0.5
BLOCK_COLUMNS, MOST_BLOCKS = 96, 32  # of nodes along x: more than most brushes reach, few beside them
# Seconds for a segment in a block of nodes and for each node in its box, measured; combing looks again, at a wider
# box and at corners too.
SEGMENT_SECONDS, NODE_SECONDS, COMBED_TIMES = 2e-4, 4e-8, 7.0
STEEP = 1e-6  # sine from the vertical below which a path has no direction across


@dataclass(frozen=True, eq=False)
class Brush:
    """One stroke.

    Attributes:
        name: for messages.
        places: (N, 3) of its path, mm.
        flat: whether it is alike at every height; z is then 0.
        radii: (N,) mm.
        falloff: share of the radius over which it fades, 0…1.
        values: (N,) at the places of its path; None where it has none.
    """

    name: str
    places: Floats
    flat: bool
    radii: Floats
    falloff: float
    values: Floats | None

    def moved(self, minimum_mm: Floats) -> Brush:
        """In the field frame, from file coordinates."""
        return replace(self, places=self.places - (minimum_mm * (1.0, 1.0, 0.0) if self.flat else minimum_mm))

    @property
    def axes(self) -> range:
        """The axes along which it changes."""
        return range(2 if self.flat else 3)

    @property
    def segments(self) -> tuple[Indices, Indices]:
        """First and last place of each segment; a dab has one, without length."""
        last = np.arange(1, len(self.places)) if len(self.places) > 1 else np.array([0])
        return np.maximum(last - 1, 0), last

    def reaches(self, size_mm: Floats) -> bool:
        """Whether its box and the part's overlap."""
        a = list(self.axes)
        low, high = (self.places[:, a] - self.radii[:, None]).min(0), (self.places[:, a] + self.radii[:, None]).max(0)
        return bool(np.all(low <= size_mm[a]) and np.all(high >= 0))

    def covers(self, size_mm: Floats) -> bool:
        """Whether one segment's inner part holds the part's box: it does where it holds the box's corners."""
        corners = np.stack(np.meshgrid(*([0.0, float(side)] for side in size_mm), indexing="ij"), axis=-1).reshape(
            -1, 3
        )
        first, last = self.segments
        inner = np.minimum(self.radii[first], self.radii[last]) * (1 - self.falloff)
        farthest = np.zeros(len(first))
        for corner in corners:
            _, squares = self._closest(corner[None], first, last)
            farthest = np.maximum(farthest, squares[0])
        return bool(np.any(farthest <= inner**2))

    def plain(self, size_mm: Floats) -> float | None:
        """The value with which it covers the part, if it has only that one."""
        if self.values is None or np.any(self.values != self.values[0]) or not self.covers(size_mm):
            return None
        return float(self.values[0])

    def check_direction(self, across: bool) -> None:
        """That it has one to be combed in.

        Raises:
            JobError: its path has no length; or, across it, is upright.
        """
        steps = np.diff(self.places, axis=0)
        if not np.any(steps):
            raise JobError(f"{self.name} has no length, and no direction to be combed in", hint="give it two places")
        if across and not np.any(_across(_units(steps))):
            raise JobError(
                f"{self.name} is upright, and across it in the xy plane is every direction", hint="take comb: along"
            )

    def _closest(self, asked: Floats, first: Indices, last: Indices) -> tuple[Floats, Floats]:
        """(M, S) where on each segment, 0…1, is the place nearest to each of (M, 3) places; the squared distance."""
        start, step = self.places[first], self.places[last] - self.places[first]
        squared = (step[:, self.axes] ** 2).sum(axis=1)
        inverse = 1.0 / np.where(squared > 0, squared, 1.0)
        offsets = [asked[:, axis, None] - start[:, axis] for axis in self.axes]
        along = offsets[0] * (step[:, 0] * inverse)
        for axis in self.axes[1:]:
            along += offsets[axis] * (step[:, axis] * inverse)
        along = np.clip(along, 0.0, 1.0, out=along)
        squares = np.zeros_like(along)
        for axis in self.axes:
            away = offsets[axis]
            away -= along * step[:, axis]
            away *= away
            squares += away
        return along, squares

    def nearness(self, asked: Floats, first: Indices, last: Indices) -> tuple[Floats, Floats]:
        """(M, S) place on each segment, 0…1, and distance over radius there."""
        along, squares = self._closest(asked, first, last)
        distance = np.sqrt(squares, out=squares)
        distance /= self.radii[first] + along * (self.radii[last] - self.radii[first])
        return along, distance

    def simpler(self) -> Brush:
        """The same stroke, but for SMOOTH, by fewer places: scribbles come with many.

        Blocks of 2, 4, 8, … segments become one where each of their places is near the one that takes its part of
        the length.
        """
        lengths = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        place = np.concatenate([[0.0], np.cumsum(lengths)])
        near = SMOOTH * self.radii.min()
        columns, limits = [*self.places.T, self.radii], [near] * 4
        if self.values is not None:
            columns, limits = [*columns, self.values], [*limits, SMOOTH * float(np.ptp(self.values))]
        kept = np.arange(len(self.places))
        tolerance, table = np.array(limits), np.stack(columns, axis=1)
        block, joined = 2, np.ones(len(lengths), bool)
        while block <= len(lengths) and joined.any():
            count = len(lengths) // block
            start = np.arange(count) * block
            inner = start[:, None] + np.arange(1, block)
            whole = (place[start + block] - place[start])[:, None]
            share = (place[inner] - place[start, None]) / np.where(whole > 0, whole, 1.0)
            chord = table[start, None] + share[..., None] * (table[start + block] - table[start])[:, None]
            halves = joined[: 2 * count : 2] & joined[1 : 2 * count : 2]
            joined = halves & np.all(np.abs(table[inner] - chord) <= tolerance, axis=(1, 2))
            kept = np.setdiff1d(kept, inner[joined], assume_unique=False)
            block *= 2
        values = None if self.values is None else self.values[kept]
        return replace(self, places=self.places[kept], radii=self.radii[kept], values=values)


@dataclass(frozen=True, eq=False)
class Painting:
    """Strokes over each other.

    Attributes:
        brushes: the lowest first.
        channels: per brush (N, C) what it paints at the places of its path.
        base: (C,) where nothing is painted.
        comb: paint n nᵀ of the path's direction, along or across, instead.
    """

    brushes: Sequence[Brush]
    channels: Sequence[Floats]
    base: Floats
    comb: str | None = None

    @cached_property
    def _boxes(self) -> tuple[Floats, Floats]:
        """(strokes, 3) lowest and highest corner of what each reaches."""
        boxes = [_box(brush, *brush.segments, 0.0) for brush in self.brushes]
        return np.array([low.min(axis=0) for low, _ in boxes]), np.array([high.max(axis=0) for _, high in boxes])

    def at(self, places: Floats) -> Floats:
        """(M, C) what is painted at (M, 3) places."""
        out = np.empty((len(places), len(self.base)))
        # In blocks along x: within one, segments are looked up by y alone.
        blocks = int(np.clip(np.sqrt(len(places)) / BLOCK_COLUMNS, 1, MOST_BLOCKS))
        for block in np.array_split(np.argsort(places[:, 0], kind="stable"), blocks):
            order = block[np.argsort(places[block, 1], kind="stable")]
            asked = np.asfortranarray(places[order])
            painted = np.tile(self.base, (len(order), 1))
            for i, rows in _met(*self._boxes, asked):
                _stroke(asked[rows], painted[rows], self.brushes[i], self.channels[i], self.comb)
            out[order] = painted
        return out

    def seconds(self, size_mm: Floats, spacing_mm: float) -> float:
        """About how long it takes to paint the nodes of a box, so many mm apart."""
        total = 0.0
        for brush in self.brushes:
            first, last = brush.segments
            low, high = _box(brush, first, last, 0.0)
            low, high = np.clip(low, 0.0, size_mm), np.clip(high, 0.0, size_mm)
            rows = np.where((high > low) | (size_mm == 0), (high - low) / spacing_mm + 1, 0.0)
            planes = (rows[:, 2] if not brush.flat else np.ones(len(rows))) * (rows[:, 0] > 0) * (rows[:, 1] > 0)
            blocks = 1 + rows[:, 0] / BLOCK_COLUMNS
            total += float((planes * (SEGMENT_SECONDS * blocks + NODE_SECONDS * rows[:, 0] * rows[:, 1])).sum())
        return total * (COMBED_TIMES if self.comb else 1.0)


def _stroke(asked: Floats, painted: Floats, brush: Brush, values: Floats, comb: str | None) -> None:
    """One brush over what is painted; asked is sorted by y. Changes `painted`."""
    first, last = brush.segments
    nearest = np.full(len(asked), np.inf)
    which, where = np.zeros(len(asked), np.int64), np.zeros(len(asked))
    for chosen, segment in _pairs(asked, brush, first, last, 0.0):
        along, distance = brush.nearness(asked[chosen], first[segment], last[segment])
        closer = np.flatnonzero(distance[:, 0] < nearest[chosen])
        better = chosen[closer]
        nearest[better], which[better], where[better] = distance[closer, 0], segment[0], along[closer, 0]
    reached = np.flatnonzero(nearest < 1 if brush.falloff else nearest <= 1)
    if not len(reached):
        return
    if comb is None:
        low, high = values[first[which[reached]]], values[last[which[reached]]]
        colour = low + where[reached, None] * (high - low)
    else:
        colour, directed = _combed(asked, reached, nearest, brush, comb == "across")
        reached, colour = reached[directed], colour[directed]
    share = np.ones(len(reached))
    if brush.falloff:
        t = np.clip((1 - nearest[reached]) / brush.falloff, 0.0, 1.0)
        share = t * t * (3 - 2 * t)
    below = painted[reached]
    painted[reached] = np.where(share[:, None] == 1, colour, below + share[:, None] * (colour - below))


def _combed(
    asked: Floats, reached: Indices, nearest: Floats, brush: Brush, across: bool
) -> tuple[Floats, NDArray[np.bool_]]:
    """(R, 6) the direction of the path near some places as n nᵀ, and whether it has one there.

    A mean of the segments as lines, of those that are nearly as near as the nearest: continuous, however many they
    are. A corner counts with the direction half way around it, else two sides at 90° would have no mean.
    """
    first, last, directions, lengths = _elements(brush)
    tensors = tensors_of(_across(directions) if across else directions)
    # Sorted by y as they were; the components of paths in the plane that are 0 everywhere are left out.
    asked, nearest = np.asfortranarray(asked[reached]), nearest[reached]
    total = np.zeros((len(reached), 6), order="F")
    used = np.flatnonzero(tensors.any(axis=0)).tolist()
    for chosen, element in _pairs(asked, brush, first, last, CLOSENESS):
        distance = brush.nearness(asked[chosen], first[element], last[element])[1][:, 0]
        weight = 1 - (distance - nearest[chosen]) / CLOSENESS
        near = np.flatnonzero(weight > 0)
        chosen, weight = chosen[near], weight[near]
        # A segment's length as far as it is that near: many short ones shall not outweigh a long one.
        weight *= weight * np.minimum(lengths[element], CLOSENESS * brush.radii[first[element]])
        for k in used:
            total[chosen, k] += weight * tensors[element, k]
    trace = total[:, :3].sum(axis=1)
    directed = trace > 0
    return total / np.where(directed, trace, 1.0)[:, None], directed


def _elements(brush: Brush) -> tuple[Indices, Indices, Floats, Floats]:
    """First and last place, direction (E, 3) and length of each segment that has one, and of each corner.

    In the order of the path: a run of them is near together.
    """
    first, last = brush.segments
    steps = brush.places[last] - brush.places[first]
    lengths = np.linalg.norm(steps, axis=1)
    first, last, steps, lengths = (array[lengths > 0] for array in (first, last, steps, lengths))
    directions = steps / lengths[:, None]
    closed = len(first) > 1 and np.array_equal(brush.places[first[0]], brush.places[last[-1]])
    before = np.arange(0 if not closed else -1, len(first) - 1)
    after = before + 1
    turned = directions[before] + directions[after]
    size = np.linalg.norm(turned, axis=1)
    # A half turn has no direction half way: no weight.
    halfway = turned / np.where(size > 0, size, 1.0)[:, None]
    weights = np.where(size > 0, 0.5 * np.minimum(lengths[before], lengths[after]), 0.0)
    corners = first[after]
    order = np.argsort(np.concatenate([2 * np.arange(len(first)) + 1, 2 * after]), kind="stable")
    joined = [
        np.concatenate(pair)[order]
        for pair in ((first, corners), (last, corners), (directions, halfway), (lengths, weights))
    ]
    return joined[0], joined[1], joined[2], joined[3]


def _box(brush: Brush, first: Indices, last: Indices, beyond: float) -> tuple[Floats, Floats]:
    """(S, 3) lowest and highest corner of what each segment reaches; without end along z where it is flat."""
    reach = (1 + beyond) * np.maximum(brush.radii[first], brush.radii[last])[:, None]
    a, b = brush.places[first], brush.places[last]
    low, high = np.minimum(a, b) - reach, np.maximum(a, b) + reach
    if brush.flat:
        low[:, 2], high[:, 2] = -np.inf, np.inf
    return low, high


def _met(low: Floats, high: Floats, asked: Floats) -> Iterator[tuple[int, slice]]:
    """Boxes that meet the one around some places, in order, and the places between their lowest and highest y."""
    if not len(asked):
        return
    begin, end = np.searchsorted(asked[:, 1], low[:, 1], "left"), np.searchsorted(asked[:, 1], high[:, 1], "right")
    met = np.all((low <= asked.max(axis=0)) & (high >= asked.min(axis=0)), axis=1)
    for i in np.flatnonzero(met & (begin < end)).tolist():
        yield i, slice(int(begin[i]), int(end[i]))


def _pairs(
    asked: Floats, brush: Brush, first: Indices, last: Indices, beyond: float
) -> Iterator[tuple[Indices, Indices]]:
    """Each segment, as an array of one, and the places that it may reach, in the order of the path.

    One at a time: what is asked is sorted by y, so that few places are looked at for each.
    """
    low, high = _box(brush, first, last, beyond)
    axes = (0,) if brush.flat else (0, 2)
    for i, rows in _met(low, high, asked):
        inside = [(asked[rows, axis] >= low[i, axis]) & (asked[rows, axis] <= high[i, axis]) for axis in axes]
        chosen = np.flatnonzero(inside[0] if brush.flat else inside[0] & inside[1]) + rows.start
        if len(chosen):
            yield chosen, np.array([i])


def _units(steps: Floats) -> Floats:
    length = np.linalg.norm(steps, axis=1, keepdims=True)
    units: Floats = steps / np.where(length > 0, length, 1.0)
    return units


def _across(directions: Floats) -> Floats:
    """(N, 3) at right angles in the xy plane, as long as what they have there; none of upright ones."""
    turned = np.stack([-directions[:, 1], directions[:, 0], np.zeros(len(directions))], axis=1)
    turned[np.hypot(turned[:, 0], turned[:, 1]) < STEEP] = 0.0
    return turned
