"""Pictures one above the other, and what lies beyond a picture's box."""

from __future__ import annotations

import io
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from PIL import Image
from pydantic import TypeAdapter, ValidationError

from amslicer import JobError, load_job
from amslicer.fields import FieldSpec, Frame, Inputs, Sampler, open_field, open_orientation
from amslicer.fields.orientation import Angles
from amslicer.placement import place

Floats = NDArray[np.float64]

MINIMUM = np.array([10.0, -5.0, 3.0])
SIZE = np.array([4.0, 2.0, 3.0])
FRAME = Frame(MINIMUM, SIZE)
PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}  # along its rows, up its columns, and its normal
RNG = np.random.default_rng(8)
POINTS = RNG.uniform(-1.0, 5.0, (400, 3))
A, B, C = (np.random.default_rng(i).integers(0, 256, shape) for i, shape in enumerate([(5, 7), (9, 4), (2, 3)]))


def png(pixels: Any, bits: int = 8) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8 if bits == 8 else np.uint16)).save(stream, "PNG")
    return stream.getvalue()


FILES = {"a": png(A), "b": png(B), "c": png(C)}


def sampler(spec: Any, frame: Frame = FRAME, files: dict[str, bytes] = FILES) -> Sampler:
    field: Any = TypeAdapter(FieldSpec).validate_python(spec)
    return open_field(field, frame, Inputs(Path("nowhere"), dict(files)))


def values(field: Sampler, points: Floats = POINTS) -> Floats:
    return np.broadcast_to(field.scalar(*points.T), len(points))


# Beyond the box


def tent(shares: Floats, count: int, index: NDArray[np.int64]) -> Floats:
    """How much of each of a row of texels is seen at shares of the box: bilinear weights, written as hats."""
    weights: Floats = np.maximum(0.0, 1 - np.abs(shares[:, None] * count - 0.5 - index))
    return weights


def tiled(grey: NDArray[np.int64], u: Floats, v: Floats, outside: str) -> Floats:
    """Bilinear values of a picture laid out 11 × 11 times around its box, v upwards."""
    tiles = np.arange(-5, 6)
    turn = outside == "mirror"
    columns = [
        grey.shape[1] - 1 - np.arange(grey.shape[1]) if turn and t % 2 else np.arange(grey.shape[1]) for t in tiles
    ]
    rows = [grey.shape[0] - 1 - np.arange(grey.shape[0]) if turn and t % 2 else np.arange(grey.shape[0]) for t in tiles]
    whole = grey[::-1][np.ix_(np.concatenate(rows), np.concatenate(columns))] / 255
    wx = tent(u, grey.shape[1], np.arange(whole.shape[1]) - 5 * grey.shape[1])
    wy = tent(v, grey.shape[0], np.arange(whole.shape[0]) - 5 * grey.shape[0])
    np.testing.assert_allclose(wx.sum(axis=1), 1)
    return np.einsum("ni,nj,ij->n", wy, wx, whole)


@pytest.mark.parametrize("outside", ["repeat", "mirror"])
@pytest.mark.parametrize("plane", PLANES)
def test_beyond_the_box_is_the_picture_again(plane: str, outside: str) -> None:
    across, up, _ = PLANES[plane]
    box = [MINIMUM[across] + 0.5, MINIMUM[up] + 0.25, MINIMUM[across] + 2.5, MINIMUM[up] + 1.75]
    field = sampler({"image": "a", "plane": plane, "box": box, "outside": outside})
    u, v = (POINTS[:, across] - 0.5) / 2.0, (POINTS[:, up] - 0.25) / 1.5
    expected = tiled(A, u, v, outside)
    np.testing.assert_allclose(values(field), expected, rtol=0, atol=1e-12)
    samples, weights = field.taps(*POINTS.T)
    np.testing.assert_allclose((samples * weights).sum(axis=0), expected, rtol=0, atol=1e-12)
    x, y, z = np.linspace(-1, 5, 30)[None], np.linspace(-1, 5, 20)[:, None], np.asarray(0.7)
    raster = np.broadcast_to(field.scalar(x, y, z), (20, 30))
    points = np.stack([np.ravel(c) for c in np.broadcast_arrays(x, y, z)], axis=1)
    assert np.array_equal(raster.ravel(), values(field, points))


