"""Directions read from pictures: the way that grey levels rise, hues, or cosines and sines of the doubled angle.

    {image: paint/height.png, reads: gradient, smooth_mm: 0.5}     normals across the contour lines of a relief
    {image: paint/hues.png, reads: hue}                            as amslicer draws directions: red 0°, cyan 90°
    {image: paint/lines.png, reads: vector}                        8-bit RGB; blue means nothing
    {image: paint/cos.png, with: paint/sin.png, reads: vector}     16-bit grey

Angles are from the plane's first axis towards its second. Lines are combined through the doubled angle, so that 1° and
179° meet at 0°, never at 90°.

gradient: The derivatives per mm (Gaussians of one texel), as tensors g gᵀ, are averaged over `smooth_mm`, so that the
steepest texels count most. hue: the circle of hues is half a turn, and the saturation is the weight. vector: black is
-1, white is 1; the length is the weight. Texels that show no direction (flat, grey, or within a level of the middle)
take that of the nearest one that does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from amslicer.errors import JobError
from amslicer.fields.pictures import GREY, RGB, read_picture
from amslicer.fields.rectangle import Rectangle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.fields.pictures import Texels
    from amslicer.fields.rectangle import Outside

    Floats = NDArray[np.float64]
    Singles = NDArray[np.float32]
    File = tuple[bytes, str]

Reads = Literal["gradient", "hue", "vector"]

MOST_TEXELS = 32_000_000  # four bytes each, and as many more while they are read
UNIT = 32767  # of a component as int16: a direction is then within 0.001°
BAND_ROWS = 128  # rows worked on at a time: a picture's derivatives as floats would fill the memory
DERIVATIVE_TEXELS = 1.0  # of the Gaussian: the narrowest that is the same in all directions
TRUNCATED = 4.0  # standard deviations, where Gaussians end
MOST_SMOOTH_TEXELS = 256.0  # wider averages take minutes, and need no such picture
NEUTRAL_LEVELS = 1.0  # from the middle, where 8 bits have no exact zero

DIRECTIONS_CHANGE = "directions change slowly from pixel to pixel"
GREYS = replace(GREY, most=MOST_TEXELS, why_less=DIRECTIONS_CHANGE)
COLOURS = replace(RGB, most=MOST_TEXELS, why_less=DIRECTIONS_CHANGE)


@dataclass(frozen=True, eq=False)
class LineTexels:
    """Lines over a rectangle of the field frame.

    Attributes:
        lines: (2, rows, columns) weight times cosine and sine of the doubled angle, of UNIT; row 0 is where the second
            of the rectangle's axes is smallest.
        turns_over: whether lines are mirrored with a picture that is turned over.
    """

    lines: NDArray[np.int16]
    rectangle: Rectangle
    turns_over: bool = False

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along its two axes, where there is more than one texel."""
        return self.rectangle.varies(self.lines.shape[1:])

    def at(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(2, N) weight times cosine and sine of the doubled angle at (N,) places."""
        shape = self.lines.shape[1:]
        (c0, c1, fx), (r0, r1, fy) = self.rectangle.around((x, y, z), shape)
        sides: list[tuple[NDArray[np.bool_], NDArray[np.bool_]]] = []
        if self.turns_over and self.rectangle.outside == "mirror":
            sides = [
                self.rectangle.turned((x, y, z)[axis], along, shape[1 - along])
                for along, axis in enumerate(self.rectangle.axes)
            ]

        def corner(row: int, column: int) -> Floats:
            found = self.lines[:, (r0, r1)[row], (c0, c1)[column]].astype(np.float64)
            if sides:
                found[1] = np.where(sides[0][column] != sides[1][row], -found[1], found[1])
            return found

        low, high = (corner(row, 0) + fx * (corner(row, 1) - corner(row, 0)) for row in (0, 1))
        result: Floats = low + fy * (high - low)
        return result


@dataclass(frozen=True, eq=False)
class PictureLines:
    """Directions in a plane, from pictures at ascending heights along its normal: linear between them as lines.

    Attributes:
        heights_mm: of each picture, field frame.
    """

    pictures: tuple[LineTexels, ...]
    heights_mm: tuple[float, ...] = (0.0,)

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """Along the plane's axes where there are texels, and along its normal where there are pictures."""
        normal = self.pictures[0].rectangle.normal
        x, y, z = (
            any(picture.varies[axis] for picture in self.pictures) or (axis == normal and len(self.pictures) > 1)
            for axis in range(3)
        )
        return x, y, z

    @cached_property
    def turns(self) -> bool:
        """Whether any texel differs from another."""
        first = self.pictures[0].lines[:, :1, :1]
        return any(bool((picture.lines != first).any()) for picture in self.pictures)

    def normals(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """(N, 3) unit normals in the part's file axes at (N,) field-frame points."""
        rectangle = self.pictures[0].rectangle
        cosine, sine = between(
            self.heights_mm, (x, y, z)[rectangle.normal], (x, y, z), lambda k, *place: self.pictures[k].at(*place)
        )
        angle = 0.5 * np.arctan2(sine, cosine)
        normals = np.zeros((len(angle), 3))
        normals[:, rectangle.axes[0]], normals[:, rectangle.axes[1]] = np.cos(angle), np.sin(angle)
        return normals


def place_between(heights_mm: tuple[float, ...], along: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Which of ascending heights is the last not above each place, and the share of the next; 0 beyond the ends."""
    known = np.asarray(heights_mm)
    last = np.clip(np.searchsorted(known, along, side="right") - 1, 0, len(known) - 1)
    following = np.minimum(last + 1, len(known) - 1)
    step = known[following] - known[last]
    share = np.where(step > 0, np.maximum(along - known[last], 0.0) / np.where(step > 0, step, 1.0), 0.0)
    return last, share


def between(
    heights_mm: tuple[float, ...], along: Floats, place: tuple[Floats, Floats, Floats],
    at: Callable[[int, Floats, Floats, Floats], Floats],
) -> Floats:  # fmt: skip
    """Values that are known at ascending heights, linear between them and clamped beyond.

    Args:
        along: coordinate of the heights at each place.
        at: (…, N) values at the height of this number, at places.
    """
    if len(heights_mm) == 1:
        return at(0, *place)
    last, share = place_between(heights_mm, np.asarray(along, np.float64))
    if last.size == 1:  # the places stay a raster
        return _two(int(last.flat[0]), share.reshape(-1)[0], place, at)
    x, y, z, last, share = np.broadcast_arrays(*place, last, share)
    result = None
    for k in np.unique(last):
        chosen = last == k
        found = _two(int(k), share[chosen], (x[chosen], y[chosen], z[chosen]), at)
        if result is None:
            result = np.empty((*found.shape[:-1], *last.shape))
        result[..., chosen] = found
    return np.zeros(last.shape) if result is None else result


def _two(
    k: int, share: Floats, place: tuple[Floats, Floats, Floats], at: Callable[[int, Floats, Floats, Floats], Floats]
) -> Floats:
    low = at(k, *place)
    if not share.any():
        return low
    result: Floats = low + share * (at(k + 1, *place) - low)
    return result


def read_lines(
    picture: File, second: File | None, reads: Reads, rectangle: Rectangle, smooth_mm: float | None
) -> LineTexels:
    """The lines that a picture shows.

    Args:
        picture: its bytes and its name.
        second: of reads: vector: the sines, where they are a picture of their own.
        smooth_mm: of reads: gradient.

    Raises:
        JobError: it cannot be used, or shows no direction.
    """
    name = picture[1]
    if reads == "gradient":
        levels = read_picture(*picture, GREYS)[0][::-1]
        bands = _gradients(levels, rectangle, smooth_mm, name)
        shape, nothing = levels.shape, "is of one grey level everywhere"
    elif reads == "hue":
        colours, full_scale = read_picture(*picture, COLOURS)
        bands = _hues(colours[::-1], full_scale)
        shape, nothing = colours.shape[:2], "has no colours"
    else:
        channels = _channels(picture, second)
        bands = _vectors(channels)
        shape, nothing = channels[0][0].shape, "is of the middle grey everywhere"
    lines = np.empty((2, *shape), np.int16)
    for first, band in bands:
        lines[:, first : first + band.shape[1]] = np.rint(UNIT * band)
    empty = np.logical_not(lines.any(axis=0), dtype=np.bool_)
    if empty.all():
        raise JobError(
            f"the picture '{name}' {nothing}, and reads: {reads} makes no direction of that",
            hint="give orientation as a number where it is the same everywhere, or check the picture",
        )
    if empty.any():
        _fill(lines, empty, rectangle)
    return LineTexels(lines, rectangle, turns_over=reads == "gradient")


def _gradients(
    levels: Texels, rectangle: Rectangle, smooth_mm: float | None, name: str
) -> Iterator[tuple[int, Singles]]:
    """Bands of rows: where each begins, and its (2, rows, columns) directions of the gradient, of length 1 or 0."""
    from scipy.ndimage import gaussian_filter

    texel_mm = rectangle.texel_mm(levels.shape)
    sigma = tuple(1.0 if smooth_mm is None else smooth_mm / side for side in texel_mm)
    if max(sigma) > MOST_SMOOTH_TEXELS:
        raise JobError(
            f"the picture '{name}' is smoothed over {max(sigma):.4g} pixels (smooth_mm {smooth_mm:g}, pixels of "
            f"{texel_mm[0]:.3g} × {texel_mm[1]:.3g} mm); at most {MOST_SMOOTH_TEXELS:g} are",
            hint="make the picture smaller: magick IN -resize 25% OUT.png",
        )
    wide, high = (int(TRUNCATED * DERIVATIVE_TEXELS + 0.5) + int(TRUNCATED * s + 0.5) for s in sigma)
    rows, columns = levels.shape
    aspect = [min(texel_mm) / side for side in texel_mm]
    for first in range(0, rows, BAND_ROWS):
        last = min(first + BAND_ROWS, rows)
        grey = _extended(levels, np.arange(first - high, last + high), 0, rectangle.outside)
        grey = _extended(grey, np.arange(-wide, columns + wide), 1, rectangle.outside)
        gx, gy = (
            gaussian_filter(grey, DERIVATIVE_TEXELS, order=order, truncate=TRUNCATED) * np.float32(aspect[i])
            for i, order in enumerate(((0, 1), (1, 0)))
        )
        tensor = (gx * gx - gy * gy, 2 * gx * gy)
        found = np.stack(
            [
                gaussian_filter(part, sigma[::-1], truncate=TRUNCATED)[high : high + last - first, wide:-wide]
                for part in tensor
            ]
        )
        length = np.hypot(*found)
        yield first, (found / np.where(length > 0, length, 1.0)).astype(np.float32)


def _extended(values: Texels | Singles, index: NDArray[np.int64], axis: int, outside: Outside) -> Singles:
    """Rows (0) or columns (1) by their numbers, also beyond the picture; clamped ones go on with the border's slope."""
    count = values.shape[axis]
    edge, mirrored = np.clip(index, 0, count - 1), None
    if outside == "repeat":
        edge = index % count
    elif outside == "mirror":
        edge = np.minimum(index % (2 * count), 2 * count - 1 - index % (2 * count))
    else:
        mirrored = np.clip(2 * edge - index, 0, count - 1)
    found: Singles = values.take(edge, axis).astype(np.float32)
    return found if mirrored is None else 2 * found - values.take(mirrored, axis).astype(np.float32)


def _hues(colours: Texels, full_scale: int) -> Iterator[tuple[int, Singles]]:
    """Bands of rows: saturation times cosine and sine of the hue, which is the doubled angle."""
    for first in range(0, len(colours), BAND_ROWS):
        red, green, blue = np.moveaxis(colours[first : first + BAND_ROWS].astype(np.float32) / full_scale, -1, 0)
        most = np.maximum(np.maximum(red, green), blue)
        chroma = most - np.minimum(np.minimum(red, green), blue)
        some = np.where(chroma > 0, chroma, 1.0)
        sixth = np.select(
            [most == red, most == green], [(green - blue) / some, 2 + (blue - red) / some], 4 + (red - green) / some
        )
        hue = sixth * (np.pi / 3)
        saturation = chroma / np.where(most > 0, most, 1.0)
        yield first, np.stack([saturation * np.cos(hue), saturation * np.sin(hue)]).astype(np.float32)


def _channels(picture: File, second: File | None) -> tuple[tuple[Texels, int], tuple[Texels, int]]:
    """Levels of cosines and of sines, row 0 lowest, each with its full scale."""
    if second is None:
        colours, full_scale = read_picture(*picture, COLOURS)
        return (colours[::-1, :, 0], full_scale), (colours[::-1, :, 1], full_scale)
    (cosines, of_cosines), (sines, of_sines) = (read_picture(*each, GREYS) for each in (picture, second))
    if cosines.shape != sines.shape:
        one, other = (f"{shape[1]} × {shape[0]}" for shape in (cosines.shape, sines.shape))
        raise JobError(
            f"the picture '{picture[1]}' has {one} pixels, and '{second[1]}' with it has {other}",
            hint="the two are cosines and sines of the same pixels: make them of one size",
        )
    return (cosines[::-1], of_cosines), (sines[::-1], of_sines)


def _vectors(channels: tuple[tuple[Texels, int], tuple[Texels, int]]) -> Iterator[tuple[int, Singles]]:
    """Bands of rows: the components as they are, at most of length 1."""
    for first in range(0, len(channels[0][0]), BAND_ROWS):
        parts = []
        for levels, full_scale in channels:
            from_middle = levels[first : first + BAND_ROWS].astype(np.float64) - full_scale / 2
            parts.append((from_middle / (full_scale / 2), np.abs(from_middle) <= NEUTRAL_LEVELS))
        neutral = parts[0][1] & parts[1][1]
        yield first, np.where(neutral, 0.0, np.stack([parts[0][0], parts[1][0]])).astype(np.float32)


def _fill(lines: NDArray[np.int16], empty: NDArray[np.bool_], rectangle: Rectangle) -> None:
    """Gives texels without a direction that of the nearest one, in mm; of a repeated picture also across its border."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = empty.shape
    pad = ((0, 0), (0, 0))
    if rectangle.outside == "repeat":
        pad = ((rows // 2,) * 2, (columns // 2,) * 2)
    tiled = np.pad(empty, pad, mode="wrap")
    nearest = distance_transform_edt(
        tiled, sampling=rectangle.texel_mm(empty.shape)[::-1], return_distances=False, return_indices=True
    )
    own = tuple(slice(before, before + count) for (before, _), count in zip(pad, empty.shape, strict=True))
    up, across = (
        (part[own][empty] - before) % count for part, (before, _), count in zip(nearest, pad, empty.shape, strict=True)
    )
    lines[:, empty] = lines[:, up, across]
