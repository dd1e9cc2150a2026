"""Surface relief: what moves, by how much, and that the stack of it is as sound as any."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import manifold3d
import meshes
import numpy as np
import parts
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import amslicer
from amslicer import Job, Run
from amslicer.errors import AmslicerError, JobError
from amslicer.pattern import make_noise
from amslicer.pipeline import Prepared, prepare
from amslicer.pointfield import field_at
from amslicer.refine import MAX_STRETCH, Surface, join_places, refine, ways_out
from amslicer.surface import check_closed, connect

Floats = NDArray[np.float64]

COARSE = {"pitch_um": 100, "layer_um": 100}
TURNING = {"gradient": {"axis": "y", "from": 0, "to": 80}}
GRADED = {"gradient": {"axis": "x", "from": 0.7, "to": 1.6}}


def job(part: Path, displacement: Any, **asked: Any) -> Job:
    """A job with a relief, of a file beside the part; other keys as of parts.job."""
    asked = {"printer": COARSE, "dimensions": 3, **asked}
    parts.job(part, **asked)
    file = part.with_suffix(".yaml")
    file.write_text(json.dumps({**json.loads(file.read_text()), "displacement": displacement}))
    return amslicer.load_job(file, part=part)


def tube(outer: float, inner: float, height: float, segments: int = 96) -> meshes.Solid:
    """A polygon's, whose corners lie on the circles."""
    hole = manifold3d.Manifold.cylinder(height + 2, inner, -1, segments).translate((0, 0, -1))
    return meshes.from_manifold(manifold3d.Manifold.cylinder(height, outer, -1, segments) - hole)


def closed(prepared: Prepared) -> Surface:
    """The displaced surface, which has no open edge and faces outwards."""
    assert prepared.moved is not None
    surface = prepared.moved.surface
    check_closed(connect(surface.vertices, surface.triangles, np.zeros(3)))
    assert surface.volume_mm3 > 0
    return surface


def in_file(prepared: Prepared, vertices: Floats) -> Floats:
    """(V, 3) coordinates of the part's file."""
    placement = prepared.placement
    return np.stack(placement.to_field(*vertices.T), axis=-1) + placement.file_minimum_mm


@pytest.mark.parametrize(
    "solid",
    [
        meshes.box((3.0, 2.0, 0.4)),
        meshes.torus(3.0, 1.0),
        meshes.nested_shells(),
        meshes.joined(meshes.box(), meshes.box((3.0, 4.0, 5.0), (1.0, 1.0, 1.0))),
        meshes.joined(meshes.box((1.0, 1.0, 1.0)), meshes.box((1.0, 1.0, 1.0), (1.0, 1.0, 0.0))),  # share an edge
    ],
    ids=["box", "torus", "cavity", "overlapping", "touching"],
)
def test_refined_surface_is_the_same(solid: meshes.Solid) -> None:
    vertices, triangles = solid
    body = connect(vertices, triangles, np.zeros(3)).body
    before = join_places(vertices, triangles, body)
    after = refine(before, 0.3, "resolution_mm")
    ends = after.vertices[after.triangles] - after.vertices[np.roll(after.triangles, -1, axis=1)]
    assert np.linalg.norm(ends, axis=-1).max() <= 0.3
    assert after.area_mm2 == pytest.approx(before.area_mm2, rel=1e-12)
    assert after.volume_mm3 == pytest.approx(before.volume_mm3, rel=1e-12)
    check_closed(connect(after.vertices, after.triangles, np.zeros(3)))
    print(f"{len(before.triangles)} triangles became {len(after.triangles)}")


