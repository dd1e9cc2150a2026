"""The volume source: sampled fields are where, and what, their formula says; directions are combined as lines."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from test_volumefiles import npy, npz, nrrd_file, tiff, vti

from amslicer import JobError, slice_job
from amslicer.fields import FieldSpec, Frame, Inputs, Sampler, open_field, open_orientation, voxels
from amslicer.fields import source as source_module
from amslicer.fields.orientation import Orientation
from amslicer.fields.source import Source
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]

MINIMUM, SIZE = np.array([10.0, -5.0, 3.0]), np.array([6.0, 4.0, 5.0])
FRAME = Frame(MINIMUM, SIZE)
COUNTS = (24, 20, 30)  # samples along x, y, z
POINTS = np.random.default_rng(1).uniform(0, 1, (500, 3)) * SIZE  # field frame


def spec(**settings: Any) -> Any:
    """As the job file writes it."""
    return TypeAdapter(FieldSpec).validate_python({"volume": "a.npy", **settings})


def inputs(content: bytes | NDArray[Any], name: str = "a.npy") -> Inputs:
    return Inputs(Path("nowhere"), {name: content if isinstance(content, bytes) else npy(content)})


def numbers(content: bytes | NDArray[Any], frame: Frame = FRAME, **settings: Any) -> Sampler:
    return open_field(spec(**settings), frame, inputs(content, settings.get("volume", "a.npy")))


def directions(content: bytes | NDArray[Any], frame: Frame = FRAME, **settings: Any) -> Orientation:
    return open_orientation(spec(**settings), frame, inputs(content, settings.get("volume", "a.npy")))


def at(field: Sampler, points: Floats = POINTS) -> Floats:
    return np.broadcast_to(field.scalar(*points.T), len(points))


def centres(frame: Frame = FRAME, counts: tuple[int, int, int] = COUNTS) -> tuple[Floats, Floats, Floats]:
    """x, y, z in file coordinates of the samples of an array stretched over the part, as (z, y, x) grids."""
    x, y, z = (
        low + (np.arange(n) + 0.5) * side / n
        for low, side, n in zip(frame.minimum_mm, frame.size_mm, counts, strict=True)
    )
    return tuple(np.broadcast_arrays(x[None, None, :], y[None, :, None], z[:, None, None]))  # type: ignore[return-value]


def formula(x: Floats, y: Floats, z: Floats) -> Floats:
    """0.1 … 0.9, curved along every axis."""
    return 0.5 + 0.2 * np.sin(0.7 * (x - 10)) + 0.1 * np.cos(0.9 * (y + 5)) + 0.1 * np.sin(0.5 * (z - 3) ** 1.2)


def within(points: Floats, margin: float) -> NDArray[np.bool_]:
    """Which points are not in the outermost half voxels, where samples are clamped."""
    half = margin * SIZE / np.array(COUNTS)
    return np.all((points >= half) & (points <= SIZE - half), axis=1)


# Where each sample is


def test_linear_fields_are_exact_in_every_type(tmp_path: Path) -> None:
    """Trilinear interpolation has no error on a + bx + cy + dz: only the file's rounding is left."""
    x, y, z = centres()
    a = 0.05 * (x - 10) + 0.06 * (y + 5) + 0.04 * (z - 3)
    made: dict[str, bytes] = {
        "a.npy": npy(a), "f.npy": npy(np.asfortranarray(a)), "a.npz": npz(a=a), "a.nrrd": nrrd_file(a, tmp_path),
        "a.tif": tiff(a.astype("f4")), "u.npy": npy(np.rint(a * 65535).astype("u2")),
        "u.tiff": tiff(np.rint(a * 65535).astype("u2")), "a.vti": vti({"a": a}), "h.npy": npy(a.astype("f2")),
        "b.vti": vti({"a": np.rint(a * 65535).astype("u2")}, packed=True),
    }  # fmt: skip
    inner = POINTS[within(POINTS, 0.5)]
    assert len(inner) > 300
    expected = inner @ [0.05, 0.06, 0.04]
    for name, content in made.items():
        allowed = {"u": 1 / 65535, "h": 5e-4, "b": 1 / 65535}.get(name[0], 1e-7)
        found = at(numbers(content, volume=name, placed="box"), inner)
        worst = np.abs(found - expected).max()
        print(f"{name}: {worst:.2g}, allowed {allowed:.2g}")
        assert worst <= allowed, name


