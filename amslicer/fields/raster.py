"""A field on a raster of pixels that is linear between texels, along the rows and along the columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Along = tuple[NDArray[np.int64], NDArray[np.int64], Floats]


@dataclass(frozen=True)
class Raster:
    """Texels of one height, and where pixels lie between them: what a device needs to interpolate.

    Attributes:
        texels: (texel rows, texel columns) values.
        columns: (C,) each: texel below, texel above and the share between them, of the pixels' columns.
        rows: (R,) each: the same of the pixels' rows.
    """

    texels: NDArray[np.floating]
    columns: Along
    rows: Along

    def spread(self, rows: int, columns: int) -> Raster:
        """The same for more pixels, along whichever axis there is one texel."""

        def along(neighbours: Along, count: int) -> Along:
            if len(neighbours[0]) == count:
                return neighbours
            zero = np.zeros(count, np.int64)
            return zero, zero, np.zeros(count)

        return Raster(self.texels, along(self.columns, columns), along(self.rows, rows))

    @property
    def is_plain(self) -> bool:
        """Whether the texel above a column is the next one, wherever it counts."""
        below, above, share = self.columns
        return bool(np.all((above == below + 1) | (share == 0)))

    def used(self) -> Raster:
        """The same with the rows of texels alone that lie between pixels."""
        below, above, share = self.rows
        first, end = int(below.min()), int(above.max()) + 1
        return Raster(
            np.asarray(self.texels[first:end], np.float32), self.columns, (below - first, above - first, share)
        )


@runtime_checkable
class Rastered(Protocol):
    """A sampler that can give its texels to a device."""

    def raster(self, x: Floats, y: Floats, z: Floats) -> Raster | None:
        """The field on the raster of (1, C) x and (R, 1) y at one z; None where it is no such field there."""


def raster_of(values: NDArray[np.floating]) -> Raster:
    """(R, C) values that are the pixels' own."""
    rows, columns = (np.arange(count) for count in values.shape)
    return Raster(
        np.asarray(values, np.float32), (columns, columns, np.zeros(len(columns))), (rows, rows, np.zeros(len(rows)))
    )