def test_planes_move_by_one() -> None:
    """Whatever the angle between faces, n·d = 1 for each of them, if it is not too sharp."""
    for solid in (meshes.box(), tube(3.0, 2.0, 2.0), meshes.tetrahedron()):
        surface = refine(join_places(*solid, None), 0.5, "resolution_mm")
        a, b, c = np.moveaxis(surface.vertices[surface.triangles], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        ways = ways_out(surface)[surface.triangles]
        blunt = np.linalg.norm(ways, axis=-1) < MAX_STRETCH * (1 - 1e-9)
        moved = np.einsum("tci,ti->tc", ways, normal)[blunt]
        assert np.abs(moved - 1).max() < 1e-4
    corners = ways_out(join_places(*meshes.box((2.0, 2.0, 2.0), (-1.0, -1.0, -1.0)), None))
    np.testing.assert_allclose(np.abs(corners), 1, atol=1e-5)


def test_a_needle_does_not_go_anywhere() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 40.0]], np.float64)
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert np.linalg.norm(ways_out(join_places(vertices, triangles, None)), axis=1).max() <= MAX_STRETCH * (1 + 1e-12)


NOISES: dict[str, dict[str, Any]] = {
    "phasor": {"orientation": {"azimuth": 30, "elevation": 20}},
    "phasor in 2D, turning": {"dimensions": 2, "orientation": TURNING},
    "graded, isotropic": {"period": GRADED, "orientation": TURNING, "isotropy": 0.4},
    "aligned": {"alignment": 10, "orientation": TURNING},
    "lobes": {"lobes": [{"angle": 0}, {"angle": 90}], "orientation": 15},
    "gabor": {"noise": "gabor", "orientation": 30},
    "gabor-isotropic": {"noise": "gabor-isotropic", "dimensions": 2},
    "phacelle": {"noise": "phacelle", "orientation": 30},
    "phacelle-simple": {"noise": "phacelle-simple", "orientation": TURNING},
    "wave": {"noise": "wave", "dimensions": 2, "orientation": 30},
    "wave-cellular": {"noise": "wave-cellular"},
    "random-phase": {"noise": "random-phase"},
}


@pytest.mark.parametrize("asked", NOISES.values(), ids=NOISES.keys())
def test_field_on_the_host_is_that_of_the_job(tmp_path: Path, asked: dict[str, Any]) -> None:
    """At the pixels of one layer; and another seed is another field."""
    some = parts.job(parts.box(tmp_path, (3.0, 2.0, 2.0)), **{"printer": COARSE, "dimensions": 3, **asked})
    prepared = prepare(some)
    layer, grid = 9, prepared.grid
    expected = amslicer.field(some, layer)[::-1]
    x, y = np.meshgrid(grid.x_mm(), grid.y_mm())
    points = np.stack([x, y, np.full(x.shape, grid.z_mm(layer))], axis=-1).reshape(-1, 3)
    found = field_at(some, prepared.painted, make_noise(some, prepared.painted), points).reshape(x.shape)
    error = np.sqrt(np.mean(np.abs(found - expected) ** 2) / np.mean(np.abs(expected) ** 2))
    phase = np.quantile(np.abs(np.angle(found * expected.conj())), 0.95)
    print(f"relative RMS error {error:.1e}, 95 % of the phases within {phase:.1e} rad")
    assert error < 2e-3
    assert phase < 5e-3
    several = np.concatenate([points[::7], points[1::7]])
    again = field_at(some, prepared.painted, make_noise(some, prepared.painted), several)
    both = np.concatenate([found.reshape(-1)[::7], found.reshape(-1)[1::7]])
    assert np.sqrt(np.mean(np.abs(again - both) ** 2)) < 2e-3 * np.sqrt(np.mean(np.abs(both) ** 2))
    other = amslicer.field(parts.job(some.part, **{"printer": COARSE, "dimensions": 3, "seed": 2, **asked}), layer)
    assert np.sqrt(np.mean(np.abs(found - other[::-1]) ** 2) / np.mean(np.abs(expected) ** 2)) > 0.2