@pytest.mark.parametrize("outside", ["repeat", "mirror"])
def test_there_is_no_seam(outside: str) -> None:
    field = sampler({"image": "a", "box": [10, -5, 11, -4], "outside": outside})
    for border in (-1.0, 0.0, 1.0, 2.0):
        for axis in (0, 1):
            below, above = POINTS.copy(), POINTS.copy()
            below[:, axis], above[:, axis] = border - 1e-9, border + 1e-9
            assert np.abs(values(field, below) - values(field, above)).max() < 1e-6
    again = POINTS + np.array([2.0, -4.0, 1.0])
    np.testing.assert_allclose(values(field, again), values(field), rtol=0, atol=1e-9)


def test_clamp_is_the_default_and_inside_all_are_the_same() -> None:
    plain = sampler({"image": "a"})
    assert np.array_equal(values(sampler({"image": "a", "outside": "clamp"})), values(plain))
    inside = np.random.default_rng(0).uniform(0.2, 0.8, (200, 3)) * SIZE
    for outside in ("repeat", "mirror"):
        found = values(sampler({"image": "a", "outside": outside}), inside)
        np.testing.assert_allclose(found, values(plain, inside), rtol=0, atol=1e-14)


@pytest.mark.parametrize("outside", ["clamp", "repeat", "mirror"])
@pytest.mark.parametrize("grey", [[[51]], [[51, 51]], np.full((5, 7), 51)])
def test_a_uniform_picture_is_exactly_its_value_everywhere(outside: str, grey: Any) -> None:
    field = sampler({"image": "d", "outside": outside}, files={"d": png(grey)})
    assert (values(field) == 0.2).all()
    assert field.bounds == (0.2, 0.2)


# Stacks


def test_a_stack_is_linear_between_its_pictures() -> None:
    """At file heights 2, 4 and 7 mm: -1, 1 and 4 in the field frame."""
    field = sampler({"stack": {"2": "a", 4: "b", 7.0: "c"}, "range": [0.1, 0.7]})
    a, b, c = (values(sampler({"image": name, "range": [0.1, 0.7]})) for name in "abc")
    z = POINTS[:, 2]
    low, high = np.clip((z + 1) / 2, 0, 1), np.clip((z - 1) / 3, 0, 1)
    expected = np.where(z < 1, a + low * (b - a), b + high * (c - b))
    np.testing.assert_allclose(values(field), expected, rtol=0, atol=1e-12)
    assert field.varies == (True, True, True)
    ends = [sampler({"image": name, "range": [0.1, 0.7]}).bounds for name in "abc"]
    assert field.bounds == (min(low for low, _ in ends), max(high for _, high in ends))


@pytest.mark.parametrize("plane", PLANES)
def test_heights_are_along_the_planes_normal(plane: str) -> None:
    normal = PLANES[plane][2]
    low, high = MINIMUM[normal] + 0.5, MINIMUM[normal] + 2.5
    field = sampler({"stack": {low: "a", high: "b"}, "plane": plane})
    a, b = (values(sampler({"image": name, "plane": plane})) for name in "ab")
    share = np.clip((POINTS[:, normal] - 0.5) / 2, 0, 1)
    np.testing.assert_allclose(values(field), a + share * (b - a), rtol=0, atol=1e-12)
    x, y, z = np.linspace(-1, 5, 30)[None], np.linspace(-1, 5, 20)[:, None], np.asarray(1.3)
    raster = np.broadcast_to(field.scalar(x, y, z), (20, 30))
    points = np.stack([np.ravel(c) for c in np.broadcast_arrays(x, y, z)], axis=1)
    assert np.array_equal(raster.ravel(), values(field, points))


def test_at_its_height_a_picture_is_exactly_itself() -> None:
    field = sampler({"stack": {"4.1": "b", "3.3": "a", "5.7": "c"}})
    for height, name in ((-9.0, "a"), (3.3, "a"), (4.1, "b"), (5.7, "c"), (99.0, "c")):
        points = POINTS.copy()
        points[:, 2] = height - MINIMUM[2]
        assert np.array_equal(values(field, points), values(sampler({"image": name}), points))


def test_one_picture_is_the_same_everywhere_along_the_normal() -> None:
    field = sampler({"stack": {"7": "a"}})
    assert field.varies == (True, True, False)
    assert np.array_equal(values(field), values(sampler({"image": "a"})))


