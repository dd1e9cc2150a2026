"""What of a part is of one material whatever the pattern says: bodies with their own, skins, cavities."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

from amslicer.mask import Runs
from amslicer.skin import Skin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.mask import Slicer

    Bools = NDArray[np.bool_]

LAYERS_AT_ONCE = 8  # sliced together
KEPT = 32  # layers whose labels are kept
NO_BODY = -1


@dataclass(frozen=True, eq=False)
class Regions:
    """Pixels of given materials, layer by layer, in any order and thread.

    Attributes:
        slicer: of the whole part.
        body_labels: (rows, columns) body of each pixel of a layer, or NO_BODY; None where no body has a material.
        body_material: material of each body, from 1 on; 0 where it has the pattern.
        void: number of the material that stands for nothing; 0 where there is none.
        skin: (material, thickness, top and bottom in mm).
    """

    slicer: Slicer
    grid: Grid
    body_labels: Callable[[int], NDArray[np.int16]] | None = None
    body_material: tuple[int, ...] = ()
    void: int = 0
    skin: tuple[int, float, float, float] | None = None
    _solid: OrderedDict[int, Bools] = field(default_factory=OrderedDict)
    _labels: OrderedDict[int, NDArray[np.uint8]] = field(default_factory=OrderedDict)
    _skins: list[Skin] = field(default_factory=list)
    _lock: RLock = field(default_factory=RLock)

    def labels(self, layer: int) -> NDArray[np.uint8]:
        """(rows, columns) material of each pixel, from 1 on; 0 where the pattern decides, and outside the part."""
        with self._lock:
            if layer not in self._labels:
                labels = self._of_bodies(layer)
                if self.skin is not None:
                    labels[self._skin.of_layer(layer)] = self.skin[0]
                self._labels[layer] = labels
                while len(self._labels) > KEPT:
                    self._labels.popitem(last=False)
            return self._labels[layer]

    def solid(self, layer: int) -> Bools:
        """(rows, columns) what the mesh winds around."""
        with self._lock:
            if layer not in self._solid:
                first = layer // LAYERS_AT_ONCE * LAYERS_AT_ONCE
                end = min(first + LAYERS_AT_ONCE, self.grid.layers)
                self._solid.update(zip(range(first, end), self.slicer.runs(first, end).solid(), strict=True))
                while len(self._solid) > 2 * LAYERS_AT_ONCE:
                    self._solid.popitem(last=False)
            return self._solid[layer]

    def split(self, runs: Runs, first: int) -> tuple[Runs, dict[int, NDArray[np.uint8]]]:
        """Solid pixels apart: those that the pattern decides, and those of each given material.

        Args:
            runs: the solid pixels of some layers.
            first: the part's number of the first of them.

        Returns:
            Runs of the pattern's pixels; per material (layers, rows, bytes) bits, the highest first.
        """
        solid = runs.solid()
        labels = np.stack([self.labels(first + layer) for layer in range(runs.layers)])
        given = {int(m): np.packbits((labels == m) & solid, axis=-1) for m in np.unique(labels) if m}
        return runs_of(solid & (labels == 0), self.grid, runs.overlap_px), given

    @property
    def _skin(self) -> Skin:
        if not self._skins:
            assert self.skin is not None
            self._skins.append(Skin(self._printed, self.grid, *self.skin[1:]))
        return self._skins[0]

    def _printed(self, layer: int) -> Bools:
        """What is solid and no cavity: a skin goes around cavities too."""
        solid = self.solid(layer)
        return solid & (self._of_bodies(layer) != self.void) if self.void and self.body_labels else solid

    def _of_bodies(self, layer: int) -> NDArray[np.uint8]:
        if self.body_labels is None:
            return np.zeros((self.grid.rows, self.grid.columns), np.uint8)
        materials = np.array([*self.body_material, 0], np.uint8)  # the last stands for NO_BODY
        return materials[self.body_labels(layer)]


def runs_of(solid: Bools, grid: Grid, overlap_px: NDArray[np.int64] | None) -> Runs:
    """Runs of (layers, rows, columns) pixels."""
    edges = np.diff(np.pad(solid.reshape(-1, grid.columns), ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(edges > 0)
    _, stop = np.nonzero(edges < 0)
    return Runs(len(solid), grid, row, start, stop, overlap_px)
