"""A field by values at scattered points, in a table or inline.

    {points: probes.csv}                                          columns x,y,z,value; mm, file coordinates
    {points: [[0, 0, 0, 0.2], [20, 0, 0, 0.8]]}                   the same inline; [x, y, value]: alike at every height
    {points: probes.csv, method: nearest}                         thin-plate | nearest | linear
    {points: probes.csv, within: [0, 1], smoothing: 0, neighbors: 24, grid_mm: 0.5}

Of neighbors, at most 40 make a value: each of some 36 000 nodes then costs 0.2 ms.

As an orientation, columns x,y,z and angle; or azimuth,elevation (degrees); or nx,ny,nz (any length and sign); a value
is an angle. They are interpolated as lines. Without z, the field is the same at every height.

thin-plate: smooth, through the points, and beyond their values where it has to; `within` bounds it. linear: straight
between the points, and outside them as where the straight line to their middle meets their hull. Both are made at
nodes, grid_mm apart, and are trilinear between. nearest: the value of the nearest point (of several, the first one);
it has edges, so each pixel asks for itself: about 2 µs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from amslicer.errors import JobError
from amslicer.fields.constant import ConstantSampler
from amslicer.fields.nodes import Nodes, NodesSampler
from amslicer.fields.orientation import Angles, Lines, Orientation, Vector, principal_lines, tensors_of, unit_vectors
from amslicer.fields.scattered import CLOSEST_MM, GLOBAL_MOST, NEIGHBOURS, interpolate
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source, one_tap
from amslicer.fields.spacing import asked_spacing, spacing_for
from amslicer.fields.tables import MOST_ROWS, Table, number_fault, read_table

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

DIRECTIONS = (("angle",), ("azimuth", "elevation"), ("nx", "ny", "nz"))
COLUMNS = ("x", "y", "z", "value", "angle", "azimuth", "elevation", "nx", "ny", "nz")
ALIKE = 1e-9  # between components of n nᵀ: rounding of angles, 1e-7°
# Nodes are made within some seconds: a value takes 40 ns per point of one plate, or 60 to 90 µs among 24 neighbours.
KERNELS, FEWEST_NODES, MOST_NODES, MOST_LOCAL_NODES = 30_000_000, 50_000, 500_000, 100_000
MOST_NEIGHBOURS = 40  # 0.2 ms per value, twice the default's; 100 take 18 ms
NODES_PER_POINT = 8
TIES = 8  # points at the same distance: the corners of a cube around its middle

Row = Annotated[tuple[Number, ...], Field(min_length=3, max_length=4)]


def _kind(value: Any) -> str:
    return "file" if isinstance(value, str) else "rows"


class PointsSource(Source):
    """Values at scattered points, interpolated."""

    points: Annotated[
        Annotated[str, Field(min_length=1), Tag("file")]
        | Annotated[tuple[Row, ...], Field(min_length=1, max_length=MOST_ROWS), Tag("rows")],
        Discriminator(_kind),
    ] = Field(
        description="CSV table, relative to the job file, with columns x,y,z,value (mm, file coordinates); or a list "
        "of [x, y, z, value] or [x, y, value]"
    )
    method: Literal["thin-plate", "nearest", "linear"] = Field(
        default="thin-plate", description="smooth through the points, the nearest one's value, or straight between"
    )
    smoothing: Annotated[Number, Field(ge=0)] = Field(
        default=0.0, description="of thin-plate: 0 passes through the points, more passes near them"
    )
    neighbors: Annotated[int, Field(strict=True, ge=4, le=MOST_NEIGHBOURS)] | None = Field(
        default=None,
        description=f"of thin-plate: points that make a value; default: all, or {NEIGHBOURS} of over {GLOBAL_MOST}",
    )
    within: tuple[Number, Number] | None = Field(default=None, description="values below and above become these")
    grid_mm: Annotated[Number, Field(gt=0)] | None = Field(
        default=None, description="mm between nodes, linear between; default: by the part's size and the points"
    )

    @field_validator("points")
    @classmethod
    def _sound_rows(cls, points: Any) -> Any:
        if isinstance(points, tuple):
            names = ("x", "y", "value") if len(points[0]) == 3 else ("x", "y", "z", "value")
            for i, row in enumerate(points):
                if len(row) != len(names):
                    raise ValueError(f"point {i + 1} has {len(row)} numbers, and the first one {len(names)}")
                for name, value in zip(names, row, strict=True):
                    if fault := number_fault(name, value):
                        raise ValueError(f"point {i + 1}: {fault}")
        return points

    @model_validator(mode="after")
    def _of_one_mind(self) -> Self:
        if self.within is not None and not self.within[0] <= self.within[1]:
            raise ValueError(f"within must be [low, high] with low <= high, but is {list(self.within)}")
        if self.method != "thin-plate" and (self.smoothing or self.neighbors is not None):
            key = "smoothing" if self.smoothing else "neighbors"
            raise ValueError(f"{key} goes with method: thin-plate, not {self.method}")
        if self.method == "nearest" and self.grid_mm is not None:
            raise ValueError("grid_mm goes with method: thin-plate or linear; nearest has no nodes")
        return self

    @property
    def mixes_numbers(self) -> bool:
        """Always, but the nearest point's own."""
        return self.method != "nearest"

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The values over a part.

        Raises:
            JobError: the table cannot be used, has no values, or two for one place.
        """
        table, word = self._table(inputs)
        if "value" not in table.columns:
            raise JobError(
                f"the table '{table.name}' has no column 'value', and a number is asked for",
                hint=f"it has {', '.join(table.columns)}; directions go to fields.orientation",
            )
        low, high = self.within or (-np.inf, np.inf)
        values = np.clip(table.matrix(["value"]), low, high) if self.method != "thin-plate" else table.matrix(["value"])
        places, values, _ = _merged(table, values, word, frame, 0.0)
        if np.all(values == values[0]):
            return ConstantSampler(float(np.clip(values[0, 0], low, high)))
        if self.method == "nearest":
            return NearestSampler(Nearest.of(places, frame), values[:, 0])
        nodes = self._nodes(places, values, frame)
        if self.method == "linear":
            return NodesSampler(nodes, (float(values.min()), float(values.max())))
        return NodesSampler(nodes, self.within)

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The directions over a part, interpolated as lines.

        Raises:
            JobError: the table cannot be used, has no directions, or two for one place.
        """
        table, word = self._table(inputs)
        if self.within is not None:
            raise JobError(
                f"within: {list(self.within)} of a field by points that is a direction",
                hint="leave out within: lines have no ends",
            )
        names = _direction_columns(table)
        given = table.matrix(names)
        vectors = _vectors(given)
        places, tensors, kept = _merged(table, tensors_of(vectors), word, frame, ALIKE)
        if np.all(np.abs(tensors - tensors[0]) <= ALIKE):
            first = tuple(ConstantSampler(float(value)) for value in given[0])
            return Vector((first[0], first[1], first[2])) if len(first) == 3 else Angles(*first)
        if self.method == "nearest":
            nearest, normals = Nearest.of(places, frame), vectors[kept]
            return Lines(lambda x, y, z: normals[nearest.index(x, y, z)], nearest.varies)
        nodes = self._nodes(places, tensors, frame)
        return Lines(lambda x, y, z: principal_lines(np.moveaxis(nodes.at(x, y, z), 0, -1)), nodes.varies)

    def paths(self) -> tuple[str, ...]:
        """The table's path, where there is one."""
        return (self.points,) if isinstance(self.points, str) else ()

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its table elsewhere."""
        if not isinstance(self.points, str):
            return self
        return self.model_copy(update={"points": renamed.get(self.points, self.points)})

    def _table(self, inputs: Inputs) -> tuple[Table, str]:
        """The table, and what its rows are called."""
        if isinstance(self.points, str):
            table = read_table(inputs.read(self.points), self.points, COLUMNS)
            for axis in ("x", "y"):
                if axis not in table.columns:
                    raise JobError(
                        f"the table '{table.name}' has no column '{axis}'",
                        hint="its columns are x,y,z,value or x,y,value",
                    )
            return table, "lines"
        rows = np.array(self.points, np.float64)
        names = ("x", "y", "value") if rows.shape[1] == 3 else ("x", "y", "z", "value")
        return Table("points", dict(zip(names, rows.T, strict=True)), np.arange(1, len(rows) + 1)), "points"

    def _nodes(self, places: Floats, values: Floats, frame: Frame) -> Nodes:
        function, span = interpolate(places, values, self.method, self.smoothing, self.neighbors)
        size, varies, count = frame.size_mm, span.varies, len(places)
        if self.grid_mm is not None:
            spacing = asked_spacing(size, varies, self.grid_mm, "points")
        elif self.method == "linear":
            spacing = spacing_for(size, varies, MOST_NODES)
        elif self.neighbors is None and count <= GLOBAL_MOST:
            spacing = spacing_for(size, varies, int(np.clip(KERNELS // count, FEWEST_NODES, MOST_NODES)))
        else:
            more = min(1.0, (NEIGHBOURS / (self.neighbors or NEIGHBOURS)) ** 2)
            budget = int(more * np.clip(NODES_PER_POINT * count, FEWEST_NODES, MOST_LOCAL_NODES))
            spacing = spacing_for(size, varies, budget)
        return Nodes(function, size, spacing, values.shape[1], varies)


def _direction_columns(table: Table) -> tuple[str, ...]:
    """The columns that give a direction: one of DIRECTIONS, or the value."""
    found = [names for names in DIRECTIONS if set(names) & set(table.columns)]
    if len(found) > 1:
        raise JobError(
            f"the table '{table.name}' gives directions twice: by {' and by '.join(', '.join(n) for n in found)}",
            hint="leave one of them out",
        )
    names = found[0] if found else ("value",)
    missing = [name for name in names if name not in table.columns]
    if missing:
        raise JobError(
            f"the table '{table.name}' has no column '{missing[0]}'",
            hint="a direction is angle; or azimuth and elevation; or nx, ny and nz",
        )
    return names


def _vectors(given: Floats) -> Floats:
    """(N, 3) unit vectors of angles, azimuths and elevations, or components."""
    if given.shape[1] == 3:
        return unit_vectors(given)
    azimuth, elevation = np.deg2rad(given[:, 0]), np.deg2rad(given[:, 1] if given.shape[1] == 2 else 0 * given[:, 0])
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)


def _merged(
    table: Table, values: Floats, word: str, frame: Frame, alike: float
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """(N, 3) places (field frame) that are all apart, their values, and which rows they are.

    Raises:
        JobError: a place has two values that differ by more than `alike`.
    """
    z = table.columns.get("z")
    columns = [table.columns["x"], table.columns["y"], np.zeros(len(table.lines)) if z is None else z]
    places = np.stack(columns, axis=1)
    cell = np.round(places / CLOSEST_MM)
    _, first, group = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    first_of = first[group.ravel()]
    differs = np.any(np.abs(values - values[first_of]) > alike, axis=1)
    if differs.any():
        i, axes = int(np.argmax(differs)), "xy" if z is None else "xyz"
        at = ", ".join(f"{axis} = {value:g}" for axis, value in zip(axes, places[i], strict=False))
        raise JobError(
            f"the table '{table.name}' has two values at the same place ({at} mm): {word} "
            f"{table.lines[first_of[i]]} and {table.lines[i]}",
            hint="leave one of them out",
        )
    kept = np.sort(first)
    shift = frame.minimum_mm if z is not None else frame.minimum_mm * (1.0, 1.0, 0.0)
    return places[kept] - shift, values[kept], kept


@dataclass(frozen=True, eq=False)
class Nearest:
    """Which point is the nearest one; asked along the axes on which the points differ."""

    tree: Any
    axes: tuple[int, ...]
    count: int
    frame: Frame

    @classmethod
    def of(cls, places: Floats, frame: Frame) -> Nearest:
        """Of (N, 3) places."""
        from scipy.spatial import cKDTree

        axes = tuple(int(axis) for axis in np.flatnonzero(np.ptp(places, axis=0) > 0))
        return cls(cKDTree(places[:, axes]), axes, len(places), frame)

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along its axes."""
        return (0 in self.axes, 1 in self.axes, 2 in self.axes)

    def index(self, x: Floats, y: Floats, z: Floats) -> NDArray[np.int64]:
        """Of several at the same distance, the first one; outside the box as at its nearest place."""
        used = [self.frame.nearest(axis, np.asarray((x, y, z)[axis], np.float64)) for axis in self.axes]
        asked = np.stack(np.broadcast_arrays(*used), axis=-1)
        ties = min(TIES, self.count)
        distance, found = self.tree.query(asked, k=[*range(1, ties + 1)])
        first: NDArray[np.int64] = np.where(distance == distance[..., :1], found, self.count).min(axis=-1)
        return first


@dataclass(frozen=True, eq=False)
class NearestSampler:
    """The value of the nearest point."""

    nearest: Nearest
    values: Floats
    texels: None = None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the axes on which the points differ."""
        return self.nearest.varies

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value."""
        return float(self.values.min()), float(self.values.max())

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points; as small as the coordinates that count."""
        found: Floats = self.values[self.nearest.index(x, y, z)]
        return found

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point."""
        return one_tap(self.scalar(x, y, z), np.broadcast_arrays(x, y, z)[0])