def test_ring_with_an_exact_sawtooth(tmp_path: Path) -> None:
    """All faces move by h(θ): V = ∫ ½ ((R + h)² - (r - h)²)(H + 2h) dθ."""
    outer, inner, height, amplitude, teeth = 3.0, 2.0, 2.0, 0.3, 4
    field = {"expression": f"{teeth}*atan2(y, x)/(2*pi) - floor({teeth}*atan2(y, x)/(2*pi))"}
    part = parts.stl(tmp_path, tube(outer, inner, height))
    prepared = prepare(job(part, {"amplitude_mm": amplitude, "field": field, "resolution_mm": 0.13}))
    surface = closed(prepared)
    h = amplitude * (np.arange(10_000) + 0.5) / 10_000
    volume = 2 * np.pi * np.mean(((outer + h) ** 2 - (inner - h) ** 2) / 2 * (height + 2 * h))
    expected = volume - np.pi * (outer**2 - inner**2) * height
    gained = prepared.volume_mm3 - prepared.mesh.volume_mm3
    radius = np.hypot(*in_file(prepared, surface.vertices)[:, :2].T)
    print(
        f"{len(surface.triangles)} triangles; gained {gained:.4f} mm³ of {expected:.4f}; radius to {radius.max():.4f}"
    )
    assert gained == pytest.approx(expected, rel=0.03)
    assert radius.max() - outer == pytest.approx(amplitude, rel=0.03)
    assert inner - radius.min() == pytest.approx(amplitude, rel=0.03)


def test_ring_with_a_sawtooth_of_the_pattern(tmp_path: Path) -> None:
    """A regular wave along the axis, at the outer face: 3 periods, of each the mean of R h + h²/2."""
    outer, height, amplitude, period = 1.5, 6.0, 0.2, 2.0
    at = {"expression": "where(hypot(x, y) > 1.4, where(z > 0.001, where(z < 5.999, 1, 0), 0), 0)"}
    part = parts.stl(tmp_path, tube(outer, 1.0, height, 32))
    displacement = {"amplitude_mm": amplitude, "profile": "sawtooth", "at": at}
    asked = {"period": period, "bandwidth": 0.05, "orientation": {"azimuth": 0, "elevation": 90}}
    prepared = prepare(job(part, displacement, printer={"pitch_um": 50, "layer_um": 100}, **asked))
    surface = closed(prepared)
    assert prepared.moved is not None
    edge = prepared.moved.resolution_mm
    assert edge == pytest.approx(period / 36)
    expected = 2 * np.pi * (outer * amplitude / 2 + amplitude**2 / 6) * height
    gained = prepared.volume_mm3 - prepared.mesh.volume_mm3
    points = in_file(prepared, surface.vertices)
    radius = np.hypot(*points[:, :2].T)
    print(
        f"{len(surface.triangles)} triangles; gained {gained:.4f} mm³ of {expected:.4f}; radius to {radius.max():.4f}"
    )
    assert gained == pytest.approx(expected, rel=0.03)
    assert radius.max() - outer == pytest.approx(amplitude, rel=0.03)
    # Along the axis, on the facets' corners: rises of about the whole amplitude, one a period.
    corner = (np.abs(points[:, 1]) < 1e-9) & (points[:, 0] > 1.4) & (points[:, 2] > 0.001) & (points[:, 2] < 5.999)
    along = radius[corner][np.argsort(points[corner, 2])]
    jumps = np.abs(np.diff(along))
    print(f"jumps {np.sort(jumps)[-4:]}")
    assert np.count_nonzero(jumps > 0.8 * amplitude) == 3


