"""How many pixels cover a part, and where their centres lie."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amslicer.grid import MM_PER_INCH, Grid, centre_mm, cover, first_centre


@pytest.mark.parametrize(
    ("size_mm", "pitch_mm", "pixels"),
    [
        (10.0, 2.5, 4),
        (10.0, 3.0, 4),
        (9.0, 3.0, 3),
        (0.3, 0.1, 3),  # 0.3 / 0.1 = 2.9999999999999996 in float64
        (0.7, 0.1, 7),  # 6.999999999999999
        (2.1, 0.7, 3),  # 3.0000000000000004
        (4.0009, 1.0, 4),  # within a thousandth of a pixel above a whole number: none more
        (4.0011, 1.0, 5),
        (0.40009, 0.1, 4),  # a thousandth of a pixel, not of a mm
        (0.40011, 0.1, 5),
        (3.9989, 1.0, 4),
        (4.5, 1.0, 5),
        (25.4, 25.4 / 600, 600),
        (1.0, 0.027, 38),  # 37.04
        (0.999, 0.027, 37),
        (0.0, 0.1, 1),  # at least one
        (1e-9, 0.1, 1),
        (0.05, 0.1, 1),
        (3048.0, 10.0, 305),
    ],
)
def test_number_of_pixels_is_size_over_pitch_rounded_up(size_mm: float, pitch_mm: float, pixels: int) -> None:
    assert cover((size_mm, 1.0, 1.0), (pitch_mm, 1.0), 1.0).columns == pixels
    assert cover((1.0, size_mm, 1.0), (1.0, pitch_mm), 1.0).rows == pixels
    assert cover((1.0, 1.0, size_mm), (1.0, 1.0), pitch_mm).layers == pixels


def test_each_axis_has_its_own_pitch() -> None:
    grid = cover(np.array([10.0, 10.0, 10.0]), (2.0, 4.0), 0.5)
    assert (grid.columns, grid.rows, grid.layers) == (5, 3, 20)
    assert grid.pitch_mm == (2.0, 4.0)
    assert grid.layer_mm == 0.5
    assert grid.voxel_mm3 == 4.0
    assert all(type(count) is int for count in (grid.columns, grid.rows, grid.layers))


def test_margin_is_added_on_each_side_in_x_and_y_only() -> None:
    plain, grid = (cover((3.0, 5.0, 7.0), (1.0, 1.0), 1.0, margin_px=margin) for margin in (0, 4))
    assert (plain.width_px, plain.height_px) == (3, 5)
    assert (grid.width_px, grid.height_px) == (11, 13)
    assert (grid.columns, grid.rows, grid.layers) == (3, 5, 7)


def test_centres_are_half_a_pixel_from_the_corner() -> None:
    grid = Grid(columns=3, rows=2, layers=4, pitch_mm=(0.5, 2.0), layer_mm=0.25)
    np.testing.assert_array_equal(grid.x_mm(), [0.25, 0.75, 1.25])
    np.testing.assert_array_equal(grid.y_mm(), [1.0, 3.0])
    assert [grid.z_mm(layer) for layer in range(4)] == [0.125, 0.375, 0.625, 0.875]
    np.testing.assert_array_equal(centre_mm(np.arange(-1, 3), 0.5), [-0.25, 0.25, 0.75, 1.25])


def test_corner_is_the_parts_own_less_the_margin() -> None:
    grid = cover((3.0, 5.0, 7.0), (0.5, 0.25), 1.0, margin_px=6)
    assert grid.corner_mm([10.0, -20.0, 0.5]) == (7.0, -21.5, 0.5)
    assert grid.corner_mm(np.array([0.0, 0.0, 0.0])) == (-3.0, -1.5, 0.0)
    assert cover((3.0, 5.0, 7.0), (0.5, 0.25), 1.0).corner_mm([1.0, 2.0, 3.0]) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("margin_px", [0, 3])
def test_pixels_of_a_written_bitmap_lie_where_the_manifest_says(margin_px: int) -> None:
    """x = origin.x + (c + 1/2) px, y = origin.y + (H - r - 1/2) py, z = origin.z + (l + 1/2) layer."""
    part_origin = (100.0, -50.0, 2.0)
    grid = cover((4.0, 3.0, 1.0), (0.5, 0.25), 0.125, margin_px)
    origin = grid.corner_mm(part_origin)
    height = grid.height_px
    for column in range(grid.columns):
        written = origin[0] + (column + margin_px + 0.5) * 0.5
        assert part_origin[0] + grid.x_mm()[column] == written
    for row in range(grid.rows):
        written_row = height - 1 - (row + margin_px)  # top-down
        assert part_origin[1] + grid.y_mm()[row] == origin[1] + (height - written_row - 0.5) * 0.25
    for layer in range(grid.layers):
        assert part_origin[2] + grid.z_mm(layer) == origin[2] + (layer + 0.5) * 0.125


def test_the_whole_part_is_covered_but_for_a_thousandth_of_a_pixel() -> None:
    random = np.random.default_rng(1)
    for size, pitch in zip(random.uniform(0, 50, 500), random.uniform(0.02, 3, 500), strict=True):
        columns = cover((size, 1.0, 1.0), (pitch, 1.0), 1.0).columns
        assert columns * pitch >= size - 1.001e-3 * pitch
        assert columns == 1 or (columns - 1) * pitch < size


def test_inch_is_its_definition() -> None:
    assert MM_PER_INCH == 25.4


def test_first_centre_is_the_first_one_at_or_above() -> None:
    position = np.array([-0.2, 0.0, 0.125, 0.25, 0.26, 0.5, 0.75, 0.7500001, 1.3])
    found = first_centre(position, 0.5)  # centres at 0.25, 0.75, 1.25
    np.testing.assert_array_equal(found, [0, 0, 0, 0, 1, 1, 1, 2, 3])
    assert found.dtype == np.int64
    np.testing.assert_array_equal(first_centre(np.array([-0.25, -0.26, -0.76]), 0.5), [-1, -1, -2])


@pytest.mark.parametrize("pitch_mm", [2.0, 1.0, 0.5, 0.125, 2.0**-9])
def test_first_centre_is_half_open(pitch_mm: float) -> None:
    """A position on a centre belongs to it; the next float64 above belongs to the next centre."""
    index = np.arange(1, 2000)
    centre = (2 * index + 1) * (pitch_mm / 2)  # exact
    np.testing.assert_array_equal(first_centre(centre, pitch_mm), index)
    np.testing.assert_array_equal(centre_mm(index, pitch_mm), centre)
    above = np.nextafter(centre, math.inf)
    # Subtracting the half loses the last bit or two of a quotient of this size, never more.
    np.testing.assert_array_equal(first_centre(centre + 8 * (above - centre), pitch_mm), index + 1)
    np.testing.assert_array_equal(first_centre(np.nextafter(centre, -math.inf), pitch_mm), index)


@given(
    st.lists(st.floats(-1e4, 1e4), min_size=2, max_size=30),
    st.floats(1e-3, 10),
)
@settings(deadline=None, max_examples=200)
def test_first_centre_is_monotone_and_right_within_rounding(positions: list[float], pitch_mm: float) -> None:
    position = np.sort(np.array(positions))
    index = first_centre(position, pitch_mm)
    assert (np.diff(index) >= 0).all()
    slack = 4 * np.spacing(np.abs(position) + pitch_mm)
    assert ((index + 0.5) * pitch_mm >= position - slack).all()
    assert ((index - 0.5) * pitch_mm < position + slack).all()


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 10))
@settings(deadline=None, max_examples=200)
def test_first_centre_is_monotone_from_one_float_to_the_next(position: float, pitch_mm: float) -> None:
    """Around the centre nearest to any position, where rounding could break the order."""
    start = (math.floor(position / pitch_mm) + 0.5) * pitch_mm
    steps = start + np.arange(-40, 41) * np.spacing(start)
    index = first_centre(steps, pitch_mm)
    assert (np.diff(index) >= 0).all()
    assert index[-1] - index[0] <= 1