@pytest.mark.parametrize("name", ["a.npy", "a.npz", "a.nrrd", "a.tif", "a.vti"])
def test_curved_fields_are_within_the_error_of_interpolation(name: str, tmp_path: Path) -> None:
    """At most h²/8 of the second derivative along each axis: 0.2·0.49, 0.1·0.81 and, by hand, below 0.12 along z."""
    a = formula(*centres())
    make = {"npy": npy, "npz": lambda v: npz(a=v), "nrrd": lambda v: nrrd_file(v, tmp_path), "tif": tiff}
    content = vti({"a": a}) if name == "a.vti" else make[name[2:]](a)
    found = numbers(content, volume=name, placed="box")
    h = SIZE / np.array(COUNTS)
    allowed = float((h**2 / 8) @ [0.098, 0.081, 0.12])
    inner = POINTS[within(POINTS, 0.5)]
    worst = np.abs(at(found, inner) - formula(*(inner + MINIMUM).T)).max()
    print(f"{name}: {worst:.2g}, allowed {allowed:.2g}")
    assert 0 < worst <= allowed


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_axes_are_z_y_x_and_ascend(axis: int) -> None:
    """One bright sample at a typed place of the array shines where its indices say, and nowhere else."""
    a = np.zeros((3, 4, 6), "u1")
    k, j, i = 2, 1, 4
    a[k, j, i] = 255
    field = numbers(a)
    place = np.array([[(i + 0.5) / 6, (j + 0.5) / 4, (k + 0.5) / 3]]) * SIZE
    assert at(field, place) == 1
    moved = place.copy()
    moved[0, axis] -= SIZE[axis] / (6, 4, 3)[axis]
    assert at(field, moved) == pytest.approx(0, abs=1e-12)
    ramp = np.arange(5.0).reshape([5 if i == 2 - axis else 1 for i in range(3)])
    sampler = numbers(ramp)
    assert sampler.varies == tuple(i == axis for i in range(3))
    low, high = np.zeros(3), SIZE.copy()
    assert at(sampler, np.array([low, high])).tolist() == [0, 4]


def test_samples_are_clamped_beyond_the_box() -> None:
    a = np.random.default_rng(2).random((3, 4, 5))
    field = numbers(a, box=[11, -4, 4, 14, -2, 7])
    inside = np.array([[11.0, -4, 4], [14, -2, 7], [11, -2, 7]]) - MINIMUM
    outside = np.array([[-99.0, -99, -99], [99, 99, 99], [-99, 99, 99]])
    expected = [a[0, 0, 0], a[-1, -1, -1], a[-1, -1, 0]]
    assert at(field, inside).tolist() == expected
    assert at(field, outside).tolist() == expected


def test_a_box_in_file_coordinates() -> None:
    """The same as a part that has that box."""
    a = np.random.default_rng(2).random((3, 4, 5))
    box = [11, -4, 4, 14, -2, 7]
    own = Frame(np.array(box[:3], float), np.array(box[3:], float) - box[:3])
    np.testing.assert_allclose(at(numbers(a, box=box)), at(numbers(a, own), POINTS + MINIMUM - box[:3]), atol=1e-12)


def test_placed_by_the_file(tmp_path: Path) -> None:
    """A sample of a linear field is at its own place, whatever the part's box."""
    first, step = np.array([8.0, -7.0, 2.0]), np.array([0.5, 0.4, 0.25])
    counts = (20, 18, 30)
    x, y, z = (first[i] + step[i] * np.arange(n) for i, n in enumerate(counts))
    a = 0.03 * x[None, None, :] + 0.04 * y[None, :, None] + 0.05 * z[:, None, None]
    header = {"space dimension": 3, "space directions": np.diag(step), "space origin": first}
    spacing = f'Spacing="{step[0]} {step[1]} {step[2]}"'
    cells, points = first - step / 2, first
    made = {
        "a.nrrd": nrrd_file(a, tmp_path, **header),
        "a.vti": vti({"a": a}, geometry=f'Origin="{cells[0]} {cells[1]} {cells[2]}" {spacing}'),
        "p.vti": vti({"a": a}, "PointData", geometry=f'Origin="{points[0]} {points[1]} {points[2]}" {spacing}'),
    }
    expected = (POINTS + MINIMUM) @ [0.03, 0.04, 0.05]
    for name, content in made.items():
        for placed in ({}, {"placed": "file"}):
            np.testing.assert_allclose(at(numbers(content, volume=name, **placed)), expected, atol=1e-12, err_msg=name)
        stretched = at(numbers(content, volume=name, placed="box"))
        assert np.abs(stretched - expected).max() > 0.05
        again = at(numbers(content, volume=name, box=[*MINIMUM, *(MINIMUM + SIZE)]))
        np.testing.assert_allclose(again, stretched, atol=1e-12)


def test_points_reach_the_sides_of_a_box_and_cells_do_not() -> None:
    ramp = np.broadcast_to(np.arange(5.0), (2, 2, 5)).copy()
    x = np.column_stack([np.linspace(0, SIZE[0], 9), np.ones((9, 2))])
    points = numbers(vti({"a": ramp}, "PointData"), volume="a.vti", placed="box")
    np.testing.assert_allclose(at(points, x), np.linspace(0, 4, 9), atol=1e-12)
    cells = numbers(vti({"a": ramp}), volume="a.vti", placed="box")
    np.testing.assert_allclose(at(cells, x), np.clip(np.linspace(0, 4, 9) * 1.25 - 0.5, 0, 4), atol=1e-12)


