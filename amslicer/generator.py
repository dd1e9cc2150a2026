"""Random words and sums over random points, on an open device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.device import Device
    from amslicer.noise.alignment import Neighbours

    Floats = NDArray[np.float64]


class DeviceGenerator:
    """amslicer.noise.kernels.Generator with OpenCL, beside what else the device does. In one thread at a time."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._queue = device.other_queue()

    def words(
        self, first: tuple[int, int, int], count: tuple[int, int, int], per_cell: int, seed: int, number: int
    ) -> NDArray[np.uint32]:
        """(cells z, cells y, cells x, per_cell, 4) random words of a box of cells."""
        words = np.empty((count[2], count[1], count[0], per_cell, 4), np.uint32)
        buffer = self.device.empty(words.nbytes)
        self.device.run(
            self.device.kernel("impulses"), words.size // 4, buffer, np.array([*first, 0], np.int32),
            np.array([*count, per_cell], np.uint32), np.array([seed & 0xFFFFFFFF, seed >> 32], np.uint32),
            np.uint32(number), queue=self._queue,
        )  # fmt: skip
        self.device.read(buffer, words, self._queue)
        return words

    def normal_fields(
        self, places: Floats, cells: NDArray[np.int64], points: NDArray[np.float32], weights: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """(N, 4) fields that are N(0, 1) at each place."""
        count = len(places)
        fields = np.empty((count, 4), np.float32)
        buffer = self.device.empty(fields.nbytes)
        padded = np.zeros((*points.shape[:-1], 4), np.float32)
        padded[..., :3] = points
        z, y, x, per_cell = points.shape[:4]
        self.device.run(
            self.device.kernel("normal_fields"), count, buffer, self.device.buffer(_four(places, np.float32)),
            self.device.buffer(_four(cells, np.int32)), self.device.buffer(padded), self.device.buffer(weights),
            np.array([x, y, z, per_cell], np.uint32), np.uint32(count), np.uint32(z == 1),
            queue=self._queue,
        )  # fmt: skip
        self.device.read(buffer, fields, self._queue)
        return fields

    def aligned(
        self, neighbours: Neighbours, z: NDArray[np.complex64], known: NDArray[np.bool_], sweeps: int
    ) -> NDArray[np.complex64]:
        """exp(iφ) of kernels after phase alignment."""
        device, count, queue = self.device, len(z), self._queue
        n = neighbours
        tables = [device.buffer(a) for a in (n.places, n.waves, n.normals, n.grids, n.shapes, n.reaches, n.cells)]
        sizes = np.int32(len(n.reaches)), np.uint32(count), np.float32(n.dimensions), np.float32(n.least)
        counts = np.empty(count, np.uint32)
        counted, unused = device.empty(counts.nbytes), device.empty(4)
        find = device.kernel("neighbours")
        device.run(find, count, counted, unused, unused, unused, *tables, *sizes, np.uint32(0), queue=queue)
        device.read(counted, counts, queue)
        ends = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        starts = device.buffer(ends.astype(np.uint32))
        entries, overlaps = (device.empty(size * int(ends[-1])) for size in (4, 8))
        device.run(find, count, counted, starts, entries, overlaps, *tables, *sizes, np.uint32(1), queue=queue)
        before, after = device.empty(z.nbytes), device.empty(z.nbytes)
        known_before = device.buffer(known.astype(np.uint8))
        device.write(before, z, queue)
        for number in range(sweeps + 1):
            device.run(
                device.kernel("sweep"), count, after, before, starts, counted, entries, overlaps,
                known_before, np.uint32(number == 0), np.uint32(count), queue=queue,
            )  # fmt: skip
            before, after = after, before
        out = np.empty_like(z)
        device.read(before, out, queue)
        return out


def _four(values: NDArray[np.generic], kind: type[np.generic]) -> NDArray[np.generic]:
    """(N, 3) values as OpenCL's vectors of four."""
    out = np.zeros((len(values), 4), kind)
    out[:, :3] = values
    return out
