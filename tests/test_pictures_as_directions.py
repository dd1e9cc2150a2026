"""Directions read from pictures, against the formulas that they were painted by."""

from __future__ import annotations

import colorsys
import io
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from PIL import Image
from pydantic import TypeAdapter, ValidationError

import amslicer
from amslicer import JobError, analysis
from amslicer.fieldpictures import hue_colors
from amslicer.fields import FieldSpec, Frame, Inputs, open_field, open_orientation, picturelines
from amslicer.fields.orientation import Orientation
from amslicer.placement import place

Floats = NDArray[np.float64]

MINIMUM = np.array([10.0, -5.0, 3.0])
SIZE = np.array([4.0, 2.0, 3.0])
FRAME = Frame(MINIMUM, SIZE)
PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}  # along its rows, up its columns, and its normal
POINTS = np.random.default_rng(5).uniform(0.0, 1.0, (3000, 3)) * SIZE
FULL = {8: 255, 16: 65535}


def png(pixels: Any, bits: int = 8) -> bytes:
    """A grey or RGB PNG, first row at the top."""
    stream = io.BytesIO()
    Image.fromarray(np.asarray(np.rint(pixels), np.uint8 if bits == 8 else np.uint16)).save(stream, "PNG")
    return stream.getvalue()


def lines(spec: Any, frame: Frame = FRAME, **pictures: bytes) -> Orientation:
    field: Any = TypeAdapter(FieldSpec).validate_python(spec)
    return open_orientation(field, frame, Inputs(Path("nowhere"), dict(pictures)))


def angles(field: Orientation, points: Floats = POINTS, plane: str = "xy") -> Floats:
    """Degrees from the plane's first axis towards its second."""
    normals = field.normals(*points.T)
    across, up, normal = PLANES[plane]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    np.testing.assert_allclose(normals[:, normal], 0, atol=1e-12)
    return np.rad2deg(np.arctan2(normals[:, up], normals[:, across]))


def apart(a: Any, b: Any) -> Floats:
    """Degrees between lines."""
    return np.abs((np.asarray(a) - b + 90) % 180 - 90)


def test_the_comparison_can_fail() -> None:
    assert apart(1.0, 179.0) == pytest.approx(2)
    assert apart(0.0, 90.0) == 90


# Pictures of a direction, degrees (rows, columns), row 0 at the top


def hues(angle: Floats, saturation: float = 1.0) -> Floats:
    colour = [colorsys.hsv_to_rgb(a % 180 / 180, saturation, 1.0) for a in angle.ravel()]
    return np.reshape(255 * np.array(colour), (*angle.shape, 3))


def cosines(angle: Floats, bits: int = 8) -> Floats:
    return FULL[bits] * (0.5 + 0.5 * np.cos(np.deg2rad(2 * angle)))


def sines(angle: Floats, bits: int = 8) -> Floats:
    return FULL[bits] * (0.5 + 0.5 * np.sin(np.deg2rad(2 * angle)))


def vectors(angle: Floats, blue: int = 77) -> Floats:
    return np.stack([cosines(angle), sines(angle), np.full(angle.shape, blue)], axis=-1)


def painted(kind: str, angle: Floats) -> tuple[dict[str, Any], dict[str, bytes]]:
    """A field and its pictures, which paint an angle of 0 … 180° per texel."""
    if kind == "angle":
        return {"image": "a", "range": [0, 180]}, {"a": png(65535 * angle / 180, 16)}
    if kind == "hue":
        return {"image": "a", "reads": "hue"}, {"a": png(hues(angle))}
    if kind == "vector":
        return {"image": "a", "reads": "vector"}, {"a": png(vectors(angle))}
    pair = {"a": png(cosines(angle, 16), 16), "b": png(sines(angle, 16), 16)}
    return {"image": "a", "with": "b", "reads": "vector"}, pair


