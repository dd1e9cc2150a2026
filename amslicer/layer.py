"""One layer of a stack: labels to look at and work with, bitmaps as they are made and written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import UsageError

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Layer:
    """The materials of one layer's pixels.

    Attributes:
        index: counts from the part's first layer.
        z_mm: mid-height in the printer frame.
        labels: (H, W) uint8, row 0 = largest y; 0 empty, m = material m (1-based).
        materials: names, in order.
    """

    index: int
    z_mm: float
    labels: NDArray[np.uint8]
    materials: tuple[str, ...]

    def mask(self, material: str) -> NDArray[np.bool_]:
        """(H, W) where this material is.

        Raises:
            UsageError: there is no such material.
        """
        if material not in self.materials:
            raise UsageError(
                f"there is no material '{material}' in this layer",
                hint=f"there are: {', '.join(self.materials)}",
            )
        return np.asarray(self.labels == self.materials.index(material) + 1)

    def pixels(self) -> dict[str, int]:
        """Pixels per material."""
        return {name: int(np.count_nonzero(self.labels == m)) for m, name in enumerate(self.materials, 1)}


@dataclass(frozen=True, eq=False)
class Bitmaps:
    """A layer as a printer takes it: a bitmap for each material.

    Attributes:
        index, z_mm, materials: as of Layer.
        width_px: pixels per row.
        rows: (materials, height, bytes) uint8, row 0 = largest y; a bit per pixel, the highest first, 0 beyond the
            width.
    """

    index: int
    z_mm: float
    materials: tuple[str, ...]
    width_px: int
    rows: NDArray[np.uint8]

    def layer(self) -> Layer:
        """The same as labels."""
        bits = np.unpackbits(self.rows, axis=-1, count=self.width_px)
        labels = np.zeros(bits.shape[1:], np.uint8)
        for m, bit in enumerate(bits, 1):
            labels += np.uint8(m) * bit
        return Layer(self.index, self.z_mm, labels, self.materials)

    def pixels(self) -> dict[str, int]:
        """Pixels per material."""
        return {name: _count_bits(rows) for name, rows in zip(self.materials, self.rows, strict=True)}


def _count_bits(rows: NDArray[np.uint8]) -> int:
    """Set bits; 64 at a time."""
    flat = np.ascontiguousarray(rows).ravel()
    whole = flat.size // 8 * 8
    counts = [np.bitwise_count(part).sum(dtype=np.int64) for part in (flat[:whole].view(np.uint64), flat[whole:])]
    return int(sum(counts))
