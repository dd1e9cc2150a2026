"""Shares of all materials by a picture that has one colour per material.

    ratio: {map: materials.png}                                        in the materials' own colours
    ratio: {map: materials.png, colors: {rigid: "#2b6cb0"}, dominant: 0.8, plane: xz, box: [x0, z0, x1, z1]}

Where the picture has a material's colour, that one has the share `dominant`, and the others have equal shares of what
is left (`void` is one of them where it is listed). Between texel centres the shares change linearly from one to the
other, and always sum to 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from amslicer.errors import JobError
from amslicer.fields.image import ImageSampler, Placed
from amslicer.fields.opening import BedSampler
from amslicer.fields.pictures import RGB, read_picture
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.pictures import Texels

COLOR = r"^#[0-9A-Fa-f]{6}$"
NONE = 255  # no material's number: there are 8
HINT = "paint with the materials' exact colours, without soft edges (no antialiasing, no JPEG on the way)"


class MaterialMap(Placed):
    """One colour per dominant material."""

    map: str = Field(min_length=1, description="8-bit RGB PNG or TIFF, relative to the job file")
    colors: Annotated[
        dict[str, Annotated[str, Field(pattern=COLOR)]],
        Field(json_schema_extra={"propertyNames": {"minLength": 1}}),
    ] = Field(default={}, description="colour in the picture by material, #rrggbb; default: the material's own")
    dominant: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=1.0, description="share of the material whose colour it is; the others share the rest evenly"
    )

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """Refused: it is no single number.

        Raises:
            JobError: always.
        """
        raise JobError(
            f"the material map '{self.map}' gives the shares of all materials, and one number is asked for",
            hint="use it as fields.ratio as a whole",
        )

    def colors_of(self, materials: Sequence[tuple[str, str]]) -> list[str]:
        """The colour of each of (name, own colour) materials in the picture, #rrggbb in lower case.

        Raises:
            JobError: a colour is given for something else, or two materials have the same.
        """
        names = [name for name, _ in materials]
        for name in self.colors:
            if name not in names:
                raise JobError(
                    f"the material map '{self.map}' has a color for '{name}', and there is no such material",
                    hint=f"the materials are {', '.join(names)}",
                )
        colors = [self.colors.get(name, own).lower() for name, own in materials]
        for i, color in enumerate(colors):
            first = colors.index(color)
            if first < i:
                raise JobError(
                    f"the material map '{self.map}' has the color {color} for both {names[first]} and {names[i]}",
                    hint=f"give one of them another: colors: {{{names[i]}: '#rrggbb'}}",
                )
        return colors

    def open_shares(self, frame: Frame, inputs: Inputs, materials: Sequence[tuple[str, str]]) -> tuple[Sampler, ...]:
        """The share of each material over a part; they sum to 1.

        Args:
            materials: (name, own colour) of the job's.

        Raises:
            JobError: the picture cannot be used, or has a colour that belongs to no material.
        """
        colors = self.colors_of(materials)
        texels, _ = read_picture(inputs.read(self.map), self.map, RGB)
        numbers = _numbers(texels, self.map, [name for name, _ in materials], colors)[::-1]
        placement = frame.placement if self.frame == "bed" else None
        if placement is not None:
            frame = Frame(placement.origin_mm, placement.size_mm)
        rectangle = self.rectangle(frame)
        others = (1.0 - self.dominant) / (len(colors) - 1)
        shares: list[Sampler] = []
        for m in range(len(colors)):
            table = np.full(len(colors), others)
            # No level has that share of a material that is nowhere dominant, so that the bounds are exact.
            table[m] = self.dominant if (numbers == m).any() else others
            shares.append(ImageSampler(numbers, table, rectangle))
        return tuple(shares if placement is None else (BedSampler(share, placement) for share in shares))

    def paths(self) -> tuple[str, ...]:
        """The picture's path."""
        return (self.map,)

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same map with its picture elsewhere."""
        return self.model_copy(update={"map": renamed.get(self.map, self.map)})


def _numbers(texels: Texels, name: str, materials: Sequence[str], colors: Sequence[str]) -> NDArray[np.uint8]:
    """(rows, columns) number of each texel's material, the top row first.

    Raises:
        JobError: a texel has no material's colour.
    """
    codes: NDArray[np.uint32] = np.zeros(texels.shape[:2], np.uint32)
    for channel in range(3):
        codes = np.left_shift(codes, 8) | texels[..., channel]
    known = [int(color[1:], 16) for color in colors]
    numbers = np.full(codes.shape, NONE, np.uint8)
    for m, code in enumerate(known):
        numbers[codes == code] = m
    wrong = numbers == NONE
    if wrong.any():
        row, column = (int(i) for i in np.unravel_index(np.argmax(wrong), wrong.shape))
        code = int(codes[row, column])
        found = np.array([code >> 16, code >> 8 & 255, code & 255])
        away = [np.linalg.norm(found - [c >> 16, c >> 8 & 255, c & 255]) for c in known]
        nearest = int(np.argmin(away))
        count, total = int(np.count_nonzero(codes == code)), int(np.count_nonzero(wrong))
        more = f"; {total} pixels have no material's colour" if total > count else ""
        raise JobError(
            f"the material map '{name}' has the colour #{code:06x} at column {column}, row {row} ({count} pixel"
            f"{'s' if count > 1 else ''}{more}), which belongs to no material; the nearest is {colors[nearest]} of "
            f"{materials[nearest]}",
            hint=HINT,
        )
    return numbers
