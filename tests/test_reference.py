"""G and the labels of whole jobs: rank-1 OpenCL = OpenCL kernel by kernel = the float64 twin."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.integrate import quad

import amslicer
from amslicer.device import Device
from amslicer.noise.phasor import truncation_radius
from amslicer.pipeline import Prepared, Run, prepare
from amslicer.reference import cells_of, cut_radius, cyclic_labels, impulses_of, jittered, phasor, symmetric_labels

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]
Normals = Callable[[Floats], Floats]

# float32 knows a place 5 mm away to 2.4e-7 mm, and a phase at a period of 0.5 mm (12.6 rad/mm) to 3e-6 rad; a sum
# over places, wave numbers, tables and some hundred kernels keeps well below this.
ERROR = 2e-5
RATIO_ENDS = (0.05, 0.95)


@dataclass(frozen=True)
class Case:
    """A small part and its pattern.

    Attributes:
        orientation: "constant", "graded" along x (and up y or z), or "painted" with a defect in the middle.
        corner_mm: where the part stands in its file.
        isotropy: at the lowest and the highest y.
        period_end: at the highest x; None keeps it constant.
    """

    dimensions: int
    orientation: str
    period: float
    bandwidth: float
    dpi: tuple[int, int]
    size_mm: tuple[float, float, float]
    corner_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    margin_px: int = 0
    layer: int = 0
    layer_mm: float = 0.0625
    seed: int = 1
    impulses: float | None = None
    isotropy: tuple[float, float] = (0.0, 0.0)
    period_end: float | None = None
    materials: int = 2
    profile: str = "pwm"
    edges: str = "sharp"

    def __str__(self) -> str:
        dpi = "x".join(map(str, self.dpi))
        name = f"{self.dimensions}D-{self.orientation}-p{self.period:g}-B{self.bandwidth:g}-{dpi}"
        extras = [f"s{self.isotropy[0]:g}..{self.isotropy[1]:g}"] if any(self.isotropy) else []
        extras += [f"to-p{self.period_end:g}"] if self.period_end else []
        extras += [f"{self.materials}-{self.profile}"] if self.materials > 2 else []
        return "-".join([name, *extras, *([self.edges] if self.edges != "sharp" else [])])

    @property
    def periods(self) -> tuple[float, float]:
        ends = self.period, self.period_end or self.period
        return min(ends), max(ends)


SMALL, WIDE, AWAY = (4.25, 3.0, 1.5), (9.0, 6.5, 2.0), (-17.5, -3.25, -40.0)
CASES = [
    Case(2, "constant", 1, 0.5, (600, 600), SMALL),
    Case(2, "constant", 0.5, 0.25, (600, 600), SMALL, AWAY, seed=2**64 - 1),
    Case(2, "graded", 0.5, 1, (600, 300), SMALL, seed=0),
    Case(2, "graded", 3, 1, (600, 300), WIDE, AWAY, margin_px=3),
    Case(2, "painted", 3, 0.25, (300, 300), WIDE),
    Case(2, "painted", 1, 0.5, (600, 300), SMALL, AWAY, margin_px=5, seed=2**32),
    Case(2, "painted", 1, 1, (300, 300), WIDE, impulses=4.5),
    Case(3, "constant", 1, 0.5, (600, 600), SMALL, layer=17),
    Case(3, "constant", 3, 1, (600, 300), WIDE, AWAY, layer=31),
    Case(3, "graded", 0.5, 1, (600, 300), SMALL, layer=0, seed=0),
    Case(3, "graded", 1, 1, (300, 300), SMALL, AWAY, layer=23, impulses=2.5),
    Case(3, "painted", 3, 0.25, (300, 300), WIDE, layer=16),
    Case(3, "painted", 1, 0.5, (600, 300), SMALL, AWAY, margin_px=5, layer=9, seed=2**32),
    Case(3, "painted", 0.5, 0.25, (600, 600), SMALL, layer=20, seed=2**64 - 1),
    Case(2, "constant", 1, 0.5, (600, 300), SMALL, AWAY, isotropy=(1, 1)),
    Case(2, "painted", 0.5, 1, (300, 300), SMALL, isotropy=(0, 0.7), seed=2**32, materials=5, profile="symmetric"),
    Case(3, "graded", 1, 0.5, (300, 300), SMALL, layer=20, isotropy=(0, 1), materials=3, profile="symmetric"),
    Case(3, "painted", 1, 1, (300, 300), SMALL, AWAY, layer=3, isotropy=(0.4, 0.4), seed=0),
    Case(2, "graded", 0.5, 0.5, (600, 300), SMALL, AWAY, period_end=2.0, margin_px=4),
    Case(3, "constant", 1.3, 1, (300, 300), SMALL, layer=9, period_end=0.6, isotropy=(1, 0.2), impulses=2.5),
    Case(2, "constant", 1, 0.5, (600, 300), SMALL, materials=4, profile="cyclic"),
    Case(3, "graded", 1, 1, (300, 300), SMALL, AWAY, layer=5, materials=3, profile="cyclic", seed=2**32),
    Case(2, "constant", 1, 0.25, (300, 300), SMALL, AWAY, edges="dithered"),
    Case(3, "constant", 1, 1, (300, 600), SMALL, layer=18, edges="dithered", materials=3, profile="cyclic"),
]
# Shares of the materials but the first, whose painted ratio they halve: see make_job and cumulative.
SHARE = 0.1
DEFECTS = [case for case in CASES if case.orientation == "painted" and case.bandwidth == 0.5]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder: a job given as a mapping finds its pictures there."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


# --- jobs, and the same fields in closed form -------------------------------------------------------------


def unit(azimuth_deg: Floats, elevation_deg: Floats) -> Floats:
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    flat = np.cos(elevation)
    return np.stack(np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1)


def paint_defect(folder: Path) -> None:
    """Pictures of normals that turn once around the middle and lean upwards outside.

    Azimuths stay within ±90°, as an editor would write them: where they wrap, n becomes -n.
    """
    y, x = np.mgrid[1:-1:20j, -1:1:24j]
    n = unit(np.rad2deg(np.arctan2(y, x)), 60 * np.hypot(x, y) / math.sqrt(2))
    n *= np.where(n[..., :1] < 0, -1, 1)
    for name, angle in (("azimuth", np.arctan2(n[..., 1], n[..., 0])), ("elevation", np.arcsin(n[..., 2]))):
        grey = np.round((angle / np.pi + 0.5) * 65535).astype(np.uint16)
        Image.fromarray(grey).save(folder / f"{name}.png")


def make_job(case: Case, folder: Path) -> amslicer.Job:
    part = trimesh.creation.box(extents=case.size_mm)
    part.apply_translation(np.array(case.corner_mm) + np.array(case.size_mm) / 2)
    part.export(folder / "part.stl")
    flat = case.dimensions == 2
    azimuth, elevation = {
        "constant": (-75.0, 40.0),
        "graded": (
            {"gradient": {"axis": "x", "from": -20.0, "to": 110.0}},
            {"gradient": {"axis": "z", "from": -30.0, "to": 60.0}},
        ),
        "painted": (
            {"image": "azimuth.png", "range": [-90.0, 90.0]},
            {"image": "elevation.png", "range": [-90.0, 90.0]},
        ),
    }[case.orientation]
    if case.orientation == "painted":
        paint_defect(folder)
    period: Any = float(case.period)
    if case.period_end:
        period = {"gradient": {"axis": "x", "from": period, "to": float(case.period_end)}}
    pattern = {
        "dimensions": case.dimensions, "period": period, "bandwidth": float(case.bandwidth),
        "seed": case.seed, "profile": case.profile, "edges": case.edges, "evaluate": "exact",
    }  # fmt: skip
    ratio: Any = {"gradient": {"axis": "y", "from": RATIO_ENDS[0], "to": RATIO_ENDS[1]}}
    names = [f"m{i}" for i in range(case.materials)]
    if case.materials > 2:
        halved = {"gradient": {"axis": "y", "from": RATIO_ENDS[0] / 2, "to": RATIO_ENDS[1] / 2}}
        ratio = {names[0]: halved, names[1]: "rest", **dict.fromkeys(names[2:], SHARE)}
    return amslicer.load_job(
        {
            "printer": {"dpi": list(case.dpi), "layer_mm": case.layer_mm, "margin_px": case.margin_px},
            "materials": names,
            "pattern": pattern if case.impulses is None else {**pattern, "impulses": case.impulses},
            "fields": {
                "ratio": ratio,
                "isotropy": {"gradient": {"axis": "y", "from": case.isotropy[0], "to": case.isotropy[1]}},
                "orientation": azimuth if flat else {"azimuth": azimuth, "elevation": elevation},
            },
        },
        part=folder / "part.stl",
    )


def normals_of(case: Case, prepared: Prepared) -> Normals:
    """Normals at (N, 3) places above the part's corner: a formula where there is one, else what was painted."""
    if case.orientation == "painted":
        return prepared.painted.normals
    if case.orientation == "constant":
        return lambda p: np.broadcast_to(unit(-75.0, 0.0 if case.dimensions == 2 else 40.0), p.shape)

    def graded(p: Floats) -> Floats:
        t = np.clip(p / case.size_mm, 0, 1)
        return unit(-20 + 130 * t[:, 0], 0.0 if case.dimensions == 2 else -30 + 90 * t[:, 2])

    return graded


