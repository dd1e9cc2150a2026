"""Painted fields against formulas written out here, in the part's own coordinates."""

from __future__ import annotations

import io
import json
import struct
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshes
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from pydantic import TypeAdapter

from amslicer import JobError, load_job
from amslicer.fields import FieldSpec, Frame, Inputs, Sampler, open_field
from amslicer.fields.image import read_grey
from amslicer.fields.orientation import Angles, Orientation
from amslicer.fields.source import blend
from amslicer.pipeline import prepare
from amslicer.placement import Placement, place
from amslicer.profiles import PROFILES

THRESHOLDS = PROFILES["pwm"].thresholds
Floats = NDArray[np.float64]

# A part away from the file's origin, with three different sides.
MINIMUM = np.array([10.0, -5.0, 3.0])
SIZE = np.array([4.0, 2.0, 1.0])
FRAME = Frame(MINIMUM, SIZE)
# Points of the part, and some outside it: field frame, from the box's minimum.
POINTS = np.random.default_rng(8).uniform(-1.0, 5.0, (300, 3))
ROUNDING = 1e-12


def sampler(spec: Any, frame: Frame = FRAME, **pictures: bytes) -> Sampler:
    """A field as the job file writes it, opened over a part; pictures by their name."""
    field: Any = TypeAdapter(FieldSpec).validate_python(spec)
    return open_field(field, frame, Inputs(Path("nowhere"), dict(pictures)))


def values(field: Sampler, points: Floats = POINTS) -> Floats:
    return np.broadcast_to(field.scalar(*points.T), len(points))


def png(pixels: Any, bits: int = 8) -> bytes:
    """A grey PNG of 8 or 16 bit, first row at the top."""
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8 if bits == 8 else np.uint16)).save(stream, "PNG")
    return stream.getvalue()


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def raw_png(
    width: int, height: int, rows: bytes, *, bits: int = 8, kind: int = 0, extra: bytes = b"", compressed: bytes = b""
) -> bytes:
    """A PNG by hand (RFC 2083): each of its rows begins with filter type 0."""
    header = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)
    data = compressed or zlib.compress(rows)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    )  # fmt: skip


def tiff(pixels: Any, *, bits: int, order: str = "<", white_is_zero: bool = False, sample_format: int = 1) -> bytes:
    """An uncompressed grey TIFF by hand (TIFF 6.0, page 37)."""
    array = np.asarray(pixels)
    data = array.astype(f"{order}u{bits // 8}").tobytes()
    entries = [
        (256, array.shape[1]), (257, array.shape[0]), (258, bits), (259, 1), (262, 0 if white_is_zero else 1),
        (273, 0), (277, 1), (278, array.shape[0]), (279, len(data)), (339, sample_format),
    ]  # fmt: skip
    end = 8 + 2 + 12 * len(entries) + 4
    out = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, len(entries))
    for tag, value in entries:
        out += struct.pack(f"{order}HHII", tag, 4, 1, end if tag == 273 else value)  # 4: LONG
    return out + struct.pack(f"{order}I", 0) + data


# Constants and gradients


def test_a_constant_is_the_same_everywhere() -> None:
    field = sampler(0.3)
    assert np.array_equal(values(field), np.full(300, 0.3))
    assert field.varies == (False, False, False)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("low", "high"), [(0.1, 0.9), (0.9, 0.1), (-90.0, 45.0)])
def test_a_gradient_is_linear_over_the_bounding_box(axis: int, low: float, high: float) -> None:
    field = sampler({"gradient": {"axis": "xyz"[axis], "from": low, "to": high}})
    share = np.clip(POINTS[:, axis] / SIZE[axis], 0, 1)
    np.testing.assert_allclose(values(field), low + share * (high - low), rtol=0, atol=100 * ROUNDING)
    assert field.varies == tuple(i == axis for i in range(3))


@pytest.mark.parametrize(
    ("start", "end"), [(11.0, 12.5), (12.5, 11.0), (0.0, 100.0), (None, 12.0), (11.0, None), (10.0, 14.0)]
)
def test_start_and_end_are_file_coordinates(start: float | None, end: float | None) -> None:
    gradient = {"axis": "x", "from": 0.2, "to": 0.6, "start": start, "end": end}
    x0, x1 = 10.0 if start is None else start, 14.0 if end is None else end
    share = np.clip((POINTS[:, 0] + 10.0 - x0) / (x1 - x0), 0, 1)
    np.testing.assert_allclose(values(sampler({"gradient": gradient})), 0.2 + share * 0.4, rtol=0, atol=ROUNDING)


def test_the_ends_of_a_gradient_are_exact_and_hold_beyond() -> None:
    field = sampler({"gradient": {"axis": "y", "from": 0.1, "to": 0.3, "start": -4.5, "end": -3.5}})
    points = np.array([[0, y, 0] for y in (-100.0, 0.0, 0.5, 1.5, 2.0, 100.0)])
    assert values(field, points).tolist() == [0.1, 0.1, 0.1, 0.3, 0.3, 0.3]


INSIDE_OR_ON = np.clip(POINTS, 0, SIZE)  # every radial value is that of the box's nearest point


@pytest.mark.parametrize("center", [(11.5, -4.0, 3.5), (10.0, -5.0, 3.0), (0.0, 0.0, 0.0), (11.5, -4.0), (20.0, -6.0)])
@pytest.mark.parametrize("radius", [0.01, 1.5, 1000.0])
@pytest.mark.parametrize(("low", "high"), [(0.1, 0.9), (0.9, 0.1), (-90.0, 45.0)])
def test_a_radial_gradient_is_linear_in_the_distance(
    center: tuple[float, ...], radius: float, low: float, high: float
) -> None:
    field = sampler({"gradient": {"center": list(center), "radius": radius, "from": low, "to": high}})
    away = INSIDE_OR_ON[:, : len(center)] + MINIMUM[: len(center)] - center
    share = np.minimum(np.linalg.norm(away, axis=1) / radius, 1)
    np.testing.assert_allclose(values(field), low + share * (high - low), rtol=0, atol=100 * ROUNDING)
    assert field.varies == (True, True, len(center) == 3)
    assert field.texels is None


