"""Fields made of others: mix, clip, remap, where, and all of them in each other."""

from __future__ import annotations

import io
import json
from itertools import product
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from jsonschema import Draft202012Validator
from numpy.typing import NDArray
from PIL import Image
from pydantic import TypeAdapter
from scipy.interpolate import PchipInterpolator

from amslicer import JobError, load_job
from amslicer.fields import FieldSpec, Frame, Inputs, blur, open_field, open_orientation
from amslicer.fields.combination import mix_lines
from amslicer.fields.source import Part
from amslicer.jobfile import MOST_NESTED
from amslicer.mesh import read_mesh
from amslicer.pipeline import prepare
from amslicer.placement import place
from amslicer.schema import job_schema

Floats = NDArray[np.float64]

MINIMUM, SIZE = np.array([10.0, -5.0, 3.0]), np.array([20.0, 14.0, 9.0])
FRAME = Frame(MINIMUM, SIZE)
POINTS = np.random.default_rng(1).uniform(0, 1, (400, 3)) * SIZE
X, Y, Z = POINTS.T
U, V, W = (POINTS / SIZE).T


def along(axis: str, low: float = 0.0, high: float = 1.0) -> dict[str, Any]:
    return {"gradient": {"axis": axis, "from": low, "to": high}}


def png(pixels: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(stream, "PNG")
    return stream.getvalue()


# 1° and 179° side by side; black and white in quarters.
FILES = {"angles.png": png([[1, 179]]), "quarters.png": png([[0, 255], [255, 0]])}
ANGLES = {"image": "angles.png", "range": [0, 255]}


def spec(field: Any) -> Any:
    return TypeAdapter(FieldSpec).validate_python(field)


def sampler(field: Any, frame: Frame = FRAME) -> Any:
    return open_field(spec(field), frame, Inputs(Path("nowhere"), dict(FILES)))


def lines(field: Any, frame: Frame = FRAME) -> Any:
    return open_orientation(spec(field), frame, Inputs(Path("nowhere"), dict(FILES)))


def values(field: Any, frame: Frame = FRAME, points: Floats = POINTS) -> Floats:
    return np.broadcast_to(sampler(field, frame).scalar(*points.T), len(points))


def angles(field: Any, points: Floats = POINTS) -> Floats:
    """Degrees of lines in the plane, 0 … 180."""
    normals = lines(field).normals(*points.T)
    assert np.allclose(normals[:, 2], 0)
    return np.asarray(np.rad2deg(np.arctan2(normals[:, 1], normals[:, 0])) % 180)


def mix(a: Any, b: Any, by: Any) -> dict[str, Any]:
    return {"mix": {"a": a, "b": b, "by": by}}


def where(mask: Any, then: Any, other: Any, **more: Any) -> dict[str, Any]:
    return {"where": {"mask": mask, "then": then, "else": other, **more}}


def clip(field: Any, low: float = 0.0, high: float = 1.0) -> dict[str, Any]:
    return {"clip": {"field": field, "from": low, "to": high}}


def remap(field: Any, *curve: list[float], smooth: bool = False) -> dict[str, Any]:
    return {"remap": {"field": field, "curve": list(curve), "smooth": smooth}}


CURVE: tuple[list[float], ...] = ([0.2, 3.0], [0.5, 1.0], [0.9, 1.5])


# Numbers


def test_mix_is_linear_in_each() -> None:
    found = values(mix(along("x", 2, 5), along("y", -1, 1), along("z")))
    np.testing.assert_allclose(found, (2 + 3 * U) * (1 - W) + (2 * V - 1) * W, atol=1e-12)


def test_mix_is_exact_at_its_ends_and_between_equal_fields() -> None:
    odd = 0.1 + 0.2
    assert (values(mix(0.3, odd, 1)) == odd).all()
    assert (values(mix(odd, 0.7, 0)) == odd).all()
    assert (values(mix(odd, odd, along("x"))) == odd).all()


def test_mix_bounds_are_true_and_as_narrow_as_the_share() -> None:
    field = sampler(mix(along("x", 2, 5), along("y", -1, 1), along("z", 0.25, 0.5)))
    assert field.bounds == (2 * 0.5 - 1 * 0.5, 5 * 0.75 + 1 * 0.25)
    found = values(mix(along("x", 2, 5), along("y", -1, 1), along("z", 0.25, 0.5)))
    assert field.bounds[0] <= found.min() < found.max() <= field.bounds[1]
    corners = np.array(list(product(*((0, s) for s in SIZE))))
    assert (field.scalar(*corners.T).min(), field.scalar(*corners.T).max()) == field.bounds


@pytest.mark.parametrize("low", [-0.5, 0.0])
def test_a_share_beyond_0_to_1_is_refused_with_its_place(low: float) -> None:
    with pytest.raises(JobError, match=r"mix\.by is .* at x = .* y = .* z = .* mm \(file coordinates\)") as caught:
        sampler(mix(0.1, 0.2, along("x", low, 1.5)))
    assert "clip" in str(caught.value.hint)
    expected = "-0.5 at x = 10.00, y = -5.00, z = 3.00" if low < 0 else "1.125 at x = 25.00"
    assert expected in caught.value.message


def test_a_share_beyond_0_to_1_between_the_places_looked_at_first_is_refused_too() -> None:
    field = sampler(mix(0.1, 0.2, {"expression": "where(abs(x - 11) < 0.1, 3, 0)"}))
    with pytest.raises(JobError, match=r"mix\.by is 3 at x = 11\.00"):
        field.scalar(np.array([0.5, 1.0]), np.array([1.0]), np.array([1.0]))


def test_a_share_that_leaves_by_rounding_is_taken() -> None:
    assert (values(mix(0.1, 0.7, 1 + 1e-12)) == 0.7).all()


def test_clip() -> None:
    field = sampler(clip(along("x", -1, 2), 0.1, 0.8))
    np.testing.assert_array_equal(field.scalar(X, Y, Z), np.clip(sampler(along("x", -1, 2)).scalar(X, Y, Z), 0.1, 0.8))
    assert field.bounds == (0.1, 0.8)
    assert sampler(clip(along("x", -1, 0.5), 0.1, 0.8)).bounds == (0.1, 0.5)
    assert sampler({"clip": {"field": along("x", -1, 2)}}).bounds == (0, 1)


@pytest.mark.parametrize("smooth", [False, True])
def test_remap_goes_through_its_points_and_is_flat_beyond(smooth: bool) -> None:
    given, taken = np.array(CURVE).T
    found = values(remap(along("x"), *CURVE, smooth=smooth))
    reference = PchipInterpolator(given, taken) if smooth else lambda v: np.interp(v, given, taken)
    np.testing.assert_allclose(found, reference(np.clip(U, 0.2, 0.9)), atol=1e-12)
    for value, out in CURVE:
        assert values(remap(value, *CURVE, smooth=smooth))[0] == out
    assert values(remap(-7, *CURVE, smooth=smooth))[0] == 3.0
    assert values(remap(7, *CURVE, smooth=smooth))[0] == 1.5


@pytest.mark.parametrize("smooth", [False, True])
def test_remap_bounds(smooth: bool) -> None:
    assert sampler(remap(along("x"), *CURVE, smooth=smooth)).bounds == (1.0, 3.0)
    low, high = sampler(remap(along("x", 0.6, 0.7), *CURVE, smooth=smooth)).bounds
    found = values(remap(along("x", 0.6, 0.7), *CURVE, smooth=smooth))
    assert 1.0 < low <= found.min() < found.max() <= high < 1.5
    assert sampler(remap(along("x", 0.4, 0.7), *CURVE, smooth=smooth)).bounds[0] == 1.0


def test_where() -> None:
    found = values(where(along("x"), along("y"), along("z", 5, 6)))
    np.testing.assert_array_equal(found, np.where(U > 0.5, V, 5 + W))
    found = values(where(along("x"), 1, 2, above=0.25))
    np.testing.assert_array_equal(found, np.where(U > 0.25, 1, 2))
    assert values(where(0.5, 1, 2))[0] == 2, "above is not at"


def test_where_bounds_and_axes_follow_what_can_be_chosen() -> None:
    both = sampler(where(along("x"), along("y"), along("z", 5, 6)))
    assert (both.bounds, both.varies) == ((0.0, 6.0), (True, True, True))
    above = sampler(where(along("x", 0.6, 1), along("y"), along("z", 5, 6)))
    assert (above.bounds, above.varies) == ((0.0, 1.0), (False, True, False))
    below = sampler(where(along("x", 0, 0.5), along("y"), along("z", 5, 6)))
    assert (below.bounds, below.varies) == ((5.0, 6.0), (False, False, True))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_varies_is_exact(axis: int) -> None:
    one = along("xyz"[axis])
    expected = tuple(i == axis for i in range(3))
    for field in (mix(0.1, 0.9, one), mix(one, 0.3, 0.5), clip(one, 0.1, 0.2), remap(one, *CURVE), where(one, 1, 2)):
        assert sampler(field).varies == expected
        assert lines(field).varies == expected
    for field in (mix(1, 2, 0.5), clip(3, 0, 1), where(0.2, 1, 2)):
        assert sampler(field).varies == (False, False, False)


def test_what_does_not_vary_stays_small() -> None:
    """A field constant in z costs nothing per layer, and one along x a row of pixels."""
    x, y, z = np.linspace(0, 20, 50)[None, :], np.linspace(0, 14, 40)[:, None], np.asarray(1.0)
    assert sampler(mix(0.1, clip(along("x"), 0.2, 0.3), along("x"))).scalar(x, y, z).size == 50
    assert sampler(where(along("x"), 0.1, remap(along("x"), *CURVE))).scalar(x, y, z).size == 50


# Directions


def principal(a: Floats, b: Floats, t: Floats) -> Floats:
    tensor = (1 - t)[:, None, None] * a[:, :, None] * a[:, None] + t[:, None, None] * b[:, :, None] * b[:, None]
    return np.asarray(np.linalg.eigh(tensor)[1][:, :, -1])


def test_mixed_directions_are_principal_lines() -> None:
    random = np.random.default_rng(5)
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in random.normal(size=(2, 2000, 3)))
    t = random.uniform(0, 1, 2000)
    found = mix_lines(a, b, t)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-12)
    off = 1 - np.abs(np.einsum("ni,ni->n", found, principal(a, b, t)))
    print(f"mixed lines are off by 1 - |cos| of up to {off.max():.2g}")
    assert off.max() < 1e-12
    larger = np.where((t > 0.5)[:, None], b, a)
    assert (np.einsum("ni,ni->n", found, larger) > 0).all()


