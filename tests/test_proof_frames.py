"""Proof: nothing is mirrored or turned. What is expected here was typed by hand.

A picture of blacks and whites paints ratios 0 and 1, which are plain fills: every pixel is known. Each letter of a
typed bitmap is a square cell of the part; X is the first material, . the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray

from amslicer import analysis

F = ("XXXXX",
     "X....",
     "X....",
     "XXXX.",
     "X....",
     "X....",
     "X....")  # fmt: skip
TURNED_90 = ("X......",
             "X..X...",
             "X..X...",
             "X..X...",
             "XXXXXXX")  # fmt: skip
TURNED_180 = ("....X",
              "....X",
              "....X",
              ".XXXX",
              "....X",
              "....X",
              "XXXXX")  # fmt: skip
TURNED_270 = ("XXXXXXX",
              "...X..X",
              "...X..X",
              "...X..X",
              "......X")  # fmt: skip
OVER_X = ("X....",
          "X....",
          "X....",
          "XXXX.",
          "X....",
          "X....",
          "XXXXX")  # fmt: skip
OVER_Y = ("XXXXX",
          "....X",
          "....X",
          ".XXXX",
          "....X",
          "....X",
          "....X")  # fmt: skip

# A cell is 0.25 mm: 2 x 1 pixels; or 4 x 2 pixels of 600 x 300 dpi, 0.169 mm. One layer each.
FINE: tuple[dict[str, Any], float, tuple[int, int]] = ({"pitch_um": [125, 250], "layer_um": 250}, 0.25, (2, 1))
DPI: tuple[dict[str, Any], float, tuple[int, int]] = (
    {"dpi": [600, 300], "layer_mm": 4 * 25.4 / 600}, 4 * 25.4 / 600, (4, 2),
)  # fmt: skip
# Texels per cell: pixel centres then lie between texels of one colour, never between two.
TEXELS = 8


def cells(typed: Sequence[str]) -> NDArray[np.uint8]:
    return np.array([[1 if letter == "X" else 2 for letter in row] for row in typed], np.uint8)


def bitmap(typed: Sequence[str], pixels: tuple[int, int]) -> NDArray[np.uint8]:
    """Labels of a typed bitmap with so many pixels per cell, (across, down)."""
    return np.kron(cells(typed), np.ones(pixels[::-1], np.uint8))


def picture(folder: Path, typed: Sequence[str]) -> str:
    grey = np.where(bitmap(typed, (TEXELS, TEXELS)) == 1, 255, 0).astype(np.uint8)
    return parts.paint(folder, grey)


def lettered(
    folder: Path, printer: dict[str, Any], cell_mm: float, turn: tuple[float, float, float], height: int = 1
) -> NDArray[np.uint8]:
    """Labels of a part of 5 x 7 cells with the F painted on it; it does not lie at its file's origin."""
    size = (5 * cell_mm, 7 * cell_mm, height * cell_mm)
    part = parts.stl(folder, meshes.box(size, at=(16.0, -8.0, 4.0)))
    ratio = {"image": picture(folder, F), "range": [0, 1]}
    job = parts.job(part, ratio=ratio, orientation=27, printer=printer, settings={"rotate": turn})
    return parts.labels(job)


@pytest.mark.parametrize("printer", [FINE, DPI], ids=["125x250um", "600x300dpi"])
@pytest.mark.parametrize(
    ("turn", "expected"),
    [
        ((0, 0, 0), F),
        ((0, 0, 90), TURNED_90),
        ((0, 0, 180), TURNED_180),
        ((0, 0, 270), TURNED_270),
        ((0, 0, -90), TURNED_270),
        ((180, 0, 0), OVER_X),
        ((0, 180, 0), OVER_Y),
    ],
)
def test_painted_letter(
    tmp_path: Path, turn: tuple[float, float, float], expected: Sequence[str],
    printer: tuple[dict[str, Any], float, tuple[int, int]],
) -> None:  # fmt: skip
    settings, cell_mm, pixels = printer
    labels = lettered(tmp_path, settings, cell_mm, turn)
    np.testing.assert_array_equal(labels, bitmap(expected, pixels)[None])


def test_letter_stands_up(tmp_path: Path) -> None:
    """Turned 90° about x, file y points up: the lowest layer shows the picture's lowest row."""
    labels = lettered(tmp_path, FINE[0], FINE[1], (90, 0, 0), height=3)
    rows = ("X....", "X....", "X....", "XXXX.", "X....", "X....", "XXXXX")
    expected = np.stack([bitmap([row] * 3, FINE[2]) for row in rows])
    np.testing.assert_array_equal(labels, expected)


