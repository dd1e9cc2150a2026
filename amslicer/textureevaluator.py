"""Evaluates random-phase textures at the nodes of tiles with OpenCL: two textures, between which a plane lies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.evaluator import asked_for, work_shape

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.noise.textures import RandomPhase
    from amslicer.tiles import Tiling

    Floats = NDArray[np.float64]

KEPT_BYTES = 1 << 30  # of textures: all that a block of layers lies between, of large parts
PLACE = np.dtype([("whole", np.int32, 2), ("part", np.float32, 2)])  # cl/texture.cl: struct Place


class Textures:
    """The textures that the device holds, shared by all blocks of a job."""

    def __init__(self, device: Device, noise: RandomPhase) -> None:
        self._device, self.noise = device, noise
        self._buffers: dict[int, Any] = {}

    def buffer(self, step: int) -> Any:
        """A step's texture on the device; the last few are kept."""
        if step not in self._buffers:
            most = max(2, KEPT_BYTES // (4 * self.noise.spot.size))
            while len(self._buffers) >= most:
                del self._buffers[next(iter(self._buffers))]
            self._buffers[step] = self._device.buffer(self.noise.texture(step))
        return self._buffers[step]


class TextureEvaluator:
    """A texture at the planes of nodes of a block of layers.

    Args:
        device: an open device.
        textures: the job's.
        tiles: (T, 2) tiles to evaluate.
        tiling: the tiles' nodes.
        block: number of the block of layers.
    """

    def __init__(
        self, device: Device, textures: Textures, tiles: NDArray[np.int32], tiling: Tiling, block: int
    ) -> None:
        self.device, self._textures, self._tiles, self._tiling, self._block = device, textures, tiles, tiling, block
        self._nodes = tiling.nodes[0].count
        x, y, _ = tiling.nodes
        pixel = textures.noise.pixel_mm
        # Of each tile's first node, counted from the centre of the texture's first pixel.
        place = (tiles * tiling.sides_mm + (x.start_mm, y.start_mm)) / pixel - 0.5
        places = np.zeros(len(tiles), PLACE)
        places["part"] = place - np.floor(place)
        places["whole"] = np.mod(np.floor(place), textures.noise.spot.shape[::-1])
        self._places = device.buffer(places)
        self._steps = np.array([x.step_mm / pixel, y.step_mm / pixel], np.float32)

    @property
    def floats_per_plane(self) -> int:
        """Size of G of one plane: real and imaginary part at every node of every tile."""
        return len(self._tiles) * self._nodes**2 * 2

    def field(
        self, first: int, count: int, some: range | None = None, needed: Any = None, out: Any = None
    ) -> tuple[Any, NDArray[np.uint32]]:
        """As of amslicer.evaluator.Evaluator: values as the real part of a field."""
        some, needed, out = asked_for(self.device, len(self._tiles), self._nodes, count, some, needed, out)
        noise, z = self._textures.noise, self._tiling.nodes[2]
        rows, columns = noise.spot.shape
        kernel = self.device.kernel("texture", work_shape(self.device, self._nodes))
        for plane in range(count) if len(some) else ():
            step, share = noise.place(self._block * z.side_mm + z.start_mm + (first + plane) * z.step_mm)
            lower = self._textures.buffer(step)
            upper = self._textures.buffer(step + 1) if share else lower
            kernel(
                self.device.queue, (len(some),), (1,), out, needed, self._places, lower, upper, np.float32(share),
                np.array([columns, rows], np.int32), self._steps, np.uint32(some.start), np.uint32(plane),
                np.uint32(count),
            )  # fmt: skip
        return out, np.arange(len(some), dtype=np.uint32)
