"""A picture's micro-texture as a field: its mean, spread and physical size, in the part's own frame."""

from __future__ import annotations

import io
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from pydantic import TypeAdapter, ValidationError
from scipy import stats
from scipy.ndimage import gaussian_filter

from amslicer import JobError, randomphase
from amslicer.fields import FieldSpec, Frame, Inputs, Sampler, open_field
from amslicer.fields import texture as module
from amslicer.fields.orientation import Angles
from amslicer.placement import Placement, place

Floats = NDArray[np.float64]

MINIMUM, SIZE = np.array([10.0, -5.0, 3.0]), np.array([20.0, 14.0, 9.0])
FRAME = Frame(MINIMUM, SIZE)
PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}  # along its rows, up its columns, and its normal
SIDE_PX, SIZE_MM = 60, 6.0  # pixels of 0.1 mm
KINDS = ("random-phase", "asymptotic-spot")
RNG = np.random.default_rng(12)


def png(pixels: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels)).save(stream, "PNG")
    return stream.getvalue()


def grain(shape: tuple[int, int] = (SIDE_PX, SIDE_PX), width: float = 1.5) -> bytes:
    """16-bit grains of about 4 × width pixels that do not close at the borders."""
    noise = gaussian_filter(RNG.standard_normal((shape[0] + 40, shape[1] + 40)), width)[20:-20, 20:-20]
    return png(np.clip(32768 + 8000 * noise / noise.std(), 0, 65535).astype(np.uint16))


GRAIN = grain()


def sampler(frame: Frame = FRAME, content: bytes = GRAIN, **settings: Any) -> Any:
    """A texture as the job file writes it, opened over a part."""
    spec = {"texture": "grain.png", "mean": 0.4, "spread": 0.1, "size_mm": SIZE_MM, **settings}
    source: Any = TypeAdapter(FieldSpec).validate_python(spec)
    return open_field(source, frame, Inputs(Path("nowhere"), {"grain.png": content}))


def at(field: Sampler, points: Floats) -> Floats:
    return np.broadcast_to(field.scalar(*points.T), len(points))


def layer(field: Sampler, z: float = 0.0, pitch: float = 0.05) -> Floats:
    """Values over the part at a height, on a raster of points."""
    x, y = np.arange(pitch / 2, SIZE[0], pitch), np.arange(pitch / 2, SIZE[1], pitch)
    return np.broadcast_to(field.scalar(x[None, :], y[:, None], np.asarray(z)), (len(y), len(x)))


def texels(field: Any, z: float = 0.0) -> Floats:
    """A whole period of the texture at its pixels' centres."""
    y, x = (pixel_centres(count, field.pixel_mm) for count in field.sides)
    return np.asarray(field.scalar(x[None, :], y[:, None], np.asarray(z)))


def pixel_centres(count: int, pixel_mm: float) -> Floats:
    return (np.arange(count) + 0.5) * pixel_mm


POINTS = np.random.default_rng(1).uniform(0, 1, (400, 3)) * SIZE


# Mean, spread, bounds


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("mean", "spread"), [(0.4, 0.1), (30.0, 8.0), (-1.0, 0.02)])
def test_mean_and_spread_are_those_asked_for(kind: str, mean: float, spread: float) -> None:
    """Values are about Gaussian. Of those, clipping at 3σ takes E[min(|X|, 3)²]: 0.25 % of the spread."""
    found = texels(sampler(kind=kind, mean=mean, spread=spread))
    x = np.linspace(-8, 8, 200_001)
    clipped = np.sqrt(np.sum(np.minimum(np.abs(x), 3) ** 2 * stats.norm.pdf(x)) * (x[1] - x[0]))
    print(
        f"{kind}: mean {found.mean():.6g} of {mean}, spread × {found.std() / spread:.4f}; clipped it is × {clipped:.4f}"
    )
    assert found.mean() == pytest.approx(mean, abs=0.002 * spread)
    assert found.std() == pytest.approx(clipped * spread, rel=0.003)


def test_over_the_part_mean_and_spread_are_so_within_statistics() -> None:
    """20 × 14 mm hold some 7000 independent places of 0.2 mm; the bilinear mean of pixels is a little smoother."""
    found = layer(sampler())
    print(f"over the part: mean {found.mean():.4f} of 0.4, spread {found.std():.4f} of 0.1")
    assert found.mean() == pytest.approx(0.4, abs=4 * 0.1 / np.sqrt(2000))
    assert 0.09 < found.std() < 0.102


