"""A field painted on the part's own vertices: colours or values stored in its PLY, OBJ, GLB or 3MF file.

    {vertex: quality}                                          a property by its name: floats as they are
    {vertex: red, range: [0.1, 0.9]}                           red, green, blue, alpha, or grey of the colours
    {vertex: grey, range: [0, 1], depth: 2, beyond: 0.5}       only the skin: 0.5 from 2 mm below the surface on
    {vertex: angle, range: [0, 180]}                           as an orientation: an angle in degrees
    {vertex: color, reads: hue}                                the hue's half is the direction's azimuth
    {vertex: [nx, ny, nz], reads: vector}                      three properties along the file's axes
    {vertex: uv, reads: uv}                                    along the u axis of the texture coordinates

Integers are shares of their type's largest value; range maps 0 … 1 to its two values. Every place has the value of the
nearest point on the surface, linear over its triangle; found at nodes grid_mm apart and linear between. Directions are
combined as lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Annotated, Literal
from weakref import WeakValueDictionary

import numpy as np
from pydantic import Field, model_validator

from amslicer.errors import JobError
from amslicer.fields.nodes import Nodes, lines_on_nodes
from amslicer.fields.orientation import principal_lines, tensors_of, unit_vectors
from amslicer.fields.source import Frame, Inputs, Number, Range, Sampler, Source, blend
from amslicer.fields.spacing import spacing_or_default

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import NDArray

    from amslicer.fields.orientation import Orientation
    from amslicer.mesh import Mesh
    from amslicer.meshfiles.painted_mesh import Paint
    from amslicer.nearest import Surface

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

GREY = (0.299, 0.587, 0.114)  # ITU-R BT.601 luma
UNIT = (0.0, 1.0)  # the default range
DIRECTION_SPACINGS = 2  # as of {distance: normal}
FLAT = 1e-12  # of a texture's largest triangle: one this small says nothing about directions


class VertexSource(Source):
    """Values or directions at the vertices of the part's file."""

    vertex: str | tuple[str, str, str] = Field(
        description="a property's name; red, green, blue, alpha or grey of the colours; three names for reads: vector"
    )
    reads: Literal["value", "hue", "vector", "uv"] = Field(
        default="value", description="numbers; or directions: of hues, of three components, of texture coordinates"
    )
    range: Range = Field(default=UNIT, description="values of 0 and 1, or of an integer's smallest "
                                         "and largest")  # fmt: skip
    depth: Annotated[Number, Field(gt=0)] | None = Field(
        default=None,
        description="mm below the surface over which the value becomes beyond; default: painted throughout",
    )
    beyond: Number | None = Field(default=None, description="value at the depth and deeper")
    grid_mm: Annotated[Number, Field(gt=0)] | None = Field(
        default=None, description="mm between the nodes at which it is found; default: some 500 000 over the part"
    )

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        if isinstance(self.vertex, tuple) != (self.reads == "vector"):
            raise ValueError("three names go with reads: vector, one name with the others")
        if (self.depth is None) != (self.beyond is None):
            raise ValueError("depth and beyond go together: the value from so many mm below the surface on")
        if self.depth is not None and self.reads != "value":
            raise ValueError(f"depth and beyond are of numbers, but reads is {self.reads}")
        if self.range != UNIT and self.reads in ("hue", "uv"):
            raise ValueError(f"range {list(self.range)} means nothing to reads: {self.reads}")
        return self

    @property
    def needs_part(self) -> bool:
        """Always: it is read from the part's file."""
        return True

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The values over the part.

        Raises:
            JobError: the file has no such values, or directions are read from it.
        """
        if self.reads != "value":
            raise JobError(
                f"{{vertex: …, reads: {self.reads}}} makes directions, and numbers are asked for",
                hint="use it under fields.orientation, or leave out reads",
            )
        assert isinstance(self.vertex, str)
        painted = _open(frame)
        corners = blend(painted.column(self.vertex), *self.range)[painted.paint.triangles]
        spacing = spacing_or_default(frame.size_mm, self.grid_mm, "vertex")
        return VertexSampler(painted, corners, frame.size_mm, spacing, self.depth, self.beyond)

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The directions over the part; of values, these as angles in degrees.

        Raises:
            JobError: the file has no such values, or no direction in them.
        """
        if self.depth is not None:
            return super().open_orientation(frame, inputs)
        painted = _open(frame)
        corners = self._tensors(painted)
        if not corners.any():
            raise JobError(
                f"{painted.file}: nothing painted on it makes a direction by reads: {self.reads}",
                hint="hues need colours, vectors a length, texture coordinates an area",
            )

        def lines(places: Floats) -> Floats:
            triangle, shares, _ = painted.nearest(places)
            tensors = np.einsum("nc,nct->nt", shares, corners[triangle])
            some = (np.abs(tensors).max(axis=1) > 0)[:, None]
            return np.where(some, principal_lines(tensors), 0.0)

        spacing = spacing_or_default(frame.size_mm, self.grid_mm, "vertex", DIRECTION_SPACINGS)
        return lines_on_nodes(lines, frame.size_mm, spacing)

    def _tensors(self, painted: PaintedSurface) -> Floats:
        """(T, 3, 6) lines at the triangles' corners, times how much each says."""
        triangles = painted.paint.triangles
        if self.reads == "uv":
            return painted.along_u()
        if isinstance(self.vertex, tuple):
            if painted.paint.turns:
                raise JobError(
                    f"{painted.file} turns the mesh that its vectors are painted on: their axes are unclear",
                    hint="apply the node's rotation before exporting, or use PLY",
                )
            vectors = np.stack([blend(painted.column(name), *self.range) for name in self.vertex], axis=1)
            said = np.abs(vectors).max(axis=1) > 0
            spoken: Floats = tensors_of(unit_vectors(vectors)) * said[:, None]
            return spoken[triangles]
        if self.reads == "hue":
            azimuth, weight = _hue(np.stack([painted.column(name) for name in ("red", "green", "blue")], axis=1))
        else:
            azimuth, weight = np.deg2rad(blend(painted.column(self.vertex), *self.range)), np.ones(())
        flat = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
        weighted: Floats = tensors_of(flat) * weight[..., None]
        return weighted[triangles]


