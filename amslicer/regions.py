"""What of a part is of one material whatever the pattern says: bodies with their own, skins, cavities."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.mask import Runs, join_runs
from amslicer.skin import Skin, ends_of_runs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.mask import Slicer

    Bools = NDArray[np.bool_]

LAYERS_AT_ONCE, KEPT = 16, 256  # layers that are sliced together, and whose runs are kept
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
    _runs: OrderedDict[int, Runs] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def labels(self, layer: int) -> NDArray[np.uint8]:
        """(rows, columns) material of each pixel, from 1 on; 0 where the pattern decides, and outside the part."""
        labels = self._of_bodies(layer)
        if self.skin is not None:
            labels[self._skin.of_layer(layer)] = self.skin[0]
        return labels

    def solid(self, layer: int) -> Bools:
        """(rows, columns) what the mesh winds around."""
        with self._lock:
            if layer not in self._runs:
                first = layer // LAYERS_AT_ONCE * LAYERS_AT_ONCE
                end = min(first + LAYERS_AT_ONCE, self.grid.layers)
                runs = self.slicer.runs(first, end)
                self._runs.update({first + i: runs.part(i, i + 1) for i in range(end - first)})
                while len(self._runs) > KEPT:
                    self._runs.popitem(last=False)
            found = self._runs[layer]
        out: Bools = found.solid()[0]
        return out

    def split(
        self, runs: Runs, first: int, each: Callable[..., Iterable[Any]] = map
    ) -> tuple[Runs, dict[int, NDArray[np.uint8]]]:
        """Solid pixels apart: those that the pattern decides, and those of each given material.

        Args:
            runs: the solid pixels of some layers.
            first: the part's number of the first of them.
            each: like map; over threads it is that much faster.

        Returns:
            Runs of the pattern's pixels; per material (layers, rows, bytes) bits, the highest first.
        """
        if self.skin is not None:
            self._skin.prepare(first, first + runs.layers, each)
        apart = list(each(lambda layer: self._apart(runs.part(layer, layer + 1), first + layer), range(runs.layers)))
        given = {m: np.stack([of_layer[m] for _, of_layer in apart]) for m in self._materials}
        return replace(join_runs([pattern for pattern, _ in apart]), overlap_px=runs.overlap_px), given

    def _apart(self, runs: Runs, layer: int) -> tuple[Runs, dict[int, NDArray[np.uint8]]]:
        """As split, of one layer."""
        solid, labels = runs.solid()[0], self.labels(layer)
        given = {m: np.packbits((labels == m) & solid, axis=-1) for m in self._materials}
        return runs_of((solid & (labels == 0))[None], self.grid, runs.overlap_px), given

    @property
    def _materials(self) -> list[int]:
        """Those that pixels may be given."""
        return sorted({*self.body_material, *(self.skin or ())[:1]} - {0})

    @cached_property
    def _skin(self) -> Skin:
        assert self.skin is not None
        return Skin(self._printed, self.grid, *self.skin[1:])

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
    return Runs(len(solid), grid, *ends_of_runs(solid.reshape(-1, grid.columns)), overlap_px)
