"""Pictures of a stack to look at: layers in material colours, in their true aspect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont
    from PIL.ImageFont import ImageFont as BitmapFont

    from amslicer.layer import Layer
    from amslicer.stack import Stack

    Font = FreeTypeFont | BitmapFont

BACKGROUND = (255, 255, 255)
INK = (45, 55, 72)
SHEET_WIDTH = 1600  # px: as wide as a laptop's screen
THUMBNAILS = 12
GAP = 16  # px between pictures
TEXT_HEIGHT = 22  # px for a line of text


def layer_picture(
    layer: Layer, colors: tuple[str, ...], pitch_mm: tuple[float, float], width: int | None = None
) -> Image:
    """A layer in material colours, in its true aspect: the finer pitch keeps its pixels.

    Args:
        colors: "#rrggbb" per material.
        pitch_mm: pixel size along x and y.
        width: scale to this many pixels across; None keeps every pixel.
    """
    from PIL import Image

    palette = np.array([BACKGROUND, *(_rgb(c) for c in colors)], np.uint8)
    picture = Image.fromarray(palette[layer.labels])
    finest = min(pitch_mm)
    full = (
        max(1, round(picture.width * pitch_mm[0] / finest)),
        max(1, round(picture.height * pitch_mm[1] / finest)),
    )
    if full != picture.size:
        picture = picture.resize(full, Image.Resampling.NEAREST)
    if width is not None and width != picture.width:
        height = max(1, round(picture.height * width / picture.width))
        smaller = width < picture.width
        picture = picture.resize((width, height), Image.Resampling.BOX if smaller else Image.Resampling.NEAREST)
    return picture


def contact_sheet(stack: Stack, count: int = THUMBNAILS) -> Image:
    """One large layer above thumbnails of evenly spaced ones, with heights and a legend."""
    from PIL import Image, ImageDraw, ImageFont

    positions = sorted({round(p) for p in np.linspace(0, len(stack) - 1, min(count, len(stack)))})
    pixels = [sum(record.pixels.values()) for record in stack.records]
    largest = int(np.argmax(pixels))
    pitch, colors = stack.grid.pitch_mm, stack.colors
    columns = min(4, len(positions))
    thumb_width = (SHEET_WIDTH - GAP * (columns + 1)) // columns
    main = layer_picture(stack[largest], colors, pitch, _fitting(stack, SHEET_WIDTH - 2 * GAP))
    thumbs = [layer_picture(stack[i], colors, pitch, _fitting(stack, thumb_width)) for i in positions]
    rows = -(-len(thumbs) // columns)
    row_height = thumbs[0].height + TEXT_HEIGHT + GAP
    height = main.height + 2 * TEXT_HEIGHT + 3 * GAP + rows * row_height
    sheet = Image.new("RGB", (SHEET_WIDTH, height), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=16)

    entries = [
        (m["color"], f"{m['name']} {100 * m['ratio']:.2f} % (asked {100 * m['ratio_asked']:.2f} %)")
        for m in stack.manifest["materials"]
    ]
    draw_legend(draw, (GAP, GAP), entries, font)
    sheet.paste(main, (GAP, 2 * GAP + TEXT_HEIGHT))
    caption = _caption(stack[largest], main.width / (stack.grid.width_px * pitch[0]))
    draw.text((GAP, 2 * GAP + TEXT_HEIGHT + main.height), caption, fill=INK, font=font)
    top = main.height + 2 * TEXT_HEIGHT + 3 * GAP
    for number, (position, thumb) in enumerate(zip(positions, thumbs, strict=True)):
        left = GAP + (number % columns) * (thumb_width + GAP)
        upper = top + (number // columns) * row_height
        sheet.paste(thumb, (left, upper))
        draw.text((left, upper + thumb.height), _caption(stack[position]), fill=INK, font=font)
    return sheet


def draw_legend(draw: ImageDraw, place: tuple[int, int], entries: Sequence[tuple[str, str]], font: Font) -> None:
    """Writes a line of materials: a swatch of the colour, then the text."""
    x, y = place
    for color, text in entries:
        draw.rectangle((x, y, x + 16, y + 16), fill=color, outline=INK)
        draw.text((x + 24, y), text, fill=INK, font=font)
        x += 48 + int(draw.textlength(text, font=font))


def _fitting(stack: Stack, side: int) -> int:
    """The width at which a layer fits into a square of this side."""
    width, height = (
        n * p for n, p in zip((stack.grid.width_px, stack.grid.height_px), stack.grid.pitch_mm, strict=True)
    )
    return max(1, round(side * min(1.0, width / height)))


def _caption(layer: Layer, px_per_mm: float | None = None) -> str:
    scale = f", 10 mm = {10 * px_per_mm:.0f} px of this picture" if px_per_mm else ""
    return f"layer {layer.index}, z = {layer.z_mm:.3f} mm{scale}"


def _rgb(color: str) -> tuple[int, ...]:
    return tuple(int(color[i : i + 2], 16) for i in (1, 3, 5))