def _hue(colours: Floats) -> tuple[Floats, Floats]:
    """(V,) half the hue, radians, and saturation of (V, 3) colours."""
    most, least = colours.max(axis=1), colours.min(axis=1)
    chroma = most - least
    some = np.where(chroma > 0, chroma, 1.0)
    red, green, blue = colours.T
    sixth = np.select(
        [most == red, most == green], [(green - blue) / some, 2 + (blue - red) / some], 4 + (red - green) / some
    )
    return sixth * (np.pi / 6), chroma / np.where(most > 0, most, 1.0)


@dataclass(frozen=True, eq=False)
class PaintedSurface:
    """The part's surface with what its file says at the vertices.

    Attributes:
        file: name of the part's file.
        key: identity of its contents.
        paint: vertices in the field frame.
        mesh: the part's; kept, so that no other has its id.
    """

    file: str
    key: str
    paint: Paint
    surface: Surface
    mesh: Mesh

    def column(self, name: str) -> Floats:
        """(V,) values of a property.

        Raises:
            JobError: there is none, or it is NaN somewhere.
        """
        values = self.paint.values
        if name == "grey" and name not in values and {"red", "green", "blue"} <= set(values):
            red, green, blue = (self.column(colour) for colour in ("red", "green", "blue"))
            # From green, so that equal components are that grey exactly.
            return green + GREY[0] * (red - green) + GREY[2] * (blue - green)
        if name not in values:
            there = ", ".join([*values, *(["grey"] if {"red", "green", "blue"} <= set(values) else [])])
            raise JobError(
                f"{self.file} has no '{name}' at its vertices; it has {there or 'no values at all'}",
                hint="name one of these; for directions of colours write {vertex: color, reads: hue}"
                if there
                else "export it with vertex colours or values (PLY, OBJ, GLB, 3MF)",
            )
        used = np.unique(self.paint.triangles)
        wrong = used[~np.isfinite(values[name][used])]
        if len(wrong):
            place = (self.paint.vertices[wrong[0]]).round(3).tolist()
            raise JobError(
                f"{self.file}: '{name}' is {values[name][wrong[0]]} at vertex {wrong[0]} "
                f"({place} mm from the part's lowest corner), and at {len(wrong)} in all",
                hint="paint a number there and export again",
            )
        return values[name]

    def along_u(self) -> Floats:
        """(T, 3, 6) lines along which u grows and v stays, at the corners: means over the triangles around a vertex.

        Raises:
            JobError: there are no texture coordinates.
        """
        if self.paint.uv is None:
            raise JobError(
                f"{self.file} has no texture coordinates at all corners",
                hint="unwrap it and export OBJ or GLB with UVs, or PLY with s and t at its vertices",
            )
        corners, uv = self.paint.vertices[self.paint.triangles], self.paint.uv
        if not np.isfinite(uv).all():
            first = int(np.flatnonzero(~np.isfinite(uv).all(axis=(1, 2)))[0])
            raise JobError(
                f"{self.file}: a texture coordinate of triangle {first} is no number", hint="unwrap it again"
            )
        (e1, e2), (d1, d2) = ((k[:, 1] - k[:, 0], k[:, 2] - k[:, 0]) for k in (corners, uv))
        area = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
        along = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) * np.sign(area)[:, None]
        along[np.abs(area) <= FLAT * np.abs(area).max(initial=0.0)] = 0.0
        size = np.linalg.norm(np.cross(e1, e2), axis=1)
        tensors = tensors_of(unit_vectors(along)) * (size * (np.abs(along).max(axis=1) > 0))[:, None]
        # Across a seam of the texture the place is the same and the coordinates are not: no mean there.
        keys = np.concatenate([corners, uv], axis=2).reshape(-1, 5)
        _, which = np.unique(keys, axis=0, return_inverse=True)
        which = which.reshape(-1)
        sums = np.stack([np.bincount(which, np.repeat(column, 3)) for column in tensors.T], axis=1)
        trace = sums[:, :3].sum(axis=1, keepdims=True)
        return (sums / np.where(trace > 0, trace, 1.0))[which].reshape(-1, 3, 6)

    def nearest(self, places: Floats) -> tuple[Ints, Floats, Floats]:
        """(N,) triangle nearest to (N, 3) places, (N, 3) shares of its corners there, (N,) distance."""
        from amslicer.nearest import barycentric

        distance, piece, closest = self.surface.nearest(places)
        triangle = self.surface.parent[piece]
        return triangle, barycentric(self._corners[triangle], closest), distance

    @cached_property
    def _corners(self) -> Floats:
        return self.paint.vertices[self.paint.triangles]