def test_mixed_directions_are_exact_at_their_ends() -> None:
    a, b = lines(137.0).normals(X, Y, Z), lines(20.0).normals(X, Y, Z)
    assert np.array_equal(mix_lines(a, b, np.zeros(400)), a)
    assert np.array_equal(mix_lines(a, b, np.ones(400)), b)
    assert np.array_equal(mix_lines(a, a, np.full(400, 0.3)), a)
    assert np.array_equal(lines(mix(137, 20, 0)).normals(X, Y, Z), a)
    assert np.array_equal(lines(mix(137, 20, 1)).normals(X, Y, Z), b)


def test_1_and_179_degrees_never_give_90() -> None:
    for share in (0.25, 0.5, 0.75, along("y")):
        for field in (mix(1, 179, share), mix(ANGLES, ANGLES, share), mix(ANGLES, 1, share)):
            off = angles(field)
            assert (np.minimum(off, 180 - off) <= 1 + 1e-9).all()
    assert angles(mix(1, 179, 0.5))[0] % 180 == pytest.approx(0, abs=1e-9)
    # The same angles as numbers would be 90°: the test sees the difference.
    assert values(mix(1, 179, 0.5))[0] == 90


def test_pictures_of_angles_pass_through_as_lines() -> None:
    plain = lines(ANGLES).normals(X, Y, Z)
    for field in (
        clip(ANGLES, 0, 180), remap({"image": "angles.png"}, [0, 0], [1, 255]), where(0.9, ANGLES, 45),
        where(along("z", 0.6, 0.9), ANGLES, 45),
    ):  # fmt: skip
        np.testing.assert_allclose(lines(field).normals(X, Y, Z), plain, atol=1e-12)
    found = lines({"clip": {"field": ANGLES, "from": 0, "to": 180}}).azimuth
    assert found.texels == sampler(ANGLES).texels