@pytest.mark.parametrize("both_ways", [False, True])
def test_plate_with_a_sine(tmp_path: Path, both_ways: bool) -> None:
    """The top of a plate, four periods a side: the mean height times the area."""
    side, amplitude = 8.0, 0.3
    inside = "where(z > 1.999, where(abs(x - 4) < 3.999, where(abs(y - 4) < 3.999, 1, 0), 0), 0)"
    displacement = {
        "amplitude_mm": amplitude,
        "at": {"expression": inside},
        "both_ways": both_ways,
        "resolution_mm": 0.08,
    }
    asked = {"period": 2.0, "bandwidth": 0.05, "orientation": 0}
    prepared = prepare(job(parts.box(tmp_path, (side, side, 2.0)), displacement, **asked))
    surface = closed(prepared)
    gained = prepared.volume_mm3 - prepared.mesh.volume_mm3
    mean = 0.0 if both_ways else amplitude / 2
    z = in_file(prepared, surface.vertices)[:, 2]
    print(f"gained {gained:.4f} mm³ of {mean * side**2:.4f}; from {z.max():.4f}")
    assert gained == pytest.approx(mean * side**2, abs=0.03 * amplitude / 2 * side**2)
    assert z.max() - 2 == pytest.approx(amplitude - (amplitude / 2 if both_ways else 0), rel=0.03)


def test_engraving(tmp_path: Path) -> None:
    """Below 0 the same plate loses as much."""
    field = {"expression": "where(z > 1.999, where(abs(x - 2) < 1, where(abs(y - 2) < 1, 1, 0), 0), 0)"}
    part = parts.box(tmp_path, (4.0, 4.0, 2.0))
    displacement = {"field": field, "resolution_mm": 0.05}
    deep, high = (prepare(job(part, {**displacement, "amplitude_mm": a})) for a in (-0.5, 0.5))
    change = [p.volume_mm3 - 32 for p in (deep, high)]
    assert change[0] == pytest.approx(-change[1], rel=1e-9)
    assert change[1] == pytest.approx(0.5 * 4, rel=0.06)  # a stamp of 2 mm, to within half an edge on each side
    assert deep.placement.size_mm == pytest.approx([4, 4, 2])
    assert high.placement.size_mm == pytest.approx([4, 4, 2.5])


def test_height_from_a_field_is_exact_at_vertices(tmp_path: Path) -> None:
    """Nothing is taken from the pattern; the file's coordinates do not know of the relief."""
    part = parts.stl(tmp_path, meshes.box((3.0, 2.0, 1.0), (5.0, -1.0, 2.0)))
    field = {"expression": "(x - 5)/3*(y + 1)/2"}
    prepared = prepare(job(part, {"amplitude_mm": 0.25, "field": field, "resolution_mm": 0.2}))
    x, y, z = in_file(prepared, closed(prepared).vertices).T
    top = (z > 2.99) & (x > 5.001) & (x < 7.999) & (y > -0.999) & (y < 0.999)
    assert np.count_nonzero(top) > 100
    np.testing.assert_allclose(z[top], 3 + 0.25 * (x[top] - 5) / 3 * (y[top] + 1) / 2, atol=1e-12)


def test_relief_and_materials_are_one_pattern(tmp_path: Path) -> None:
    """Heights on the top of a box are those of the phase at the pixels below, in 2D."""
    amplitude = 0.2
    part = parts.box(tmp_path, (6.0, 5.0, 1.0))
    some = job(
        part, {"amplitude_mm": amplitude, "at": {"expression": "clip(2*z - 1, 0, 1)"}}, dimensions=2, period=2.0,
        orientation=30, printer={"pitch_um": 50, "layer_um": 100},
    )  # fmt: skip
    prepared = prepare(some)
    grid, corner = prepared.grid, prepared.placement.low_mm
    x, y, z = closed(prepared).vertices.T
    flat = (z > 1 - 1e-9) & (x > 0.3) & (x < 5.9) & (y > 0.3) & (y < 5.0)
    assert corner == pytest.approx([-amplitude, -amplitude, 0])
    phase = np.angle(amslicer.field(some, 0))[::-1]
    column, row = ((v[flat] / 0.05).astype(int) for v in (x, y))
    expected = 1 + amplitude * (0.5 + 0.5 * np.cos(phase[row, column]))
    error = np.abs(z[flat] - expected)
    print(f"{np.count_nonzero(flat)} vertices within {error.max():.4f} mm; {grid.columns} columns")
    # Half a pixel's diagonal is 0.11 rad of the wave, which is no steeper than half the amplitude per rad.
    assert np.quantile(error, 0.99) < amplitude / 2 * 0.13
    assert np.ptp(z[flat]) > 0.9 * amplitude


