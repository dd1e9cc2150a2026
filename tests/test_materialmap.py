"""Shares of all materials by the colours of a picture."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from PIL import Image
from pydantic import ValidationError

from amslicer import JobError, Run, layers, load_job, slice_job, verify
from amslicer.fields import Frame, Inputs, open_field
from amslicer.fields.materialmap import MaterialMap
from amslicer.specification import DEFAULT_COLORS

Floats = NDArray[np.float64]

MINIMUM = np.array([10.0, -5.0, 3.0])
SIZE = np.array([4.0, 2.0, 3.0])
FRAME = Frame(MINIMUM, SIZE)
POINTS = np.random.default_rng(8).uniform(-1.0, 5.0, (500, 3))
MATERIALS = (("rigid", "#2B6CB0"), ("flexible", "#f6ad55"), ("soft", "#38a169"), ("dark", "#101010"))
PIXEL = {"pitch_um": 100, "layer_um": 100}


def painted(numbers: Any, materials: Any = MATERIALS) -> NDArray[np.uint8]:
    """(rows, columns, 3) picture of the numbers of materials."""
    rgb = [[int(color[i : i + 2], 16) for i in (1, 3, 5)] for _, color in materials]
    return np.array(rgb, np.uint8)[np.asarray(numbers)]


def png(pixels: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def shares(numbers: Any, materials: Any = MATERIALS, frame: Frame = FRAME, **spec: Any) -> Any:
    source = MaterialMap.model_validate({"map": "m.png", **spec})
    inputs = Inputs(Path("nowhere"), {"m.png": png(painted(numbers, materials))})
    return source.open_shares(frame, inputs, materials)


def values(field: Any, points: Floats = POINTS) -> Floats:
    return np.broadcast_to(field.scalar(*points.T), len(points))


NUMBERS = np.random.default_rng(3).integers(0, 4, (6, 9))


def hats(numbers: NDArray[np.int64], m: int, points: Floats) -> Floats:
    """Bilinear share of one material's texels, clamped: hats around the texel centres."""
    rows, columns = numbers.shape
    u = np.clip(points[:, 0] / SIZE[0] * columns - 0.5, 0, columns - 1)
    v = np.clip(points[:, 1] / SIZE[1] * rows - 0.5, 0, rows - 1)
    wx = np.maximum(0, 1 - np.abs(u[:, None] - np.arange(columns)))
    wy = np.maximum(0, 1 - np.abs(v[:, None] - np.arange(rows)))
    return np.einsum("ni,nj,ij->n", wy, wx, (numbers[::-1] == m).astype(float))


@pytest.mark.parametrize("dominant", [1.0, 0.7, 0.25, 0.0])
def test_the_dominant_material_has_its_share_and_the_others_the_rest(dominant: float) -> None:
    found = shares(NUMBERS, dominant=dominant)
    others = (1 - dominant) / 3
    for m, field in enumerate(found):
        expected = others + (dominant - others) * hats(NUMBERS, m, POINTS)
        np.testing.assert_allclose(values(field), expected, rtol=0, atol=1e-12)
        assert field.bounds == (min(dominant, others), max(dominant, others))
        assert field.varies == (True, True, False)
    np.testing.assert_allclose(sum(values(field) for field in found), 1, rtol=0, atol=1e-12)


def test_texel_centres_are_exact() -> None:
    found = shares([[0, 1], [2, 3]], dominant=0.7)
    centres = np.array([[1.0, 1.5, 0], [3.0, 1.5, 0], [1.0, 0.5, 0], [3.0, 0.5, 0]])
    np.testing.assert_array_equal(np.array([values(f, centres) for f in found]).argmax(axis=0), [0, 1, 2, 3])
    assert values(found[2], centres)[2] == 0.7


def test_a_material_that_is_nowhere_dominant_has_exact_bounds() -> None:
    found = shares([[0, 2], [2, 0]], dominant=0.7)
    assert [field.bounds[1] for field in found] == pytest.approx([0.7, 0.1, 0.7, 0.1])


def test_colours_may_be_others_than_the_materials_own() -> None:
    plain = shares(NUMBERS)
    renamed = tuple((name, color) for (name, _), color in zip(MATERIALS, DEFAULT_COLORS[4:], strict=True))
    source = MaterialMap.model_validate({"map": "m.png", "colors": dict(MATERIALS)})
    inputs = Inputs(Path("nowhere"), {"m.png": png(painted(NUMBERS))})
    for one, other in zip(plain, source.open_shares(FRAME, inputs, renamed), strict=True):
        assert np.array_equal(values(one), values(other))