def test_equal_pictures_give_exactly_their_value() -> None:
    files = {"a": png(np.full((3, 4), 51)), "b": png(np.full((2, 2), 13107), 16)}
    field = sampler({"stack": {"2": "a", "5": "b"}}, files=files)
    assert (values(field) == 0.2).all()


def test_groups_of_points_change_nothing() -> None:
    field = sampler({"stack": {"2": "a", "4": "b", "7": "c"}})
    whole = values(field)
    assert np.array_equal(np.concatenate([values(field, POINTS[i : i + 7]) for i in range(0, 400, 7)]), whole)
    assert field.scalar(*np.zeros((3, 0))).shape == (0,)


def test_taps_make_up_the_values() -> None:
    field = sampler({"stack": {"2": "a", "4": "b", "7": "c"}})
    samples, weights = field.taps(*POINTS.T)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=0), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose((samples * weights).sum(axis=0), values(field), rtol=0, atol=1e-12)
    assert field.texels == sampler({"stack": {"2": "a", "4": "b", "7": "c"}, "range": [0, 9]}).texels
    assert field.texels != sampler({"stack": {"2": "a", "4": "b", "8": "c"}}).texels


def line_angles(spec: Any, files: dict[str, bytes], points: Floats) -> Floats:
    field: Any = TypeAdapter(FieldSpec).validate_python(spec)
    normals = open_orientation(field, FRAME, Inputs(Path("nowhere"), dict(files))).normals(*points.T)
    return np.rad2deg(np.arctan2(normals[:, 1], normals[:, 0]))


def apart(a: Any, b: Any) -> Floats:
    return np.abs((np.asarray(a) - b + 90) % 180 - 90)


@pytest.mark.parametrize("reads", ["value", "vector"])
@pytest.mark.parametrize(("one", "other", "middle"), [(1, 179, 0), (80, 100, 90), (30, 50, 40)])
def test_directions_blend_as_lines(reads: str, one: float, other: float, middle: float) -> None:
    def picture(angle: float) -> bytes:
        if reads == "value":
            return png([[round(angle)]])
        doubled = np.deg2rad(2 * angle)
        return png([[np.rint([127.5 + 127.5 * np.cos(doubled), 127.5 + 127.5 * np.sin(doubled), 9])]])

    spec = {"stack": {"3": "one", "5": "other"}, "reads": reads, "range": [0, 255] if reads == "value" else [0, 1]}
    files = {"one": picture(one), "other": picture(other)}
    points = np.tile([1.0, 1.0, 0.0], (5, 1))
    points[:, 2] = [-1, 0, 1, 2, 9]
    found = line_angles(spec, files, points)
    assert apart(found, [one, one, middle, other, other]).max() < 0.3


def test_an_azimuth_flips_with_its_elevation() -> None:
    """(80, 30) and (-100, -30) are one line; stacks of the same texels are read together."""
    low, high = ({"stack": {"3": "b", "5": "w"}, "range": r} for r in ([80, -100], [30, -30]))
    files = {"b": png([[0]]), "w": png([[255]])}
    field = Angles(sampler(low, files=files), sampler(high, files=files))
    z = np.linspace(0, 2, 9)
    found = field.normals(np.ones(9), np.ones(9), z)
    up, turned = np.deg2rad(30), np.deg2rad(80)
    expected = np.array([np.cos(up) * np.cos(turned), np.cos(up) * np.sin(turned), np.sin(up)])
    np.testing.assert_allclose(np.abs(found @ expected), 1, atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "to_pattern"),
    [
        ({}, lambda p: p),
        ({"scale": 2.0}, lambda p: 2 * p),
        ({"rotate_deg": (180, 0, 0)}, lambda p: np.stack([p[:, 0], SIZE[1] - p[:, 1], SIZE[2] - p[:, 2]], axis=1)),
        ({"rotate_deg": (0, 90, 0)}, lambda p: np.stack([p[:, 2], p[:, 1], SIZE[0] - p[:, 0]], axis=1)),
    ],
)
def test_it_follows_the_part(settings: dict[str, Any], to_pattern: Any) -> None:
    plain = values(sampler({"stack": {"2": "a", "4": "b", "7": "c"}}))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * SIZE
    for shift in (np.zeros(3), np.array([100.0, -250.5, 37.25])):
        heights = {2 + shift[2]: "a", 4 + shift[2]: "b", 7 + shift[2]: "c"}
        mesh: Any = SimpleNamespace(vertices=corners, minimum_mm=MINIMUM + shift)
        coordinates = place(mesh, **settings)[0].to_field(*to_pattern(POINTS).T)
        found = sampler({"stack": heights}, Frame(MINIMUM + shift, SIZE)).scalar(*coordinates)
        np.testing.assert_allclose(found, plain, rtol=0, atol=1e-9)


