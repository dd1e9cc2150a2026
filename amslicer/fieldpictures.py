"""How painted fields look: numbers as a ramp of colours, directions as hues with strokes along the sheets."""

from __future__ import annotations

import colorsys
from typing import TYPE_CHECKING

import numpy as np

from amslicer.pictures import BACKGROUND, INK

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image

    Floats = NDArray[np.float64]
    Colors = NDArray[np.uint8]

# From light to dark, so that it reads in grey too.
RAMP = np.array([(252, 246, 222), (159, 207, 186), (52, 137, 160), (28, 66, 120), (20, 20, 60)], float)
HUES = 360  # entries of the circle of hues
SATURATION, VALUE = 0.5, 0.97  # pale enough for dark strokes
STROKE_STEP_PX, STROKE_PX = 26, 18  # from stroke to stroke, and the length of one
UPRIGHT = 0.12  # share of a normal in the plane below which its sheets, lying flat, have no direction to draw


def ramp_colors(share: Floats) -> Colors:
    """(…, 3) colours of numbers from 0 to 1."""
    place = np.clip(share, 0.0, 1.0) * (len(RAMP) - 1)
    below = np.minimum(place.astype(int), len(RAMP) - 2)
    part = (place - below)[..., None]
    colors: Colors = np.rint(RAMP[below] + part * (RAMP[below + 1] - RAMP[below])).astype(np.uint8)
    return colors


def hue_colors(azimuth_deg: Floats, flatness: Floats) -> Colors:
    """(…, 3) colours of lines: once round the circle of hues in 180°; paler where sheets lie flat.

    Args:
        flatness: 1 where the normal is horizontal, 0 where it is upright.
    """
    circle = np.array([colorsys.hsv_to_rgb(i / HUES, SATURATION, VALUE) for i in range(HUES)])
    index = np.floor((azimuth_deg % 180.0) / 180.0 * HUES).astype(int) % HUES
    pale = 1 - flatness[..., None]
    colors: Colors = np.rint(255 * (circle[index] * (1 - pale) + pale)).astype(np.uint8)
    return colors


def scalar_picture(values: NDArray[np.floating], inside: NDArray[np.bool_], low: float, high: float) -> Image:
    """Numbers from low to high as a ramp; row 0 of the arrays is at the bottom."""
    share = (values.astype(np.float64) - low) / (high - low if high > low else 1.0)
    return _masked(ramp_colors(share), inside)


def direction_picture(normals: Floats, inside: NDArray[np.bool_]) -> Image:
    """(rows, columns, 3) normals as hues; row 0 of the arrays is at the bottom."""
    azimuth = np.rad2deg(np.arctan2(normals[..., 1], normals[..., 0]))
    return _masked(hue_colors(azimuth, np.hypot(normals[..., 0], normals[..., 1])), inside)


def _masked(colors: Colors, inside: NDArray[np.bool_]) -> Image:
    from PIL import Image

    return Image.fromarray(np.where(inside[..., None], colors, np.array(BACKGROUND, np.uint8))[::-1])


def draw_strokes(picture: Image, normals: Floats, inside: NDArray[np.bool_]) -> None:
    """Strokes along the sheets, as they are seen from above: shorter where the sheets lean, a dot where they lie flat.

    Args:
        picture: a picture of the same pixels, at any size.
    """
    from PIL import ImageDraw

    draw = ImageDraw.Draw(picture)
    rows, columns = inside.shape
    for y in range(STROKE_STEP_PX // 2, picture.height, STROKE_STEP_PX):
        for x in range(STROKE_STEP_PX // 2, picture.width, STROKE_STEP_PX):
            row, column = rows - 1 - y * rows // picture.height, x * columns // picture.width
            if not inside[row, column]:
                continue
            nx, ny = (float(v) for v in normals[row, column, :2])
            if np.hypot(nx, ny) < UPRIGHT:
                draw.ellipse((x - 1, y - 1, x + 1, y + 1), fill=INK)
            else:  # across the normal; the picture's y points down
                dx, dy = STROKE_PX / 2 * -ny, -STROKE_PX / 2 * nx
                draw.line((x - dx, y - dy, x + dx, y + dy), fill=INK, width=2)


def ramp_bar(width: int, height: int) -> Image:
    """The ramp from 0 to 1, left to right."""
    from PIL import Image

    return Image.fromarray(np.broadcast_to(ramp_colors(np.linspace(0, 1, width)), (height, width, 3)).copy())


def hue_bar(width: int, height: int) -> Image:
    """The hues of directions from 0° to 180°, left to right."""
    from PIL import Image

    colors = hue_colors(np.linspace(0, 180, width, endpoint=False), np.ones(width))
    return Image.fromarray(np.broadcast_to(colors, (height, width, 3)).copy())