# Of jobs that are under way: several fields are painted on the same part.
_OPEN: WeakValueDictionary[int, PaintedSurface] = WeakValueDictionary()
_OPENING = Lock()


def _open(frame: Frame) -> PaintedSurface:
    from amslicer.meshfiles.painted_mesh import read_paint
    from amslicer.nearest import surface_of

    part = frame.part("vertex")
    with _OPENING:
        made = _OPEN.get(id(part.mesh))
        if made is None:
            paint = read_paint(part)
            surface = surface_of(paint.vertices, paint.triangles)
            made = PaintedSurface(part.mesh.file, part.mesh.sha256, paint, surface, part.mesh)
            _OPEN[id(part.mesh)] = made
        return made


@dataclass(frozen=True, eq=False)
class VertexSampler:
    """Values at the corners of the surface's triangles, carried into the volume.

    Attributes:
        corners: (T, 3) values.
        depth_mm: where they have become `beyond`; None: nowhere.
    """

    painted: PaintedSurface
    corners: Floats
    size_mm: Floats
    spacing_mm: float
    depth_mm: float | None
    beyond: float | None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Everywhere, or nowhere if all values are the same."""
        apart = self.bounds[0] != self.bounds[1]
        return (apart, apart, apart)

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value of the vertices, and that beyond."""
        ends = [float(self.corners.min()), float(self.corners.max()), *([] if self.beyond is None else [self.beyond])]
        return min(ends), max(ends)

    @property
    def texels(self) -> tuple[str, str] | None:
        """Fields of one part are painted on the same corners."""
        return ("vertex", self.painted.key) if self.depth_mm is None else None

    @cached_property
    def _nodes(self) -> Nodes:
        return Nodes(self._at, self.size_mm, self.spacing_mm, 1 if self.depth_mm is None else 2)

    def _at(self, places: Floats) -> Floats:
        """(N, 1) values; with a depth also (N, 2) how deep the places are, mm, negative outside."""
        triangle, shares, distance = self.painted.nearest(places)
        a, b, c = self.corners[triangle].T
        value: Floats = a + shares[:, 1] * (b - a) + shares[:, 2] * (c - a)
        if self.depth_mm is None:
            return value[:, None]
        return np.stack([value, np.where(self.painted.surface.inside(places), distance, -distance)], axis=1)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points, within the bounds."""
        low, high = self.bounds
        if low == high:
            return np.asarray(low)
        found = self._nodes.at(x, y, z)
        return np.asarray(np.clip(self._blended(found[0], found[-1]), low, high))

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The three corners of the nearest triangle and their shares, found for each point itself."""
        places: Floats = np.stack(np.broadcast_arrays(x, y, z), axis=1)
        triangle, shares, distance = self.painted.nearest(places)
        depth = distance if self.depth_mm is None else np.where(self.painted.surface.inside(places), distance, 0.0)
        return self._blended(self.corners[triangle].T, depth), shares.T

    def _blended(self, value: Floats, depth: Floats) -> Floats:
        if self.depth_mm is None or self.beyond is None:
            return value
        t = np.clip(depth / self.depth_mm, 0.0, 1.0)
        return np.asarray(np.where(t == 1, self.beyond, value + t * (self.beyond - value)))