def cumulative(case: Case, prepared: Prepared) -> Floats:
    """(materials - 1, height, 1) painted shares of the materials up to one, margin included."""
    _, y, _ = pixel_centres(case, prepared)
    first = RATIO_ENDS[0] + (RATIO_ENDS[1] - RATIO_ENDS[0]) * np.clip(y / case.size_mm[1], 0, 1)
    if case.materials == 2:
        return first[None]
    after = [np.full(first.shape, 1 - SHARE * n) for n in range(case.materials - 2, 0, -1)]
    return np.stack([first / 2, *after])


def tile_centres(case: Case, prepared: Prepared) -> Floats:
    """(height, width, 3) centre of the tile, counted from the part's corner, that each pixel is in."""
    tiling, pitch = prepared.tiling, 25.4 / np.array(case.dpi)
    column, row = (np.arange(-case.margin_px, n + case.margin_px) for n in (prepared.grid.columns, prepared.grid.rows))
    x, y = ((i // tiling.pixels[0] + 0.5) * (tiling.pixels[0] * p) for i, p in ((column, pitch[0]), (row, pitch[1])))
    z = (case.layer // tiling.layers + 0.5) * tiling.layers * case.layer_mm
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None], z), axis=-1)


def pixel_centres(case: Case, prepared: Prepared) -> tuple[Floats, Floats, float]:
    """x (1, width), y (height, 1) and z of a layer's pixels in mm above the part's corner, margin included."""
    margin, pitch = case.margin_px, 25.4 / np.array(case.dpi)
    x = (np.arange(-margin, prepared.grid.columns + margin) + 0.5) * pitch[0]
    y = (np.arange(-margin, prepared.grid.rows + margin) + 0.5) * pitch[1]
    return x[None, :], y[:, None], (case.layer + 0.5) * case.layer_mm


