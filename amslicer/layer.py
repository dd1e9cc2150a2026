"""One layer of a stack, whatever it came from or goes to."""

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