def test_a_radial_gradient_is_exact_at_the_centre_and_from_the_radius_on() -> None:
    field = sampler({"gradient": {"center": [11.0, -4.0, 3.5], "radius": 0.5, "from": 0.7, "to": 0.1}})
    points = np.array([[1, 1, 0.5], [1.5, 1, 0.5], [1, 0.5, 0.5], [1, 1, 1], [1.5, 1.5, 1], [4, 2, 0]])
    assert values(field, points).tolist() == [0.7, 0.1, 0.1, 0.1, 0.1, 0.1]
    assert values(field, np.array([[1.25, 1, 0.5]]))[0] == pytest.approx(0.4, abs=ROUNDING)


def test_around_a_line_the_height_does_not_matter() -> None:
    field = sampler({"gradient": {"center": [11.0, -4.0], "radius": 3, "from": 0, "to": 1}})
    x, y, z = np.linspace(0, 4, 7)[None, :], np.linspace(0, 2, 5)[:, None], np.linspace(0, 1, 3)[:, None, None]
    assert field.scalar(x, y, z).shape == (5, 7)


@pytest.mark.parametrize(
    ("center", "radius", "nearest", "farthest"),
    [
        # The box is 10 … 14, -5 … -3, 3 … 4 mm; by hand the distances to its nearest and farthest point.
        ([12, -4, 3.5], 100, 0, np.sqrt(4 + 1 + 0.25)),
        ([10, -5, 3], 100, 0, np.sqrt(16 + 4 + 1)),
        ([7, -5, 3], 100, 3, np.sqrt(49 + 4 + 1)),
        ([7, -9, 9], 100, np.sqrt(9 + 16 + 25), np.sqrt(49 + 36 + 36)),
        ([7, -9], 100, 5, np.sqrt(49 + 36)),
        ([12, -4], 1, 0, 1),
        ([7, -9], 1, 1, 1),
    ],
)
@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.8, 0.2)])
def test_bounds_of_a_radial_gradient_are_tight(
    center: list[float], radius: float, nearest: float, farthest: float, low: float, high: float
) -> None:
    field = sampler({"gradient": {"center": center, "radius": radius, "from": low, "to": high}})
    expected = sorted(low + share / radius * (high - low) for share in (nearest, farthest))
    assert field.bounds == pytest.approx(expected, abs=ROUNDING)
    assert values(field).min() >= field.bounds[0]
    assert values(field).max() <= field.bounds[1]


@pytest.mark.parametrize("center", [[1e300, 0, 0], [-1e308, 1e308], [1e-300, 0, 0]])
@pytest.mark.parametrize("radius", [1e-300, 1e300])
def test_a_radial_gradient_of_absurd_size_is_a_number(center: list[float], radius: float) -> None:
    field = sampler({"gradient": {"center": center, "radius": radius, "from": 0.2, "to": 0.7}})
    assert ((values(field) >= 0.2) & (values(field) <= 0.7)).all()


def test_values_between_two_ends_never_pass_them() -> None:
    """Bounds rely on it. (With t < 1 the product rounds to less than b - a, so only t = 1 needs care.)"""
    rng = np.random.default_rng(1)
    t = np.concatenate([1 - np.arange(20) * 2.0**-53, 1 - np.logspace(-15, -1, 100), [0.0]])
    for a, b in rng.uniform(-1, 1, (2000, 2)):
        assert blend(t, a, b).min() >= min(a, b)
        assert blend(t, a, b).max() <= max(a, b)


# Pictures

PICTURE = np.array([[0, 51, 255], [102, 153, 204]])  # two rows of three


def bilinear(pixels: Floats, u: Floats, v: Floats) -> Floats:
    """The mean of a picture's texels, weighted by how near their centres are; u, v: shares of the box, v upwards."""
    rows, columns = pixels.shape
    x, y = np.clip(u * columns - 0.5, 0, columns - 1), np.clip((1 - v) * rows - 0.5, 0, rows - 1)
    total = np.zeros_like(u)
    for row in range(rows):
        for column in range(columns):
            near = np.maximum(0, 1 - np.abs(x - column)) * np.maximum(0, 1 - np.abs(y - row))
            total += near * pixels[row, column]
    return total


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("shape", [(2, 3), (1, 1), (1, 4), (5, 1), (3, 3), (7, 2)])
def test_a_picture_is_bilinear_over_the_box_and_clamped(bits: int, shape: tuple[int, int]) -> None:
    full = 2**bits - 1
    grey = np.random.default_rng(shape).integers(0, full + 1, shape)
    field = sampler({"image": "a"}, a=png(grey, bits))
    expected = bilinear(grey / full, POINTS[:, 0] / 4.0, POINTS[:, 1] / 2.0)
    np.testing.assert_allclose(values(field), expected, rtol=0, atol=ROUNDING)


def test_texel_centres_have_their_own_value_and_the_top_row_is_the_largest_y() -> None:
    field = sampler({"image": "a"}, a=png(PICTURE))
    x, y = (np.arange(3) + 0.5) * 4 / 3, np.array([1.5, 0.5])
    found = field.scalar(x[None, :], y[:, None], np.zeros((1, 1)))
    np.testing.assert_allclose(found, PICTURE / 255, rtol=0, atol=ROUNDING)