def held_back(prepared: Prepared, places: Floats) -> Floats:
    """The envelope's period; tests/test_levels.py is about it."""
    shortest, longest = prepared.painted.period_bounds_mm
    periods = np.clip(prepared.painted.periods(places), shortest, longest)
    return np.clip(prepared.painted.envelope_periods(places, periods), shortest, periods)


def twin(case: Case, prepared: Prepared, *, signs: bool = True, **changed: Any) -> NDArray[np.complex128]:
    """The reference's G over a layer, with the sign of each tile."""

    def along(axis: int, start: float, end: float | None) -> Callable[[Floats], Floats]:
        stop = start if end is None else end
        return lambda p: start + (stop - start) * np.clip(p[:, axis] / case.size_mm[axis], 0, 1)

    normal = normals_of(case, prepared)
    centres = tile_centres(case, prepared)
    reference_normal = normal(centres.reshape(-1, 3)).reshape(centres.shape) if signs else None
    settings: dict[str, Any] = {
        "period": along(0, case.period, case.period_end), "bandwidth": case.bandwidth, "dimensions": case.dimensions,
        "seed": case.seed, "normal": normal, "reference_normal": reference_normal, "impulses": case.impulses or 4.0,
        "isotropy": along(1, *case.isotropy), "periods": case.periods,
        "envelope": (lambda places: held_back(prepared, places)) if case.periods[0] < case.periods[1] else None,
    }  # fmt: skip
    return phasor(*pixel_centres(case, prepared), **{**settings, **changed})