def relief(width_mm: float, height_mm: float, shape: tuple[int, int]) -> Floats:
    """Heights whose gradient turns by 180° along the width: ∇(y + L/π ln sin(πx/L)) = (cot(πx/L), 1)."""
    rows, columns = shape
    x = (np.arange(columns) + 0.5) / columns * width_mm
    y = (rows - np.arange(rows) - 0.5) / rows * height_mm
    found: Floats = y[:, None] + width_mm / np.pi * np.log(np.sin(np.pi * x / width_mm))
    return found


def full_scale(values: Floats, bits: int = 16) -> Floats:
    return FULL[bits] * (values - values.min()) / np.ptp(values)


KINDS = ("angle", "hue", "vector", "vector of two")
ROWS, COLUMNS = 24, 64
TURNING = np.tile(180 * (np.arange(COLUMNS) + 0.5) / COLUMNS, (ROWS, 1))


@pytest.mark.parametrize(
    ("kind", "plane"),  # numbers are azimuths, wherever their picture lies
    [("angle", "xy"), *((kind, plane) for kind in KINDS[1:] for plane in PLANES)],
)
def test_a_turning_direction_is_read_as_painted(kind: str, plane: str) -> None:
    spec, pictures = painted(kind, TURNING)
    field = lines({**spec, "plane": plane}, **pictures)
    across = PLANES[plane][0]
    inside = np.abs(POINTS[:, across] / SIZE[across] - 0.5) < 0.5 - 0.5 / COLUMNS
    error = apart(angles(field, plane=plane), 180 * POINTS[:, across] / SIZE[across])[inside]
    print(f"{kind}, {plane}: at most {error.max():.3f}°, mean {error.mean():.4f}°")
    assert error.max() < 0.5
    assert field.varies == tuple(axis in PLANES[plane][:2] for axis in range(3))
    assert field.turns


@pytest.mark.parametrize("plane", PLANES)
def test_the_gradient_of_a_relief_is_its_direction(plane: str) -> None:
    across, up, _ = PLANES[plane]
    grey = png(full_scale(relief(SIZE[across], SIZE[up], (150, 256))), 16)
    field = lines({"image": "a", "reads": "gradient", "plane": plane}, a=grey)
    share = POINTS[:, across] / SIZE[across]
    inside = np.abs(share - 0.5) < 0.5 - 4 / 256
    error = apart(angles(field, plane=plane), 180 * share)[inside]
    print(f"gradient, {plane}: at most {error.max():.3f}°, mean {error.mean():.4f}°")
    assert error.max() < 1


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0, 90.0, 133.0, 171.0])
@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize(("bits", "within"), [(8, 1.5), (16, 0.05)])
def test_a_gradient_is_per_mm_however_long_texels_are(angle: float, plane: str, bits: int, within: float) -> None:
    """20 × 60 texels over rectangles of three shapes, up to the border; the levels' rounding counts."""
    across, up, _ = PLANES[plane]
    u, v = (np.arange(60) + 0.5) / 60 * SIZE[across], (20 - np.arange(20) - 0.5) / 20 * SIZE[up]
    ramp = u[None] * np.cos(np.deg2rad(angle)) + v[:, None] * np.sin(np.deg2rad(angle))
    content = png(full_scale(ramp, bits), bits)
    smooth = {"smooth_mm": 0.4} if bits == 8 else {}
    for reads in ({}, {"box": [MINIMUM[across], MINIMUM[up], *(MINIMUM + SIZE)[[across, up]]]}):
        field = lines({"image": "a", "reads": "gradient", "plane": plane, **smooth, **reads}, a=content)
        error = apart(angles(field, plane=plane), angle)
        assert error.max() < within


def test_the_sign_of_a_gradient_does_not_matter() -> None:
    grey = full_scale(relief(4, 2, (40, 80)), 16)
    spec = {"image": "a", "reads": "gradient"}
    up, down = (angles(lines(spec, a=png(g, 16))) for g in (grey, 65535 - grey))
    assert apart(up, down).max() < 0.05


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("one", "other", "middle"), [(1, 179, 0), (80, 100, 90), (10, 170, 0), (30, 50, 40)])
def test_lines_meet_at_the_line_between_them(kind: str, one: float, other: float, middle: float) -> None:
    spec, pictures = painted(kind, np.array([[one, other]], np.float64))
    field = lines(spec, **pictures)
    x = np.linspace(0, 4, 41)
    found = angles(field, np.stack([x, np.ones(41), np.ones(41)], axis=1))
    assert apart(found[20], middle) < 0.3
    spread = apart(one, other)
    assert (apart(found, one) < spread + 0.5).all()
    assert (apart(found, other) < spread + 0.5).all()