def test_a_picture_reaches_through_the_part() -> None:
    field = sampler({"image": "a"}, a=png(PICTURE))
    assert field.varies == (True, True, False)
    moved = POINTS + np.array([0, 0, 7.0])
    assert np.array_equal(values(field), values(field, moved))


@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (0.15, 0.8), (0.8, 0.15), (-90.0, 90.0), (0.3, 0.3), (0.1, 0.7)])
@pytest.mark.parametrize("bits", [8, 16])
def test_range_maps_black_to_its_first_and_white_to_its_second_number(a: float, b: float, bits: int) -> None:
    full = 2**bits - 1
    black, white, grey = (
        values(sampler({"image": "a", "range": [a, b]}, a=png([[level]], bits)))[0] for level in (0, full, full // 5)
    )
    assert black == a
    assert white == b
    assert grey == pytest.approx(a + 0.2 * (b - a), abs=1e-13)


def test_white_is_exactly_the_second_number_even_where_a_plus_b_minus_a_is_not() -> None:
    a, b = 0.7, 0.1
    a_plus = a + (b - a)
    assert a_plus != b, "the case says nothing"
    assert blend(np.array([1.0]), a, b)[0] == b
    assert values(sampler({"image": "a", "range": [a, b]}, a=png([[255, 255]])))[0] == b


@pytest.mark.parametrize("box", [[11.0, -4.0, 13.0, -3.5], [0.0, -10.0, 100.0, 10.0], [20.0, 5.0, 21.0, 6.0]])
def test_a_box_is_in_file_coordinates(box: list[float]) -> None:
    field = sampler({"image": "a", "box": box}, a=png(PICTURE))
    u = (POINTS[:, 0] + 10.0 - box[0]) / (box[2] - box[0])
    v = (POINTS[:, 1] - 5.0 - box[1]) / (box[3] - box[1])
    np.testing.assert_allclose(values(field), bilinear(PICTURE / 255, u, v), rtol=0, atol=ROUNDING)


PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@pytest.mark.parametrize("plane", PLANES)
def test_a_picture_lies_in_its_plane(plane: str) -> None:
    """Columns along the plane's first axis; the top row is where the second is largest."""
    across, up = PLANES[plane]
    field = sampler({"image": "a", "plane": plane}, a=png(PICTURE))
    expected = bilinear(PICTURE / 255, POINTS[:, across] / SIZE[across], POINTS[:, up] / SIZE[up])
    np.testing.assert_allclose(values(field), expected, rtol=0, atol=ROUNDING)
    assert field.varies == tuple(axis in (across, up) for axis in range(3))
    samples, weights = field.taps(*POINTS.T)
    np.testing.assert_allclose((samples * weights).sum(axis=0), expected, rtol=0, atol=ROUNDING)
    top = np.zeros((1, 3))
    top[0, up] = SIZE[up]
    assert values(field, top)[0] == PICTURE[0, 0] / 255


@pytest.mark.parametrize("plane", PLANES)
def test_a_box_is_in_its_planes_file_coordinates(plane: str) -> None:
    across, up = PLANES[plane]
    low, high = (MINIMUM + offset for offset in np.array([[0.5, -1.0, 0.25], [3.0, 1.5, 2.0]]))
    box = [low[across], low[up], high[across], high[up]]
    field = sampler({"image": "a", "plane": plane, "box": box}, a=png(PICTURE))
    u, v = ((POINTS[:, i] + MINIMUM[i] - low[i]) / (high[i] - low[i]) for i in (across, up))
    np.testing.assert_allclose(values(field), bilinear(PICTURE / 255, u, v), rtol=0, atol=ROUNDING)


def test_a_picture_varies_where_it_has_texels() -> None:
    row = {plane: sampler({"image": "a", "plane": plane}, a=png([[0, 255]])).varies for plane in PLANES}
    column = {plane: sampler({"image": "a", "plane": plane}, a=png([[0], [255]])).varies for plane in PLANES}
    assert row == {"xy": (True, False, False), "xz": (True, False, False), "yz": (False, True, False)}
    assert column == {"xy": (False, True, False), "xz": (False, False, True), "yz": (False, False, True)}


def test_pictures_in_different_planes_do_not_share_texels() -> None:
    """Even over the same rectangle of a cube."""
    cube = Frame(np.zeros(3), np.ones(3))
    texels = [sampler({"image": "a", "plane": plane}, cube, a=png(PICTURE)).texels for plane in (*PLANES, "xz")]
    assert len(set(texels)) == 3
    assert texels[1] == texels[3]


def test_a_box_of_the_parts_size_is_the_default() -> None:
    plain = sampler({"image": "a"}, a=png(PICTURE))
    boxed = sampler({"image": "a", "box": [10, -5, 14, -3]}, a=png(PICTURE))
    assert np.array_equal(values(plain), values(boxed))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("white_is_zero", [False, True])
def test_tiff_in_both_byte_orders_and_polarities(order: str, bits: int, white_is_zero: bool) -> None:
    """Black is range[0], however the file stores black: refused, or read for what it shows."""
    full = 2**bits - 1
    pixels = np.array([[0, 1, full // 5], [full, 2, 3]])
    try:
        grey, scale = read_grey(tiff(pixels, bits=bits, order=order, white_is_zero=white_is_zero), "a.tif")
    except JobError:
        assert white_is_zero
        return
    assert scale == full
    assert grey.tolist() == (full - pixels if white_is_zero else pixels).tolist()


@pytest.mark.parametrize(
    ("bits", "row", "expected"),
    [
        (1, b"\xa0", [1.0, 0.0, 1.0, 0.0]),
        (2, b"\x1b", [0.0, 1 / 3, 2 / 3, 1.0]),
        (4, b"\x0f\x39", [0.0, 1.0, 0.2, 0.6]),
        (8, b"\x00\xff\x33\x99", [0.0, 1.0, 0.2, 0.6]),
        (16, b"\x00\x00\xff\xff\x33\x33\x00\x01", [0.0, 1.0, 0.2, 1 / 65535]),
    ],
)
def test_every_depth_of_grey_png(bits: int, row: bytes, expected: list[float]) -> None:
    grey, full = read_grey(raw_png(4, 1, b"\0" + row, bits=bits), "a.png")
    assert (grey / full).tolist() == [expected]


# The same value, however it is written

WAYS = {
    "constant": (0.2, {}),
    "gradient": ({"gradient": {"axis": "x", "from": 0.2, "to": 0.2}}, {}),
    "gradient between places": ({"gradient": {"axis": "z", "from": 0.2, "to": 0.2, "start": 0.1, "end": 0.7}}, {}),
    "8 bit": ({"image": "a"}, {"a": png(np.full((5, 7), 51))}),
    "16 bit": ({"image": "a"}, {"a": png(np.full((3, 2), 13107), 16)}),
    "one pixel": ({"image": "a"}, {"a": png([[51]])}),
    "4 bit": ({"image": "a"}, {"a": raw_png(2, 1, b"\0\x33", bits=4)}),
    "16 bit tiff": ({"image": "a"}, {"a": tiff(np.full((3, 2), 13107), bits=16, order=">")}),
    "black": ({"image": "a", "range": [0.2, 0.9]}, {"a": png([[0, 0]])}),
    "white": ({"image": "a", "range": [0.7, 0.2]}, {"a": png([[255, 255]])}),
    "empty range": ({"image": "a", "range": [0.2, 0.2]}, {"a": png(PICTURE)}),
    "box": ({"image": "a", "box": [0.1, 0.2, 0.3, 7.7]}, {"a": png(np.full((5, 7), 51))}),
    "xz": ({"image": "a", "plane": "xz"}, {"a": png(np.full((5, 7), 51))}),
    "yz box": ({"image": "a", "plane": "yz", "box": [0.1, 0.2, 0.3, 7.7]}, {"a": png(np.full((5, 7), 51))}),
    "around a point": ({"gradient": {"center": [11.3, -4, 3], "radius": 3, "from": 0.2, "to": 0.2}}, {}),
    "around a line": ({"gradient": {"center": [11.3, -4], "radius": 0.7, "from": 0.2, "to": 0.2}}, {}),
    "beyond the radius": ({"gradient": {"center": [90, 0, 0], "radius": 3, "from": 0.7, "to": 0.2}}, {}),
    "expression": ({"expression": "0.2"}, {}),
    "folded": ({"expression": "1/5"}, {}),
    "expression of x": ({"expression": "where(x > -100, 0.2, x)"}, {}),
}


@pytest.mark.parametrize("way", WAYS)
def test_the_same_value_gives_the_same_bits(way: str) -> None:
    spec, pictures = WAYS[way]
    found = values(sampler(spec, **pictures))
    assert np.array_equal(found, np.full(300, 0.2))
    bits = THRESHOLDS(found).view(np.uint32)
    assert np.array_equal(bits, THRESHOLDS(np.full(300, 0.2)).view(np.uint32))


def test_the_threshold_of_a_fifth() -> None:
    """cos(π/5) = (1 + √5) / 4, whose square is the threshold."""
    assert THRESHOLDS(np.array([0.2]))[0] == np.float32(((1 + np.sqrt(5)) / 4) ** 2)


@pytest.mark.parametrize("way", WAYS)
def test_the_same_angle_gives_the_same_normals(way: str) -> None:
    spec, pictures = WAYS[way]
    found = normals(Angles(sampler(spec, **pictures)))
    assert np.array_equal(found, normals(Angles(sampler(0.2))))


# Orientation


def normals(orientation: Orientation, points: Floats = POINTS) -> Floats:
    return orientation.normals(*points.T)


def middle(shape: tuple[int, int]) -> Floats:
    """The border between the two columns (or rows) of a picture of two texels."""
    return np.array([[2.0 if shape[1] == 2 else 1.0, 1.0 if shape[0] == 2 else 0.5, 0.5]])


def line_angle(normal: Floats) -> float:
    """Degrees in 0 … 180 of a normal in the plane, its sign left out."""
    assert normal[2] == 0
    return float(np.rad2deg(np.arctan2(normal[1], normal[0])) % 180)


def from_line(found: float, expected: float) -> float:
    """How far two lines are apart, degrees."""
    return abs((found - expected + 90) % 180 - 90)


@pytest.mark.parametrize(
    ("angle_deg", "normal"),
    [
        (0, (1, 0, 0)),
        (30, (np.sqrt(0.75), 0.5, 0)),
        (90, (0, 1, 0)),
        (-90, (0, -1, 0)),
        (180, (-1, 0, 0)),
        (765, (np.sqrt(0.5), np.sqrt(0.5), 0)),
    ],
)
def test_a_constant_angle(angle_deg: float, normal: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(normals(Angles(sampler(angle_deg)))[0], normal, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "normal"),
    [
        (0, 0, (1, 0, 0)),
        (0, 90, (0, 0, 1)),
        (123, 90, (0, 0, 1)),
        (0, -90, (0, 0, -1)),
        (90, 30, (0, np.sqrt(0.75), 0.5)),
        (45, 45, (0.5, 0.5, np.sqrt(0.5))),
        (0, 120, (-0.5, 0, np.sqrt(0.75))),
    ],
)
def test_azimuth_and_elevation(azimuth: float, elevation: float, normal: tuple[float, float, float]) -> None:
    found = normals(Angles(sampler(azimuth), sampler(elevation)))
    np.testing.assert_allclose(found[0], normal, rtol=0, atol=ROUNDING)


def test_a_gradient_of_an_angle_is_a_plain_number() -> None:
    """Half way from 1 to 179 degrees is 90, though as lines they are 2 degrees apart."""
    field = Angles(sampler({"gradient": {"axis": "x", "from": 1, "to": 179}}))
    angles = np.deg2rad(1 + np.clip(POINTS[:, 0] / 4, 0, 1) * 178)
    expected = np.stack([np.cos(angles), np.sin(angles), np.zeros(300)], axis=-1)
    np.testing.assert_allclose(normals(field), expected, rtol=0, atol=ROUNDING)


def test_gradients_of_azimuth_and_elevation_are_plain_numbers() -> None:
    field = Angles(
        sampler({"gradient": {"axis": "x", "from": 1, "to": 179}}),
        sampler({"gradient": {"axis": "y", "from": -80, "to": 80}}),
    )
    azimuth = np.deg2rad(1 + np.clip(POINTS[:, 0] / 4, 0, 1) * 178)
    elevation = np.deg2rad(-80 + np.clip(POINTS[:, 1] / 2, 0, 1) * 160)
    expected = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    np.testing.assert_allclose(normals(field), np.stack(expected, axis=-1), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("shape", [(1, 2), (2, 1)])
@pytest.mark.parametrize(
    ("one", "other", "between"),
    [(1, 179, 0), (-90, 90, 90), (89, -89, 90), (80, 100, 90), (0, 60, 30), (-45, 44, -0.5), (10, 350, 0)],
)
def test_pictures_of_angles_are_averaged_as_lines(
    one: float, other: float, between: float, shape: tuple[int, int]
) -> None:
    picture = png(np.array([0, 255]).reshape(shape))
    field = Angles(sampler({"image": "a", "range": [one, other]}, a=picture))
    found = normals(field, middle(shape))[0]
    assert from_line(line_angle(found), between) < 1e-9
    assert np.linalg.norm(found) == pytest.approx(1, abs=ROUNDING)


def test_lines_are_averaged_by_their_doubled_angle() -> None:
    field = Angles(sampler({"image": "a", "range": [10, 70]}, a=png([[0, 255]])))
    for x in np.linspace(0, 4, 17):
        share = np.clip(x / 4 * 2 - 0.5, 0, 1)
        vector = (1 - share) * np.exp(2j * np.deg2rad(10)) + share * np.exp(2j * np.deg2rad(70))
        found = normals(field, np.array([[x, 1.0, 0.5]]))[0]
        assert from_line(line_angle(found), float(np.rad2deg(np.angle(vector)) / 2)) < 1e-9


def test_a_uniform_picture_keeps_its_sign() -> None:
    """-90 painted everywhere is the direction of the number -90."""
    field = Angles(sampler({"image": "a", "range": [-90, 90]}, a=png(np.zeros((4, 4)))))
    np.testing.assert_allclose(normals(field), np.tile([0, -1, 0], (300, 1)), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("elevation_shape", [(1, 2), (1, 1)], ids=["same texels", "other texels"])
@pytest.mark.parametrize("azimuth_deg", [90, 37])
def test_an_azimuth_that_flips_with_its_elevation_is_the_same_line(
    azimuth_deg: int, elevation_shape: tuple[int, int]
) -> None:
    """(az, el) and (az - 180, -el) are n and -n."""
    azimuth = sampler({"image": "a", "range": [azimuth_deg, azimuth_deg - 180]}, a=png([[0, 255]]))
    if elevation_shape == (1, 2):
        elevation = sampler({"image": "a", "range": [30, -30]}, a=png([[0, 255]]))
    else:
        # The other pixel grid cannot pair the flips, but a flat normal has none.
        elevation = sampler({"image": "a", "range": [0, 1]}, a=png([[0]]))
    up = np.deg2rad(30 if elevation_shape == (1, 2) else 0)
    turned = np.deg2rad(azimuth_deg)
    expected = np.array([np.cos(up) * np.cos(turned), np.cos(up) * np.sin(turned), np.sin(up)])
    for x in (0.0, 1.0, 1.5, 1.9, 2.0, 2.3, 4.0):
        found = normals(Angles(azimuth, elevation), np.array([[x, 1.0, 0.5]]))[0]
        assert abs(found @ expected) == pytest.approx(1, abs=1e-12)


def test_lines_in_space_are_averaged_through_their_tensor() -> None:
    """Two normals at equal weight: the mean line is the bisector of their smaller angle."""
    rng = np.random.default_rng(4)
    for azimuths, elevations in zip(rng.integers(-180, 181, (30, 2)), rng.integers(-90, 91, (30, 2)), strict=True):
        field = Angles(
            sampler({"image": "a", "range": [int(a) for a in azimuths]}, a=png([[0, 255]])),
            sampler({"image": "a", "range": [int(e) for e in elevations]}, a=png([[0, 255]])),
        )
        a, e = np.deg2rad(azimuths), np.deg2rad(elevations)
        one, other = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
        if abs(one @ other) < 0.05:  # nearly square to each other: two bisectors
            continue
        bisector = one + other if one @ other > 0 else one - other
        found = normals(field, middle((1, 2)))[0]
        assert abs(found @ bisector) / np.linalg.norm(bisector) == pytest.approx(1, abs=1e-9)


angles = st.floats(-1e4, 1e4)
texels = st.lists(st.integers(0, 255), min_size=4, max_size=4)


@settings(max_examples=60, deadline=None)
@given(azimuths=texels, elevations=texels, spread=st.tuples(angles, angles), solid=st.booleans(), pair=st.booleans())
def test_normals_are_unit_vectors(
    azimuths: list[int], elevations: list[int], spread: tuple[float, float], solid: bool, pair: bool
) -> None:
    azimuth = sampler({"image": "a", "range": list(spread)}, a=png(np.reshape(azimuths, (2, 2))))
    shape = (2, 2) if pair else (1, 4)
    elevation = sampler({"image": "a", "range": [-90, 90]}, a=png(np.reshape(elevations, shape)))
    found = normals(Angles(azimuth, elevation if solid else None))
    assert found.shape == (300, 3)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=0, atol=1e-9)


# Pictures that are refused


def saved(mode: str, kind: str = "PNG", **options: Any) -> bytes:
    stream = io.BytesIO()
    Image.new(mode, (3, 2)).save(stream, kind, **options)
    return stream.getvalue()


def animated(kind: str) -> bytes:
    stream = io.BytesIO()
    frames = [Image.new("L", (3, 2), level) for level in (0, 255)]
    frames[0].save(stream, kind, save_all=True, append_images=frames[1:])
    return stream.getvalue()


def rotated(kind: str) -> bytes:
    """Displayed a quarter turn from how it is stored (Exif orientation 6)."""
    exif = Image.Exif()
    exif[0x0112] = 6
    return saved("L", kind, exif=exif)


ROWS = b"".join(b"\0" + bytes([200] * 8) for _ in range(8))
EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 2 2\n%%EndComments\n0 0 2 2 rectfill\nshowpage\n%%EOF\n"
REFUSED = {
    "RGB": saved("RGB"),
    "16-bit RGB": raw_png(1, 1, b"\0" + bytes(6), bits=16, kind=2),
    "palette": saved("P"),
    "RGBA": saved("RGBA"),
    "grey and alpha": saved("LA"),
    "16-bit grey and alpha": raw_png(1, 1, b"\0" + bytes(4), bits=16, kind=4),
    "a transparent grey": raw_png(8, 8, ROWS, extra=chunk(b"tRNS", b"\0\xc8")),
    "CMYK": saved("CMYK", "TIFF"),
    "float": saved("F", "TIFF"),
    "32 bit": saved("I", "TIFF"),
    "signed": tiff([[0, 1], [2, 3]], bits=16, sample_format=2),
    "signed bytes": tiff([[0, 1], [2, 200]], bits=8, sample_format=2),
    "JPEG named png": saved("L", "JPEG"),
    "GIF named png": saved("L", "GIF"),
    "BMP named png": saved("L", "BMP"),
    "EPS named png": EPS,
    "animated": animated("PNG"),
    "several pages": animated("TIFF"),
    "rotated PNG": rotated("PNG"),
    "rotated TIFF": rotated("TIFF"),
    "empty": b"",
    "text": b"0.2 0.3\n0.4 0.5\n",
    "only a signature": b"\x89PNG\r\n\x1a\n",
    "no rows": raw_png(8, 8, b""),
    "half of the rows": raw_png(8, 8, ROWS[:36]),
    "a row too few": raw_png(8, 8, ROWS[:-9]),
    "a byte too few": raw_png(8, 8, ROWS[:-1]),
    "half of the deflate stream": raw_png(8, 8, ROWS, compressed=zlib.compress(ROWS, 0)[:40]),
    "no pixels": raw_png(0, 0, b""),
    "120 Mpx": raw_png(20_000, 6_000, ROWS),
    "3600 Mpx": raw_png(60_000, 60_000, ROWS),
    "largest PNG": raw_png(2**31 - 1, 2**31 - 1, ROWS),
    "text bomb": raw_png(8, 8, ROWS, extra=chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(200_000_000)))),
}


@pytest.mark.parametrize("case", REFUSED)
def test_pictures_that_are_refused(case: str) -> None:
    with pytest.raises(JobError) as caught:
        read_grey(REFUSED[case], "paint/a.png")
    assert "'paint/a.png'" in caught.value.message
    assert "\n" not in caught.value.message
    assert caught.value.hint


def test_the_size_is_refused_as_declared() -> None:
    with pytest.raises(JobError, match=r"20000 × 6000"):
        read_grey(REFUSED["120 Mpx"], "a.png")


@pytest.mark.parametrize("case", ["3600 Mpx", "largest PNG", "empty", "text"])
def test_messages_speak_of_the_picture_only(case: str) -> None:
    with pytest.raises(JobError) as caught:
        read_grey(REFUSED[case], "a.png")
    assert "object at 0x" not in caught.value.message


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
@pytest.mark.parametrize("bits", [8, 16])
def test_a_picture_cut_short_is_refused_or_whole(kind: str, bits: int) -> None:
    """Never a picture with other values: only what follows the last texel may be missing."""
    grey = np.random.default_rng(2).integers(1, 2**bits, (9, 11)).astype(f"u{bits // 8}")
    stream = io.BytesIO()
    Image.fromarray(grey).save(stream, kind)
    whole = stream.getvalue()
    refused = 0
    for length in range(len(whole)):
        try:
            found, _ = read_grey(whole[:length], "a.png")
        except JobError:
            refused += 1
        else:
            assert np.array_equal(found, grey), f"cut to {length} of {len(whole)} bytes"
    assert refused >= len(whole) - 40


def test_a_damaged_picture_is_refused_or_whole() -> None:
    grey = np.random.default_rng(2).integers(1, 256, (9, 11)).astype(np.uint8)
    whole = png(grey)
    start = whole.index(b"IDAT")
    for at in range(start, len(whole) - 12):
        damaged = whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :]
        try:
            found, _ = read_grey(damaged, "a.png")
        except JobError:
            continue
        assert np.array_equal(found, grey), f"byte {at}"


# Ratios outside 0 … 1


def box_job(folder: Path, ratio: Any, **pattern: Any) -> Any:
    (folder / "part.stl").write_bytes(meshes.binary_stl(meshes.box((3.0, 4.0, 0.5), (7.0, 8.0, 9.0))))
    file = folder / "job.yaml"
    content = {
        "printer": {"pitch_um": 100, "layer_um": 100},
        "materials": ["a", "b"],
        "fields": {"ratio": ratio},
        "pattern": {"dimensions": 2, **pattern},
    }
    file.write_text(json.dumps(content), encoding="utf-8")
    return load_job(file, part=folder / "part.stl")


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        # The part lies at (7, 8, 9) mm in its file, pixel centres at 0.05 … 2.95 mm in it: 0.1 + x leaves 1 at 0.95.
        ({"gradient": {"axis": "x", "from": 0.1, "to": 3.1}}, "fields.ratio is 1.05 at x = 7.95, y = 8.05"),
        ({"gradient": {"axis": "y", "from": 1.0, "to": -1.0}}, "fields.ratio is -0.025 at x = 7.05, y = 10.05"),
        ({"image": "a.png", "range": [0, 1.5]}, "fields.ratio is 1.1 at x = 8.35"),
        ({"image": "a.png", "range": [-0.25, 1]}, "fields.ratio is -0.25 at x = 7.05"),
        ({"expression": "x - 6.95"}, "fields.ratio is 1.1 at x = 8.05, y = 8.05"),
        ({"expression": "sqrt(x - 7.5)"}, 'the expression "sqrt(x - 7.5)" is nan at x = 7.05, y = 8.05, z = 9.05 mm'),
        # 0.05 from the centre's height and 0.15 mm aside: 1 + 0.1 (√(0.05² + 0.15²) / 0.1)
        (
            {"gradient": {"center": [7.2, 8.05, 9.0], "radius": 5, "from": 1, "to": 6}},
            f"fields.ratio is {1 + np.hypot(0.05, 0.15):.4g} at x = 7.05, y = 8.05",
        ),
    ],
)
def test_a_ratio_outside_0_to_1_is_refused_with_its_place(tmp_path: Path, ratio: Any, said: str) -> None:
    (tmp_path / "a.png").write_bytes(png([[0, 0, 170, 255, 255, 255]]))
    # Texels of 0.5 mm; with [0, 1.5] white is 1.5 from x = 1.75 on, and 1 at 1.25: 1 + (x - 1.25) leaves 1 at 1.35.
    prepared = prepare(box_job(tmp_path, ratio))
    with pytest.raises(JobError) as caught:
        prepared.painted.ratio_map(prepared.grid, 0)
    assert said in caught.value.message
    assert "mm (file coordinates)" in caught.value.message
    assert caught.value.hint