# --- comparisons ------------------------------------------------------------------------------------------


def rms(values: Complexes) -> float:
    return float(np.sqrt(np.mean(np.abs(values.astype(np.complex128)) ** 2)))


def assert_same_field(got: Complexes, expected: Complexes) -> None:
    """The rms difference is at most ERROR of the rms |G|; NaN is never the same."""
    assert got.shape == expected.shape
    assert rms(got - expected) <= ERROR * rms(expected)


def most_flips(pixels: int) -> float:
    """How many of these pixels may be of the other material.

    G is nearly complex Gaussian with E|G|² = σ². An independent error of rms e·σ turns its phase by e·σ/√π/|G| on
    average, and E[1/|G|] = √π/σ: by e. The phase is uniform, and passes one of the two thresholds ±πρ with the
    probability 2·e/2π = e/π for two materials, and proportionally for more. Two pixels more, because a count so far
    below 1 has no smaller bound.
    """
    return pixels * ERROR / math.pi + 2


def assert_same_labels(got: NDArray[np.uint8], expected: NDArray[np.uint8]) -> None:
    assert got.shape == expected.shape
    assert np.count_nonzero(got != expected) <= most_flips(got.size)


# --- the device and the twin ------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES, ids=str)
def test_device_and_twin_agree(device: Device, folder: Path, case: Case) -> None:
    job = make_job(case, folder)
    prepared = prepare(job)
    expected = twin(case, prepared)
    assert_same_field(prepared.pattern(device).field(case.layer), expected)
    assert_same_field(prepared.pattern(device).field(case.layer, per_pixel=True), expected)

    (layer,) = amslicer.layers(job, Run(layers=(case.layer, case.layer + 1)))
    x, y, z = pixel_centres(case, prepared)
    solid = (x > 0) & (x < case.size_mm[0]) & (y > 0) & (y < case.size_mm[1]) & (z < case.size_mm[2])
    labels_of = cyclic_labels if case.profile == "cyclic" else symmetric_labels
    expected = dithered(case, prepared, expected) if case.edges == "dithered" else expected
    assert_same_labels(layer.labels[::-1], np.where(solid, labels_of(expected, cumulative(case, prepared)), 0))