@pytest.mark.parametrize("displacement", [{"amplitude_mm": 0}, {"amplitude_mm": 0, "profile": "sawtooth"}])
def test_none_changes_no_byte(tmp_path: Path, displacement: dict[str, Any]) -> None:
    part = parts.stl(tmp_path, meshes.torus(2.0, 0.8))
    plain = parts.labels(parts.job(part, printer=COARSE, dimensions=3))
    np.testing.assert_array_equal(parts.labels(job(part, displacement)), plain)


def test_little_changes_some(tmp_path: Path) -> None:
    """The comparison above can fail."""
    part = parts.stl(tmp_path, meshes.torus(2.0, 0.8))
    plain = parts.labels(parts.job(part, printer=COARSE, dimensions=3))
    assert parts.labels(job(part, {"amplitude_mm": 0.2})).shape != plain.shape


@pytest.mark.parametrize("profile", ["sine", "sawtooth", "pwm", "field"])
def test_stack_is_sound(tmp_path: Path, profile: str) -> None:
    """Threads and ranges of layers change no byte; verify finds nothing; the volume is the displaced mesh's."""
    part = parts.stl(tmp_path, meshes.torus(2.0, 0.8))
    height = {"field": {"expression": "0.5 + 0.5*sin(3*z)"}} if profile == "field" else {"profile": profile}
    displacement = {"amplitude_mm": 0.3, "resolution_mm": 0.15, **height}
    some = job(part, displacement, ratio=0.3, orientation=20)
    whole = amslicer.slice_job(some, tmp_path / "one", run=Run(jobs=1))
    amslicer.slice_job(some, tmp_path / "two", run=Run(jobs=2))
    amslicer.slice_job(some, tmp_path / "some", run=Run(layers=(5, 12)))
    one, two, few = (json.loads((tmp_path / n / "manifest.json").read_text()) for n in ("one", "two", "some"))
    assert one["layers"] == two["layers"]
    assert one["layers"][5:12] == few["layers"]
    report = amslicer.verify(tmp_path / "one")
    assert report.ok, [check for check in report.checks if not check.ok]
    prepared = prepare(some)
    volume = one["solid_pixels"] * 1e-3
    print(f"{volume:.3f} mm³ of pixels, {prepared.volume_mm3:.3f} of the mesh, {prepared.mesh.volume_mm3:.3f} before")
    assert one["part"]["volume_mm3"] == pytest.approx(prepared.volume_mm3)
    assert volume == pytest.approx(prepared.volume_mm3, rel=0.01)
    assert prepared.volume_mm3 > 1.05 * prepared.mesh.volume_mm3
    assert any("relief: the surface has" in note for note in prepared.notes())
    assert whole is not None


def test_verify_knows_the_volume(tmp_path: Path) -> None:
    """A stack of the plain part, told that it has the relief, does not pass."""
    part = parts.stl(tmp_path, meshes.torus(3.0, 1.0))
    amslicer.slice_job(job(part, {"amplitude_mm": 0.4, "field": 1, "resolution_mm": 0.2}), tmp_path / "out")
    file = tmp_path / "out" / "manifest.json"
    manifest = json.loads(file.read_text())
    manifest["part"]["volume_mm3"] = prepare(parts.job(part, printer=COARSE)).volume_mm3
    file.write_text(json.dumps(manifest))
    report = amslicer.verify(tmp_path / "out")
    assert [check.name.split(":")[0] for check in report.checks if not check.ok] == ["volume"]