def test_a_ratio_that_leaves_with_the_height_is_refused_in_its_layer(tmp_path: Path) -> None:
    prepared = prepare(box_job(tmp_path, {"gradient": {"axis": "z", "from": 0.9, "to": 1.15}}))
    assert prepared.painted.ratio_depends_on_z
    layers = [0, 1]  # 0.9 + 0.05 (l + ½): 1.025 in layer 2, at 0.25 mm in the part
    for layer in layers:
        np.testing.assert_allclose(
            prepared.painted.ratio_map(prepared.grid, layer), 0.9 + 0.05 * (layer + 0.5), atol=1e-6
        )
    with pytest.raises(JobError, match=r"fields\.ratio is 1\.025 at .* z = 9\.25 mm"):
        prepared.painted.ratio_map(prepared.grid, 2)


def test_the_ratio_is_sampled_at_the_pixel_centres(tmp_path: Path) -> None:
    prepared = prepare(box_job(tmp_path, {"gradient": {"axis": "x", "from": 0.0, "to": 0.9}}))
    found = prepared.painted.ratio_map(prepared.grid, 3)
    assert found.shape == (1, 40, 30)
    np.testing.assert_allclose(found[0], np.tile((np.arange(30) + 0.5) * 0.1 * 0.3, (40, 1)), atol=1e-6)


