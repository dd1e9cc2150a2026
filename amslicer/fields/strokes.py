"""A field painted with a brush: strokes along paths, later ones over earlier ones.

    {strokes: [{path: [[0, 0], [20, 5]], radius: 3, value: 0.9}], base: 0.5}       mm, file coordinates
    {strokes: [{path: [[5, 5, 2]], radius: 3, falloff: smooth, value: 0.1}], base: 0.5}    a dab, in space
    {strokes: strokes.csv, base: 0.5}                     columns stroke,x,y,z,value,radius (z, value, radius: optional)
    {strokes: [{path: …, radius: 3}], comb: along, base: 0}        directions, combed along the strokes

A stroke has its value around its path, and fades to what is below it over the outer `falloff` share of its radius (0:
not at all, smooth: from the path on). Values and radii may be lists, one number per place of the path, linear between.
Paths of [x, y] are alike at every height.

As an orientation, `comb` paints the laminate's normal along the path, or across it in the xy plane, and `base` is the
angle elsewhere, degrees; strokes with values paint these angles. Directions are blended as lines.

The field is made at nodes, at most a quarter of the narrowest fading apart, and is trilinear between. Where that would
be more than two million nodes, or half a minute's work, they are farther apart, and edges are as blurred as these are;
`grid_mm` says how far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator

from amslicer.errors import JobError
from amslicer.fields.brush import Brush, Painting
from amslicer.fields.constant import ConstantSampler
from amslicer.fields.nodes import MOST_NODES, Nodes, NodesSampler
from amslicer.fields.orientation import Angles, Lines, Orientation, principal_lines, tensors_of
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source
from amslicer.fields.spacing import asked_spacing, spacing_for
from amslicer.fields.tables import number_fault, read_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST_STROKES, MOST_PLACES = 10_000, 100_000  # seconds of reading and simplifying; painting has MOST_SECONDS
MOST_STROKE_NODES = 2_000_000  # a few seconds of painting, and 48 MB of directions
NODES_PER_FADING = 4  # a smooth step by straight pieces: within 5 % (h²/8 of its largest second derivative)
NODES_PER_RADIUS = 2  # at least, where finer ones would take too long
MOST_SECONDS, COARSER = 30.0, 1.25  # of painting, by one core; how much farther apart nodes are then, step by step
SHORTEST_MM = 1e-3  # shorter radii are mistakes
DEFAULT_FALLOFF = 0.5
COLUMNS = ("stroke", "x", "y", "z", "value", "radius")

Radius = Annotated[Number, Field(ge=SHORTEST_MM)]
Place = Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]


def _kind(value: Any) -> str:
    return "list" if isinstance(value, list | tuple) else "number"


def _falloff_kind(value: Any) -> str:
    return "word" if isinstance(value, str) else "share"


def _source_kind(value: Any) -> str:
    return "file" if isinstance(value, str) else "list"


Falloff = Annotated[
    Annotated[Literal["smooth"], Tag("word")] | Annotated[Annotated[Number, Field(ge=0, le=1)], Tag("share")],
    Discriminator(_falloff_kind),
]


class Stroke(BaseModel):
    """One stroke of a brush."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    path: Annotated[tuple[Place, ...], Field(min_length=1, max_length=MOST_PLACES)] = Field(
        description="places [x, y, z] in mm, file coordinates; or [x, y]: alike at every height; one place is a dab"
    )
    radius: Annotated[
        Annotated[Radius, Tag("number")] | Annotated[tuple[Radius, ...], Tag("list")], Discriminator(_kind)
    ] = Field(description="of the brush, mm; or one per place of the path")
    falloff: Falloff = Field(
        default=DEFAULT_FALLOFF, description="share of the radius over which the stroke fades; smooth: all of it"
    )
    value: (
        Annotated[Annotated[Number, Tag("number")] | Annotated[tuple[Number, ...], Tag("list")], Discriminator(_kind)]
        | None
    ) = Field(default=None, description="what it paints; or one value per place of the path")

    @field_validator("path")
    @classmethod
    def _sound_path(cls, path: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        for i, place in enumerate(path):
            if len(place) != len(path[0]):
                raise ValueError(f"place {i + 1} has {len(place)} coordinates, and the first one {len(path[0])}")
            for axis, value in zip("xyz", place, strict=False):
                if fault := number_fault(axis, value):
                    raise ValueError(f"place {i + 1}: {fault}")
        return path

    @field_validator("radius", "value")
    @classmethod
    def _one_each(cls, value: Any, info: Any) -> Any:
        path = info.data.get("path")
        if isinstance(value, tuple) and path is not None and len(value) != len(path):
            raise ValueError(f"has {len(value)} numbers for a path of {len(path)} places")
        for number in value if isinstance(value, tuple) else () if value is None else (value,):
            if fault := number_fault(info.field_name, number):
                raise ValueError(fault)
        return value

    def brush(self, number: int) -> Brush:
        """The stroke by numbers."""
        places = np.array(self.path, np.float64)
        count = len(places)
        flat = places.shape[1] == 2
        return Brush(
            name=f"stroke {number}",
            places=np.column_stack([places, np.zeros(count)]) if flat else places,
            flat=flat,
            radii=np.broadcast_to(np.array(self.radius, np.float64), count),
            falloff=1.0 if self.falloff == "smooth" else float(self.falloff),
            values=None if self.value is None else np.broadcast_to(np.array(self.value, np.float64), count),
        )


class StrokesSource(Source):
    """Strokes of a brush over a base."""

    strokes: Annotated[
        Annotated[str, Field(min_length=1), Tag("file")]
        | Annotated[tuple[Stroke, ...], Field(min_length=1, max_length=MOST_STROKES), Tag("list")],
        Discriminator(_source_kind),
    ] = Field(
        description="the strokes, the lowest first; or a CSV table, relative to the job file, with columns "
        "stroke,x,y,z,value,radius"
    )
    base: Number | None = Field(
        default=None, description="where no stroke is; of directions an angle in degrees, by default 0"
    )
    comb: Literal["along", "across"] | None = Field(
        default=None, description="paint directions: the laminate's normal along the strokes, or across them"
    )
    radius: Radius | None = Field(default=None, description="mm, of a table's strokes without a column radius")
    falloff: Falloff | None = Field(default=None, description="of a table's strokes; default 0.5")
    grid_mm: Annotated[Number, Field(gt=0)] | None = Field(
        default=None, description="mm between nodes, linear between; default: by the part's size and the brushes"
    )

    @field_validator("strokes")
    @classmethod
    def _not_too_many(cls, strokes: Any) -> Any:
        if isinstance(strokes, tuple):
            places = sum(len(stroke.path) for stroke in strokes)
            if places > MOST_PLACES:
                raise ValueError(f"have {places} places; at most {MOST_PLACES} are painted")
        return strokes

    @property
    def mixes_numbers(self) -> bool:
        """Always: where strokes fade, and between nodes."""
        return True

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The painted numbers over a part.

        Raises:
            JobError: a table cannot be used; or a value or the base is missing, as where directions are meant.
        """
        if self.comb is not None:
            raise JobError(
                f"strokes with comb: {self.comb} are directions, and a number is asked for",
                hint="give fields.orientation these strokes; numbers take a value per stroke and no comb",
            )
        if self.base is None:
            raise JobError("strokes have no base, and a number is asked for", hint="give the value where no stroke is")
        brushes = self._brushes(inputs)
        for brush in brushes:
            if brush.values is None:
                raise JobError(f"{brush.name} has no value, and a number is asked for", hint="give each stroke a value")
        base, brushes = np.array([self.base]), _seen(brushes, frame)
        if brushes and (hidden := brushes[0].plain(frame.size_mm)) is not None:  # it covers the part
            base, brushes = np.array([hidden]), brushes[1:]
        painted = np.concatenate([base, *(b.values for b in brushes if b.values is not None)])
        low, high = float(painted.min()), float(painted.max())
        if low == high:
            return ConstantSampler(low)
        channels = [b.values[:, None] for b in brushes if b.values is not None]
        return NodesSampler(self._nodes(brushes, channels, base, None, frame), (low, high))

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The painted directions over a part, blended as lines.

        Raises:
            JobError: a table cannot be used, some strokes have a value and some have none, or one has no direction.
        """
        brushes = self._brushes(inputs)
        valued = [brush for brush in brushes if brush.values is not None]
        if valued and (self.comb is not None or len(valued) < len(brushes)):
            other = next((brush.name for brush in brushes if brush.values is None), f"comb: {self.comb}")
            raise JobError(
                f"{valued[0].name} has a value, an angle, and {other} is combed along its path",
                hint="give all strokes a value and no comb, or none a value",
            )
        comb = None if valued else self.comb or "along"
        for brush in brushes if comb else ():
            brush.check_direction(comb == "across")
        # Across an upright piece of path nothing is painted: what is below is not hidden.
        degrees, brushes = self.base or 0.0, _seen(brushes, frame, hiding=comb != "across")
        if brushes and valued and (hidden := brushes[0].plain(frame.size_mm)) is not None:
            degrees, brushes = hidden, brushes[1:]
        if not brushes or (valued and all(np.all(b.values == degrees) for b in brushes)):
            return Angles(ConstantSampler(degrees))
        channels = [np.zeros((len(b.places), 6)) if b.values is None else _flat_tensors(b.values) for b in brushes]
        nodes = self._nodes(brushes, channels, _flat_tensors(np.array([degrees]))[0], comb, frame)
        return Lines(lambda x, y, z: principal_lines(np.moveaxis(nodes.at(x, y, z), 0, -1)), nodes.varies)

    def paths(self) -> tuple[str, ...]:
        """The table's path, where there is one."""
        return (self.strokes,) if isinstance(self.strokes, str) else ()

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its table elsewhere."""
        if not isinstance(self.strokes, str):
            return self
        return self.model_copy(update={"strokes": renamed.get(self.strokes, self.strokes)})

    def _brushes(self, inputs: Inputs) -> list[Brush]:
        if isinstance(self.strokes, str):
            return self._from_table(self.strokes, inputs)
        for key in ("radius", "falloff"):
            if getattr(self, key) is not None:
                raise JobError(f"strokes: {key} stands beside a list of strokes", hint=f"give each stroke its {key}")
        return [stroke.brush(i) for i, stroke in enumerate(self.strokes, 1)]

    def _from_table(self, name: str, inputs: Inputs) -> list[Brush]:
        """One brush per run of equal numbers in the column stroke, in the order of the file."""
        table = read_table(inputs.read(name), name, COLUMNS)
        for column in ("stroke", "x", "y"):
            if column not in table.columns:
                raise JobError(
                    f"the table '{name}' has no column '{column}'", hint=f"its columns are {', '.join(COLUMNS)}"
                )
        flat, count = "z" not in table.columns, len(table.lines)
        if "radius" in table.columns:
            radii = table.columns["radius"]
            if self.radius is not None:
                raise JobError(f"strokes: radius, and the table '{name}' has a column radius", hint="leave one out")
            if not np.all(radii >= SHORTEST_MM):
                i = int(np.argmin(radii >= SHORTEST_MM))
                raise JobError(
                    f"the table '{name}', line {table.lines[i]}: radius is {radii[i]:g} mm; it is at least "
                    f"{SHORTEST_MM:g} mm",
                    hint="leave the row out",
                )
        elif self.radius is None:
            raise JobError(f"the table '{name}' has no column 'radius'", hint="add it, or radius: beside strokes")
        else:
            radii = np.full(count, self.radius)
        if count > MOST_PLACES:
            raise JobError(
                f"the table '{name}' has {count} places; at most {MOST_PLACES} are painted",
                hint="leave out every other one: a path is straight between its places",
            )
        falloff = DEFAULT_FALLOFF if self.falloff is None else 1.0 if self.falloff == "smooth" else self.falloff
        numbers = table.columns["stroke"]
        starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist()]
        if len(starts) > MOST_STROKES:
            raise JobError(
                f"the table '{name}' has {len(starts)} strokes; at most {MOST_STROKES} are painted",
                hint="join those that follow each other, or paint a picture or a volume",
            )
        if len(np.unique(numbers)) < len(starts):
            again = next(i for n, i in enumerate(starts) if numbers[i] in numbers[starts[:n]])
            raise JobError(
                f"the table '{name}' returns to stroke {numbers[again]:g} in line {table.lines[again]}",
                hint="keep a stroke's rows together, or give the later ones another number",
            )
        z = np.zeros(count) if flat else table.columns["z"]
        places = np.stack([table.columns["x"], table.columns["y"], z], axis=1)
        values = table.columns.get("value")
        parts = [slice(a, b) for a, b in zip(starts, [*starts[1:], count], strict=True)]
        return [
            Brush(
                name=f"stroke {numbers[part][0]:g} of the table '{name}' (line {table.lines[part][0]})",
                places=places[part],
                flat=flat,
                radii=radii[part],
                falloff=float(falloff),
                values=None if values is None else values[part],
            )
            for part in parts
        ]

    def _nodes(
        self, brushes: Sequence[Brush], channels: Sequence[Floats], base: Floats, comb: str | None, frame: Frame
    ) -> Nodes:
        varies = (True, True, not all(brush.flat for brush in brushes))
        size = frame.size_mm
        painting = Painting(brushes, channels, base, comb)
        if self.grid_mm is not None:
            spacing = coarsest = asked_spacing(size, varies, self.grid_mm, "strokes")
        else:
            narrowest = min(float(brush.radii.min()) * brush.falloff for brush in brushes) / NODES_PER_FADING
            wanted = min(narrowest, spacing_for(size, varies, MOST_NODES))
            spacing = max(wanted, spacing_for(size, varies, MOST_STROKE_NODES))
            coarsest = min(float(brush.radii.min()) for brush in brushes) / NODES_PER_RADIUS
        while (seconds := painting.seconds(size, spacing)) > MOST_SECONDS:
            if spacing * COARSER > coarsest:
                segments = sum(len(brush.segments[0]) for brush in brushes)
                raise JobError(
                    f"strokes of {segments} segments take about {seconds:.0f} s to paint on nodes {spacing:.3g} mm "
                    f"apart; at most {MOST_SECONDS:g} s are spent",
                    hint="give fewer places or smaller radii"
                    + ("" if self.grid_mm is None else f", or a larger grid_mm than {self.grid_mm:g}"),
                )
            spacing *= COARSER
        return Nodes(painting.at, size, spacing, len(base), varies)


def _flat_tensors(degrees: Floats) -> Floats:
    angle = np.deg2rad(degrees)
    return tensors_of(np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1))


def _seen(brushes: Sequence[Brush], frame: Frame, hiding: bool = True) -> list[Brush]:
    """In the field frame, those that reach the part and, where they hide, are not under one that covers it."""
    moved = (brush.moved(frame.minimum_mm) for brush in brushes)
    reaching = [brush.simpler() for brush in moved if brush.reaches(frame.size_mm)]
    covering = (i for i, brush in enumerate(reaching) if hiding and brush.covers(frame.size_mm))
    return reaching[max(covering, default=0) :]