@pytest.mark.parametrize("settings", [{}, {"renew_mm": 2.0}, {"kind": "asymptotic-spot"}])
def test_bounds_hold_and_are_reached(settings: dict[str, Any]) -> None:
    field = sampler(**settings)
    assert field.bounds == pytest.approx((0.1, 0.7))
    found = texels(field)
    assert found.min() == field.bounds[0]
    assert found.max() == field.bounds[1]
    for z in np.linspace(0, 4, 7):
        some = layer(field, z, pitch=0.1)
        assert field.bounds[0] <= some.min()
        assert some.max() <= field.bounds[1]


def test_rounding_does_not_leave_the_bounds() -> None:
    """The whole way from one bound to the other: high + (low - high) may be less than low."""
    pairs = product(np.linspace(0.1, 0.9, 41), np.linspace(0.01, 0.2, 20))
    bounds = ((m, s, m - 3 * s, m + 3 * s) for m, s in pairs)
    mean, spread = next((float(m), float(s)) for m, s, low, high in bounds if high + (low - high) < low)
    field = sampler(mean=mean, spread=spread, size_mm=float(SIDE_PX))  # pixels of 1 mm
    low, high = field.bounds
    field._made[0] = np.full(field.sides, low)
    field._made[0][:, -1] = high
    # Just below the first pixel's centre the last one is the pixel below, and the share of the first rounds to 1.
    values = field.scalar(np.nextafter(np.full((1, 1), 0.5), 0), np.full((1, 1), 0.5), np.zeros(()))
    assert low <= values <= high


def test_without_spread_it_is_the_mean_to_the_last_bit() -> None:
    assert (at(sampler(mean=0.2, spread=0, renew_mm=1.7), POINTS) == 0.2).all()


# Size


def half_width(picture: Floats, axis: int = 1) -> float:
    """Where the autocorrelation along an axis falls to a half, in samples."""
    d = picture - picture.mean()
    alike = [1.0]
    while alike[-1] > 0.5:
        alike.append(float(np.mean(d * np.roll(d, len(alike), axis)) / d.var()))
    return len(alike) - 2 + (alike[-2] - 0.5) / (alike[-2] - alike[-1])


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("size_mm", [3.0, 6.0, 12.0])
def test_the_grain_is_as_large_as_size_mm_says(size_mm: float, axis: int) -> None:
    """White noise smoothed by a Gaussian of σ pixels has the autocorrelation exp(-d²/4σ²): ½ at 2σ √ln 2."""
    expected = 2 * 1.5 * np.sqrt(np.log(2)) * size_mm / SIDE_PX
    found = half_width(layer(sampler(size_mm=size_mm), pitch=0.04), axis) * 0.04
    print(f"size_mm {size_mm}, axis {axis}: half width {found:.3f} mm of {expected:.3f}")
    assert found == pytest.approx(expected, rel=0.12)


def test_the_width_counts_and_pixels_are_square() -> None:
    content = grain((40, 120))
    field = sampler(content=content, size_mm=12.0)
    assert field.pixel_mm == pytest.approx(0.1)
    found = layer(field, pitch=0.04)
    ratio = half_width(found, 0) / half_width(found, 1)
    assert ratio == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("plane", PLANES)
def test_the_texture_covers_the_part_without_a_seam_and_repeats_beyond(plane: str) -> None:
    across, up, _ = PLANES[plane]
    field = sampler(plane=plane)
    rows, columns = field.sides
    assert columns * 0.1 >= SIZE[across]
    assert rows * 0.1 >= SIZE[up]
    assert rows % 2 == columns % 2 == 1
    period = np.zeros(3)
    period[across], period[up] = columns * 0.1, -2 * rows * 0.1
    np.testing.assert_allclose(at(field, POINTS + period), at(field, POINTS), rtol=0, atol=1e-9)
    line = np.zeros((2 * columns, 3))
    line[:, across] = pixel_centres(2 * columns, 0.1)
    step = np.abs(np.diff(at(field, line)))
    assert step[columns - 1] <= step[: columns - 1].max()