def test_spacing_alone_is_placed_at_the_parts_corner() -> None:
    x = (np.arange(12) + 0.5) * 0.25
    a = np.broadcast_to(x, (4, 6, 12)).astype("f4").copy()
    content = tiff(a, imagej=True, resolution=(4, 4), metadata={"axes": "ZYX", "spacing": 0.5, "unit": "mm"})
    field = numbers(content, volume="a.tif", placed="file")
    inside = POINTS[(POINTS[:, 0] > 0.125) & (POINTS[:, 0] < 2.875)]
    np.testing.assert_allclose(at(field, inside), inside[:, 0], atol=1e-6)
    stretched = numbers(content, volume="a.tif")
    assert at(stretched, np.array([[SIZE[0] / 2, 1, 1]])) == pytest.approx(1.5)
    with pytest.raises(JobError, match="has placed: file, and the file does not say"):
        numbers(a, placed="file")


# Values


def test_range_maps_full_scale_exactly() -> None:
    for kind, full in (("u1", 255), ("u2", 65535), ("u4", 2**32 - 1), ("u8", 2**64 - 1), ("?", 1)):
        a = np.array([0, full], "u8").astype(kind).reshape(1, 1, 2)
        for low, high in ((0.1, 0.7), (-90, 90), (0.3, 0.3)):
            field = numbers(a, range=[low, high])
            assert at(field, np.array([[0.0, 0, 0], [99, 0, 0]])).tolist() == [low, high]
            assert field.bounds == (min(low, high), max(low, high))


def test_floats_are_taken_as_they_are_unless_a_range_is_given() -> None:
    a = np.array([-30.0, 20.0, 70.0], "f4").reshape(1, 1, 3)
    assert numbers(a).bounds == (-30, 70)
    assert numbers(a / 100, range=[1, 3]).bounds == pytest.approx((0.4, 2.4))
    assert numbers(a / 100, range=[3, 1]).bounds == pytest.approx((1.6, 3.6))


@pytest.mark.parametrize("value", [0.2, 0.1, 0.7, 1 / 3])
def test_equal_samples_are_the_constant_to_the_last_bit(value: float) -> None:
    field = numbers(np.full((3, 4, 5), value))
    assert (at(field) == value).all()
    assert field.varies == (False, False, False)
    grey = numbers(np.full((3, 4, 5), 51, "u1"))
    assert (at(grey) == 0.2).all()
    tapped, weights = field.taps(*POINTS.T)
    assert (tapped == value).all()
    np.testing.assert_allclose(weights.sum(axis=0), 1)


def test_the_same_field_as_a_volume_an_expression_and_a_gradient() -> None:
    """Linear along x: between the outermost samples' centres all three are the same."""
    a = np.broadcast_to((np.arange(24) + 0.5) / 24, (2, 3, 24)).copy()
    volume = numbers(a, range=[0.1, 0.9])
    others: Any = [{"expression": "0.1 + 0.8*u"}, {"gradient": {"axis": "x", "from": 0.1, "to": 0.9}}]
    inner = POINTS[within(POINTS, 0.5)]
    assert volume.varies == (True, False, False)
    for other in others:
        source: Any = TypeAdapter(FieldSpec).validate_python(other)
        np.testing.assert_allclose(at(volume, inner), at(open_field(source, FRAME, Inputs(Path())), inner), atol=1e-12)


def test_a_volume_of_one_plane_is_the_picture(tmp_path: Path) -> None:
    """Pictures have their top row at the largest y: turned over, the same texels give the same bits."""
    grey = np.random.default_rng(4).integers(0, 256, (7, 9), dtype=np.uint8)
    parts.paint(tmp_path, grey[::-1])
    picture: Any = TypeAdapter(FieldSpec).validate_python({"image": "painted.png", "range": [0.1, 0.8]})
    expected = at(open_field(picture, FRAME, Inputs(tmp_path)))
    np.testing.assert_allclose(at(numbers(grey[None], range=[0.1, 0.8])), expected, atol=1e-12)


