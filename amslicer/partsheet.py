"""Lays out the preview of a part: painted fields beside layers, in true aspect, with captions that say what is seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from amslicer.fieldpictures import direction_picture, draw_strokes, hue_bar, ramp_bar, scalar_picture
from amslicer.partpreview import AREA_PX, View, close_up, laminate, outline, overview, painted_maps
from amslicer.pictures import BACKGROUND, GAP, INK, TEXT_HEIGHT, draw_legend, layer_picture

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

    from amslicer.pictures import Font
    from amslicer.pipeline import Prepared, Run

FONT_PX = 16
BAR_PX = 120, 12  # of a legend
SHADE = "#edf2f7"  # where the part is, but not in this layer


@dataclass(frozen=True)
class Panel:
    """A picture with a caption under it, and the legend of its colours: what stands before and after a bar."""

    picture: Image
    caption: str
    legend: tuple[str, Image, str] | None = None


def part_sheet(prepared: Prepared, run: Run) -> Image:
    """The picture of a job that is ready to be sliced.

    Raises:
        AmslicerError: the fields cannot be used, or no device works.
    """
    job = prepared.job
    close = close_up(job, prepared)
    far = close if close.whole else overview(job, prepared)
    fields, layers = _field_panels(far, close), _layer_panels(close, run)
    # A long part lies in columns of panels, a deep one in rows.
    deep = prepared.placement.size_mm[1] > prepared.placement.size_mm[0]
    legend = [(m.color, m.name) for m in job.spec.materials]
    return _sheet(heading(prepared, close), legend, fields, layers, deep=bool(deep))


def heading(prepared: Prepared, close: View) -> list[str]:
    """What is seen, in lines of text."""
    spec, size = prepared.job.spec, prepared.placement.size_mm
    pattern, pitch = spec.pattern, close.prepared.grid.pitch_mm
    # The font has neither the micro sign nor the multiplication sign.
    measures = " x ".join(f"{float(v):.4g}" for v in size)
    shown, printed = (" x ".join(f"{1000 * p:.0f}" for p in sides) for sides in (pitch, spec.printer.pitch_mm))
    period = f"period {pattern.period:g} mm, " if isinstance(pattern.period, float) else ""
    grid = prepared.grid
    lines = [
        f"{prepared.mesh.file}: {measures} mm, {grid.layers} layers of {1000 * grid.layer_mm:g} um on "
        f"{spec.printer.name or 'the printer'}; {pattern.noise} in {pattern.dimensions}D, {period}seed {pattern.seed}",
        f"Not sliced yet. Layers are drawn with pixels of {shown} um; the printer's are {printed} um.",
    ]
    if not close.whole:
        width, depth = close.size_mm
        grid = close.prepared.grid
        lines.append(
            f"They show only a WINDOW of {width:.3g} x {depth:.3g} mm in the middle of the part, framed in the painted "
            f"fields: all of it would take {grid.columns} x {grid.rows} pixels, and coarser ones would hide the sheets."
        )
    return lines


def _field_panels(far: View, close: View) -> list[Panel]:
    """The painted fields over the whole part."""
    inside = outline(far)
    maps = painted_maps(far.prepared, inside)
    first = far.prepared.job.materials[0]
    ratio, at = maps.ratio, f"z = {maps.z_mm:.3g} mm"
    low, high = (100 * float(v) for v in _range(ratio, inside))
    directions = _enlarged(direction_picture(maps.normals, inside), far)
    draw_strokes(directions, maps.normals, inside)
    panels = [
        Panel(
            _enlarged(scalar_picture(ratio, inside, 0, 1), far),
            f"ratio of {first} at {at}: {_span(low, high, ' %')}", ("0", ramp_bar(*BAR_PX), "100 %"),
        ),
        Panel(directions, _direction_caption(maps.normals[inside], at), ("0°", hue_bar(*BAR_PX), "180°")),
    ]  # fmt: skip
    for name, values in maps.others.items():
        low, high = _range(values, inside)
        picture = _enlarged(scalar_picture(values, inside, low, high), far)
        panels.append(Panel(picture, f"{name} at {at}", (f"{low:.3g}", ramp_bar(*BAR_PX), f"{high:.3g}")))
    if not close.whole:
        for panel in panels:
            _frame(panel.picture, close)
    return panels


def _direction_caption(normals: NDArray[np.float64], at: str) -> str:
    """What hues and strokes mean, for (N, 3) normals."""
    steep = np.rad2deg(np.arcsin(np.clip(np.abs(normals[:, 2]), 0, 1))) if len(normals) else np.zeros(1)
    elevation = f", elevation {_span(float(steep.min()), float(steep.max()), '°')}" if steep.max() > 0 else ""
    return f"normal at {at}{elevation}, azimuth as hue; strokes along the sheets"


def _range(values: NDArray[np.floating], inside: NDArray[np.bool_]) -> tuple[float, float]:
    here = values[inside] if inside.any() else values
    return float(here.min()), float(here.max())


def _span(low: float, high: float, unit: str) -> str:
    a, b = f"{low:.3g}", f"{high:.3g}"
    return f"{a}{unit}" if a == b else f"{a} to {b}{unit}"


def _layer_panels(close: View, run: Run) -> list[Panel]:
    """Layers in material colours; grey where the part is above or below."""
    job, grid = close.prepared.job, close.prepared.grid
    seen = outline(close)[::-1]
    colors = (*(m.color for m in job.spec.materials), SHADE)
    panels = []
    for layer in laminate(close, run):
        shaded = np.where((layer.labels == 0) & seen, len(colors), layer.labels).astype(np.uint8)
        picture = layer_picture(replace(layer, labels=shaded), colors, grid.pitch_mm)
        panels.append(Panel(_enlarged(picture, close), f"layer {layer.index}, z = {layer.z_mm:.3g} mm"))
    return panels


def _enlarged(picture: Image, view: View) -> Image:
    """In true aspect, a whole number of times the finer pixel: as large as the others' area allows."""
    from PIL import Image

    finest = min(view.prepared.grid.pitch_mm)
    width, height = (max(1, round(side / finest)) for side in view.size_mm)
    times = max(1, round(math.sqrt(AREA_PX)) // max(width, height))
    return picture.resize((times * width, times * height), Image.Resampling.NEAREST)


def _frame(picture: Image, close: View) -> None:
    """Where the window lies in a picture of the whole part."""
    from PIL import ImageDraw

    grid = close.prepared.grid
    left, right = (picture.width * c / grid.columns for c in close.window.columns)
    low, high = (picture.height * (1 - r / grid.rows) for r in close.window.rows)
    ImageDraw.Draw(picture).rectangle((left, high, right - 1, low - 1), outline=INK, width=2)


def _sheet(
    texts: Sequence[str],
    legend: Sequence[tuple[str, str]],
    fields: Sequence[Panel],
    layers: Sequence[Panel],
    *,
    deep: bool,
) -> Image:
    from PIL import Image, ImageDraw, ImageFont

    groups = (fields, layers)
    longest = max(map(len, groups))
    cells = {(i, g): panel for g, group in enumerate(groups) for i, panel in enumerate(group)}
    if deep:
        cells = {(g, i): panel for (i, g), panel in cells.items()}
    rows, columns = (len(groups), longest) if deep else (longest, len(groups))
    font = ImageFont.load_default(FONT_PX)
    probe = ImageDraw.Draw(Image.new("RGB", (1, 1)))
    widths = [
        max(max(p.picture.width, _caption_width(probe, p, font)) for (_, c), p in cells.items() if c == column)
        for column in range(columns)
    ]
    heights = [max(p.picture.height for (r, _), p in cells.items() if r == row) for row in range(rows)]
    width = sum(widths) + GAP * (columns + 1)
    lines = [line for text in texts for line in _wrapped(probe, text, font, width - 2 * GAP)]
    top = GAP + TEXT_HEIGHT * (len(lines) + 1) + GAP
    sheet = Image.new("RGB", (width, top + sum(heights) + rows * (TEXT_HEIGHT + GAP)), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for number, line in enumerate(lines):
        draw.text((GAP, GAP + number * TEXT_HEIGHT), line, fill=INK, font=font)
    draw_legend(draw, (GAP, GAP + len(lines) * TEXT_HEIGHT), legend, font)
    for (row, column), panel in cells.items():
        x = GAP + sum(widths[:column]) + GAP * column
        y = top + sum(heights[:row]) + row * (TEXT_HEIGHT + GAP)
        sheet.paste(panel.picture, (x, y))
        _draw_caption(sheet, draw, (x, y + panel.picture.height + 2), panel, font)
    return sheet


def _caption_width(draw: ImageDraw, panel: Panel, font: Font) -> int:
    width = draw.textlength(panel.caption, font)
    if panel.legend:
        before, bar, after = panel.legend
        width += draw.textlength(before, font) + bar.width + draw.textlength(after, font) + 2 * GAP
    return int(width) + 1


def _draw_caption(sheet: Image, draw: ImageDraw, place: tuple[int, int], panel: Panel, font: Font) -> None:
    x, y = place
    draw.text((x, y), panel.caption, fill=INK, font=font)
    if panel.legend:
        before, bar, after = panel.legend
        x += int(draw.textlength(panel.caption, font)) + GAP
        draw.text((x, y), before, fill=INK, font=font)
        x += int(draw.textlength(before, font)) + GAP // 4
        sheet.paste(bar, (x, y + (TEXT_HEIGHT - bar.height) // 2))
        draw.text((x + bar.width + GAP // 4, y), after, fill=INK, font=font)


def _wrapped(draw: ImageDraw, text: str, font: Font, width: int) -> list[str]:
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and draw.textlength(longer, font) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
