"""A field by the depth below the part's own surface, and directions that make shells parallel to its skin.

    {distance: {from: 0.2, to: 0.8, depth: 2.0}}                     0.2 at the skin, 0.8 from 2 mm below it on
    {distance: {from: 0.2, to: 0.8, depth: 2.0}, from_faces: top}    depth below upward faces: all, top, bottom or sides
    {distance: {from: 0.2, to: 0.8, depth: 2.0}, per: body}          walls inside the part count as its surface too
    {distance: normal, grid_mm: 0.4}                                 as an orientation: the normal of the nearest skin

Depths are mm of the part's file, in any direction. Top are the faces whose normal is within 45° of the file's +z,
bottom those within 45° of -z, sides the others; they face air above, below or beside them, that of cavities included.
The depth is found at nodes grid_mm apart and linear between; exact at flat skin, rounded off by a part of grid_mm along
ridges, where two faces are equally near. Bodies that overlap or touch are one solid, but for a single surface that cuts
through itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from amslicer.errors import JobError
from amslicer.fields.nodes import Nodes, lines_on_nodes
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source, blend, one_tap
from amslicer.fields.spacing import spacing_or_default

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.orientation import Orientation
    from amslicer.nearest import Surface

    Floats = NDArray[np.float64]

STEEP = float(np.sqrt(0.5))  # cosine of 45°: between faces that look up, down and sideways
ROUNDING = 1e-9  # of the cosine: a face at 45° looks up
CELL = float(np.sqrt(3))  # diagonal of a cell of nodes, in spacings: no place is further from the cell's nodes
DIRECTION_SPACINGS = 2  # directions turn over millimetres, and their nodes cost more: an eighth as many of them


class ByDepth(BaseModel):
    """The values at the surface and at a depth below it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    from_: Number = Field(alias="from", description="value at the surface")
    to: Number = Field(description="value at the depth and deeper")
    depth: Annotated[Number, Field(gt=0)] = Field(description="mm below the surface")


class DistanceSource(Source):
    """Linear from the surface to a depth below it; or the direction of the nearest surface's normal."""

    distance: ByDepth | Literal["normal"] = Field(description="values by depth; or normal: directions, for shells")
    from_faces: Literal["all", "top", "bottom", "sides"] = Field(
        default="all", description="the faces from which depth is measured, by their normals in the file's axes"
    )
    per: Literal["part", "body"] = Field(
        default="part", description="part: walls within overlapping or touching bodies are none; body: they are"
    )
    grid_mm: Annotated[Number, Field(gt=0)] | None = Field(
        default=None, description="mm between the nodes at which it is found; default: some 500 000 over the part"
    )

    @property
    def needs_part(self) -> bool:
        """Always: it is made from the part's mesh."""
        return True

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The values over the part.

        Raises:
            JobError: directions are no numbers, or the part has no such faces.
        """
        if isinstance(self.distance, str):
            raise JobError(
                "{distance: normal} makes directions, and numbers are asked for",
                hint="use it under fields.orientation, or write {distance: {from: 0.2, to: 0.8, depth: 2.0}}",
            )
        by = self.distance
        spacing = spacing_or_default(frame.size_mm, self.grid_mm, "distance")
        surface, margin = self._surface(frame), CELL * spacing

        def depths(places: Floats) -> Floats:
            # Beyond both ends by a cell, so that values at the ends themselves are linear between true depths.
            return surface.depths(places, -margin, by.depth + margin, spacing)[:, None]

        return DepthSampler(Nodes(depths, frame.size_mm, spacing), by.depth, by.from_, by.to)

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """Directions away from the surface; of values by depth, these as angles in degrees.

        Raises:
            JobError: the part has no such faces.
        """
        if not isinstance(self.distance, str):
            return super().open_orientation(frame, inputs)
        spacing = spacing_or_default(frame.size_mm, self.grid_mm, "distance", DIRECTION_SPACINGS)
        return lines_on_nodes(self._surface(frame).directions, frame.size_mm, spacing)

    def _surface(self, frame: Frame) -> Surface:
        from amslicer.nearest import surface_of

        mesh = frame.part("distance").mesh
        surface = surface_of(mesh.vertices, mesh.triangles, inner_walls=self.per == "body")
        if self.from_faces == "all":
            return surface
        up = surface.normals[:, 2]
        top, bottom = up >= STEEP - ROUNDING, up <= -STEEP + ROUNDING
        faces = {"top": top, "bottom": bottom, "sides": ~(top | bottom)}[self.from_faces]
        if not faces.any():
            raise JobError(
                f"{mesh.file} has no {self.from_faces} faces to measure a distance from: none of its normals is "
                + ("further than 45° from z" if self.from_faces == "sides" else "that near to z"),
                hint="leave out from_faces, or name others of top, bottom and sides",
            )
        return surface.only(faces)


@dataclass(frozen=True, eq=False)
class DepthSampler:
    """from_ at the surface, to at depth_mm below it and deeper, linear between, by depths at nodes.

    Attributes:
        depths: mm below the surface, negative outside; of one channel.
    """

    depths: Nodes
    depth_mm: float
    from_: float
    to: float
    texels: None = None

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Everywhere, or nowhere if both values are the same."""
        apart = self.from_ != self.to
        return (apart, apart, apart)

    @property
    def bounds(self) -> tuple[float, float]:
        """Both values."""
        return (min(self.from_, self.to), max(self.from_, self.to))

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points; outside the part as at its surface."""
        if self.from_ == self.to:
            return np.asarray(self.from_)
        return blend(np.clip(self.depths.at(x, y, z)[0] / self.depth_mm, 0.0, 1.0), self.from_, self.to)

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """One sample of weight 1 per point: an angle by depth is a plain number."""
        return one_tap(self.scalar(x, y, z), x)
