"""Which pixels and places of a placed part are in which of its bodies (see bodynames.py).

Each body is sliced by itself, as the part is: what is said of a pixel's centre is exactly what would be printed of that
body alone.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from threading import RLock
from typing import TYPE_CHECKING, NamedTuple, cast
from weakref import WeakValueDictionary

import numpy as np

from amslicer.bodynames import Bodies, find_bodies
from amslicer.holes import find_holes
from amslicer.mask import Slicer, expand, make_slicer
from amslicer.placement import rotation_matters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.mesh import Mesh
    from amslicer.placement import Placement

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Numbers = NDArray[np.int16]

NO_BODY = -1
BLOCK_LAYERS = 16  # sliced together
KEPT_BYTES = 512 << 20  # of blocks
BORDER_BYTES = 10  # an int64 and an int16
TABLE_CELLS = 48  # along the longest side: which body is next, for places in none
SPARSE = 4  # rows of a raster further apart than this are looked up pixel by pixel


class _Block(NamedTuple):
    """Some layers' pixels, one row after another, as stretches that are of one body."""

    border: Ints  # (K,) where each stretch begins: (layer of the block × rows + row) × (columns + 1) + column
    body: Numbers  # (K,) its body, or NO_BODY


@dataclass(frozen=True, eq=False)
class BodyIndex:
    """Which body is where, as the slicer sees it: of the pixel centres each body winds around. In any thread.

    Where bodies overlap the one of highest priority counts, of equals the later one.

    Attributes:
        mesh: the part.
        slicers: of each body, in the pattern frame.
        priorities: of each body.
    """

    mesh: Mesh
    bodies: Bodies
    grid: Grid
    slicers: tuple[Slicer, ...]
    priorities: tuple[int, ...]
    _blocks: OrderedDict[int, _Block] = field(default_factory=OrderedDict)
    _lock: RLock = field(default_factory=RLock)

    def labels(self, layer: int) -> Numbers:
        """(rows, columns) body of each pixel of a layer, row 0 = lowest y; NO_BODY where there is none."""
        grid = self.grid
        return self._dense(layer, 0, grid.rows)[:, : grid.columns]

    def everywhere(self, layer: int) -> Numbers:
        """As labels, with the next body, about, where there is none: of a surface that was moved since."""
        grid, found = self.grid, self.labels(layer)
        nearest = self._next(grid.x_mm()[None, :], grid.y_mm()[:, None], np.asarray(grid.z_mm(layer)))
        return cast("Numbers", np.where(found == NO_BODY, nearest, found))

    def at(self, x: Floats, y: Floats, z: Floats) -> Numbers:
        """Body of places, by the pixel that they are in; of those in no body the one that is next to it, about.

        Args:
            x, y, z: pattern frame, mm; they broadcast.
        """
        grid = self.grid
        column, row, layer = (
            np.floor(np.clip(np.asarray(place) / pitch, -1, count)).astype(np.int64)
            for place, pitch, count in zip(
                (x, y, z), (*grid.pitch_mm, grid.layer_mm), (grid.columns, grid.rows, grid.layers), strict=True
            )
        )
        raster = layer.size == 1 and column.ndim == row.ndim == 2 and column.shape[0] == row.shape[1] == 1
        if raster and row.size and np.ptp(row) < SPARSE * row.size:
            found = self._raster(int(layer.flat[0]), row[:, 0], column[0])
        else:
            found = self._points(*np.broadcast_arrays(column, row, layer))
        outside = found == NO_BODY
        if outside.any():
            found = np.where(outside, self._next(x, y, z), found)
        return found

    def _raster(self, layer: int, row: Ints, column: Ints) -> Numbers:
        grid = self.grid
        found = np.full((len(row), len(column)), NO_BODY, np.int16)
        rows, columns = (np.flatnonzero((a >= 0) & (a < n)) for a, n in ((row, grid.rows), (column, grid.columns)))
        if 0 <= layer < grid.layers and len(rows) and len(columns):
            first = int(row[rows].min())
            dense = self._dense(layer, first, int(row[rows].max()) + 1)
            found[np.ix_(rows, columns)] = dense[np.ix_(row[rows] - first, column[columns])]
        return found

    def _points(self, column: Ints, row: Ints, layer: Ints) -> Numbers:
        grid = self.grid
        found = np.full(column.shape, NO_BODY, np.int16)
        inside = (column >= 0) & (column < grid.columns) & (row >= 0) & (row < grid.rows)
        inside &= (layer >= 0) & (layer < grid.layers)
        number = layer // BLOCK_LAYERS
        for block in np.unique(number[inside]):
            chosen = inside & (number == block)
            place = ((layer[chosen] - block * BLOCK_LAYERS) * grid.rows + row[chosen]) * (grid.columns + 1)
            border, body = self._block(int(block))
            found[chosen] = body[np.searchsorted(border, place + column[chosen], side="right") - 1]
        return found

    def _dense(self, layer: int, first: int, end: int) -> Numbers:
        """(end - first, columns + 1) labels of some rows of a layer; the last column is none."""
        number, width = layer // BLOCK_LAYERS, self.grid.columns + 1
        border, body = self._block(number)
        begin = (layer - number * BLOCK_LAYERS) * self.grid.rows
        start, stop = (begin + first) * width, (begin + end) * width
        low, high = np.searchsorted(border, start, side="right") - 1, np.searchsorted(border, stop)
        edges = np.concatenate([[start], border[low + 1 : high], [stop]])
        return np.repeat(body[low:high], np.diff(edges)).reshape(end - first, width)

    def _block(self, number: int) -> _Block:
        with self._lock:
            if number in self._blocks:
                self._blocks.move_to_end(number)
            else:
                first = number * BLOCK_LAYERS
                self._blocks[number] = self._stretches(first, min(first + BLOCK_LAYERS, self.grid.layers))
                kept = [BORDER_BYTES * len(block.border) for block in self._blocks.values()]
                while len(self._blocks) > 1 and sum(kept) > KEPT_BYTES:
                    self._blocks.popitem(last=False)
                    kept.pop(0)
            return self._blocks[number]

    def _stretches(self, first: int, end: int) -> _Block:
        """The runs of all bodies in the layers first … end - 1, cut where any begins or ends."""
        width = self.grid.columns + 1
        starts, stops, ranks = [], [], []
        order = sorted(range(len(self.slicers)), key=lambda body: (self.priorities[body], body))
        for rank, body in enumerate(order):
            runs = self.slicers[body].runs(first, end)
            starts.append(runs.row * width + runs.start)
            stops.append(runs.row * width + runs.stop)
            ranks.append(np.full(len(runs.row), rank))
        start, stop, rank_of = (np.concatenate(parts) for parts in (starts, stops, ranks))
        border = np.unique(np.concatenate([[0], start, stop]))
        low = np.searchsorted(border, start)
        rank_at, stretch = expand(rank_of, low, np.searchsorted(border, stop) - low)
        highest = np.full(len(border), -1)
        np.maximum.at(highest, stretch, rank_at)
        body_of = np.array([*order, NO_BODY], np.int16)  # -1 is the last
        return _Block(border, body_of[highest])

    def _next(self, x: Floats, y: Floats, z: Floats) -> Numbers:
        """The table's bodies at places; beyond the part as at its sides."""
        along = [
            np.clip(np.floor(np.asarray(place) / side), 0, count - 1).astype(np.int64)
            for place, side, count in zip((x, y, z), self._cell_mm, self._table.shape[::-1], strict=True)
        ]
        return cast("Numbers", self._table[along[2], along[1], along[0]])

    @property
    def _extent_mm(self) -> Floats:
        grid = self.grid
        return np.array([grid.columns, grid.rows, grid.layers]) * (*grid.pitch_mm, grid.layer_mm)

    @property
    def _cell_mm(self) -> Floats:
        return self._extent_mm / self._table.shape[::-1]

    @cached_property
    def _table(self) -> Numbers:
        """(z, y, x) the body in the middle of coarse cells, or that of the nearest cell which has one."""
        from scipy.ndimage import distance_transform_edt

        with self._lock:
            extent = self._extent_mm
            x, y, z = (max(1, round(float(side / extent.max() * TABLE_CELLS))) for side in extent)
            cell = extent / (x, y, z)
            px, py, pz = ((np.arange(n) + 0.5) * side for n, side in zip((x, y, z), cell, strict=True))
            table = np.empty((z, y, x), np.int16)
            for layer in range(z):
                column, row, at = (
                    (place / pitch).astype(np.int64)
                    for place, pitch in zip((px, py, pz[layer]), (*self.grid.pitch_mm, self.grid.layer_mm), strict=True)
                )
                table[layer] = self._raster(int(at), row, column)
            # Bodies thinner than a cell have their corners at least.
            for body, slicer in enumerate(self.slicers):
                corners = np.clip((slicer.corners.reshape(-1, 3) / cell).astype(np.int64), 0, np.array([x, y, z]) - 1)
                i, j, k = corners.T
                free = table[k, j, i] == NO_BODY
                table[k[free], j[free], i[free]] = body
            nearest = distance_transform_edt(
                table == NO_BODY, sampling=cell[::-1], return_distances=False, return_indices=True
            )
            return cast("Numbers", table[tuple(nearest)])