def test_where_takes_one_direction_or_the_other() -> None:
    field = where({"image": "quarters.png"}, ANGLES, along("x", 20, 40), above=0.5)
    chosen = values({"image": "quarters.png"}) > 0.5
    expected = np.where(chosen[:, None], lines(ANGLES).normals(X, Y, Z), lines(along("x", 20, 40)).normals(X, Y, Z))
    np.testing.assert_array_equal(lines(field).normals(X, Y, Z), expected)


def test_as_an_azimuth_where_keeps_lines() -> None:
    """Four texels behind one, one number behind the other: the samples chosen are those of the field chosen."""
    field = sampler(where(along("y"), ANGLES, 60))
    samples, weights = field.taps(X, Y, Z)
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-12)
    np.testing.assert_allclose((samples * weights).sum(axis=0), field.scalar(X, Y, Z), atol=1e-9)
    assert (samples[:, V <= 0.5] == 60).all()
    from amslicer.fields.orientation import Angles

    found = np.rad2deg(np.arctan2(*Angles(field).normals(X, Y, Z).T[1::-1])) % 180
    assert found[V <= 0.5] == pytest.approx(60)
    assert (np.minimum(found, 180 - found)[V > 0.5] <= 1 + 1e-9).all()


def test_turns() -> None:
    assert not lines(mix(30, 30, along("x"))).turns
    assert not lines(mix(30, 60, 0.4)).turns
    assert not lines(where(along("x"), 30, 30)).turns
    assert lines(mix(30, 60, along("x"))).turns
    assert lines(where(along("x"), 30, 60)).turns
    assert lines(mix(along("x", 0, 9), 60, 0.1)).turns


