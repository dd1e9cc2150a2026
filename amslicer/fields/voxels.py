"""Samples on a grid in space, read as numbers or lines: trilinear, clamped outside, always z first, then x, then y.

The order is the same for a raster and for single points, so that a value does not depend on who else asks. An array
stays in its own number type, and in its file where it is mapped: only what is looked at becomes floats.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from amslicer.errors import JobError
from amslicer.fields.orientation import tensors_of, unit_vectors
from amslicer.fields.raster import Raster
from amslicer.fields.source import blend
from amslicer.fields.tensors import eigenlines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

VECTOR_COMPONENTS, TENSOR_COMPONENTS = 3, 6
SCAN_BYTES = 4 << 20  # looked at a time: fits a processor's cache
KEPT_BYTES = 64 << 20  # of blended planes: those of the layers that threads work on
MOST_IN_SINGLES = 8.0  # values up to here keep half a millionth in single precision: less than a level of 16 bits
SINGLE_SCALES = (1e-30, 1e30)  # per sample: the samples themselves are then numbers in single precision


@dataclass(frozen=True)
class Reader:
    """Samples of the file's type to values.

    Attributes:
        full_scale: what counts as 1.
        range: values of 0 and 1.
        component: which one of samples that have several; all where it is None.
    """

    full_scale: float
    range: tuple[float, float]
    component: int | Literal["magnitude"] | None = None

    def __call__(self, samples: NDArray[Any]) -> Floats:
        """Values of (…) or (…, C) samples."""
        t = self.chosen(samples).astype(np.float64)
        if self.full_scale != 1:
            t = t / self.full_scale
        values = t if self.range == (0.0, 1.0) else blend(t, *self.range)
        return np.sqrt((values * values).sum(axis=-1)) if self.component == "magnitude" else values

    def chosen(self, samples: NDArray[Any]) -> NDArray[Any]:
        """The samples, or their one component."""
        return samples[..., self.component] if isinstance(self.component, int) else samples

    def ends(self, samples: NDArray[Any]) -> tuple[float, float]:
        """The smallest and the largest value."""
        if self.component == "magnitude":
            values = self(samples)
        else:  # values follow the samples: only two need to be made
            some = self.chosen(samples)
            values = Reader(self.full_scale, self.range)(np.stack([some.min(), some.max()]))
        return float(values.min()), float(values.max())


@dataclass(frozen=True)
class Axis:
    """Samples along one axis of the field frame.

    Attributes:
        count: how many.
        first_mm: place of the first.
        step_mm: between two.
        varies: whether they differ along it.
    """

    count: int
    first_mm: float
    step_mm: float
    varies: bool

    def neighbours(self, position: Floats) -> tuple[Indices, Indices, Floats]:
        """Sample below, sample above and the share between them."""
        place = np.asarray(position, np.float64)
        if not self.varies:
            zero = np.zeros(place.shape, np.int64)
            return zero, zero, np.zeros(place.shape)
        along = np.clip((place - self.first_mm) / (self.step_mm or 1.0), 0.0, self.count - 1.0)
        below = np.minimum(along.astype(np.int64), self.count - 2)
        return below, below + 1, along - below


@dataclass(frozen=True, eq=False)
class Voxels:
    """(z, y, x) or (z, y, x, C) samples and their places along x, y, z."""

    array: NDArray[Any]
    axes: tuple[Axis, Axis, Axis]

    def corners(self, read: Reader, x: Floats, y: Floats, z: Floats) -> tuple[list[Floats], list[Floats]]:
        """Values of the eight samples around each point (z slowest, then y, then x), and shares along x, y, z."""
        (c0, c1, fx), (r0, r1, fy), (p0, p1, fz) = (a.neighbours(v) for a, v in zip(self.axes, (x, y, z), strict=True))
        v = self.array
        return [read(v[p, r, c]) for p in (p0, p1) for r in (r0, r1) for c in (c0, c1)], [fx, fy, fz]

    def weights(self, shares: list[Floats]) -> Floats:
        """(8, N) trilinear weights, in the order of `corners`."""
        fx, fy, fz = shares
        return np.stack([a * b * c for a in (1 - fz, fz) for b in (1 - fy, fy) for c in (1 - fx, fx)])


@dataclass(frozen=True)
class Scan:
    """What is known of an array after looking at all of it.

    Attributes:
        bounds: the smallest and the largest value.
        varies: whether samples differ along x, y, z.
    """

    bounds: tuple[float, float]
    varies: tuple[bool, bool, bool]


def scan(array: NDArray[Any], read: Reader, name: str) -> Scan:
    """Looks at all samples once, some planes at a time.

    Raises:
        JobError: one is not finite; the message says which.
    """
    lows, highs, varies = [], [], [False, False, False]
    planes = max(1, SCAN_BYTES // max(1, array[0].nbytes))
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, len(array), planes):
            some = array[start : start + planes]
            if array.dtype.kind == "f" and not (np.isfinite(some.min()) and np.isfinite(some.max())):
                first = np.argwhere(~np.isfinite(some))[0]
                index = (int(first[0]) + start, *(int(i) for i in first[1:]))
                axes = ("z", "y", "x", "component")
                where = ", ".join(f"{axis} = {i}" for axis, i in zip(axes, index, strict=False))
                raise JobError(
                    f"the volume '{name}' has {array[index]} at sample {where} (counted from 0)",
                    hint="fill the samples that are no finite numbers, for example with numpy.nan_to_num",
                )
            low, high = read.ends(some)
            lows.append(low)
            highs.append(high)
            chosen = read.chosen(some)
            for axis, first_one in ((2, read.chosen(array[:1])), (1, chosen[:, :1]), (0, chosen[:, :, :1])):
                varies[axis] = varies[axis] or bool((chosen != first_one).any())
    bounds = min(lows), max(highs)
    if not np.isfinite([*bounds, bounds[1] - bounds[0]]).all():
        raise JobError(
            f"the volume '{name}' has values from {bounds[0]:g} to {bounds[1]:g} with range {list(read.range)}",
            hint="scale it down: no length, ratio or angle is so large",
        )
    return Scan(bounds, (varies[0], varies[1], varies[2]))


@dataclass(frozen=True, eq=False)
class VolumeSampler:
    """Numbers on a grid in space. In any thread.

    Attributes:
        bounds: the smallest and the largest value of any sample.
    """

    voxels: Voxels
    read: Reader
    bounds: tuple[float, float]
    _planes: OrderedDict[tuple[int, float], Floats] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the axes along which samples differ."""
        x, y, z = (axis.varies for axis in self.voxels.axes)
        return x, y, z

    @property
    def texels(self) -> Hashable:
        """Volumes of the same size in the same place share their texels."""
        return ("volume", *self.voxels.axes)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Trilinear values, never beyond the bounds; lerp form, so that equal samples give exactly their value."""
        height = np.asarray(z)
        if height.size == 1 and np.broadcast(x, y).size > 1:  # one height: its plane first
            values = self._at_height(x, y, height)
        else:
            (a, b, c, d, e, f, g, h), (fx, fy, fz) = self.voxels.corners(self.read, x, y, z)
            rows = [_lerp(low, high, fz) for low, high in ((a, e), (b, f), (c, g), (d, h))]
            values = _lerp(_lerp(rows[0], rows[1], fx), _lerp(rows[2], rows[3], fx), fy)
        return np.clip(values, *self.bounds)  # rounding leaves them

    def raster(self, x: Floats, y: Floats, z: Floats) -> Raster:
        """The plane at one height, as texels of a raster."""
        columns, rows, heights = self.voxels.axes
        below, above, share = heights.neighbours(z)
        ends = int(below.flat[0]), int(above.flat[0])
        if self._are_singles:
            plane = self._plane_of_singles(*ends, np.float32(share.flat[0]))
        else:  # a range may take large numbers away, which is left to doubles
            plane = self._plane(*ends, float(share.flat[0])).astype(np.float32)
            np.clip(plane, *np.array(self.bounds, np.float32), out=plane)
        c0, c1, fx = columns.neighbours(x[0])
        r0, r1, fy = rows.neighbours(y[:, 0])
        return Raster(plane, (c0, c1, fx), (r0, r1, fy))

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The eight samples around each point and their trilinear weights."""
        samples, shares = self.voxels.corners(self.read, x, y, z)
        return np.stack(samples), self.voxels.weights(shares)

    def _at_height(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at one height; along rows once per row of voxels where the places are a raster."""
        columns, rows, heights = self.voxels.axes
        p0, p1, fz = heights.neighbours(z)
        plane = self._plane(int(p0.flat[0]), int(p1.flat[0]), float(fz.flat[0]))
        (c0, c1, fx), (r0, r1, fy) = columns.neighbours(x), rows.neighbours(y)
        if c0.ndim == r0.ndim == 2 and c0.shape[0] == r0.shape[1] == 1:
            used, place = np.unique([r0[:, 0], r1[:, 0]], return_inverse=True)
            some = plane[used]
            across = _lerp(some[:, c0[0]], some[:, c1[0]], fx)
            low, high = across[place.reshape(2, -1)]
            return _lerp(low, high, fy)
        values = _lerp(_lerp(plane[r0, c0], plane[r0, c1], fx), _lerp(plane[r1, c0], plane[r1, c1], fx), fy)
        return np.broadcast_to(values, np.broadcast_shapes(values.shape, z.shape))

    @property
    def _are_singles(self) -> bool:
        """Whether single precision is enough from the samples on."""
        read, (start, end) = self.read, self.read.range
        small = max(abs(start), *map(abs, self.bounds)) <= MOST_IN_SINGLES
        scaled = SINGLE_SCALES[0] <= abs(end - start) / read.full_scale <= SINGLE_SCALES[1]
        return small and scaled and read.component != "magnitude"

    def _plane_of_singles(self, below: int, above: int, share: np.float32) -> NDArray[np.floating]:
        """As _plane, in the device's own numbers: half the work of a layer."""
        read, (start, end) = self.read, self.read.range
        low, high = (read.chosen(self.voxels.array[i]).astype(np.float32) for i in (below, above))
        high -= low
        high *= share
        low += high
        low *= np.float32((end - start) / read.full_scale)
        low += np.float32(start)
        return np.clip(low, *np.array(self.bounds, np.float32), out=low)

    def _plane(self, below: int, above: int, share: float) -> Floats:
        """(y, x) values at one height; the last few are kept, for a layer is asked for in strips."""
        key = (below, share)
        with self._lock:
            if key in self._planes:
                self._planes.move_to_end(key)
                return self._planes[key]
        low = self.read(self.voxels.array[below])
        plane = _lerp(low, self.read(self.voxels.array[above]), np.float64(share)) if share else low
        with self._lock:
            self._planes[key] = plane
            while len(self._planes) > max(2, KEPT_BYTES // plane.nbytes):
                self._planes.popitem(last=False)
        return plane


def vector_directions(voxels: Voxels, read: Reader, x: Floats, y: Floats, z: Floats) -> Floats:
    """(N, 3) directions of the vectors around each point, combined as lines; those of length 0 weigh nothing."""
    samples, shares = voxels.corners(read, x, y, z)
    tensors: Floats = np.zeros((len(x), TENSOR_COMPONENTS))
    for vectors, weight in zip(samples, voxels.weights(shares), strict=True):
        shown = np.where((vectors != 0).any(axis=-1), weight, 0.0)
        tensors += shown[:, None] * tensors_of(unit_vectors(vectors))
    return eigenlines(tensors, 1)


def tensor_directions(voxels: Voxels, read: Reader, x: Floats, y: Floats, z: Floats, which: int) -> Floats:
    """(N, 3) principal directions of the tensors interpolated at each point.

    Args:
        which: 1: of the largest principal value, 2: of the middle one, 3: of the smallest.
    """
    (a, b, c, d, e, f, g, h), shares = voxels.corners(read, x, y, z)
    fx, fy, fz = (share[:, None] for share in shares)
    rows = [_lerp(low, high, fz) for low, high in ((a, e), (b, f), (c, g), (d, h))]
    tensors = _lerp(_lerp(rows[0], rows[1], fx), _lerp(rows[2], rows[3], fx), fy)
    return eigenlines(tensors, which)


def _lerp(low: Floats, high: Floats, share: Floats | np.float64) -> Floats:
    out: Floats = low + share * (high - low)
    return out