def dithered(case: Case, prepared: Prepared, g: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """G at random places within the pixels; only for constant directions, whose wave is one everywhere."""
    normal = normals_of(case, prepared)(np.zeros((1, 3)))[0]
    wave = normal * 2 * np.pi / case.period * (25.4 / case.dpi[0], 25.4 / case.dpi[1], case.layer_mm)
    columns, rows = np.arange(g.shape[1])[None, :], np.arange(g.shape[0])[:, None]
    return jittered(g, columns, rows, case.layer if case.dimensions == 3 else 0, wave, case.seed)


def test_cases_cover_what_can_differ() -> None:
    for dimensions in (2, 3):
        some = [case for case in CASES if case.dimensions == dimensions]
        assert {c.orientation for c in some} == {"constant", "graded", "painted"}
        assert {c.period for c in some} >= {0.5, 1, 3}
        assert {bool(any(c.isotropy)) for c in some} == {c.period_end is not None for c in some} == {True, False}
        assert {c.profile for c in some} == {"pwm", "symmetric", "cyclic"}
        assert {c.edges for c in some} == {"sharp", "dithered"}
        assert {c.bandwidth for c in some} == {0.25, 0.5, 1}
        assert {c.dpi[0] == c.dpi[1] for c in some} == {True, False}


@pytest.mark.parametrize("case", DEFECTS, ids=str)
def test_painted_defects_need_signs(folder: Path, case: Case) -> None:
    """Otherwise agreement on them would prove nothing: without signs, Im G is another one, and Re G the same."""
    prepared = prepare(make_job(case, folder))
    with_signs, without = twin(case, prepared), twin(case, prepared, signs=False)
    assert np.allclose(with_signs.real, without.real, rtol=0, atol=1e-12)
    assert rms(with_signs - without) > 0.1 * rms(with_signs)


def test_the_comparison_can_fail(folder: Path) -> None:
    """Another seed, half a pixel, one sign, one per mille of a period, NaN, and labels of another ratio."""
    case = CASES[5]
    prepared = prepare(make_job(case, folder))
    expected = twin(case, prepared)
    assert_same_field(expected.astype(np.complex64), expected)
    x, y, z = pixel_centres(case, prepared)
    shifted = phasor(
        x + 0.02, y, z, period=case.period, bandwidth=case.bandwidth, dimensions=2, seed=case.seed,
        normal=normals_of(case, prepared),
    )  # fmt: skip
    broken = expected.copy()
    broken[0, 0] = np.nan
    for wrong in (
        twin(case, prepared, seed=case.seed + 1), twin(case, prepared, period=1.001 * case.period, periods=None),
        twin(case, prepared, error=1e-2), shifted, expected.conj(), broken,
    ):  # fmt: skip
        with pytest.raises(AssertionError):
            assert_same_field(wrong, expected)
    labels = symmetric_labels(expected, [[[0.5]]])
    assert_same_labels(labels, labels)
    with pytest.raises(AssertionError):
        assert_same_labels(labels, symmetric_labels(expected, [[[0.51]]]))


# --- the twin alone ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("impulses", [0.3, 4.0, 4.5])
def test_twin_against_a_plain_sum(dimensions: int, impulses: float) -> None:
    """Every impulse of many cells, one after the other, at a few places on both sides of 0."""
    period, width, normal = 0.8, 0.5 / 0.8, (0.48, -0.6, 0.64)
    per_cell, side = cells_of(width, dimensions, impulses)
    assert per_cell / side**dimensions == pytest.approx(impulses * width**dimensions)
    steps = range(-4, 4)
    cells = np.array(list(product(steps, steps, steps if dimensions == 3 else (0,))))
    places, phases = impulses_of(cells, side_mm=side, per_cell=per_cell, dimensions=dimensions, seed=7)
    radius = {2: 1.483, 3: 1.562}[dimensions] / width
    points = np.random.default_rng(3).uniform(-side, side, (5, 3))
    expected = []
    for point in points:
        total = 0j
        for place, phase in zip(places.reshape(-1, 3), phases.reshape(-1), strict=True):
            d = [point[a] - place[a] for a in range(dimensions)]
            if max(map(abs, d)) < radius:
                angle = sum(2 * math.pi / period * n * v for n, v in zip(normal, d, strict=False)) + phase
                total += math.exp(-math.pi * width**2 * sum(v * v for v in d)) * cmath.exp(1j * angle)
        expected.append(total)
    got = phasor(
        *points.T, period=period, bandwidth=0.5, dimensions=dimensions, seed=7, normal=normal, impulses=impulses
    )  # fmt: skip
    assert np.allclose(got, expected, rtol=0, atol=1e-12)


def test_coordinates_broadcast_and_z_does_not_matter_in_the_plane() -> None:
    settings: dict[str, Any] = {"period": 1.0, "bandwidth": 0.5, "seed": 1, "normal": (0.6, 0.8, 0.0)}
    x, y = np.linspace(-1, 2, 7), np.linspace(0, 1, 3)[:, None]
    flat = phasor(x, y, 0.0, dimensions=2, **settings)
    assert flat.shape == (3, 7)
    assert np.array_equal(flat, phasor(x, y, 9.7, dimensions=2, **settings))
    solid = phasor(x, y, [[[0.0]], [[9.7]]], dimensions=3, **settings)
    assert solid.shape == (2, 3, 7)
    assert solid[1, 2, 4] == phasor(x[4], y[2, 0], 9.7, dimensions=3, **settings)


def test_turning_the_reference_conjugates_and_keeps_the_wave() -> None:
    """n and -n are one laminate: the sign that a tile takes is not seen in Re G, nor by a symmetric profile."""
    x, y = np.linspace(0, 4, 20), np.linspace(0, 4, 20)[:, None]
    normal = np.array([0.6, 0.0, 0.8])
    settings: dict[str, Any] = {"period": 1.0, "bandwidth": 0.5, "dimensions": 3, "seed": 1, "normal": normal}
    plain = phasor(x, y, 0.0, **settings)
    along, against = (phasor(x, y, 0.0, reference_normal=n, **settings) for n in (normal, -normal))
    assert np.array_equal(along, plain)
    assert np.array_equal(against, plain.conj())
    assert np.array_equal(symmetric_labels(along, [[[0.3]]]), symmetric_labels(against, [[[0.3]]]))


@pytest.mark.parametrize("dimensions", [2, 3])
def test_power_and_ratio_are_those_of_the_random_process(dimensions: int) -> None:
    """Campbell: E|G|² = Λ b^d ∫ exp(-2π b² r²) dV = Λ 2^(-d/2); and P(|arg G| < πρ) = ρ as the phase is uniform.

    Power is correlated over 1/b², and a square of 110 periods holds 3 000 of these: the variance of a mean over
    6 000 places is at most (1/3 000 + 1/6 000) times that of one place, E² and ρ(1 - ρ). Five standard deviations.
    """
    place = np.random.default_rng(5).uniform(-55, 55, (6_000, 3))
    place[:, 2] *= 0.01
    g = phasor(*place.T, period=1, bandwidth=0.5, dimensions=dimensions, seed=3, normal=(0.6, 0.8, 0.0))
    assert rms(g) ** 2 == pytest.approx(4 * 2 ** (-dimensions / 2), rel=0.12)
    assert np.mean(symmetric_labels(g, [[0.3]]) == 1) == pytest.approx(0.3, abs=0.052)


# --- the kernels' radius ----------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [cut_radius, truncation_radius])
def test_radius_is_the_published_one(radius: Callable[[float, int, float], float]) -> None:
    """By hand from Lagae et al. 2011, IV: √(-ln e / π)/b in 2D, at 1e-3, and at 2 % with their a = 0.0443528."""
    assert radius(1.0, 2, 1e-3) == pytest.approx(1.483, abs=5e-4)
    assert radius(1.0, 3, 1e-3) == pytest.approx(1.562, abs=5e-4)
    assert radius(0.0443528, 2, 0.02) == pytest.approx(25.160, abs=5e-4)
    assert radius(0.5, 3, 1e-3) == pytest.approx(2 * radius(1.0, 3, 1e-3))


@pytest.mark.parametrize("radius", [cut_radius, truncation_radius])
@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("error", [0.5, 0.02, 1e-3, 1e-5])
def test_radius_leaves_the_error_asked_for(
    radius: Callable[[float, int, float], float], dimensions: int, error: float
) -> None:
    """The energy of exp(-π b² r²) beyond the radius, integrated numerically, is e² of the whole."""
    b = 0.7
    r = radius(b, dimensions, error)
    beyond, whole = (
        quad(lambda t: t ** (dimensions - 1) * math.exp(-2 * math.pi * b**2 * t**2), *ends, epsabs=0)[0]
        for ends in ((r, r + 5 / b), (0, 10 / b))
    )
    assert math.sqrt(beyond / whole) == pytest.approx(error, rel=1e-6)