# All in each other, and frames


def part_frame(minimum: Floats = MINIMUM) -> Frame:
    """A frame whose part is a box of two named halves, for per_body."""
    path = Path("/nowhere/part.obj")

    def load() -> Part:
        import tempfile

        half = (SIZE[0] / 2, SIZE[1], SIZE[2])
        solids = [meshes.box(half, tuple(minimum)), meshes.box(half, (minimum[0] + half[0], *minimum[1:]))]
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "part.stl"
            file.write_bytes(meshes.binary_stl(meshes.joined(*solids)))
            return Part(path, read_mesh(file))

    mesh = load().mesh
    return Frame(minimum, SIZE, place(mesh)[0], load)


COMBINED: dict[str, Any] = {
    "mix": lambda f: mix(f, 0.5, 0.25),
    "mix by": lambda f: mix(0.2, 0.8, f),
    "clip": lambda f: clip(f, 0.3, 0.6),
    "remap": lambda f: remap(f, [0, 0.2], [0.5, 0.9], [1, 0.4]),
    "smooth": lambda f: remap(f, [0, 0.2], [0.5, 0.9], [1, 0.4], smooth=True),
    "where": lambda f: where(f, 0.2, f, above=0.4),
    "blur": lambda f: {"blur": {"field": f, "mm": 4.0}},
    "per_body": lambda f: {"per_body": {"1": f, "rest": 0.7}},
}


