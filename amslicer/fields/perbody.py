"""A field for each of the part's bodies.

    {per_body: {sole: FIELD, upper: FIELD}}
    {per_body: {"1": FIELD, rest: FIELD}}

Bodies are the named objects of a 3MF, OBJ or GLB file; of other files the outward surfaces, called "1", "2", … in the
order of their first triangles (amslicer/bodynames.py). A place belongs to the body that its pixel belongs to; a place
outside all of them takes the one next to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from amslicer.errors import JobError
from amslicer.fields.choice import ChoiceOfLines, ChoiceSampler
from amslicer.fields.opening import open_field, open_orientation
from amslicer.fields.source import Frame, Inputs, Sampler, Source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from amslicer.bodies import BodyIndex
    from amslicer.fields import FieldSpec
    from amslicer.fields.choice import Which
    from amslicer.fields.orientation import Orientation

    Floats = NDArray[np.float64]

REST = "rest"  # of the bodies: those that are not named
COARSE = 256  # pixels along the longest side, where the printer's are not known


class PerBodySource(Source):
    """One field per body of the part."""

    per_body: dict[str, FieldSpec] = Field(
        min_length=1,
        description="a field for each body of the part, by name; `rest` for those that are not named",
        json_schema_extra={"propertyNames": {"minLength": 1}},
    )

    @property
    def needs_part(self) -> bool:
        """Always."""
        return True

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The numbers over a part.

        Raises:
            JobError: the part has no such body, or one that has no field.
        """
        index, keys, number = self._bodies(frame)
        opened = {key: open_field(spec, frame, inputs) for key, spec in self.per_body.items()}
        used = [opened[key] for key in keys]
        if len(used) == 1:
            return used[0]
        return ChoiceSampler(used, _which(index, number, frame), (True, True, True))

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The directions over a part; raises as open does."""
        index, keys, number = self._bodies(frame)
        opened = {key: open_orientation(spec, frame, inputs) for key, spec in self.per_body.items()}
        used = [opened[key] for key in keys]
        if len(used) == 1:
            return used[0]
        return ChoiceOfLines(used, _which(index, number, frame), (True, True, True))

    def _bodies(self, frame: Frame) -> tuple[Callable[[], BodyIndex], list[str], NDArray[np.int64]]:
        """Where the bodies are, the keys of the fields that they have, and per body which of these."""
        from amslicer.bodies import body_index
        from amslicer.bodynames import find_bodies, listed
        from amslicer.grid import cover
        from amslicer.placement import place

        mesh = frame.part("per_body").mesh
        bodies = find_bodies(mesh)
        bodies.numbers([key for key in self.per_body if key != REST], "per_body")
        keys = [name if name in self.per_body else REST for name in bodies.names]
        if REST not in self.per_body and REST in keys:
            bare = [name for name, key in zip(bodies.names, keys, strict=True) if key == REST]
            raise JobError(
                f"per_body: the body {listed(bare[:1])} of the part has no field"
                + (f", and {len(bare) - 1} more have none" if len(bare) > 1 else ""),
                hint=f"give it one, or {REST}: FIELD for all that are not named",
            )
        used = list(dict.fromkeys(keys))

        def index() -> BodyIndex:
            placement = frame.placement or place(mesh)[0]
            pixel_mm = float(placement.size_mm.max()) / COARSE
            grid = frame.grid or cover(placement.size_mm.tolist(), (pixel_mm, pixel_mm), pixel_mm)
            return body_index(mesh, placement, grid, frame.body_priorities)

        return index, used, np.array([used.index(key) for key in keys])


def _which(make_index: Callable[[], BodyIndex], number: NDArray[np.int64], frame: Frame) -> Which:
    """Per place the number of the field that its body has."""
    from amslicer.placement import place

    index = make_index()
    placement = frame.placement or place(index.mesh)[0]

    def which(x: Floats, y: Floats, z: Floats) -> NDArray[np.int64]:
        found: NDArray[np.int64] = number[index.at(*placement.to_pattern(x, y, z))]
        return found

    return which