@pytest.mark.parametrize("turn", [(0, 0, 90), (30, 0, 45)])
def test_turning_the_part_turns_the_relief(tmp_path: Path, turn: tuple[float, float, float]) -> None:
    """Heights follow the file's coordinates, and the printed size the scale."""
    part = parts.box(tmp_path, (3.0, 2.0, 1.0))
    field = {"gradient": {"axis": "x", "from": 0, "to": 1}}
    displacement = {"amplitude_mm": 0.3, "field": field, "resolution_mm": 0.25}
    straight, turned = (
        prepare(job(part, displacement, settings={"rotate": angles})) for angles in ((0.0, 0.0, 0.0), turn)
    )
    one, other = (in_file(p, closed(p).vertices) for p in (straight, turned))
    distance, _ = cKDTree(one).query(other)
    assert distance.max() < 1e-9
    assert cKDTree(one).query(other * (1, 1, -1))[0].max() > 0.1  # it could be otherwise
    larger = {**displacement, "amplitude_mm": 0.6, "resolution_mm": 0.5}
    scaled = prepare(job(part, larger, settings={"scale": 2.0}))
    assert scaled.volume_mm3 == pytest.approx(8 * straight.volume_mm3, rel=1e-9)


def test_open_mesh_with_relief(tmp_path: Path) -> None:
    """The hole's rim moves with the surface; what closes is sliced."""
    vertices, triangles = meshes.sphere(2.0, 2)
    part = parts.stl(tmp_path, (vertices, triangles[1:]))
    some = job(part, {"amplitude_mm": 0.2, "field": 1}, settings={"allow_open": True}, period=4.0)
    assert parts.labels(some).any()


def bad(**keys: Any) -> dict[str, Any]:
    return {"amplitude_mm": 0.2, **keys}


@pytest.mark.parametrize(
    ("displacement", "asked", "words"),
    [
        (bad(amplitude_mm=0.6), {}, "amplitude_mm is 0.6, but the part's smallest side is 1 mm"),
        (bad(at={"expression": "2*x"}), {}, r"displacement.at is .* at x = .*between 0 and 1"),
        (bad(field={"expression": "x - 1"}), {}, r"displacement.field is -1 at x = 0.00"),
        (bad(field=0.5, profile="sine"), {}, "two heights"),
        (bad(profile="cyclic"), {}, "order of materials, no height"),
        (bad(profile="sinus"), {}, "displacement.profile: input should be"),
        (bad(resolution_mm=0), {}, "resolution_mm"),
        (bad(resolution_mm=1e-4), {}, "million triangles"),
        (bad(height=1), {}, "unknown key 'displacement.height'"),
        ({}, {}, "amplitude_mm' is missing"),
        (bad(profile="sawtooth"), {"noise": "gabor"}, "displacement.profile: sawtooth needs a phase"),
        (
            bad(profile="sawtooth"), {"orientation": {"expression": "where(x > 1.5, 180, 0)"}},
            "displacement.profile: sawtooth needs arrows",
        ),
    ],
)  # fmt: skip
def test_refused(tmp_path: Path, displacement: dict[str, Any], asked: dict[str, Any], words: str) -> None:
    part = parts.box(tmp_path, (3.0, 2.0, 1.0))
    with pytest.raises(AmslicerError, match=words) as caught:
        prepare(job(part, displacement, **asked))
    assert isinstance(caught.value, JobError)
    assert math.isfinite(len(str(caught.value)))


def test_walls_that_would_be_engraved_away_are_refused(tmp_path: Path) -> None:
    """A tube of 0.4 mm, 0.5 mm engraved from both sides."""
    part = parts.stl(tmp_path, meshes.from_trimesh(trimesh.creation.annulus(3, 3.4, 5)))
    for displacement in ({"amplitude_mm": -0.5}, {"amplitude_mm": -0.5, "field": 1}):
        job = parts.job(part, sections={"displacement": displacement})
        with pytest.raises(JobError, match="its walls are thinner than that"):
            parts.labels(job)