def test_bounds_hold_everywhere() -> None:
    a = np.random.default_rng(5).random((5, 6, 7))
    for settings in ({}, {"range": [0.7, 0.1]}):
        field = numbers(a, **settings)
        values = at(field, np.random.default_rng(6).uniform(-0.2, 1.2, (20_000, 3)) * SIZE)
        assert field.bounds[0] <= values.min()
        assert values.max() <= field.bounds[1]
        grid = [np.concatenate([[0], (np.arange(n) + 0.5) / n, [1]]) * s for n, s in zip((7, 6, 5), SIZE, strict=True)]
        corners = np.stack([g.ravel() for g in np.meshgrid(*grid)], axis=-1)
        assert at(field, corners).min() == pytest.approx(field.bounds[0], abs=1e-12)
        assert at(field, corners).max() == pytest.approx(field.bounds[1], abs=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", ["f2", "f4", "f8"])
def test_what_is_not_finite_is_refused_with_the_first_place(bad: float, kind: str) -> None:
    a = np.zeros((60, 70, 80), kind)
    a[41, 3, 5] = a[50, 0, 0] = bad
    with pytest.raises(JobError, match=r"a\.npy' has -?(nan|inf) at sample z = 41, y = 3, x = 5 \(counted from 0\)"):
        numbers(a)
    v = np.zeros((4, 5, 6, 3), kind)
    v[3, 2, 1, 2] = bad
    for open_ in (directions, numbers):
        with pytest.raises(JobError, match=r"z = 3, y = 2, x = 1, component = 2"):
            open_(v, **({"component": 0} if open_ is numbers else {}))
    for name, content in (("a.tif", tiff(a[:, :9, :9].astype("f4"))), ("a.vti", vti({"a": v.astype("f4")}))):
        with pytest.raises(JobError, match=f"{name}' has -?(nan|inf) at sample z = "):
            directions(content, volume=name)


def test_values_beyond_all_numbers_are_refused() -> None:
    with pytest.raises(JobError, match=r"has values from .*inf with range"):
        numbers(np.full((1, 1, 2), 1e308), range=[0, 1e10])


# The same for whoever asks


def test_rasters_points_and_threads_get_the_same_bits() -> None:
    a = np.random.default_rng(7).random((9, 8, 7)).astype("f4")
    field = numbers(a)
    x, y = np.arange(0.05, SIZE[0], 0.1)[None, :], np.arange(0.05, SIZE[1], 0.1)[:, None]
    across, up = np.broadcast_arrays(x, y)

    def layer(z: float) -> Floats:
        return np.asarray(field.scalar(x, y, np.asarray(z)))

    heights = np.linspace(-1, 6, 12)
    alone = [layer(z) for z in heights]
    with ThreadPoolExecutor(4) as pool:
        for again, expected in zip(pool.map(layer, np.tile(heights, 4)), alone * 4, strict=True):
            assert np.array_equal(again, expected)
    for z, expected in zip(heights, alone, strict=True):
        flat = np.column_stack([across.ravel(), up.ravel(), np.full(across.size, z)])
        assert np.array_equal(at(field, flat), expected.ravel())
        assert np.array_equal(field.scalar(across, up, np.asarray(z)), expected)
        assert np.array_equal(layer(z)[10:20], field.scalar(x, y[10:20], np.asarray(z)))
        one = flat[137:138]
        assert at(field, one)[0] == expected.ravel()[137]


def test_a_strip_does_not_blend_its_plane_again(monkeypatch: pytest.MonkeyPatch) -> None:
    field = numbers(np.random.default_rng(7).random((9, 8, 7)))
    asked: list[int] = []
    kept = voxels.Reader.__call__
    monkeypatch.setattr(voxels.Reader, "__call__", lambda self, v: asked.append(v.size) or kept(self, v))
    x, y = np.linspace(0, 6, 50)[None, :], np.linspace(0, 4, 40)[:, None]
    for first in range(0, 40, 8):
        field.scalar(x, y[first : first + 8], np.asarray(2.2))
    assert asked == [56, 56]


LARGE = {
    "an offset": (lambda a: a + 1e6, [-1e6, -1e6 + 1]),
    "beyond single precision": (lambda a: a * 1e40, [0, 1e-40]),
    "tiny": (lambda a: a * 1e-40, [0, 1e40]),
    "64 bits": (lambda a: np.rint(a * 2**40).astype("u8"), [0, (2**64 - 1) / 2**40]),
}


@pytest.mark.parametrize("change", LARGE)
def test_large_numbers_that_a_range_takes_away(change: str) -> None:
    """A device's texels are those of the same field written without them, within single precision."""
    a = np.random.default_rng(4).random((4, 5, 6))
    made, ends = LARGE[change]
    x, y = np.linspace(0, 6, 31)[None, :], np.linspace(0, 4, 21)[:, None]
    plain, changed = numbers(a), numbers(made(a), range=ends)
    for z in (0.1, 2.2, 4.9):
        expected, found = (field.raster(x, y, np.asarray(z)) for field in (plain, changed))  # type: ignore[attr-defined]
        assert expected.texels.dtype == found.texels.dtype == np.float32
        np.testing.assert_allclose(found.texels, expected.texels, atol=1e-6)
        low, high = changed.bounds
        assert np.float32(low) <= found.texels.min() <= found.texels.max() <= np.float32(high)
        (c0, c1, fx), (r0, r1, fy) = found.columns, found.rows
        t = found.texels.astype(float)
        across = t[:, c0] + fx * (t[:, c1] - t[:, c0])
        spread = across[r0] + fy[:, None] * (across[r1] - across[r0])
        np.testing.assert_allclose(spread, changed.scalar(x, y, np.asarray(z)), atol=1e-6)


ENDLESS = [-1e308, 1e308]


@pytest.mark.parametrize(
    "field",
    [
        {"volume": "a.npy"},
        {"image": "a.png"},
        {"stack": {"0": "a.png"}},
        {"mesh_data": "a.vtu", "array": "a"},
        {"volume": "a.npy", "component": 0},
    ],
)
def test_ranges_whose_width_overflows(field: dict[str, Any]) -> None:
    adapter: Any = TypeAdapter(FieldSpec)
    with pytest.raises(ValidationError, match="whose difference is one"):
        adapter.validate_python({**field, "range": ENDLESS})
    adapter.validate_python({**field, "range": [-8e307, 8e307]})


def test_samples_whose_difference_overflows() -> None:
    a = np.zeros((2, 2, 2))
    a[0, 0, 0], a[1, 1, 1] = ENDLESS
    with pytest.raises(JobError, match=r"values from -1e\+308 to 1e\+308"):
        numbers(a)


@pytest.mark.parametrize(
    "field",
    [
        {"volume": "a.npy", "box": [-1e308, 0, 0, 1e308, 1, 1]},
        {"image": "a.png", "box": [-1e308, 0, 1e308, 1]},
        {"stack": {"0": "a.png"}, "box": [0, 0, 1, 1e10]},
        {"image": "a.png", "box": [0, 0, 1e-300, 1e-300], "outside": "repeat"},
        {"volume": "a.npy", "box": [0, 0, 0, 1e-310, 1, 1]},
    ],
)
def test_boxes_that_are_nowhere(field: dict[str, Any]) -> None:
    adapter: Any = TypeAdapter(FieldSpec)
    with pytest.raises(ValidationError, match=r"within ±1e\+09 mm|sides of 1e-06 mm"):
        adapter.validate_python(field)


# Directions


def lines_apart(found: Floats, expected: Floats) -> Floats:
    """Degrees between lines."""
    return np.rad2deg(np.arccos(np.clip(np.abs(np.einsum("ni,ni->n", found, expected)), 0, 1)))


def test_lines_apart_can_tell() -> None:
    a = np.array([[1.0, 0, 0]] * 3)
    b = np.array([[0.0, 1, 0], [-1, 0, 0], [np.cos(np.deg2rad(3)), 0, np.sin(np.deg2rad(3))]])
    np.testing.assert_allclose(lines_apart(a, b), [90, 0, 3], atol=1e-6)


TURN_DEG_PER_MM = 55.0  # two and a half turns over the part, through all ends of ±90 degrees


def turning(x: Floats, y: Floats, z: Floats) -> Floats:
    """Unit normals that turn along x + z in a plane that is tilted with y."""
    angle = np.deg2rad(TURN_DEG_PER_MM * (x - 10 + 0.4 * (z - 3)))
    tilt = 0.4 * (y + 5) / SIZE[1]
    return np.stack([np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)], axis=-1)