def test_letter_stands_up_on_its_right_side(tmp_path: Path) -> None:
    """Turned 90° about y, file x points down: the lowest layer shows the picture's right column."""
    labels = lettered(tmp_path, FINE[0], FINE[1], (0, 90, 0), height=3)
    columns = ("X......", "X..X...", "X..X...", "X..X...", "XXXXXXX")
    expected = np.stack([bitmap([[letter] * 3 for letter in column], FINE[2]) for column in columns])
    np.testing.assert_array_equal(labels, expected)


def test_picture_on_a_box(tmp_path: Path) -> None:
    """A picture of 2 x 2 cells on the lower right quarter; outside its box it is clamped."""
    part = parts.stl(tmp_path, meshes.box((2.0, 2.0, 0.25), at=(16.0, -8.0, 4.0)))
    ratio = {"image": picture(tmp_path, ("X.", ".X")), "range": [0, 1], "box": [17.0, -8.0, 18.0, -7.0]}
    labels = parts.bitmap(parts.job(part, ratio=ratio, printer=FINE[0]))
    expected = ("XXXXXX..",
                "XXXXXX..",
                "XXXXXX..",
                "XXXXXX..",
                "XXXXXX..",
                "XXXXXX..",
                "......XX",
                "......XX")  # fmt: skip
    np.testing.assert_array_equal(labels, bitmap(expected, FINE[2]))


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_gradient_axes(tmp_path: Path, axis: str) -> None:
    """A step from 0 to 1 in the middle of a cube of 4 cells: the first material has the larger coordinates."""
    low = {"x": 16.0, "y": -8.0, "z": 4.0}
    part = parts.stl(tmp_path, meshes.box((1.0, 1.0, 1.0), at=(low["x"], low["y"], low["z"])))
    step = {"axis": axis, "from": 0, "to": 1, "start": low[axis] + 0.49, "end": low[axis] + 0.51}
    labels = parts.labels(parts.job(part, ratio={"gradient": step}, printer=FINE[0]))
    right = ("..XX", "..XX", "..XX", "..XX")
    back = ("XXXX", "XXXX", "....", "....")
    first, second = ("....",) * 4, ("XXXX",) * 4
    expected = {"x": [right] * 4, "y": [back] * 4, "z": [first, first, second, second]}[axis]
    np.testing.assert_array_equal(labels, np.stack([bitmap(typed, FINE[2]) for typed in expected]))


# Four corners, four directions: typed for the part as it lies, and turned by 90 degrees (each corner moves on
# counter-clockwise and its direction grows by 90).
CORNERS = ((10, 50), (100, 160))
CORNERS_TURNED_90 = ((140, 70), (100, 10))


@pytest.mark.parametrize("printer", [parts.SQUARE, parts.OBLONG], ids=["square", "600x300dpi"])
@pytest.mark.parametrize(("turn", "expected"), [(0, CORNERS), (90, CORNERS_TURNED_90)])
def test_four_corners_of_directions(
    tmp_path: Path, turn: float, expected: tuple[tuple[float, float], ...], printer: dict[str, Any]
) -> None:
    """A 48 x 32 mm plate, each quarter's inner part within 3.5° of its typed direction."""
    grey = np.kron(np.array(CORNERS, np.uint8), np.ones((32, 32), np.uint8))
    orientation = {"image": parts.paint(tmp_path, grey), "range": [0, 255]}
    job = parts.job(
        parts.plate(tmp_path, 48, 32), orientation=orientation, printer=printer, settings={"rotate": [0, 0, turn]}
    )
    labels = parts.bitmap(job)
    height, width = labels.shape
    pitch = parts.pitch_mm(printer)[:2]
    assert (width > height * pitch[1] / pitch[0]) == (turn == 0)
    border = [round(2 / p) for p in pitch]
    for row in (0, 1):
        for column in (0, 1):
            quarter = labels[
                row * height // 2 + border[1] : (row + 1) * height // 2 - border[1],
                column * width // 2 + border[0] : (column + 1) * width // 2 - border[0],
            ]
            measured = analysis.mean_direction(analysis.signed(quarter), pitch, 1.0)
            print(
                f"turned {turn}: row {row}, column {column}: painted {expected[row][column]}, measured {measured:.1f}"
            )
            assert analysis.line_error(measured, expected[row][column]) <= 3.5