# Of jobs that are under way: fields and materials by body look at the same one. An index keeps its mesh alive, so that
# no other has the same id.
_MADE: WeakValueDictionary[tuple[object, ...], BodyIndex] = WeakValueDictionary()


def body_index(mesh: Mesh, placement: Placement, grid: Grid, priorities: Mapping[str, int] | None = None) -> BodyIndex:
    """The bodies of a placed part on a printer's grid.

    Args:
        priorities: by name, where bodies overlap; 0 by default.

    Raises:
        JobError: the part has no body of a name.
    """
    asked = {name: priority for name, priority in (priorities or {}).items() if priority}
    key = (
        id(mesh), placement.rotation.tobytes(), placement.scale, placement.low_mm.tobytes(), grid,
        tuple(sorted(asked.items())),
    )  # fmt: skip
    made = _MADE.get(key)
    if made is None:
        bodies = find_bodies(mesh)
        ranks = [0] * len(bodies.names)
        for number, priority in zip(bodies.numbers(list(asked), "bodies"), asked.values(), strict=True):
            ranks[number] = priority
        vertices = _placed(mesh, placement)
        holes = find_holes(mesh.rim, vertices, grid)
        order = np.argsort(bodies.of_triangle, kind="stable")
        bounds = np.searchsorted(bodies.of_triangle[order], np.arange(len(bodies.names) + 1))
        slicers = tuple(
            make_slicer(vertices, mesh.triangles[order[start:end]], grid, holes) for start, end in pairwise(bounds)
        )
        made = _MADE[key] = BodyIndex(mesh, bodies, grid, slicers, tuple(ranks))
    return made