INNER = POINTS[within(POINTS, 0.5)]


def test_angles_turn_as_lines() -> None:
    x, _, z = centres()
    degrees = TURN_DEG_PER_MM * (x - 10 + 0.4 * (z - 3))
    wrapped = (degrees + 90) % 180 - 90
    x, _, z = (INNER + MINIMUM).T
    expected = np.deg2rad(TURN_DEG_PER_MM * (x - 10 + 0.4 * (z - 3)))
    flat = np.stack([np.cos(expected), np.sin(expected), np.zeros_like(x)], axis=-1)
    for a, settings in ((wrapped, {}), (np.rint((wrapped + 90) / 180 * 65535).astype("u2"), {"range": [-90, 90]})):
        found = directions(a, **settings)
        worst = lines_apart(found.normals(*INNER.T), flat).max()
        print(f"angles as {a.dtype}: {worst:.3f} degrees")
        assert worst < 1
        assert found.varies == (True, False, True)


def test_vectors_turn_as_lines_whatever_their_sign_and_length() -> None:
    n = turning(*centres())
    rng = np.random.default_rng(8)
    v = n * rng.choice([-1, 1], n.shape[:3])[..., None] * rng.uniform(0.01, 50, n.shape[:3])[..., None]
    found = directions(v.astype("f4"))
    worst = lines_apart(found.normals(*INNER.T), turning(*(INNER + MINIMUM).T)).max()
    print(f"vectors: {worst:.3f} degrees")
    assert worst < 1
    np.testing.assert_allclose(np.linalg.norm(found.normals(*POINTS.T), axis=1), 1)


