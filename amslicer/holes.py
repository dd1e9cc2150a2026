"""Where rows of pixels pass through the holes of an open mesh: there, nothing says which pixels are inside.

A row's winding number ends at the sum, over all holes, of the open edges that its layer's plane cuts below the
row. Two holes can cancel each other, so that a row with a wrong inside still returns to 0: each hole is looked
at by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.grid import Grid, centre_mm, first_centre
from amslicer.mask import cut_edges, expand

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.surface import Rim

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

LAYERS_AT_ONCE = 4096
"""Layers that are counted per step: bounds memory."""


@dataclass(frozen=True)
class OpenRows:
    """How much of a part is left out: pixel rows, in how many layers, from the first to the last of them."""

    rows: int
    layers: int
    first_layer: int
    last_layer: int


@dataclass(frozen=True)
class Holes:
    """The open edges of a mesh.

    Attributes:
        ends: (E, 2, 3) where each begins and ends, pattern frame, mm.
        uses: (E,) how much more often triangles run from the first end to the second than back.
        hole: (E,) number of the hole that each borders.
    """

    ends: Floats
    uses: Ints
    hole: Ints
    grid: Grid

    def spans(self, first: int, end: int) -> tuple[Ints, Ints]:
        """Rows of the layers first … end - 1 that pass through a hole: spans begin … stop - 1 of
        (layer - first) × grid rows + row, in order, none overlapping."""
        grid = self.grid
        layer_of_end = first_centre(self.ends[:, :, 2], grid.layer_mm)
        low = np.maximum(layer_of_end.min(axis=1), first)
        count = np.minimum(layer_of_end.max(axis=1), end) - low
        crossed = np.flatnonzero(count > 0)
        edge, layer = expand(crossed, low[crossed], count[crossed])
        rises = layer_of_end[edge, 1] > layer_of_end[edge, 0]
        points = cut_edges(self.ends[edge, 0], self.ends[edge, 1], rises, centre_mm(layer, grid.layer_mm))
        row = np.clip(first_centre(points[:, 1], grid.pitch_mm[1]), 0, grid.rows)
        order = np.lexsort((row, layer, self.hole[edge]))
        sign = np.where(rises, self.uses[edge], -self.uses[edge])[order]
        # Each hole's border is made of closed loops: what goes up through a plane comes down again.
        inside = np.flatnonzero(np.cumsum(sign)[:-1])
        place = ((layer - first) * grid.rows + row)[order]
        return _merged(place[inside], place[inside + 1])

    def count(self) -> OpenRows | None:
        """All rows that pass through holes; None if there are none."""
        rows = layers = 0
        first_layer, last_layer = self.grid.layers, -1
        for first in range(0, self.grid.layers, LAYERS_AT_ONCE):
            begin, stop = self.spans(first, min(first + LAYERS_AT_ONCE, self.grid.layers))
            if len(begin):
                found = first + np.unique(begin // self.grid.rows)
                rows, layers = rows + int((stop - begin).sum()), layers + len(found)
                first_layer, last_layer = min(first_layer, int(found[0])), int(found[-1])
        return OpenRows(rows, layers, first_layer, last_layer) if layers else None

    def notes(self, bottom_mm: float) -> Iterator[str]:
        """What is left out, in a sentence; bottom_mm is the z of the part's lowest point."""
        found = self.count()
        count = int(self.hole.max()) + 1
        start = f"the mesh is open ({len(self.uses)} open edges around {count} hole{'s' if count > 1 else ''})"
        if found is None:
            yield f"{start}, but no pixel row passes through there"
            return
        low, high = (bottom_mm + self.grid.z_mm(layer) for layer in (found.first_layer, found.last_layer))
        yield (
            f"{start}: {found.rows} pixel rows of {found.layers} layers, between z = {low:.3f} and {high:.3f} mm, "
            "pass through there and stay empty"
        )


def find_holes(rim: Rim | None, vertices: Floats, grid: Grid) -> Holes | None:
    """The holes of a placed mesh, (V, 3) in the pattern frame; None if it is closed."""
    return None if rim is None else Holes(vertices[rim.edges], rim.uses, rim.hole, grid)


def _merged(begin: Ints, stop: Ints) -> tuple[Ints, Ints]:
    """Spans as they are, but in order and joined where they overlap; empty ones are gone."""
    order = np.argsort(begin, kind="stable")
    begin, reached = begin[order], np.maximum.accumulate(stop[order])
    starts = np.append(True, begin[1:] >= reached[:-1])[: len(begin)]
    ends = np.append(starts[1:], True)[: len(begin)]
    begin, stop = begin[starts], reached[ends]
    return begin[stop > begin], stop[stop > begin]