# The job file's words


@pytest.mark.parametrize(
    ("stack", "said"),
    [
        ({}, "at least 1"),
        ([["0", "a"]], "dictionary"),
        ({"low": "a"}, "'low' is not a height"),
        ({True: "a"}, "True is not a height"),
        ({None: "a"}, "None is not a height"),
        ({"nan": "a"}, "'nan' is not a height"),
        ({float("inf"): "a"}, "inf is no finite height"),
        ({"1e999": "a"}, "1e999 is no finite height"),
        ({10**400: "a"}, "no finite height"),
        ({"1": "a", "1.0": "b"}, r"two pictures at 1 mm \(keys 1 and 1.0\)"),
        ({0: "a", "-0": "b"}, "two pictures at 0 mm"),
        ({"1": ""}, "at least 1 character"),
        ({"1": 3}, "string"),
    ],
)
def test_stacks_that_are_refused(stack: Any, said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        TypeAdapter(FieldSpec).validate_python({"stack": stack})


def test_one_of_image_and_stack(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="is not a field") as caught:
        load_job({"materials": ["a", "b"], "fields": {"ratio": {"image": "a", "stack": {"0": "b"}}}}, part="p.stl")
    assert caught.value.hint == "give one of image and stack, not both"


def test_a_bad_picture_is_named() -> None:
    with pytest.raises(JobError, match="'d' is not a PNG or TIFF"):
        sampler({"stack": {"2": "a", "4": "d"}}, files={**FILES, "d": b"no"})
    with pytest.raises(JobError, match="'a' with reads: hue makes directions"):
        sampler({"stack": {"2": "a"}, "reads": "hue"})


def test_its_files_are_named_and_can_be_renamed() -> None:
    source: Any = TypeAdapter(FieldSpec).validate_python({"stack": {"9": "c", "2": "a"}})
    assert source.paths() == ("a", "c")
    assert source.with_paths({"c": "inputs/c"}).stack == {2.0: "a", 9.0: "inputs/c"}


def test_a_job_is_resolved_and_runs_again(tmp_path: Path) -> None:
    """Black below, white above, on a cube away from the file's origin: half of each, in the middle layer."""
    part = parts.stl(tmp_path, meshes.box((2.0, 2.0, 2.0), at=(3.0, 4.0, 5.0)))
    parts.paint(tmp_path, np.zeros((2, 3), np.uint8), "low.png")
    parts.paint(tmp_path, np.full((5, 4), 255, np.uint8), "high.png")
    ratio = {"stack": {"5.9": "low.png", "6.1": "high.png"}}
    job = parts.job(part, ratio=ratio, printer={"pitch_um": 100, "layer_um": 100})
    labels = parts.labels(job)
    assert (labels[:9] == 2).all()
    assert (labels[11:] == 1).all()
    resolved = job.resolved()
    assert resolved["fields"]["ratio"]["stack"] == {"5.9": "low.png", "6.1": "high.png"}
    assert job.input_paths() == ("low.png", "high.png")
    again = parts.job(part, ratio=resolved["fields"]["ratio"], printer={"pitch_um": 100, "layer_um": 100})
    assert np.array_equal(parts.labels(again), labels)


# Memory


def test_a_large_picture_stays_small() -> None:
    """4 Mpx of 16 bits: two bytes each are kept, and a few times as many held while it is read."""
    levels = np.arange(4_000_000, dtype=np.uint16).reshape(2000, 2000)
    content = png(levels, 16)
    tracemalloc.start()
    field = sampler({"image": "d", "range": [0.1, 0.7]}, files={"d": content})
    assert field.bounds == (0.1, 0.7)
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"held {held / levels.nbytes:.2f}, at most {peak / levels.nbytes:.2f} times the texels' bytes")
    assert held < 1.2 * levels.nbytes
    assert peak < 4 * levels.nbytes + len(content)