def test_row_0_is_the_lowest_y(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png([[255], [0]]))  # white on top
    prepared = prepare(box_job(tmp_path, {"image": "a.png"}))
    found = prepared.painted.ratio_map(prepared.grid, 0)[0]
    assert found[0, 0] == 0
    assert found[-1, 0] == 1


# Frames


def placed(minimum: Floats = MINIMUM, **settings: Any) -> Placement:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * SIZE
    mesh: Any = SimpleNamespace(vertices=corners, minimum_mm=minimum)
    return place(mesh, **settings)[0]


# Points of the part, from its box's minimum in the file.
INSIDE = np.random.default_rng(6).uniform(0, 1, (50, 3)) * SIZE
FIELDS = {
    "gradient": ({"gradient": {"axis": "x", "from": 0.1, "to": 0.9}}, lambda p: 0.1 + 0.2 * p[:, 0]),
    "gradient in mm": (
        {"gradient": {"axis": "y", "from": 0.0, "to": 1.0, "start": -6.0, "end": -2.0}},
        lambda p: (p[:, 1] + 1) / 4,
    ),
    "gradient in z": ({"gradient": {"axis": "z", "from": 1.0, "to": 0.0}}, lambda p: 1 - p[:, 2]),
    "picture": ({"image": "a"}, lambda p: bilinear(PICTURE / 255, p[:, 0] / 4, p[:, 1] / 2)),
    "around a point": (
        {"gradient": {"center": [11, -4, 3.5], "radius": 10, "from": 0.0, "to": 1.0}},
        lambda p: np.linalg.norm(p - (1, 1, 0.5), axis=1) / 10,
    ),
    "around a line": (
        {"gradient": {"center": [11, -4], "radius": 10, "from": 0.0, "to": 1.0}},
        lambda p: np.hypot(p[:, 0] - 1, p[:, 1] - 1) / 10,
    ),
    "expression": (
        {"expression": "x + 10*y + 100*z + 1000*u + 1e4*v + 1e5*w"},
        lambda p: (p + MINIMUM) @ (1, 10, 100) + p / SIZE @ (1e3, 1e4, 1e5),
    ),
    "picture from the side": (
        {"image": "a", "plane": "yz"},
        lambda p: bilinear(PICTURE / 255, p[:, 1] / 2, p[:, 2]),
    ),
    "picture in mm": (
        {"image": "a", "box": [9, -6, 15, -1]},
        lambda p: bilinear(PICTURE / 255, (p[:, 0] + 1) / 6, (p[:, 1] + 1) / 5),
    ),
}
# How a corner-based file point becomes a pattern-frame one, by hand, for each placement.
PLACEMENTS = {
    "as it is": ({}, lambda p: p),
    "twice as large": ({"scale": 2.0}, lambda p: 2 * p),
    "a quarter turn about z": (
        {"rotate_deg": (0, 0, 90)},
        lambda p: np.stack([2 - p[:, 1], p[:, 0], p[:, 2]], axis=-1),
    ),
    "half a turn about x": (
        {"rotate_deg": (180, 0, 0)},
        lambda p: np.stack([p[:, 0], 2 - p[:, 1], 1 - p[:, 2]], axis=-1),
    ),
    "a quarter turn about y": (  # z to x, x to -z
        {"rotate_deg": (0, 90, 0)},
        lambda p: np.stack([p[:, 2], p[:, 1], 4 - p[:, 0]], axis=-1),
    ),
    "all of it": (
        {"scale": 2.0, "rotate_deg": (0, 0, 90), "on_bed": False},
        lambda p: 2 * np.stack([2 - p[:, 1], p[:, 0], p[:, 2]], axis=-1),
    ),
}