def test_plane_box_and_frame() -> None:
    """A box in file coordinates on the xz plane: the lower right quarter is soft."""
    box = [MINIMUM[0] + 1, MINIMUM[2] + 1, MINIMUM[0] + 3, MINIMUM[2] + 2]
    for shift in (0.0, 100.0):
        moved = [b + shift for b in box]
        field = shares([[0, 1], [3, 2]], plane="xz", box=moved, frame=Frame(MINIMUM + shift, SIZE))[2]
        points = np.array([[2.5, 9, 1.25], [3.9, 0, 0.1], [1.5, 0, 1.25], [2.5, 0, 1.75], [2.0, 0, 1.5]])
        np.testing.assert_allclose(values(field, points), [1, 1, 0, 0, 0.25], rtol=0, atol=1e-9)
        assert field.varies == (True, False, True)


# Refused


def refused(pixels: Any, materials: Any = MATERIALS, **spec: Any) -> JobError:
    source = MaterialMap.model_validate({"map": "paint/m.png", **spec})
    with pytest.raises(JobError) as caught:
        source.open_shares(FRAME, Inputs(Path("nowhere"), {"paint/m.png": png(pixels)}), materials)
    return caught.value


def test_a_colour_of_no_material_is_refused_with_its_place() -> None:
    pixels = painted(NUMBERS)
    pixels[2, 5] = pixels[4, 1] = (0x30, 0x70, 0xAF)
    error = refused(pixels)
    for said in ("'paint/m.png'", "#3070af", "column 5, row 2", "2 pixels", "nearest is #2b6cb0 of rigid"):
        assert said in error.message
    assert error.hint
    pixels[5, 8] = (255, 255, 255)
    error = refused(pixels)
    assert "2 pixels; 3 pixels have no material's colour" in error.message


def test_what_else_is_refused() -> None:
    assert "is not RGB" in refused([[0, 255]]).message
    assert (
        "for 'stiff', and there is no such material" in refused(painted(NUMBERS), colors={"stiff": "#000000"}).message
    )
    error = refused(painted(NUMBERS), colors={"soft": "#2B6CB0"})
    assert "#2b6cb0 for both rigid and soft" in error.message
    stream = io.BytesIO()
    Image.fromarray(painted(NUMBERS)).quantize(4).save(stream, "PNG")
    with pytest.raises(JobError, match="is not RGB"):
        MaterialMap.model_validate({"map": "m"}).open_shares(
            FRAME, Inputs(Path("nowhere"), {"m": stream.getvalue()}), MATERIALS
        )


@pytest.mark.parametrize(
    ("key", "value"),
    [("dominant", 1.5), ("dominant", -0.1), ("dominant", "1"), ("colors", {"rigid": "blue"}), ("map", ""),
     ("plane", "zx"), ("box", [0, 0, 0, 1]), ("range", [0, 1])],
)  # fmt: skip
def test_settings_that_are_refused(key: str, value: Any) -> None:
    with pytest.raises(ValidationError, match=key):
        MaterialMap.model_validate({"map": "m.png", key: value})


def test_it_is_no_number() -> None:
    with pytest.raises(JobError, match="gives the shares of all materials"):
        open_field(MaterialMap.model_validate({"map": "m.png"}), FRAME, Inputs(Path("nowhere")))


def content(ratio: Any, materials: Any = ("rigid", "flexible", "soft")) -> dict[str, Any]:
    return {"materials": list(materials), "fields": {"ratio": ratio}}


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        ({"map": "m.png", "dominant": 2}, r"fields\.ratio\.dominant: "),
        ({"map": "m.png", "dominent": 0.5}, "unknown key 'fields.ratio.dominent'"),
        ({"map": "m.png", "colors": {"rigit": "#000000"}}, "fields.ratio: .* color for 'rigit'"),
        ({"map": "m.png", "colors": {"rigid": DEFAULT_COLORS[1]}}, "both rigid and flexible"),
    ],
)
def test_a_job_says_what_is_wrong(ratio: Any, said: str) -> None:
    with pytest.raises(JobError, match=said):
        load_job(content(ratio), part="p.stl")


