"""Where a stack is off: maps of the ratio's, direction's and period's local errors, seen from above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer.fieldpictures import ramp_colors
from amslicer.pictures import BACKGROUND, GAP, INK, TEXT_HEIGHT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from PIL.Image import Image

    from amslicer.grid import Grid
    from amslicer.texture import Shown
    from amslicer.verification import Report

    Floats = NDArray[np.float64]

PANEL_PX = 420  # width of a map
# Errors below 0 to errors above: blue, white, red.
BELOW, NONE, ABOVE = np.array([(33, 102, 172), (247, 247, 247), (178, 24, 43)], float)
ANGLE_DEG, PERIOD_SHARE = 15.0, 0.15  # ends of the scales


def error_maps(report: Report, grid: Grid) -> Image:
    """A sheet of maps: per material the error of its share in the smallest windows, in units of what chance explains
    (±1: as far as an honest window goes), then the angle between shown and painted direction, and the period's ratio.

    Windows and blocks that lie above each other show the one that is furthest off.
    """
    from PIL import Image, ImageDraw, ImageFont

    panels = [*_ratio_panels(report), *_texture_panels(report.shown, grid)]
    aspect = grid.rows * grid.pitch_mm[1] / (grid.columns * grid.pitch_mm[0])
    height = max(1, round(PANEL_PX * aspect))
    columns = min(3, max(1, len(panels)))
    rows = -(-len(panels) // columns)
    size = (columns * (PANEL_PX + GAP) + GAP, rows * (height + 2 * TEXT_HEIGHT + GAP) + GAP)
    sheet = Image.new("RGB", size, BACKGROUND)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=15)
    for number, (title, scale, colors) in enumerate(panels):
        x = GAP + number % columns * (PANEL_PX + GAP)
        y = GAP + number // columns * (height + 2 * TEXT_HEIGHT + GAP)
        picture = Image.fromarray(colors[::-1]).resize((PANEL_PX, height), Image.Resampling.NEAREST)
        draw.text((x, y), title, fill=INK, font=font)
        sheet.paste(picture, (x, y + TEXT_HEIGHT))
        draw.text((x, y + TEXT_HEIGHT + height + 2), scale, fill=INK, font=font)
    return sheet


def _ratio_panels(report: Report) -> list[tuple[str, str, NDArray[np.uint8]]]:
    if not report.windows:
        return []
    leaves = report.windows[0]
    panels = []
    for m, name in enumerate(report.materials):
        error, limit = leaves.got[:, m] - leaves.asked[:, m], leaves.limit[:, m]
        share = np.divide(error, limit, out=np.sign(error), where=limit > 0)
        worst = _furthest(share, leaves.place, leaves.counts[:2])
        scale = f"blue to red: -1 to +1 of what chance explains; worst {np.abs(share).max():.2f}"
        panels.append((f"{name}: error of its ratio", scale, _diverging(worst)))
    return panels


def _texture_panels(shown: Sequence[Shown], grid: Grid) -> list[tuple[str, str, NDArray[np.uint8]]]:
    if not shown:
        return []
    centres = np.array([block.centre_mm for block in shown])
    place = np.stack([np.unique(centres[:, axis].round(6), return_inverse=True)[1] for axis in range(3)], axis=-1)
    counts = (int(place[:, 0].max()) + 1, int(place[:, 1].max()) + 1)
    angle = _furthest(np.array([block.angle_deg for block in shown]), place, counts)
    period = _furthest(np.array([1 / block.frequency - 1 for block in shown]), place, counts)
    dark = np.where(np.isnan(angle)[..., None], np.array(BACKGROUND), ramp_colors(np.nan_to_num(angle) / ANGLE_DEG))
    return [
        ("direction: angle to the painted", f"light to dark: 0 to {ANGLE_DEG:.0f} degrees", dark.astype(np.uint8)),
        (
            "period against the painted",
            f"blue to red: {100 * (1 - PERIOD_SHARE):.0f} to {100 * (1 + PERIOD_SHARE):.0f} %",
            _diverging(period / PERIOD_SHARE),
        ),
    ]


def _furthest(values: Floats, place: NDArray[np.int64], counts: tuple[int, int]) -> Floats:
    """(rows, columns) the value furthest from 0 at each place; NaN where there is none."""
    out = np.full((counts[1], counts[0]), np.nan)
    order = np.argsort(np.abs(values), kind="stable")
    out[place[order, 1], place[order, 0]] = values[order]
    return out


def _diverging(share: Floats) -> NDArray[np.uint8]:
    """(…, 3) colours of -1 … 1; paper where there is no value."""
    t = np.clip(np.nan_to_num(share), -1, 1)[..., None]
    colors = np.where(t < 0, NONE + t * (NONE - BELOW), NONE + t * (ABOVE - NONE))
    return np.where(np.isnan(share)[..., None], np.array(BACKGROUND), np.rint(colors)).astype(np.uint8)