def test_a_texture_of_a_large_part_is_bounded_and_one_of_a_small_part_is_not_cropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert sampler(Frame(MINIMUM, np.array([0.3, 0.0, 1.0]))).sides == (63, 63)  # the next product of 3, 5, 7 and 11
    assert module.MOST_PX < 4096
    assert randomphase.good_side(module.MOST_PX) == module.MOST_PX
    monkeypatch.setattr(module, "MOST_PX", 165)
    field = sampler(Frame(MINIMUM, np.array([1e6, 11.0, 1.0])))
    assert field.sides == (121, 165)
    assert np.isfinite(at(field, POINTS * 1e4)).all()


def test_sides_are_the_next_odd_products_of_small_primes() -> None:
    expected = sorted(3**a * 5**b * 7**c * 11**d for a, b, c, d in product(range(9), range(6), range(5), range(4)))
    for least in (1, 2, 10, 60, 61, 64, 100, 1000, 2500, 3993):
        assert randomphase.good_side(least) == next(n for n in expected if n >= least)


# Where it lies


@pytest.mark.parametrize("plane", PLANES)
def test_it_lies_in_its_plane_and_is_the_same_along_the_normal(plane: str) -> None:
    across, up, normal = PLANES[plane]
    field = sampler(plane=plane)
    assert field.varies == tuple(axis != normal for axis in range(3))
    moved = POINTS.copy()
    moved[:, normal] += RNG.uniform(-50, 50, len(POINTS))
    assert np.array_equal(at(field, moved), at(field, POINTS))
    for axis in (across, up):
        moved = POINTS.copy()
        moved[:, axis] += 0.3
        assert np.abs(at(field, moved) - at(field, POINTS)).mean() > 0.03
    assert sampler(plane=plane, renew_mm=2.0).varies == (True, True, True)


def test_planes_show_the_same_texture_along_other_axes() -> None:
    cube = Frame(MINIMUM, np.full(3, 14.0))
    xy, xz, yz = (sampler(cube, plane=plane) for plane in PLANES)
    a, b, c = POINTS.T
    assert np.array_equal(at(xy, np.stack([a, b, c], axis=1)), at(xz, np.stack([a, c, b], axis=1)))
    assert np.array_equal(at(xy, np.stack([a, b, c], axis=1)), at(yz, np.stack([c, a, b], axis=1)))


def placed(minimum: Floats = MINIMUM, **settings: Any) -> Placement:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * SIZE
    mesh: Any = SimpleNamespace(vertices=corners, minimum_mm=minimum)
    return place(mesh, **settings)[0]


@pytest.mark.parametrize(
    ("settings", "to_pattern"),
    [
        ({}, lambda p: p),
        ({"scale": 2.0}, lambda p: 2 * p),
        ({"rotate_deg": (0, 0, 90)}, lambda p: np.stack([SIZE[1] - p[:, 1], p[:, 0], p[:, 2]], axis=1)),
        ({"rotate_deg": (180, 0, 0)}, lambda p: np.stack([p[:, 0], SIZE[1] - p[:, 1], SIZE[2] - p[:, 2]], axis=1)),
        ({"rotate_deg": (0, 90, 0)}, lambda p: np.stack([p[:, 2], p[:, 1], SIZE[0] - p[:, 0]], axis=1)),
    ],
)
@pytest.mark.parametrize("renew_mm", [None, 8.0])
def test_it_follows_the_part(settings: dict[str, Any], to_pattern: Any, renew_mm: float | None) -> None:
    """However the part is placed, or where it lies in its file, the same point of it has the same value."""
    plain = at(sampler(renew_mm=renew_mm), POINTS)
    for shift in (np.zeros(3), np.array([100.0, -250.5, 37.25])):
        field = sampler(Frame(MINIMUM + shift, SIZE), renew_mm=renew_mm)
        coordinates = placed(MINIMUM + shift, **settings).to_field(*to_pattern(POINTS).T)
        found = np.broadcast_to(field.scalar(*coordinates), len(POINTS))
        np.testing.assert_allclose(found, plain, rtol=0, atol=1e-9)


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("turned", [0, 30])
@pytest.mark.parametrize("renew_mm", [None, 1.0])
def test_a_raster_of_pixels_is_its_points(plane: str, turned: int, renew_mm: float | None) -> None:
    field = sampler(plane=plane, renew_mm=renew_mm)
    x, y, z = np.linspace(-0.5, 12.5, 64)[None, :], np.linspace(-0.5, 4.5, 40)[:, None], np.asarray(0.73)
    placement = placed(rotate_deg=(turned, 0, turned))
    raster = np.broadcast_to(field.scalar(*placement.to_field(x, y, z)), (40, 64))
    points = placement.to_field(*(np.ravel(c) for c in np.broadcast_arrays(x, y, z)))
    np.testing.assert_allclose(raster.ravel(), np.broadcast_to(field.scalar(*points), 2560), rtol=0, atol=1e-12)


