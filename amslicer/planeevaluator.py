"""Evaluates cells between random planes at the nodes of tiles with OpenCL, as evaluator.py does G."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.evaluator import asked_for, work_shape
from amslicer.generator import DeviceGenerator
from amslicer.noise.hyperplanes import CELL, WAVE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.noise.hyperplanes import Hyperplanes, Stacks
    from amslicer.tiles import Tiling

    Floats = NDArray[np.float64]

FRACTION = 40  # bits behind the point: 300 000 tiles add up to 1e-7 spacings; 23 bits before it
# cl/hyperplanes.cl: structs Stack and Family
STACK = np.dtype([("across", np.int64), ("down", np.int64), ("at", np.int64), ("xyz", np.float32, 3),
                  ("plane", np.float32)])  # fmt: skip
FAMILY = np.dtype([("stack", STACK), ("first", np.int32), ("table", np.uint32), ("name", np.uint32),
                   ("padding", np.uint32)])  # fmt: skip


class PlaneEvaluator:
    """The planes of a block of layers, on the device, ready to give values at the planes of nodes in it.

    Evaluators of one device share its scratch buffers: use one at a time.

    Args:
        device: an open device.
        planes: the pattern.
        tiles: (T, 2) tiles to evaluate.
        tiling: the tiles' nodes.
        block: number of the block of layers.
        planar: the same in all layers: that of z = 0.
    """

    def __init__(
        self, device: Device, planes: Hyperplanes, tiles: NDArray[np.int32], tiling: Tiling, block: int, *,
        planar: bool,
    ) -> None:  # fmt: skip
        self.device = device
        self.planes = planes
        self.tiles = tiles
        self._nodes = tiling.nodes[0].count
        x, y, z = tiling.nodes
        self._steps_mm = np.array([x.step_mm, y.step_mm, 0.0 if planar else z.step_mm])
        self._first_mm = np.array([x.start_mm, y.start_mm, 0.0 if planar else block * z.side_mm + z.start_mm])
        self._sides_mm = tiling.sides_mm
        self._end_mm = np.append(self._steps_mm[:2] * (self._nodes - 1), self._steps_mm[2] * tiling.layers)
        families, slices = self._tables()
        self._buffers = device.buffer(tiles), device.buffer(families), device.buffer(slices)

    @property
    def floats_per_plane(self) -> int:
        """Size of the field of one plane: real and imaginary part at every node of every tile."""
        return len(self.tiles) * self._nodes**2 * 2

    def field(
        self, first: int, count: int, some: range | None = None, needed: Any = None, out: Any = None
    ) -> tuple[Any, NDArray[np.uint32]]:
        """Enqueues the values in the block's planes first … first + count - 1, as the real part of a field.

        Args:
            some: a run of the listed tiles; None means all.
            needed: a buffer, (T, count) uint8, a bit for each ROWS rows of nodes of a tile that are wanted in each
                plane; elsewhere are any values. None means all of them.
            out: a buffer of its own; None lends one that the next call overwrites.

        Returns:
            The buffer, float32 [planes][tiles][rows of a tile][value, 0][columns of a tile], and each tile's number
            in it.
        """
        some, needed, out = asked_for(self.device, len(self.tiles), self._nodes, count, some, needed, out)
        if len(some):
            planes, (tiles, families, slices) = self.planes, self._buffers
            self.device.kernel("hyperplanes", work_shape(self.device, self._nodes))(
                self.device.queue, (count, len(some)), (1, 1), out, tiles, needed, families, slices,
                np.uint32(planes.directions), np.uint32(planes.levels), np.float32(planes.spacing_mm),
                np.append(self._steps_mm, 0).astype(np.float32),
                np.array([planes.seed & 0xFFFFFFFF, planes.seed >> 32], np.uint32), np.array([WAVE, CELL], np.uint32),
                np.float32(planes.probability), np.uint32(planes.numbered), np.uint32(first),
                np.uint32(some.start),
            )  # fmt: skip
        return out, np.arange(len(some), dtype=np.uint32)

    def _tables(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The families, and the waves of all their slices that the tiles can meet: FAMILY, STACK."""
        planes, draw = self.planes, DeviceGenerator(self.device)
        corners = self._corners()
        stacks, names = planes.slices(draw), planes.names()
        families, slices = np.zeros(len(names), FAMILY), []
        families["stack"], families["name"] = self._stacks(stacks), names
        table = 0
        for family, name, direction, offset in zip(families, names, stacks.direction, stacks.offset, strict=True):
            place = corners @ direction / planes.spacing_mm + offset
            # cl/hyperplanes.cl begins up to two spacings before a tile and looks one plane beyond it.
            first = int(np.floor(place.min())) - 2
            count = int(np.floor(place.max())) + 3 - first
            waves, words = planes.waves(draw, int(name), first, count)
            of_slices = self._stacks(waves)
            of_slices["plane"] = (words >> np.uint32(8)) * 2.0**-24
            slices.append(of_slices)
            family["first"], family["table"] = first, table
            table += count
        return families, np.concatenate(slices)

    def _corners(self) -> Floats:
        """(8, 3) corners of a box around all nodes, mm."""
        tiles = self.tiles if len(self.tiles) else np.zeros((1, 2), np.int32)
        low = np.append(tiles.min(axis=0) * self._sides_mm, 0.0)
        high = np.append(tiles.max(axis=0) * self._sides_mm, 0.0) + self._end_mm
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
        return np.asarray(corners + self._first_mm)

    def _stacks(self, stacks: Stacks) -> NDArray[Any]:
        """Stacks as the device takes them."""
        out = np.zeros(len(stacks.offset), STACK)
        per_mm = stacks.direction / self.planes.spacing_mm
        for name, place in (
            ("across", per_mm[:, 0] * self._sides_mm[0]), ("down", per_mm[:, 1] * self._sides_mm[1]),
            ("at", per_mm @ self._first_mm + stacks.offset),
        ):  # fmt: skip
            out[name] = np.rint(place * 2.0**FRACTION)
        out["xyz"] = stacks.direction
        return out