@pytest.mark.parametrize(("outer", "inner"), list(product(COMBINED, COMBINED)))
def test_all_in_each_other(outer: str, inner: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nested fields do to the inner values what they do to a number; both as numbers and as directions."""
    monkeypatch.setattr(blur, "WANTED_VALUES", 30_000)
    frame = part_frame()
    inside = COMBINED[inner](along("x"))
    field = COMBINED[outer](inside)
    opened = sampler(field, frame)
    found = np.broadcast_to(opened.scalar(X, Y, Z), 400)
    assert opened.bounds[0] <= found.min()
    assert found.max() <= opened.bounds[1]
    given = np.broadcast_to(sampler(inside, frame).scalar(X, Y, Z), 400)
    expected = {
        "mix": lambda v: 0.75 * v + 0.125,
        "mix by": lambda v: 0.2 + 0.6 * v,
        "clip": lambda v: np.clip(v, 0.3, 0.6),
        "remap": lambda v: np.interp(v, [0, 0.5, 1], [0.2, 0.9, 0.4]),
        "smooth": PchipInterpolator([0, 0.5, 1], [0.2, 0.9, 0.4]),
        "where": lambda v: np.where(v > 0.4, 0.2, v),
        "per_body": lambda v: np.where(X < 10, v, 0.7),
    }
    if outer != "blur":
        np.testing.assert_allclose(found, expected[outer](given), atol=1e-6)
    if outer in ("clip", "remap", "smooth") and inner == "blur":  # means of numbers are no angles
        with pytest.raises(JobError, match=r"fields\.orientation: a field by blur has means of its numbers"):
            lines(field, frame)
    else:
        normals = lines(field, frame).normals(X, Y, Z)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    moved = part_frame(MINIMUM + np.array([100.0, -7.0, 3.5]))
    np.testing.assert_allclose(np.broadcast_to(sampler(field, moved).scalar(X, Y, Z), 400), found, atol=1e-6)
    some = np.broadcast_to(opened.scalar(*POINTS[7:9].T), 2)
    np.testing.assert_array_equal(some, found[7:9])


def test_huge_numbers_are_not_mixed() -> None:
    for field, key in ((mix(-1e308, 1e308, 0.5), "a"), (mix(0.0, along("x", 0, 2e9), 0.5), "b")):
        with pytest.raises(JobError, match=rf"mix\.{key} has values from .* at most ±1e\+09 is mixed") as caught:
            sampler(field)
        assert caught.value.hint


SAMPLED: dict[str, Any] = {
    "points": {"points": [[0, 0, 179], [20, 0, 1]]},
    "blur": {"blur": {"field": where(along("x"), 179, 1), "mm": 2}},
    "strokes": {"strokes": [{"path": [[0, 0], [20, 0]], "radius": 60, "value": [179, 1]}], "base": 0},
}


@pytest.mark.parametrize("name", SAMPLED)
def test_means_of_samples_are_no_azimuth_or_elevation(tmp_path: Path, name: str) -> None:
    """179° and 1° would make 90°; as the whole orientation they make lines."""
    for field in (SAMPLED[name], where(0.9, SAMPLED[name], 3), clip(mix(3, SAMPLED[name], 0.5), 0, 180)):
        for key in ("azimuth", "elevation"):
            box = parts.box(tmp_path, (20, 15, 10))
            with pytest.raises(JobError, match=rf"fields\.orientation\.{key}: a field by {name} has means") as caught:
                prepare(parts.job(box, orientation={key: field}, dimensions=3))
            assert "nx,ny,nz" in str(caught.value.hint)
    normals = lines(SAMPLED[name]).normals(X, Y, Z)
    assert np.abs(normals[:, 1]).max() < np.sin(np.deg2rad(3))  # beyond the points a thin plate goes on


def test_masks_shares_and_nearest_points_may_lead_to_an_azimuth(tmp_path: Path) -> None:
    box = parts.box(tmp_path, (20, 15, 10))
    nearest = {"points": [[0, 0, 179], [20, 0, 1]], "method": "nearest"}
    share = {"clip": {"field": {"points": [[0, 0, 0], [20, 0, 1]]}}}
    for azimuth in (nearest, where(share, 179, 1), mix(10, 20, share), along("x", 0, 30)):
        prepare(parts.job(box, orientation={"azimuth": azimuth}, dimensions=3))


def test_a_share_in_bed_coordinates_is_refused_in_these(tmp_path: Path) -> None:
    box = parts.box(tmp_path, (20, 15, 10))
    field = mix(0, 1, along("x", 0, 2))
    with pytest.raises(JobError, match="printer coordinates") as caught:
        prepare(parts.job(box, ratio={**field, "frame": "bed"}))
    assert "within: [0, 1]" in str(caught.value.hint)
    with pytest.raises(JobError, match="file coordinates"):
        prepare(parts.job(box, ratio=field))


def test_a_field_within_may_be_in_bed_coordinates() -> None:
    mesh = part_frame().part("").mesh
    placement, _ = place(mesh, rotate_deg=(0, 0, 90))
    frame = Frame(MINIMUM, SIZE, placement)
    bed = {**along("x"), "frame": "bed"}
    # The bed's x is the part's -y.
    np.testing.assert_allclose(values(mix(0, 1, bed), frame), 1 - V, atol=1e-12)
    assert sampler(mix(0, 1, bed), frame).varies == (False, True, False)
    whole = {**mix(0, 1, along("x")), "frame": "bed"}
    np.testing.assert_allclose(values(whole, frame), 1 - V, atol=1e-12)
    with pytest.raises(JobError, match="inside another one"):
        sampler({**mix(0, 1, bed), "frame": "bed"}, frame)


def test_a_whole_job_follows_its_part(tmp_path: Path) -> None:
    """Left half plain, right half the other material, however the part is turned and scaled."""
    part = parts.box(tmp_path, (2.0, 1.0, 0.2))
    ratio = clip(mix(-1, 2, where(along("x"), 1, 0)))
    for settings, mirrored in (({}, False), ({"rotate": [0, 0, 180], "scale": 2}, True)):
        labels = parts.labels(parts.job(part, ratio=ratio, settings=settings))[0]
        half = labels.shape[1] // 2
        left, right = labels[:, : half - 1], labels[:, half + 1 :]
        assert set(np.unique(left)) - {0} == {1 if mirrored else 2}  # a last row of pixels may be outside
        assert set(np.unique(right)) - {0} == {2 if mirrored else 1}


def test_a_job_of_combinations_is_dumped_and_loaded_again(tmp_path: Path) -> None:
    (tmp_path / "angles.png").write_bytes(FILES["angles.png"])
    file = tmp_path / "job.yaml"
    field = where(mix(clip(ANGLES), remap(0.3, *CURVE), 0.1), 0.1, {"blur": {"field": ANGLES, "mm": 1}})
    content = {"materials": ["a", "b"], "fields": {"ratio": field, "orientation": {"per_body": {"x y": ANGLES}}}}
    file.write_text(json.dumps(content), encoding="utf-8")
    job = load_job(file, part="part.stl")
    assert job.input_paths() == ("angles.png",)
    resolved = job.resolved({"angles.png": "inputs/angles.png"})
    assert json.dumps(resolved).count("inputs/angles.png") == 3
    assert load_job(job.resolved(), part="part.stl").spec == job.spec


# Refusals


def refusal(tmp_path: Path, text: str) -> JobError:
    file = tmp_path / "job.yaml"
    file.write_text(f"materials: [a, b]\nfields:\n  {text}\n", encoding="utf-8")
    with pytest.raises(JobError) as caught:
        load_job(file, part="part.stl")
    return caught.value


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("ratio: {mix: {a: yes, b: 1, by: 0}}", "line 3, column 17: fields.ratio.mix.a: \"yes\" is not a field"),
        ("ratio: {mix: {a: 1, b: 1}}", "the key 'fields.ratio.mix.by' is missing"),
        ("ratio: {mix: {a: 1, b: 1, bi: 0}}", "column 29: unknown key 'fields.ratio.mix.bi'"),
        ("ratio: {mix: {a: {mix: {a: 1, b: {clip: {feld: 1}}, by: 0}}, b: 1, by: 0}}",
         "unknown key 'fields.ratio.mix.a.mix.b.clip.feld'"),
        ("ratio: {mix: {a: {gradient: {axis: w, from: 0, to: 1}}, b: 1, by: 0}}", "fields.ratio.mix.a.gradient.axis"),
        ("orientation: {where: {mask: 1, then: {image: 3}, else: 0}}\n  ratio: 0.3",
         "fields.orientation.where.then.image: input should be a valid string"),
        ("ratio: {a: {clip: {field: 1, from: .nan}}, b: rest}", "fields.ratio.a.clip.from"),
        ("ratio: {clip: {field: 1, from: 2, to: 1}}", "from 2 is above to 1"),
        ("ratio: {remap: {field: 1, curve: [[0, 1]]}}", "fields.ratio.remap.curve"),
        ("ratio: {remap: {field: 1, curve: [[0, 1], [0, 2]]}}", "must ascend, but 0 follows 0"),
        ("ratio: {remap: {field: 1, curve: [[0, 1], [5e-324, 2]]}}", "follows 0 too closely"),
        ("ratio: {remap: {field: 1, curve: [[0, 1], [1, 2], [1.0000000001, 2]]}}", "follows 1 too closely"),
        ("ratio: {remap: {field: 1, curve: [[-1e308, 1], [1e308, 2]]}}", "has the number -1e+308; at most ±1e+09"),
        ("ratio: {remap: {field: 1, curve: [[0, 1e308], [1, -1e308]]}}", "has the number 1e+308; at most ±1e+09"),
        ("ratio: {remap: {field: 1, curve: [[0, 1], [1, x]]}}", "fields.ratio.remap.curve.1.1"),
        ("ratio: {remap: {field: 1, curve: [[0, 1], [1, 2]], smooth: 1}}", "fields.ratio.remap.smooth"),
        ("ratio: {blur: {field: 1, mm: 0}}", "fields.ratio.blur.mm"),
        ("ratio: {per_body: {mix: {gradient: {axis: w, from: 0, to: 1}}}}", "fields.ratio.per_body.mix.gradient.axis"),
        ("ratio: {per_body: {gradient: true}}", "fields.ratio.per_body.gradient: true is not a field"),
        ("ratio: {per_body: {}}", "fields.ratio.per_body"),
        ("ratio: {mix: {a: 1, b: 1, by: 0}, clip: {field: 1}}", "is not a field"),
    ],
)  # fmt: skip
def test_refusals_name_the_key_and_its_place(tmp_path: Path, text: str, said: str) -> None:
    found = str(refusal(tmp_path, text))
    assert said in found
    assert "job.yaml, line 3, column " in found


def nested(depth: int) -> Any:
    field: Any = along("x")
    for _ in range(depth - 1):
        field = mix(field, 0.5, 0.5)
    return field


def test_nesting_is_bounded(tmp_path: Path) -> None:
    materials = {"materials": ["a", "b"]}
    load_job({**materials, "fields": {"ratio": nested(MOST_NESTED)}}, part="p.stl")
    with pytest.raises(JobError, match=f"fields are nested more than {MOST_NESTED} deep"):
        load_job({**materials, "fields": {"ratio": nested(MOST_NESTED + 1)}}, part="p.stl")
    found = refusal(tmp_path, f"ratio: {json.dumps(nested(MOST_NESTED + 1))}")
    assert "line 3, column" in found.message


def test_ten_thousand_nested_mappings_are_refused() -> None:
    materials = {"materials": ["a", "b"]}
    plain: Any = 1
    for _ in range(10_000):
        plain = {"a": plain}
    cyclic: dict[str, Any] = {}
    cyclic["mix"] = cyclic
    for deep in (nested(10_000), plain, cyclic, {"per_body": plain}):
        with pytest.raises(JobError, match="nested"):
            load_job({**materials, "fields": {"ratio": deep}}, part="p.stl")
        with pytest.raises(Exception, match="nested") as caught:
            load_job({**materials, "fields": {"ratio": 0.5}}, "p.stl", {"fields.ratio": deep})
        assert not isinstance(caught.value, RecursionError)


def test_directions_where_numbers_are_asked_for_are_refused() -> None:
    hues = {"image": "angles.png", "reads": "gradient"}
    with pytest.raises(JobError, match="directions"):
        sampler(mix(hues, 0.5, 0.5))
    with pytest.raises(JobError, match="directions"):
        lines(where(hues, 0.5, 0.5))
    with pytest.raises(JobError, match="directions"):
        lines(clip(hues))


def test_the_example_means_what_it_says() -> None:
    folder = Path(__file__).parents[1] / "configs" / "examples"
    fields: Any = load_job(folder / "mix.yaml", part="part.stl").spec.fields
    frame = Frame(np.array([-10.0, -10.0, 0.0]), np.array([20.0, 20.0, 5.0]))

    def at(field: Any, *places: tuple[float, float, float]) -> list[float]:
        points = np.array(places) - frame.minimum_mm
        return np.broadcast_to(open_field(field, frame, Inputs(folder)).scalar(*points.T), len(places)).tolist()

    assert at(fields.ratio, (0, 0, 0), (2.5, 1, 5), (0, 2, 5), (-2.5, 0, 5)) == pytest.approx([0.2, 0.7, 0.5, 0.1])
    assert at(fields.isotropy, (-3, 0, 0), (0, 1, 2), (6, 3, 1), (10, 0, 5)) == pytest.approx([0, 0, 0.1, 0.5])
    points = np.array([[0, 0, 1], [6, 0, 2], [10, 10, 3]]) - frame.minimum_mm
    normals = open_orientation(fields.orientation, frame, Inputs(folder)).normals(*points.T)
    angle = np.rad2deg(np.arctan2(normals[:, 1], normals[:, 0])) % 180
    assert angle[[0, 2]] == pytest.approx([20, 160], abs=0.5)
    assert min(angle[1], 180 - angle[1]) < 4


@pytest.mark.parametrize("name", COMBINED)
def test_the_schema_takes_what_the_reader_takes(name: str) -> None:
    validator = Draft202012Validator(job_schema())
    good = {"materials": ["a", "b"], "fields": {"ratio": COMBINED[name](COMBINED[name](along("x")))}}
    bad = json.loads(json.dumps(good).replace('"axis": "x"', '"axis": "w"'))
    load_job(good, part="p.stl")
    assert not list(validator.iter_errors(good))
    with pytest.raises(JobError, match="axis"):
        load_job(bad, part="p.stl")
    assert list(validator.iter_errors(bad))