@pytest.mark.parametrize("where", PLACEMENTS)
@pytest.mark.parametrize("what", FIELDS)
def test_fields_follow_the_part(where: str, what: str) -> None:
    settings_, to_pattern = PLACEMENTS[where]
    spec, expected = FIELDS[what]
    field = sampler(spec, a=png(PICTURE))
    coordinates = placed(**settings_).to_field(*to_pattern(INSIDE).T)
    np.testing.assert_allclose(
        np.broadcast_to(field.scalar(*coordinates), len(INSIDE)), expected(INSIDE), rtol=1e-13, atol=1e-12
    )


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("turned", [0, 90, 30])
def test_a_raster_of_pixels_is_its_points(plane: str, turned: int) -> None:
    picture = np.random.default_rng(turned).integers(0, 256, (31, 17))
    field = sampler({"image": "a", "plane": plane, "range": [0.1, 0.7]}, a=png(picture))
    x, y, z = np.linspace(-0.5, 2.5, 64)[None, :], np.linspace(-0.5, 4.5, 40)[:, None], np.asarray(0.7)
    raster = field.scalar(*placed(rotate_deg=(0, 0, turned)).to_field(x, y, z))
    points = [np.ravel(c) for c in np.broadcast_arrays(x, y, z)]
    expected = field.scalar(*placed(rotate_deg=(0, 0, turned)).to_field(*points))
    np.testing.assert_array_equal(np.broadcast_to(raster, (40, 64)).ravel(), expected)