@pytest.mark.parametrize("which", [1, 2, 3])
def test_tensors_turn_with_their_principal_directions(which: int) -> None:
    """diag(3, 2, 0.5) in a frame that turns; its axes are the principal directions, the largest value first."""

    def axes(x: Floats, y: Floats, z: Floats) -> Floats:
        first = turning(x, y, z)
        other = np.cross(first, [0.0, 0, 1.0])
        other /= np.linalg.norm(other, axis=-1, keepdims=True)
        return np.stack([first, other, np.cross(first, other)], axis=-1)

    q = axes(*centres())
    t = np.einsum("...ik,k,...jk->...ij", q, [3.0, 2.0, 0.5], q)
    six = np.stack([t[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], axis=-1)
    settings = {} if which == 1 else {"principal": which}
    some = INNER[np.abs(turning(*(INNER + MINIMUM).T)[:, 2]) < 0.2]
    found = directions(six, **settings).normals(*some.T)
    worst = lines_apart(found, axes(*(some + MINIMUM).T)[..., which - 1]).max()
    print(f"tensors, principal {which}: {worst:.3f} degrees")
    assert worst < 1


@pytest.mark.parametrize("as_vectors", [False, True])
def test_one_degree_and_179_are_never_90(as_vectors: bool) -> None:
    degrees = np.array([1.0, 179.0]).reshape(1, 1, 2)
    a = np.stack([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees)), 0 * degrees], -1) if as_vectors else degrees
    x = np.linspace(0, SIZE[0], 101)
    normals = directions(a).normals(x, np.ones(101), np.ones(101))
    off = lines_apart(normals, np.broadcast_to([1.0, 0, 0], (101, 3)))
    assert off.max() <= 1 + 1e-9
    assert off[50] == pytest.approx(0, abs=1e-6)


def test_vectors_of_length_zero_weigh_nothing() -> None:
    a = np.zeros((1, 1, 3, 3))
    a[0, 0, 0] = 0, 2, 0
    normals = directions(a).normals(np.array([0.0, 2.9, 3.1, 6]), np.ones(4), np.ones(4))
    np.testing.assert_allclose(np.abs(normals), [[0, 1, 0], [0, 1, 0], [1, 0, 0], [1, 0, 0]], atol=1e-12)
    assert not np.isnan(directions(np.zeros((2, 2, 2, 6))).normals(*POINTS.T)).any()
    np.testing.assert_allclose(directions(np.zeros((2, 2, 2, 6))).normals(*POINTS.T), [[1, 0, 0]] * len(POINTS))


def test_one_direction_does_not_turn() -> None:
    found = directions(np.broadcast_to([1.0, 2.0, 2.0], (3, 4, 5, 3)).copy())
    assert not found.turns
    assert found.varies == (False, False, False)
    np.testing.assert_allclose(
        lines_apart(found.normals(*POINTS.T), np.full((len(POINTS), 3), [1, 2, 2]) / 3), 0, atol=1e-5
    )
    constant = directions(np.full((3, 4, 5), 30.0))
    assert not constant.turns
    expected = open_orientation(30.0, FRAME, Inputs(Path())).normals(*POINTS.T)
    np.testing.assert_array_equal(constant.normals(*POINTS.T), expected)


def test_components_are_numbers() -> None:
    a = np.random.default_rng(9).normal(size=(3, 4, 5, 3))
    np.testing.assert_array_equal(at(numbers(a[..., :1])), at(numbers(a[..., 0].copy())))
    for i, name in enumerate("xyz"):
        expected = at(numbers(a[..., i].copy()))
        for component in (name, i):
            np.testing.assert_array_equal(at(numbers(a, component=component)), expected)
    length = np.linalg.norm(a, axis=-1)
    np.testing.assert_allclose(at(numbers(a, component="magnitude")), at(numbers(length)), atol=1e-12)
    assert numbers(a, component="magnitude").bounds == pytest.approx((length.min(), length.max()))
    six = np.random.default_rng(9).normal(size=(3, 4, 5, 6))
    np.testing.assert_array_equal(at(numbers(six, component=5)), at(numbers(six[..., 5].copy())))
    angle = directions(a, component="y")
    np.testing.assert_allclose(angle.normals(*POINTS.T), directions(a[..., 1].copy()).normals(*POINTS.T))


@pytest.mark.parametrize(
    ("shape", "settings", "why"),
    [
        ((2, 2, 2, 3), {}, "holds 3 numbers per sample, and one is needed"),
        ((2, 2, 2, 6), {}, "holds 6 numbers per sample, and one is needed"),
        ((2, 2, 2, 6), {"component": "x"}, "component: x, and holds 6"),
        ((2, 2, 2, 6), {"component": "magnitude"}, "component: magnitude, and holds 6"),
        ((2, 2, 2, 3), {"component": 3}, "component: 3, and holds 3"),
        ((2, 2, 2), {"component": 0}, "has component, and holds one number"),
        ((2, 2, 2), {"principal": 1}, "has principal, and holds one number"),
    ],
)  # fmt: skip
def test_components_that_are_not_there(shape: tuple[int, ...], settings: dict[str, Any], why: str) -> None:
    with pytest.raises(JobError, match=why) as caught:
        numbers(np.zeros(shape), **settings)
    assert "a.npy" in caught.value.message
    assert caught.value.hint