def test_a_ridge_of_two_slopes_averages_as_lines() -> None:
    """Slopes of 1° and 179° (gradients (c, s) and (-c, s)) meet at 0°."""
    x, y = np.linspace(-2, 2, 80), np.linspace(1, -1, 40)
    roof = -np.abs(x)[None] * np.cos(np.deg2rad(1)) + y[:, None] * np.sin(np.deg2rad(1))
    field = lines({"image": "a", "reads": "gradient", "smooth_mm": 0.3}, a=png(full_scale(roof), 16))
    assert apart(angles(field), 0).max() < 1.5


def test_hues_are_those_that_directions_are_drawn_in() -> None:
    """The circle of fieldpictures has 360 entries, so half a degree of direction each."""
    angle = np.arange(0.25, 180, 0.5)
    drawn = hue_colors(angle, np.ones(360))[None]
    field = lines({"image": "a", "reads": "hue"}, a=png(drawn))
    centres = (np.arange(360) + 0.5) / 360 * 4
    found = angles(field, np.stack([centres, np.ones(360), np.ones(360)], axis=1))
    assert apart(found, angle).max() < 0.75


def test_saturation_is_the_weight() -> None:
    """Half way between saturations 1 and 0.25 the mean of 1·(0°) and 0.25·(60°, doubled 120°)."""
    pair = np.concatenate([hues(np.array([[0.0]])), hues(np.array([[60.0]]), 0.25)], axis=1)
    mean = 1 + 0.25 * np.exp(2j * np.deg2rad(60))
    found = angles(lines({"image": "a", "reads": "hue"}, a=png(pair)), np.array([[2.0, 1.0, 0.5]]))
    assert apart(found[0], np.rad2deg(np.angle(mean)) / 2) < 0.3


@pytest.mark.parametrize("kind", ["hue", "vector", "gradient"])
@pytest.mark.parametrize("outside", ["clamp", "repeat", "mirror"])
def test_places_without_a_direction_take_the_nearest(kind: str, outside: str) -> None:
    """A painted strip on the left: the rest is blank."""
    spec = {"image": "a", "reads": kind, "outside": outside}
    if kind == "gradient":
        x, y = np.arange(60), np.arange(30)[::-1, None]
        content = png(np.where(x < 20, 4 * np.minimum(x, 19) + 4 * y + 0 * x, 4 * 19 + 4 * y + 0 * x), 8)
        blank = png(np.where(x < 20, 40 + x + y, 0 * x + 0 * y + 200), 8)
        # Right of the step the blank is flat, and takes the direction of the step.
        found = angles(lines(spec, a=blank), np.array([[2.5, 1.0, 1.0]]))
        assert apart(found[0], 0) < 8
        found = angles(lines({**spec, "smooth_mm": 0.07}, a=content), np.array([[0.6, 1.0, 1.0], [3.0, 1.0, 1.0]]))
        slope = np.rad2deg(np.arctan2(30 / 2, 60 / 4))  # texels of 1/15 mm both ways
        assert apart(found[0], slope) < 1
        assert apart(found[1], 90) < 1
        return
    angle = np.full((30, 60), 25.0)
    picture = hues(angle) if kind == "hue" else vectors(angle)
    picture[:, 20:] = 128
    found = angles(lines(spec, a=png(picture)))
    assert apart(found, 25).max() < 0.3