@pytest.mark.parametrize("move", [(0.0, 0.0, 0.0), (100.0, -250.5, 37.25)])
def test_a_moved_part_keeps_what_is_stretched_over_it(move: tuple[float, float, float]) -> None:
    """Its own coordinates move along, so mm of the file are other places of it."""
    minimum = MINIMUM + move
    frame = Frame(minimum, SIZE)
    coordinates = placed(minimum).to_field(*INSIDE.T)
    stretched, paint = FIELDS["picture"]
    found = sampler(stretched, frame, a=png(PICTURE)).scalar(*coordinates)
    np.testing.assert_allclose(found, paint(INSIDE), rtol=0, atol=1e-12)
    in_mm = {"gradient": {"axis": "x", "from": 0, "to": 1, "start": 10 + move[0], "end": 14 + move[0]}}
    np.testing.assert_allclose(sampler(in_mm, frame).scalar(*coordinates), INSIDE[:, 0] / 4, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("rotate_deg", "normal"),
    [
        ((0, 0, 0), (np.sqrt(0.75), 0.5, 0)),
        ((0, 0, 90), (-0.5, np.sqrt(0.75), 0)),
        ((90, 0, 0), (np.sqrt(0.75), 0, 0.5)),
        ((0, 90, 0), (0, 0.5, -np.sqrt(0.75))),
        ((0, 0, 30), (0.5, np.sqrt(0.75), 0)),
    ],
)
def test_directions_turn_with_the_part(
    rotate_deg: tuple[float, float, float], normal: tuple[float, float, float]
) -> None:
    placement = placed(rotate_deg=rotate_deg, scale=3.0)
    turned = placement.turn(normals(Angles(sampler(30)), INSIDE))
    np.testing.assert_allclose(turned, np.tile(normal, (50, 1)), rtol=0, atol=1e-12)