def test_directions_that_are_none() -> None:
    for shape, settings in (((2, 2, 2, 4), {}), ((2, 2, 2, 3), {"principal": 1}), ((2, 2, 2, 9), {})):
        with pytest.raises(JobError, match=f"holds {shape[-1]} numbers per sample; directions are made of 3"):
            directions(np.zeros(shape), **settings)
    with pytest.raises(JobError, match="has principal, and holds one number"):
        directions(np.zeros((2, 2, 2)), principal=2)


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"box": [0, 0, 0, 1, 1, 0]}, "z0 < z1"),
        ({"box": [0, 0, 1, 1]}, "box"),
        ({"box": [0, 0, 0, 1, 1, 1], "placed": "file"}, "a box and placed: file"),
        ({"component": 0, "principal": 1}, "component .* and principal"),
        ({"component": 6}, "component"),
        ({"component": True}, "component"),
        ({"principal": 4}, "principal"),
        ({"placed": "origin"}, "placed"),
        ({"range": [0, float("nan")]}, "range"),
        ({"volume": ""}, "volume"),
        ({"plane": "xy"}, "plane"),
    ],
)  # fmt: skip
def test_keys_that_cannot_be(settings: dict[str, Any], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        spec(**settings)


def test_it_is_on_the_list_and_its_file_is_known() -> None:
    source: Source = spec(volume="in/a.npy")
    assert source.paths() == ("in/a.npy",)
    assert source.with_paths({"in/a.npy": "b.npy"}).paths() == ("b.npy",)


# With the part


def test_a_moved_part_has_the_same_values() -> None:
    """Stretched over the part's box it moves with it; a box in file coordinates stays."""
    rng = np.random.default_rng(10)
    a, v, shift = rng.random((4, 5, 6)), rng.normal(size=(4, 5, 6, 3)), np.array([3.0, -2.0, 7.0])
    moved = Frame(MINIMUM + shift, SIZE)
    np.testing.assert_array_equal(at(numbers(a, moved)), at(numbers(a)))
    np.testing.assert_array_equal(directions(v, moved).normals(*POINTS.T), directions(v).normals(*POINTS.T))
    box = [11, -4, 4, 14, -2, 7]
    np.testing.assert_allclose(at(numbers(a, moved, box=box), POINTS - shift), at(numbers(a, box=box)), atol=1e-12)
    own = vti({"a": a}, geometry='Origin="9 -6 2" Spacing="1 1 2"')
    kept = at(numbers(own, moved, volume="a.vti"), POINTS - shift)
    np.testing.assert_allclose(kept, at(numbers(own, volume="a.vti")), atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_file_that_lies_beside_the_part_is_refused(axis: int) -> None:
    """Clamped, it would be one value all over: units or origins that do not fit are noticed."""
    for beyond in (-2.5, SIZE[axis] + 0.5):
        origin = MINIMUM.copy()
        origin[axis] += beyond
        a = vti({"a": np.zeros((2, 2, 2))}, geometry=f'Origin="{origin[0]} {origin[1]} {origin[2]}" Spacing="1 1 1"')
        with pytest.raises(JobError, match=rf"a\.vti' lies at {'xyz'[axis]} = .* the part at .*; they do not meet"):
            numbers(a, volume="a.vti")
        numbers(a, volume="a.vti", placed="box")


F = ("XXXX",
     "X...",
     "XXX.",
     "X...",
     "X...")  # fmt: skip
PITCH = {"pitch_um": 250, "layer_um": 250}


def letter(turn: int, folder: Path, **part: Any) -> NDArray[np.uint8]:
    """Labels of a box of 4 x 5 x 2 cells of 0.5 mm with an F in its lower half, turned about z."""
    lower = np.array([[letter == "X" for letter in row] for row in F[::-1]])
    a = np.stack([lower, np.zeros_like(lower)])
    a = np.kron(a, np.ones((8, 8, 8), bool))  # pixels' centres then lie between equal samples
    np.save(folder / "f.npy", a)
    stl = parts.stl(folder, meshes.box((2.0, 2.5, 1.0), at=(16.0, -8.0, 4.0)))
    return parts.labels(
        parts.job(stl, ratio={"volume": "f.npy"}, printer=PITCH, settings={"rotate": [0, 0, turn], **part})
    )


def test_a_turned_part_takes_its_volume_with_it(tmp_path: Path) -> None:
    """Cells of 2 x 2 pixels and two layers; row 0 of a bitmap is the largest y."""
    typed = np.array([[1 if letter == "X" else 2 for letter in row] for row in F], np.uint8)
    for turns in range(4):
        found = letter(90 * turns, tmp_path)
        plane = np.kron(np.rot90(typed, turns), np.ones((2, 2), np.uint8))
        np.testing.assert_array_equal(found, np.stack([plane, plane, np.full_like(plane, 2), np.full_like(plane, 2)]))


def test_a_scaled_part_takes_its_volume_with_it(tmp_path: Path) -> None:
    typed = np.array([[1 if letter == "X" else 2 for letter in row] for row in F], np.uint8)
    found = letter(0, tmp_path, scale=2)
    plane = np.kron(typed, np.ones((4, 4), np.uint8))
    assert found.shape == (8, 20, 16)
    np.testing.assert_array_equal(found[0], plane)
    np.testing.assert_array_equal(found[3], plane)
    assert (found[4:] == 2).all()


def test_a_job_with_a_mapped_volume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its digest is the file's content's, and the stack's copy is the file."""
    a = np.random.default_rng(11).random((6, 6, 6)).astype("f4")
    np.save(tmp_path / "a.npy", a)
    part = parts.box(tmp_path, (2.0, 2.0, 1.0))

    def job() -> Any:
        return parts.job(part, ratio={"volume": "a.npy"}, printer=PITCH)

    read = job()
    plain = parts.labels(read)
    monkeypatch.setattr(source_module, "SMALLEST_MAPPED", 16)
    mapped = job()
    np.testing.assert_array_equal(parts.labels(mapped), plain)
    assert list(mapped.inputs.maps) == ["a.npy"]
    assert not mapped.inputs.files
    assert mapped.digest("p", "d", "v") == read.digest("p", "d", "v")
    out = tmp_path / "out"
    slice_job(job(), out)
    assert (out / "inputs" / "a.npy").read_bytes() == (tmp_path / "a.npy").read_bytes()
    np.save(tmp_path / "a.npy", a[::-1])
    with pytest.raises(JobError, match="changed while it was in use"):
        mapped.digest("p", "d", "v")
    assert job().digest("p", "d", "v") != read.digest("p", "d", "v")


def test_painted_directions_of_vectors_in_a_bed_frame(tmp_path: Path) -> None:
    """frame: bed: x of the vectors is the printer's, so a turned part keeps its sheets."""
    np.save(tmp_path / "v.npy", np.broadcast_to([1.0, 0, 0], (2, 2, 2, 3)))
    part = parts.box(tmp_path, (6.0, 4.0, 0.5))
    found = {}
    for frame in ("part", "bed"):
        job = parts.job(part, orientation={"volume": "v.npy", "frame": frame}, settings={"rotate": [0, 0, 30]})
        prepared = prepare(job)
        found[frame] = prepared.painted.normals(np.array([[1.0, 1.0, 0.2]]))[0]
    turned = [np.cos(np.pi / 6), np.sin(np.pi / 6), 0]
    np.testing.assert_allclose(np.abs(found["part"] @ turned), 1)
    np.testing.assert_allclose(np.abs(found["bed"] @ [1, 0, 0]), 1)


def test_a_volume_in_another_unit_is_refused(tmp_path: Path) -> None:
    """A part of 6 mm, and a file of 6 µm around its corner: its numbers are metres."""
    header = {"space dimension": 3, "space directions": np.eye(3) * 1e-3, "space origin": list(MINIMUM)}
    content = nrrd_file(np.random.default_rng(2).random((5, 4, 6)), tmp_path, **header)
    with pytest.raises(JobError, match=r"tiny beside the part: its longest side is 0\.006 mm") as refused:
        numbers(content, volume="a.nrrd")
    assert "unit" in str(refused.value.hint)
    assert numbers(content, volume="a.nrrd", placed="box").bounds[1] <= 1
    metres = nrrd_file(np.random.default_rng(2).random((5, 4, 6)), tmp_path, spacings=[1e-3] * 3, units=["m"] * 3)
    assert at(numbers(metres, volume="a.nrrd", placed="file")).max() <= 1


@pytest.mark.parametrize("which", [1, 2, 3])
def test_tensors_that_are_the_same_all_around_are_x(which: int) -> None:
    """As those of mesh_data; a thousandth of a difference is a direction again."""
    a = np.zeros((3, 4, 5, 6))
    a[..., :3] = -3.0
    x_axis = np.tile([1.0, 0, 0], (len(POINTS), 1))
    assert lines_apart(directions(a, principal=which).normals(*POINTS.T), x_axis).max() == 0
    a[..., :3] *= 1 + 1e-3 * np.array([-1, 0, 1])  # the largest is then xx
    expected = np.tile(np.eye(3)[which - 1], (len(POINTS), 1))
    assert lines_apart(directions(a, principal=which).normals(*POINTS.T), expected).max() < 1e-3