# Renewed along the normal


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_renewed_texture_is_another_one_and_changes_steadily(plane: str, kind: str) -> None:
    normal = PLANES[plane][2]
    field = sampler(plane=plane, kind=kind, renew_mm=2.0)
    points = np.random.default_rng(4).uniform(0, 1, (5000, 3)) * SIZE

    def heights(*along: float) -> list[Floats]:
        return [at(field, np.where(np.arange(3) == normal, height, points)) for height in along]

    alike = np.corrcoef(heights(0.0, 2.0, 4.0, -2.0))
    print(f"{kind}: correlation of renewed textures up to {np.abs(alike - np.eye(4)).max():.3f}")
    # The plane holds some 900 grains of 0.4 mm or more: ± 0.04.
    assert np.abs(alike - np.eye(4)).max() < 0.16
    near = np.corrcoef(heights(3.0, 3.02, 3.1))
    assert near[0, 1] > 0.99
    assert near[0, 2] > 0.95
    for height in (0.0, 0.125, 1.0, 2.0, 3.3):  # 0.125: where one of the textures in between begins
        below, above = heights(height - 1e-6, height + 1e-6)
        assert np.abs(above - below).max() < 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_the_spread_holds_in_between(kind: str) -> None:
    """Straight between sixteen textures per renewal: least half way, 0.2 % below."""
    field = sampler(kind=kind, renew_mm=1.6)
    spread = [texels(field, z).std() for z in np.linspace(0.6, 1.0, 17)]
    print(f"{kind}: spread {min(spread):.5f} … {max(spread):.5f}")
    assert 0.0990 < min(spread) < max(spread) < 0.1002


def test_many_heights_in_one_call_are_each_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.random.default_rng(3).uniform(-3, 12, (300, 3))
    field = sampler(renew_mm=4.0)
    together = at(field, points)
    single = np.array([at(field, point[None])[0] for point in points])
    np.testing.assert_allclose(together, single, rtol=0, atol=1e-12)
    monkeypatch.setattr(module, "KEPT_BYTES", 1)  # two textures: nearly all are made again
    np.testing.assert_array_equal(at(sampler(renew_mm=4.0), points[:40]), together[:40])
    assert len(field._made) > 2
    assert field.scalar(np.zeros(0), np.zeros(0), np.zeros(0)).shape == (0,)


def test_threads_see_the_same_texture_and_make_it_one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    heights = np.linspace(0, 9, 24)
    alone = [layer(sampler(renew_mm=6.0), z, pitch=0.5).tobytes() for z in heights]
    monkeypatch.setattr(module, "KEPT_BYTES", 1)
    plain, inside, most = module.Frames.at, [], []

    def slow(frames: Any, position: float) -> Floats:
        inside.append(position)
        most.append(len(inside))
        time.sleep(1e-3)
        made = plain(frames, position)
        inside.pop()
        return made

    monkeypatch.setattr(module.Frames, "at", slow)
    field = sampler(renew_mm=6.0)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda z: layer(field, z, pitch=0.5).tobytes(), heights))
    assert found == alone
    assert max(most) == 1


@pytest.mark.parametrize("renew_mm", [None, 1.3])
@pytest.mark.parametrize("plane", PLANES)
def test_taps_make_up_the_values(plane: str, renew_mm: float | None) -> None:
    field = sampler(plane=plane, renew_mm=renew_mm)
    samples, weights = field.taps(*POINTS.T)
    assert samples.shape == weights.shape == (8 if renew_mm else 4, len(POINTS))
    np.testing.assert_allclose(weights.sum(axis=0), 1, rtol=0, atol=1e-12)
    assert weights.min() >= 0
    np.testing.assert_allclose((samples * weights).sum(axis=0), at(field, POINTS), rtol=0, atol=1e-12)