def test_a_repeated_blank_takes_the_nearest_across_the_border() -> None:
    """Painted on the left (20°) and in the middle (110°): the right end is nearer to the next tile's left."""
    angle = np.full((1, 60), 20.0)
    angle[:, 30:35] = 110
    picture = vectors(angle)
    picture[:, 5:30] = picture[:, 35:] = 128
    place = np.array([[3.8, 1.0, 1.0]])
    spec = {"image": "a", "reads": "vector"}
    assert apart(angles(lines({**spec, "outside": "repeat"}, a=png(picture)), place)[0], 20) < 0.3
    assert apart(angles(lines(spec, a=png(picture)), place)[0], 110) < 0.3


# Beyond the box


def waves(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """A relief that repeats after 2 × 1 mm, and its gradient."""
    a, b = np.pi * x, 2 * np.pi * y
    return np.sin(a) + 0.3 * np.cos(b), np.pi * np.cos(a), -0.6 * np.pi * np.sin(b)


def test_a_repeated_relief_has_no_seam() -> None:
    x, y = (np.arange(160) + 0.5) / 80, (80 - np.arange(80)[:, None] - 0.5) / 80
    low, high = -1.3, 1.3
    content = png(65535 * (waves(x, y)[0] - low) / (high - low), 16)
    box = [MINIMUM[0], MINIMUM[1], MINIMUM[0] + 2, MINIMUM[1] + 1]
    field = lines({"image": "a", "reads": "gradient", "box": box, "outside": "repeat"}, a=content)
    points = np.random.default_rng(1).uniform(-3, 5, (4000, 3))
    _, gx, gy = waves(points[:, 0], points[:, 1])
    steep = np.hypot(gx, gy) > 0.8
    error = apart(angles(field, points), np.rad2deg(np.arctan2(gy, gx)))[steep]
    print(f"repeated: at most {error.max():.3f}°")
    assert error.max() < 1.5


def test_a_mirrored_relief_is_mirrored_with_its_directions() -> None:
    """Ramp of 30° in the tile: 150° in the tiles beside it, 30° again in those across the corner."""
    x, y = (np.arange(40) + 0.5) / 20, (20 - np.arange(20)[:, None] - 0.5) / 20
    ramp = x * np.cos(np.pi / 6) + y * np.sin(np.pi / 6)
    box = [MINIMUM[0], MINIMUM[1], MINIMUM[0] + 2, MINIMUM[1] + 1]
    spec = {"image": "a", "reads": "gradient", "box": box, "outside": "mirror", "smooth_mm": 0.05}
    field = lines(spec, a=png(full_scale(ramp), 16))
    middles = [(1.0, 0.5, 30), (3.0, 0.5, 150), (-1.0, 0.5, 150), (1.0, 1.5, 150), (3.0, 1.5, 30), (5.0, 0.5, 30),
               (-3.0, -0.5, 150), (-3.0, 0.5, 30)]  # fmt: skip
    found = angles(field, np.array([(x, y, 0.0) for x, y, _ in middles]))
    np.testing.assert_allclose(apart(found, np.array([a for *_, a in middles])), 0, atol=0.05)


@pytest.mark.parametrize("outside", ["repeat", "mirror"])
@pytest.mark.parametrize("reads", ["hue", "vector", "gradient"])
def test_nothing_jumps_at_a_border(outside: str, reads: str) -> None:
    rng = np.random.default_rng(3)
    shape = (12, 16) if reads == "gradient" else (12, 16, 3)
    box = [MINIMUM[0], MINIMUM[1], MINIMUM[0] + 2, MINIMUM[1] + 1]
    spec = {"image": "a", "reads": reads, "outside": outside, "box": box}
    if reads == "gradient":
        spec["smooth_mm"] = 0.3
    field = lines(spec, a=png(rng.integers(0, 256, shape)))
    y = rng.uniform(-3, 3, 400)
    for border in (-2.0, 0.0, 2.0, 4.0):
        sides = [np.stack([np.full(400, border + d), y, y], axis=1) for d in (-1e-9, 1e-9)]
        assert apart(*(angles(field, side) for side in sides)).max() < 0.01


# Frames


@pytest.mark.parametrize(
    ("settings", "to_pattern", "turned"),
    [
        ({}, lambda p: p, np.eye(3)),
        ({"scale": 2.0}, lambda p: 2 * p, np.eye(3)),
        (
            {"rotate_deg": (0, 0, 90)},
            lambda p: np.stack([SIZE[1] - p[:, 1], p[:, 0], p[:, 2]], axis=1),
            np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ),
        (
            {"rotate_deg": (0, 90, 0)},
            lambda p: np.stack([p[:, 2], p[:, 1], SIZE[0] - p[:, 0]], axis=1),
            np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
        ),
    ],
)
@pytest.mark.parametrize("plane", PLANES)
def test_it_follows_the_part(plane: str, settings: dict[str, Any], to_pattern: Any, turned: Floats) -> None:
    spec, pictures = painted("vector", TURNING)
    spec["plane"] = plane
    plain = lines(spec, **pictures).normals(*POINTS.T)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * SIZE
    for shift in (np.zeros(3), np.array([100.0, -250.5, 37.25])):
        mesh: Any = SimpleNamespace(vertices=corners, minimum_mm=MINIMUM + shift)
        placement = place(mesh, **settings)[0]
        field = lines(spec, Frame(MINIMUM + shift, SIZE), **pictures)
        found = placement.turn(field.normals(*placement.to_field(*to_pattern(POINTS).T)))
        alike = np.abs(np.einsum("ni,ni->n", found, plain @ turned.T))
        np.testing.assert_allclose(alike, 1, rtol=0, atol=1e-9)


def test_a_box_is_in_file_coordinates() -> None:
    spec, pictures = painted("vector", TURNING)
    boxed = lines({**spec, "box": [11.0, -4.5, 13.0, -4.0]}, **pictures)
    share = np.clip((POINTS[:, 0] - 1) / 2, 0.5 / COLUMNS, 1 - 0.5 / COLUMNS)
    assert apart(angles(boxed), 180 * share).max() < 0.5


def test_bands_of_rows_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    grey = png(np.random.default_rng(2).integers(0, 256, (50, 40)))
    for outside in ("clamp", "repeat", "mirror"):
        spec = {"image": "a", "reads": "gradient", "outside": outside, "smooth_mm": 0.2}
        monkeypatch.setattr(picturelines, "BAND_ROWS", 1000)
        whole = lines(spec, a=grey).normals(*POINTS.T)
        monkeypatch.setattr(picturelines, "BAND_ROWS", 7)
        assert np.array_equal(lines(spec, a=grey).normals(*POINTS.T), whole)


@pytest.mark.parametrize("reads", ["hue", "vector"])
def test_a_uniform_picture_does_not_turn(reads: str) -> None:
    picture = hues(np.full((3, 4), 40.0)) if reads == "hue" else vectors(np.full((3, 4), 40.0))
    field = lines({"image": "a", "reads": reads}, a=png(picture))
    assert not field.turns
    assert apart(angles(field), 40).max() < 0.3


# Refused


@pytest.mark.parametrize("reads", ["gradient", "hue", "vector"])
def test_directions_are_no_numbers(reads: str) -> None:
    field: Any = TypeAdapter(FieldSpec).validate_python({"image": "a.png", "reads": reads})
    with pytest.raises(JobError, match=f"'a.png' with reads: {reads} makes directions") as caught:
        open_field(field, FRAME, Inputs(Path("nowhere"), {"a.png": png([[0, 255]])}))
    assert caught.value.hint


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ({"image": "a", "reads": "angle"}, "reads"),
        ({"image": "a", "reads": "hue", "range": [0, 90]}, "hue makes directions, to which range .* means nothing"),
        (
            {"image": "a", "reads": "hue", "smooth_mm": 1},
            "1 belongs to reads: gradient, but reads is (hue|value)",
        ),
        ({"image": "a", "smooth_mm": 1}, "1 belongs to reads: gradient, but reads is (hue|value)"),
        ({"image": "a", "reads": "gradient", "smooth_mm": 0}, "smooth_mm"),
        ({"image": "a", "reads": "hue", "with": "b"}, "'b' belongs to reads: vector, but reads is (hue|value)"),
        ({"image": "a", "with": "b"}, "'b' belongs to reads: vector, but reads is (hue|value)"),
        ({"image": "a", "outside": "wrap"}, "outside"),
        ({"image": "a", "reads": "vector", "with": ""}, "with"),
    ],
)
def test_settings_that_are_refused(spec: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        TypeAdapter(FieldSpec).validate_python(spec)


GREY, COLOUR = png(np.arange(12).reshape(3, 4)), png(vectors(TURNING))


@pytest.mark.parametrize(
    ("spec", "pictures", "said"),
    [
        ({"reads": "gradient"}, {"a": png(np.full((4, 5), 9))}, "one grey level everywhere"),
        ({"reads": "gradient"}, {"a": png([[7]])}, "one grey level everywhere"),
        ({"reads": "gradient"}, {"a": COLOUR}, "is not grey"),
        ({"reads": "gradient", "smooth_mm": 300}, {"a": GREY}, "smoothed over 450 pixels .* at most 256"),
        ({"reads": "hue"}, {"a": GREY}, "is not RGB"),
        ({"reads": "hue"}, {"a": png(np.full((2, 2, 3), 90))}, "has no colours"),
        ({"reads": "vector"}, {"a": GREY}, "is not RGB"),
        ({"reads": "vector"}, {"a": png(np.full((2, 2, 3), 127))}, "of the middle grey everywhere"),
        ({"reads": "vector", "with": "b"}, {"a": COLOUR, "b": GREY}, "'a' is not grey"),
        ({"reads": "vector", "with": "b"}, {"a": GREY, "b": COLOUR}, "'b' is not grey"),
        ({"reads": "vector", "with": "b"}, {"a": GREY, "b": png([[1, 2]])}, "'a' has 4 × 3 pixels, and 'b' .* 2 × 1"),
        ({"reads": "hue"}, {"a": COLOUR[:-100]}, "cut short"),
    ],
)
def test_pictures_that_are_refused(spec: dict[str, Any], pictures: dict[str, bytes], said: str) -> None:
    with pytest.raises(JobError, match=said) as caught:
        lines({"image": "a", **spec}, **pictures)
    assert caught.value.hint


def test_too_many_pixels_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    large = Image.new("L", (8000, 4001))
    stream = io.BytesIO()
    large.save(stream, "PNG")
    with pytest.raises(JobError, match="8000 × 4001 pixels; at most 32 million"):
        lines({"image": "a", "reads": "gradient"}, a=stream.getvalue())


def test_its_files_are_named_and_can_be_renamed() -> None:
    source: Any = TypeAdapter(FieldSpec).validate_python({"image": "a.png", "with": "b.png", "reads": "vector"})
    assert source.paths() == ("a.png", "b.png")
    moved = source.with_paths({"b.png": "inputs/2.png"})
    assert (moved.image, moved.with_) == ("a.png", "inputs/2.png")
    assert moved.model_dump(by_alias=True)["with"] == "inputs/2.png"


# Printed


@pytest.mark.parametrize("kind", [*KINDS, "gradient"])
def test_the_printed_laminate_turns_as_painted(kind: str, tmp_path: Path) -> None:
    """A plate of 40 × 10 periods, whose sheets turn by 180° along it."""
    width, height = 40.0, 10.0
    if kind == "gradient":
        spec = {"image": "a", "reads": "gradient"}
        pictures = {"a": png(full_scale(relief(width, height, (64, 256))), 16)}
    else:
        spec, pictures = painted(kind, np.tile(180 * (np.arange(160) + 0.5) / 160, (40, 1)))
    for name, content in pictures.items():
        (tmp_path / f"{name}.png").write_bytes(content)
    spec = {key: f"{value}.png" if key in ("image", "with") else value for key, value in spec.items()}
    job = parts.job(parts.plate(tmp_path, width, height), orientation=spec, alignment=5)
    labels = parts.bitmap(job)
    pitch = parts.pitch_mm(parts.SQUARE)[:2]
    found = analysis.directions(analysis.signed(labels), pitch, 1.0)
    x, _ = parts.centres((labels.shape[0], labels.shape[1]), pitch)
    error = apart(found, 180 * x / width)[analysis.inner((labels.shape[0], labels.shape[1]), pitch, 2.0)]
    print(f"printed by {kind}: mean {error.mean():.2f}°, median {np.median(error):.2f}°")
    assert np.median(error) < 4


def test_turning_the_part_turns_the_sheets(tmp_path: Path) -> None:
    """30° painted as a vector on a plate that is turned by 90°."""
    picture = parts.paint(tmp_path, np.rint(vectors(np.full((4, 6), 30.0))).astype(np.uint8))
    orientation = {"image": picture, "reads": "vector"}
    for turn in (0, 90):
        job = parts.job(
            parts.plate(tmp_path, 16, 12), orientation=orientation, alignment=5, settings={"rotate": [0, 0, turn]}
        )
        found = analysis.mean_direction(analysis.signed(parts.bitmap(job)), parts.pitch_mm(parts.SQUARE)[:2], 1.0)
        assert apart(found, 30 + turn) < 3.5


def test_verification_measures_what_was_painted(tmp_path: Path) -> None:
    """A slope of 65° over 12 × 6 mm."""
    x, y = (np.arange(120) + 0.5) / 10, (60 - np.arange(60)[:, None] - 0.5) / 10
    ramp = x * np.cos(np.deg2rad(65)) + y * np.sin(np.deg2rad(65))
    (tmp_path / "a.png").write_bytes(png(full_scale(ramp), 16))
    orientation = {"image": "a.png", "reads": "gradient"}
    job = parts.job(parts.plate(tmp_path, 12.0, 6.0), orientation=orientation, period=0.5, alignment=5)
    amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    error = report.as_dict()["direction_error_deg"]
    print(f"verified: {error}° in {len(report.shown)} blocks")
    assert report.ok
    assert error is not None
    assert error < 4


UPRIGHT = {
    "image": ({"image": "lines.png", "reads": "hue", "plane": "xz"}, ""),
    "stack": ({"stack": {"0": "lines.png"}, "reads": "vector", "plane": "yz"}, ""),
    "mix": ({"mix": {"a": 30, "b": {"image": "lines.png", "reads": "gradient", "plane": "yz"}, "by": 0.5}}, ".mix.b"),
    "where": (
        {"where": {"mask": 1, "above": 0.5, "then": {"image": "lines.png", "reads": "hue", "plane": "xz"}, "else": 0}},
        ".where.then",
    ),
    "per body": ({"per_body": {"A": {"image": "lines.png", "reads": "hue", "plane": "xz"}}}, ".per_body.A"),
}


@pytest.mark.parametrize("name", UPRIGHT)
def test_directions_out_of_the_plane_are_refused_in_2d(name: str, tmp_path: Path) -> None:
    """As an elevation is: what leaves the layer would be flattened."""
    orientation, path = UPRIGHT[name]
    colours = np.random.default_rng(2).integers(0, 256, (6, 8, 3))
    (tmp_path / "lines.png").write_bytes(png(colours))
    part = parts.plate(tmp_path, 4, 4)
    key = f"fields.orientation{path}.plane"
    with pytest.raises(JobError, match=rf"line 1, column \d+: {re.escape(key)}: .*dimensions is 2") as refused:
        parts.job(part, orientation=orientation)
    assert "dimensions to 3" in str(refused.value.hint)
    parts.job(part, orientation=orientation, dimensions=3)
    flat = json.loads(re.sub('"plane": "[xyz]+"', '"plane": "xy"', json.dumps(orientation)))
    parts.job(part, orientation=flat)


def test_numbers_in_an_upright_plane_are_angles_in_2d(tmp_path: Path) -> None:
    picture = parts.paint(tmp_path, np.arange(12, dtype=np.uint8).reshape(3, 4))
    parts.job(parts.plate(tmp_path, 4, 4), orientation={"image": picture, "plane": "xz", "range": [0, 90]})