def _placed(mesh: Mesh, placement: Placement) -> Floats:
    """(V, 3) vertices in the pattern frame, to the bit those that are sliced."""
    if rotation_matters(placement.rotation, placement.scale):
        return mesh.vertices @ (placement.rotation * placement.scale).T - placement.low_mm
    return mesh.vertices - placement.low_mm


def own_materials(
    job: Job, mesh: Mesh, placement: Placement, grid: Grid, *, moved: bool = False
) -> tuple[Callable[[int], Numbers], tuple[int, ...]]:
    """Bodies with materials of their own, as the job file's `bodies` says.

    Args:
        moved: whether the part's surface is not the mesh's: what was raised belongs to the body next to it.

    Returns:
        (rows, columns) body of each pixel of a layer, NO_BODY outside; and per body the number of its material from 1
        on, 0 where it has the pattern.

    Raises:
        JobError: the part has no body of a name.
    """
    asked = job.spec.bodies or {}
    find_bodies(mesh).numbers(list(asked), "bodies")
    index = body_index(mesh, placement, grid, {name: body.priority for name, body in asked.items()})
    materials = [asked[name].material if name in asked else None for name in index.bodies.names]
    return index.everywhere if moved else index.labels, tuple(
        0 if name is None else job.materials.index(name) + 1 for name in materials
    )