def test_angles_are_averaged_as_lines() -> None:
    """Around 90°, where a texture that is painted on a line's angle crosses over to -90°."""
    plain = Angles(sampler(mean=90.0, spread=5.0))
    normals = plain.normals(*POINTS.T)
    angle = np.rad2deg(np.arctan2(normals[:, 1], normals[:, 0])) % 180
    np.testing.assert_allclose(angle, at(sampler(mean=90.0, spread=5.0), POINTS), rtol=0, atol=0.3)


def test_fields_of_the_same_grid_share_their_texels() -> None:
    plain = sampler()
    assert plain.texels == sampler(seed=2, mean=3.0).texels
    others = [sampler(renew_mm=1.0), sampler(size_mm=5.0), sampler(plane="xz"), sampler(renew_mm=2.0)]
    others.append(sampler(content=grain((60, 240)), size_mm=24.0))  # pixels of the same size, another period
    assert len({plain.texels, *(other.texels for other in others)}) == 6


# What tells textures apart


def test_the_same_settings_give_the_same_bytes_and_others_another_texture() -> None:
    plain = layer(sampler())
    assert layer(sampler()).tobytes() == plain.tobytes()
    assert layer(sampler(seed=1, kind="random-phase", plane="xy", renew_mm=None)).tobytes() == plain.tobytes()
    for settings in ({"seed": 2}, {"seed": 2**64 - 1}, {"kind": "asymptotic-spot"}, {"size_mm": 6.5}):
        assert abs(np.corrcoef(plain.ravel(), layer(sampler(**settings)).ravel())[0, 1]) < 0.2, settings
    stretched = layer(sampler(mean=1.0, spread=0.2))
    np.testing.assert_allclose(stretched, 1.0 + 2 * (plain - 0.4), rtol=0, atol=1e-9)


def test_it_is_not_the_picture() -> None:
    """Else the whole of it would be a picture's job."""
    rows = np.asarray(Image.open(io.BytesIO(GRAIN)), np.float64)[::-1]
    found = texels(sampler())[:SIDE_PX, :SIDE_PX]
    assert abs(np.corrcoef(rows.ravel(), found.ravel())[0, 1]) < 0.2


# The job file's words


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("texture", ""), ("texture", 3), ("mean", "0.4"), ("mean", float("nan")), ("mean", None), ("spread", -0.1),
        ("spread", float("inf")), ("size_mm", 0), ("size_mm", -1), ("size_mm", 1e-4), ("size_mm", None),
        ("kind", "perlin"), ("seed", -1), ("seed", 2**64), ("seed", 1.5), ("plane", "zx"), ("renew_mm", 0),
        ("renew_mm", -2), ("renew_mm", "none"), ("colour", 1),
    ],
)  # fmt: skip
def test_settings_that_are_refused(key: str, value: Any) -> None:
    with pytest.raises(ValidationError, match=key):
        sampler(**{key: value})


@pytest.mark.parametrize("missing", ["mean", "spread", "size_mm"])
def test_what_has_no_default(missing: str) -> None:
    spec = {"texture": "a", "mean": 0.4, "spread": 0.1, "size_mm": 3}
    del spec[missing]
    with pytest.raises(ValidationError, match=missing):
        TypeAdapter(FieldSpec).validate_python(spec)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (png(RNG.integers(0, 256, (9, 9, 3), np.uint8)), "has 3 channels; a field takes grey ones"),
        (png(np.full((9, 9), 7, np.uint8)), "shows nothing"),
        (grain()[:-200], "cut short"),
    ],
)
def test_pictures_that_are_refused(content: bytes, said: str) -> None:
    with pytest.raises(JobError, match=said) as caught:
        sampler(content=content)
    assert "'grain.png'" in caught.value.message
    assert caught.value.hint


def test_its_file_is_named_and_can_be_renamed() -> None:
    spec = {"texture": "paint/grain.png", "mean": 0.4, "spread": 0.1, "size_mm": 3}
    source: Any = TypeAdapter(FieldSpec).validate_python(spec)
    assert source.paths() == ("paint/grain.png",)
    assert source.with_paths({"paint/grain.png": "inputs/1.png"}).texture == "inputs/1.png"
    assert source.with_paths({}).texture == "paint/grain.png"
    assert source.with_paths({"paint/grain.png": "b"}).mean == 0.4