def test_a_material_may_be_called_map() -> None:
    for ratio in ({"map": 0.3, "other": "rest"}, {"map": "rest", "other": 0.3}):
        spec: Any = load_job(content(ratio, ("map", "other")), part="p.stl").spec
        assert set(spec.fields.ratio) == {"map", "other"}


# Jobs


def test_a_job_prints_its_map_and_turns_with_the_part(tmp_path: Path) -> None:
    """Quarters of plain materials: rigid flexible / soft rigid, and the same turned by 90°."""
    colors = dict(zip(("rigid", "flexible", "soft"), DEFAULT_COLORS, strict=False))
    numbers = np.kron([[0, 1], [2, 0]], np.ones((20, 20), int))  # two texels a pixel: none lies between two colours
    parts.paint(tmp_path, painted(numbers, list(colors.items())), "m.png")
    part = parts.stl(tmp_path, meshes.box((2.0, 2.0, 0.1), at=(7.0, 8.0, 9.0)))
    for turn, expected in ((0, [[1, 2], [3, 1]]), (90, [[2, 1], [1, 3]])):
        job = parts.job(part, ratio={"map": "m.png"}, materials=tuple(colors), printer=PIXEL,
                        settings={"rotate": [0, 0, turn]})  # fmt: skip
        np.testing.assert_array_equal(parts.bitmap(job), np.kron(expected, np.ones((10, 10), int)))
        assert job.input_paths() == ("m.png",)


def test_two_materials_are_as_by_a_grey_picture(tmp_path: Path) -> None:
    """Black and white as shares 0.2 and 0.8 are the same bytes."""
    numbers = np.random.default_rng(1).integers(0, 2, (5, 7))
    materials = [("rigid", "#ffffff"), ("flexible", "#000000")]
    parts.paint(tmp_path, painted(numbers, materials), "m.png")
    parts.paint(tmp_path, np.where(numbers == 0, 255, 0).astype(np.uint8), "grey.png")
    part = parts.box(tmp_path, (6.0, 6.0, 0.3))
    by_map = {"map": "m.png", "dominant": 0.8, "colors": dict(materials)}
    by_grey = {"image": "grey.png", "range": [1 - 0.8, 0.8]}
    one, other = (
        parts.labels(parts.job(part, ratio=ratio, orientation=20, printer=PIXEL)) for ratio in (by_map, by_grey)
    )
    assert np.array_equal(one, other)


def test_a_map_may_stay_on_the_bed(tmp_path: Path) -> None:
    """frame: bed with a part that is turned: the picture is not."""
    numbers = np.kron([[0, 1], [2, 0]], np.ones((20, 20), int))
    colors = list(zip(("rigid", "flexible", "soft"), DEFAULT_COLORS, strict=False))
    parts.paint(tmp_path, painted(numbers, colors), "m.png")
    part = parts.box(tmp_path, (2.0, 2.0, 0.1))
    ratio = {"map": "m.png", "frame": "bed"}
    job = parts.job(part, ratio=ratio, materials=("rigid", "flexible", "soft"), printer=PIXEL,
                    settings={"rotate": [0, 0, 90]})  # fmt: skip
    np.testing.assert_array_equal(parts.bitmap(job), np.kron([[1, 2], [3, 1]], np.ones((10, 10), int)))


def test_a_stack_verifies_and_resolves(tmp_path: Path) -> None:
    colors = list(zip(("rigid", "flexible", "soft"), DEFAULT_COLORS, strict=False))
    parts.paint(tmp_path, painted([[0, 1, 2]], colors), "m.png")
    job = parts.job(parts.box(tmp_path, (6.0, 6.0, 0.5)), ratio={"map": "m.png", "dominant": 0.6},
                    materials=("rigid", "flexible", "soft"), printer=PIXEL, orientation=30)  # fmt: skip
    slice_job(job, tmp_path / "out")
    report = verify(tmp_path / "out")
    assert report.ok
    again = load_job(tmp_path / "out" / "job.yaml", part=job.part)
    assert np.array_equal(next(iter(layers(again, Run()))).labels, parts.bitmap(job))
    # The middle third is flexible, the sides are clamped beyond half a texel: by symmetry, each has a third in all.
    assert report.materials["flexible"].expected == pytest.approx(0.2 + 0.4 / 3, abs=2e-3)
