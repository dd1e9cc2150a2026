"""Solid pixels against manifold3d's sections, solid angles, and pixels typed by hand."""

from __future__ import annotations

import functools
import math
import os
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import manifold3d
import meshes
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from meshes import Solid
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from amslicer.errors import PartError
from amslicer.grid import Grid, cover
from amslicer.mask import Runs, join_runs, make_slicer
from amslicer.mesh import Mesh, read_mesh
from amslicer.placement import place, rotation_matrix

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DATA = os.environ.get("AMSLICER_TEST_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="AMSLICER_TEST_DATA is not set")

# A vertex or a face exactly on a layer's plane counts as below it (half-open), so sections are taken this
# share of the part's size above the plane; where nothing lies on the plane it makes no difference.
ABOVE = 1e-9

# ---------------------------------------------------------------------------------------------------------
# The reference: sections of every body by manifold3d. manifold3d takes 2-manifold bodies without overlaps
# only, so a mesh is split into its bodies first. A section of the whole is the contours of all bodies' (those
# of inward bodies, cavities, reversed) with fill rule Positive: what winds more than 0 times is solid, so
# overlaps count once, a cavity is cut out and an island inside a cavity is back.


@dataclass(frozen=True)
class Body:
    manifold: manifold3d.Manifold
    outward: bool


@dataclass(frozen=True)
class Section:
    area_mm2: float
    perimeter_mm: float
    contours: int

    def bound_mm2(self, grid: Grid) -> float:
        """How far counted pixels may be off: half the perimeter times the pitch, a pixel per contour.

        For convex outlines and square pixels this is Nosarzewska's theorem.
        """
        pixel = grid.pitch_mm[0] * grid.pitch_mm[1]
        return self.perimeter_mm / 2 * max(grid.pitch_mm) + self.contours * pixel


def whole(solid: Solid) -> manifold3d.Manifold:
    """In float64, so that the reference's vertices are those that were sliced."""
    vertices, triangles = solid
    manifold = manifold3d.Manifold(manifold3d.Mesh64(vertices, triangles.astype(np.uint64)))
    assert manifold.status() == manifold3d.Error.NoError
    assert not manifold.is_empty()
    return manifold


def bodies(solid: Solid, by_place: bool = False) -> list[Body]:
    """Bodies: triangles that share an edge with exactly one other.

    by_place: vertices with the same coordinates are one, for formats that store every triangle's corners.
    """
    vertices, triangles = solid
    if by_place:
        vertices, number = np.unique(vertices, axis=0, return_inverse=True)
        triangles = number.reshape(-1)[triangles]
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, edge, uses = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge, kind="stable")
    pairs = (order[np.repeat(uses == 2, uses)] // 3).reshape(-1, 2)
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(triangles), len(triangles)))
    count, label = connected_components(links, directed=False)
    found = []
    for number in range(count):
        own = triangles[label == number]
        corners = vertices[own]
        outward = float(np.linalg.det(corners - corners[0, 0]).sum()) > 0
        used, own = np.unique(own, return_inverse=True)
        own = own.reshape(-1, 3)
        found.append(Body(whole((vertices[used], own if outward else own[:, ::-1])), outward))
    return found


def section(of: list[Body], z_mm: float) -> Section:
    contours = []
    for body in of:
        step = 1 if body.outward else -1
        contours += [outline[::step] for outline in body.manifold.slice(z_mm).to_polygons()]
    cross = manifold3d.CrossSection(contours, manifold3d.FillRule.Positive)
    outlines = cross.to_polygons()
    lengths = [np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1).sum() for outline in outlines]
    return Section(cross.area(), float(sum(lengths)), len(outlines))


def slice_all(solid: Solid, grid: Grid) -> Runs:
    return make_slicer(solid[0], solid[1], grid).runs(0, grid.layers)


def area_errors(runs: Runs, of: list[Body]) -> tuple[Floats, Floats, Floats]:
    """Per layer: pixels' area less the section's, its bound, the section's area (mm2)."""
    grid = runs.grid
    tiny = ABOVE * max(grid.columns * grid.pitch_mm[0], grid.rows * grid.pitch_mm[1])
    sections = [section(of, grid.z_mm(layer) + tiny) for layer in range(grid.layers)]
    area = np.array([cut.area_mm2 for cut in sections])
    bound = np.array([cut.bound_mm2(grid) for cut in sections])
    return runs.pixels * grid.pitch_mm[0] * grid.pitch_mm[1] - area, bound, area


def assert_areas(runs: Runs, of: list[Body]) -> Floats:
    """Every layer within its bound; returns the bounds."""
    error, bound, area = area_errors(runs, of)
    worst = int(np.argmax(np.abs(error) - bound))
    assert (np.abs(error) <= bound).all(), (
        f"layer {worst} of {len(area)}: {error[worst]:.6g} mm2 off the section's {area[worst]:.6g}, "
        f"bound {bound[worst]:.6g}"
    )
    return bound


def assert_volume(runs: Runs, solid: Solid, volume_mm3: float, bound_mm2: Floats) -> None:
    """Within 1 % and what sampling may cost: each layer's bound, and half a layer under every face.

    The mid-height rule is off by at most half a layer times the variation of the section's area, which is at
    most the area of the mesh seen from above and below.
    """
    corners = solid[0][solid[1]]
    seen = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]).sum() / 2
    sampling = runs.grid.layer_mm * (bound_mm2.sum() + seen / 2)
    found = int(runs.pixels.sum()) * runs.grid.voxel_mm3
    assert abs(found - volume_mm3) <= 0.01 * volume_mm3 + sampling
    # Errors of layers do not all point the same way: on these fine grids much less is left of them.
    assert abs(found - volume_mm3) <= 0.03 * volume_mm3


def fine_grid(size_mm: Floats) -> Grid:
    """Odd numbers of pixels that are no squares, for planes and rows that meet nothing by accident."""
    side = float(max(size_mm[:2]))
    return cover(size_mm, (side / 190.37, side / 151.71), float(size_mm[2]) / 50.83)


def cornered(solid: Solid) -> Solid:
    """From the bounding box minimum, as a mesh is placed."""
    return solid[0] - solid[0].min(axis=0), solid[1]


# ---------------------------------------------------------------------------------------------------------
# Areas and volumes


MORE_SOLIDS = [
    ("tetrahedron", lambda: meshes.tetrahedron(4.0)),
    ("three_overlapping", lambda: meshes.joined(meshes.sphere(), meshes.torus(), meshes.box((4.0, 4.0, 4.0)))),
    ("turned_island", lambda: turned_about((20, 30, 40), meshes.island_in_cavity())),
    ("turned_octahedra", lambda: turned_about((45, 0, 0), meshes.joined(meshes.octahedron(), meshes.box()))),
]
SOLIDS = dict(meshes.GENERATED + MORE_SOLIDS)

# Unions, by hand; the others' are their single body's.
VOLUMES_MM3 = {
    "box": 60.0,
    "nested_shells": 216.0 - 12.0,
    "island_in_cavity": 216.0 - 12.0 + 1.0,
    "turned_island": 216.0 - 12.0 + 1.0,
    "overlapping_boxes": 60.0 + 27.0 - 1.5 * 1.5 * 3.0,
    "box_inside_box": 125.0,
    "same_box_twice": 60.0,
    "boxes_sharing_edge": 2.0,
    "boxes_sharing_vertex": 3.0,
    "boxes_sharing_face": 2.0,
    "octahedron_on_planes": 4 / 3 * 8.0,
    "tetrahedron": 64 / 6,
}


def turned_about(angles: tuple[float, float, float], solid: Solid) -> Solid:
    return solid[0] @ rotation_matrix(angles).T, solid[1]


@functools.cache
def generated(name: str) -> tuple[Solid, list[Body]]:
    solid = cornered(SOLIDS[name]())
    return solid, bodies(solid)


def union_mm3(of: list[Body]) -> float:
    assert all(body.outward for body in of)
    manifolds = [body.manifold for body in of]
    return manifold3d.Manifold.batch_boolean(manifolds, manifold3d.OpType.Add).volume()


@pytest.mark.parametrize("name", SOLIDS)
def test_areas_and_volume_of_solids(name: str) -> None:
    solid, of = generated(name)
    grid = fine_grid(solid[0].max(axis=0))
    assert 30 <= grid.layers <= 200
    assert max(grid.columns, grid.rows) <= 300
    runs = slice_all(solid, grid)
    bound = assert_areas(runs, of)
    volume = VOLUMES_MM3[name] if name in VOLUMES_MM3 else union_mm3(of)
    assert_volume(runs, solid, volume, bound)


# Pixel and layer borders at every multiple of 1/8 mm, centres at every odd multiple of 1/16 mm. Scaled by
# 17/16, odd coordinates lie on centres; by 33/32, 2, 6, 10 ...; the last shares no binary fraction with
# anything: 1, 3, 5 ... lie on centres within rounding.
ON_PLANES = [("borders", 1.0, 1 / 8), ("odd", 17 / 16, 1 / 8), ("even", 33 / 32, 1 / 8), ("decimal", 1.0, 2 / 15)]


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize(("scale", "pitch_mm"), [row[1:] for row in ON_PLANES], ids=[row[0] for row in ON_PLANES])
def test_areas_with_faces_and_vertices_on_planes_and_rows(name: str, scale: float, pitch_mm: float) -> None:
    solid, _ = generated(name)
    scaled = solid[0] * scale, solid[1]
    grid = cover(scaled[0].max(axis=0), (pitch_mm, pitch_mm), pitch_mm)
    assert_areas(slice_all(scaled, grid), bodies(scaled))


# Volumes as the data folder's README gives them: unions.
DATA_SOLIDS = [
    ("featuretype.STL", 11.628),
    ("plate_holes.STL", 767_400),
    ("pyramids.3mf", 195_000),
    ("torus.3mf", 776.8),
    ("negative_indices.obj", 8.0),
    ("two_objects.obj", 1.0),
    ("shared.STL", 2.0),
    ("Globo.3mf", 60_960),
    ("large_block_obb.STL", None),
]


def data_mesh(name: str) -> tuple[Mesh, list[Body]]:
    assert DATA
    mesh = read_mesh(Path(DATA) / "meshes" / name)
    return mesh, bodies((mesh.vertices, mesh.triangles), by_place=name.lower().endswith(".stl"))


@needs_data
@pytest.mark.parametrize(("name", "volume_mm3"), DATA_SOLIDS, ids=[name for name, _ in DATA_SOLIDS])
def test_areas_and_volume_of_users_meshes(name: str, volume_mm3: float | None) -> None:
    mesh, of = data_mesh(name)
    solid = mesh.vertices, mesh.triangles
    grid = fine_grid(mesh.size_mm)
    if name == "large_block_obb.STL":
        grid = cover(mesh.size_mm, (10.0, 10.0), 10.0)
    assert 30 <= grid.layers <= 310
    assert max(grid.columns, grid.rows) <= 310
    runs = slice_all(solid, grid)
    bound = assert_areas(runs, of)
    assert_volume(runs, solid, volume_mm3 or union_mm3(of), bound)


@needs_data
@pytest.mark.parametrize("name", ["torus.3mf", "plate_holes.STL", "featuretype.STL", "shared.STL"])
def test_areas_of_users_meshes_with_vertices_on_planes(name: str) -> None:
    """Layers and rows through the very coordinates of vertices: the plane of layer 20 is a vertex's z."""
    mesh, of = data_mesh(name)
    middle = [np.unique(mesh.vertices[:, axis]) for axis in range(3)]
    chosen = [float(values[len(values) // 2]) for values in middle]
    pitch = chosen[0] / 60.5, chosen[1] / 60.5
    grid = cover(mesh.size_mm, pitch, chosen[2] / 20.5)
    assert_areas(slice_all((mesh.vertices, mesh.triangles), grid), of)


@needs_data
def test_cubes_sharing_an_edge_have_two_square_units_in_every_layer() -> None:
    mesh, _ = data_mesh("shared.STL")
    grid = cover(mesh.size_mm, (1 / 64, 1 / 64), 1 / 64)
    pixels = slice_all((mesh.vertices, mesh.triangles), grid).pixels
    np.testing.assert_allclose(pixels / 64**2, 2.0, rtol=1e-3)


def test_the_comparison_can_fail() -> None:
    """A band two pixels wide along one side, and layers shifted by one, are seen."""
    solid, of = generated("sphere")
    runs = slice_all(solid, fine_grid(solid[0].max(axis=0)))
    assert_areas(runs, of)
    wider = Runs(runs.layers, runs.grid, runs.row, runs.start, runs.stop + 2)
    with pytest.raises(AssertionError, match="mm2 off the section"):
        assert_areas(wider, of)
    later = Runs(runs.layers, runs.grid, runs.row + runs.grid.rows, runs.start, runs.stop)
    in_range = later.row < runs.layers * runs.grid.rows
    later = Runs(runs.layers, runs.grid, *(a[in_range] for a in (later.row, later.start, later.stop)))
    with pytest.raises(AssertionError, match="mm2 off the section"):
        assert_areas(later, of)
    with pytest.raises(AssertionError):
        assert_volume(runs, solid, 1.05 * union_mm3(of), np.zeros(runs.layers))


def test_the_reference_knows_overlaps_cavities_and_islands() -> None:
    """Half-way up, by hand."""
    overlap, cavity = generated("overlapping_boxes")[1], generated("island_in_cavity")[1]
    cut = section(overlap, 2.5)
    np.testing.assert_allclose([cut.area_mm2, cut.perimeter_mm], [12 + 9 - 2.25, 20.0], rtol=1e-6)
    assert cut.contours == 1
    cut = section(cavity, 3.0)
    np.testing.assert_allclose([cut.area_mm2, cut.perimeter_mm], [36 - 6 + 1, 24 + 10 + 4], rtol=1e-6)
    assert cut.contours == 3
    assert [body.outward for body in cavity] == [True, False, True]
    assert section(cavity, 6.5).area_mm2 == 0


@given(st.integers(0, 2**32 - 1), st.integers(4, 40), st.floats(0.02, 0.4), st.floats(0.3, 3.0))
@settings(deadline=None, max_examples=40)
def test_areas_of_random_hulls(seed: int, count: int, pitch: float, aspect: float) -> None:
    """Convex, where the bound is a theorem; pitches from 0.02 to 0.4 of the size."""
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3)) * random.uniform(0.3, 3, 3)
    hull = manifold3d.Manifold.hull_points(points)
    assume(hull.volume() > 1e-3)
    mesh = hull.to_mesh64()
    solid = cornered((np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)))
    size = solid[0].max(axis=0)
    side = pitch * float(size[:2].min())
    grid = cover(size, (side, side * aspect), float(size[2]) / 31.7)
    runs = slice_all(solid, grid)
    assert_areas(runs, bodies(solid))
    np.testing.assert_array_equal(runs.pixels, runs.solid().sum(axis=(1, 2)))


# ---------------------------------------------------------------------------------------------------------
# Every single pixel


def winding(points: Floats, solid: Solid) -> Floats:
    """How often a mesh winds around points: the sum of its triangles' solid angles (Van Oosterom, Strackee)."""
    corners = solid[0][solid[1]]
    total = np.zeros(len(points))
    for part in np.array_split(np.arange(len(points)), max(1, len(points) * len(corners) // 100_000)):
        a, b, c = np.moveaxis(corners[None] - points[part, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
        above = (a * np.cross(b, c)).sum(axis=2)
        below = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
        total[part] = np.arctan2(above, below).sum(axis=1) / (2 * np.pi)
    return total


def centres(grid: Grid, layer: Ints, row: Ints, column: Ints) -> Floats:
    px, py = grid.pitch_mm
    return np.stack([(column + 0.5) * px, (row + 0.5) * py, (layer + 0.5) * grid.layer_mm], axis=1)


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("pitch_mm", [1 / 8, 0.1])
def test_pixels_are_solid_where_the_mesh_winds_around_them(name: str, pitch_mm: float) -> None:
    """Samples of all pixels and of those beside the surface; those on it are left out."""
    solid, _ = generated(name)
    size = solid[0].max(axis=0)
    grid = cover(size, (pitch_mm, pitch_mm), pitch_mm)
    inside = slice_all(solid, grid).solid()
    border = (np.diff(inside, axis=2, prepend=False) != 0) | (np.diff(inside, axis=1, prepend=False) != 0)
    random = np.random.default_rng(4)
    wanted = min(400, 200_000 / len(solid[1]))
    chosen = random.random(inside.shape) < wanted / inside.size
    chosen |= border & (random.random(inside.shape) < wanted / border.sum())
    at = np.nonzero(chosen)
    points, found = centres(grid, *at), inside[at]
    step = 1e-6 * float(size.max()) * np.array([1.0, 0.7, 0.4])
    before, after = (np.rint(winding(points + way * step, solid)) for way in (-1, 1))
    clear = before == after
    assert clear.mean() > 0.5
    np.testing.assert_array_equal(found[clear], before[clear] > 0)


# The tie rule itself. Everything below is in binary fractions with heights of powers of two, so that a
# centre on the surface is on it exactly.
LATTICE = meshes.box((1 / 16, 1 / 16, 1 / 16))  # its far corner and all else on odd 1/16: centres at 1/8 mm
TIES: dict[str, Solid] = {
    "box": meshes.box((2.0, 1.0, 1.0)),
    "octahedron": meshes.moved(meshes.octahedron(1.0), (1.0, 1.0, 1.0)),
    "tetrahedron": meshes.tetrahedron(2.0),
    "mirrored_tetrahedron": (2.0 - meshes.tetrahedron(2.0)[0], meshes.tetrahedron(2.0)[1][:, ::-1]),
    "shared_face_x": meshes.joined(meshes.box((1.0, 1.0, 1.0)), meshes.box((1.0, 1.0, 1.0), (1.0, 0.0, 0.0))),
    "shared_face_y": meshes.joined(meshes.box((1.0, 1.0, 1.0)), meshes.box((1.0, 1.0, 1.0), (0.0, 1.0, 0.0))),
    "shared_face_z": meshes.joined(meshes.box((1.0, 1.0, 1.0)), meshes.box((1.0, 1.0, 1.0), (0.0, 0.0, 1.0))),
    "shared_edge": meshes.joined(meshes.box((1.0, 1.0, 1.0)), meshes.box((1.0, 1.0, 1.0), (1.0, 1.0, 0.0))),
    "shared_vertex": meshes.joined(meshes.box((1.0, 1.0, 1.0)), meshes.box((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))),
    "touching_cavity": meshes.joined(
        meshes.box((2.0, 2.0, 2.0)), meshes.turned(meshes.box((1.0, 1.0, 1.0), (0.0, 0.0, 0.5)))
    ),
}


@pytest.mark.parametrize("name", TIES)
def test_a_centre_on_the_surface_belongs_to_what_lies_above_right_and_behind(name: str) -> None:
    """Half-open: such a pixel is as solid as points a little further in z, less little in y, and in x."""
    solid = meshes.joined(LATTICE, meshes.moved(TIES[name], (1 / 16, 1 / 16, 1 / 16)))
    grid = cover(solid[0].max(axis=0), (1 / 8, 1 / 8), 1 / 8)
    inside = slice_all(solid, grid).solid()
    at = np.nonzero(np.ones_like(inside))
    points = centres(grid, *at)
    nudged = np.rint(winding(points + np.array([1e-4, 1e-6, 1e-8]), solid))
    opposite = np.rint(winding(points - np.array([1e-4, 1e-6, 1e-8]), solid))
    assert ((nudged > 0) != (opposite > 0)).sum() > 20  # many ties
    np.testing.assert_array_equal(inside[at], nudged > 0)


def pixels_of(text: str) -> NDArray[np.bool_]:
    """Rows as drawn: the first line is the largest y."""
    return np.array([[mark == "#" for mark in line] for line in reversed(text.split())])


def test_a_box_on_pixel_borders() -> None:
    """3 x 2 x 1 at (1, 1, 1) beside a box that holds the bounding box open: pixels typed by hand."""
    solid = meshes.joined(meshes.box((1.0, 1.0, 1.0)), meshes.box((3.0, 2.0, 1.0), (1.0, 1.0, 1.0)))
    grid = cover(solid[0].max(axis=0), (0.5, 1.0), 0.5)
    inside = slice_all(solid, grid).solid()
    assert inside.shape == (4, 3, 8)
    lower = pixels_of("........ ........ ##......")
    upper = pixels_of("..###### ..###### ........")
    np.testing.assert_array_equal(inside, [lower, lower, upper, upper])


def test_a_tetrahedron_by_hand() -> None:
    """x + y + z < 4 with centres at halves: their sums 1.5, 2.5 and 3.5 are inside, 4.5 is not."""
    inside = slice_all(meshes.tetrahedron(4.0), cover((4.0, 4.0, 4.0), (1.0, 1.0), 1.0)).solid()
    layers = [
        ".... #... ##.. ###.",
        ".... .... #... ##..",
        ".... .... .... #...",
        ".... .... .... ....",
    ]
    np.testing.assert_array_equal(inside, [pixels_of(text) for text in layers])


def test_a_tetrahedron_whose_faces_pass_through_centres() -> None:
    """From (0.5, 0.5, 0.5) on, x + y + z <= 5.5: centres on the low faces are in, on the slanted one out."""
    solid = meshes.tetrahedron(4.0, (0.5, 0.5, 0.5))
    inside = slice_all(solid, Grid(5, 5, 5, (1.0, 1.0), 1.0)).solid()
    layers = [
        "..... #.... ##... ###.. ####.",  # the sums of these are 1.5 ... 4.5; the next, 5.5, lie on the face
        "..... ..... #.... ##... ###..",
        "..... ..... ..... #.... ##...",
        "..... ..... ..... ..... #....",
        "..... ..... ..... ..... .....",
    ]
    np.testing.assert_array_equal(inside, [pixels_of(text) for text in layers])


def test_the_opposite_tetrahedron_whose_faces_pass_through_centres() -> None:
    """Up to (4.5, 4.5, 4.5), x + y + z >= 9.5: centres on the slanted face are in, on the high ones out."""
    vertices, triangles = meshes.tetrahedron(4.0)
    inside = slice_all((4.5 - vertices, triangles[:, ::-1]), Grid(5, 5, 5, (1.0, 1.0), 1.0)).solid()
    layers = [
        "..... ..... ..... ..... .....",  # 0.5 + 3.5 + 3.5 = 7.5 at most
        "..... ..... ..... ..... .....",
        "..... ...#. ..... ..... .....",  # 2.5 + 3.5 + 3.5 = 9.5: on the face
        "..... ..##. ...#. ..... .....",
        "..... ..... ..... ..... .....",  # 4.5 is the top face's own height
    ]
    np.testing.assert_array_equal(inside, [pixels_of(text) for text in layers])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("at", [1.0, 1.25, 1.5, 4 / 3, 1.1])
def test_two_boxes_sharing_a_face_leave_no_gap_and_share_no_pixel(axis: int, at: float) -> None:
    """The shared face on borders, on centres and elsewhere, along each axis."""
    size = [2.5, 2.5, 2.5]
    first, second, start = list(size), list(size), [0.0, 0.0, 0.0]
    first[axis], second[axis], start[axis] = at, 2.5 - at, at
    one = meshes.box((first[0], first[1], first[2]))
    other = meshes.box((second[0], second[1], second[2]), (start[0], start[1], start[2]))
    other[0][:, axis] = np.where(other[0][:, axis] > at, 2.5, at)  # exactly, without rounding of the sum
    grid = cover(size, (0.5, 0.5), 0.5)
    lower, upper, both = (slice_all(s, grid).solid() for s in (one, other, meshes.joined(one, other)))
    assert both.all()
    assert not (lower & upper).any()
    assert (lower | upper).all()
    assert lower.any()
    assert upper.any()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_face_on_centres_takes_them_below_and_gives_them_above(axis: int) -> None:
    """From 0.5 to 2.5 with centres at 0.5, 1.5, 2.5, 3.5: the first is in, the third is out."""
    low, size = [0.0, 0.0, 0.0], [4.0, 4.0, 4.0]
    low[axis], size[axis] = 0.5, 2.0
    solid = meshes.box((size[0], size[1], size[2]), (low[0], low[1], low[2]))
    inside = slice_all(solid, cover((4.0, 4.0, 4.0), (1.0, 1.0), 1.0)).solid()
    along = np.moveaxis(inside, 2 - axis, 0)
    np.testing.assert_array_equal(along.any(axis=(1, 2)), [True, True, False, False])
    np.testing.assert_array_equal(along.all(axis=(1, 2)), [True, True, False, False])


def test_thinner_than_a_pixel_is_sampled_as_it_is() -> None:
    """A wall of 0.2 px between two centres vanishes, one around a centre stays; no layer is invented."""
    walls = meshes.joined(
        meshes.box((4.0, 4.0, 0.2)),
        meshes.box((0.2, 4.0, 4.0), (0.6, 0.0, 0.0)),
        meshes.box((0.2, 4.0, 4.0), (2.4, 0.0, 0.0)),
    )
    inside = slice_all(walls, cover((4.0, 4.0, 4.0), (1.0, 1.0), 1.0)).solid()
    np.testing.assert_array_equal(inside, np.broadcast_to([False, False, True, False], (4, 4, 4)))


# Turning a part leaves noise of a few units in the last place on its flat faces: one that lies on a plane of
# centres (here the 65th, at 6.45 mm) then has corners a bit below and a bit above it.
BIT = float(np.spacing(64.5 * 0.1))
NOISE = [(-2, -2, 1, 2), (-2, -2, 2, 1), (1, -1, 0, 2), (1, -2, -1, 2), (-2, 0, 1, 2), (0, 0, 0, 0), (1, 1, 1, 1)]


def pin(axis: int, noise: tuple[int, int, int, int]) -> Solid:
    """From (4, 4, 4) to (5, 5, 5), but along one axis to the plane, with noise."""
    vertices, triangles = meshes.box((1.0, 1.0, 1.0), (4.0, 4.0, 4.0))
    vertices[vertices[:, axis] == 5.0, axis] = 64.5 * 0.1 + np.array(noise) * BIT
    return vertices, triangles


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_noise_on_a_plane_of_centres_reaches_no_pixel_outside(axis: int, noise: tuple[int, int, int, int]) -> None:
    inside = slice_all(pin(axis, noise), Grid(100, 100, 100, (0.1, 0.1), 0.1)).solid()
    expected = [(40, 49)] * 3
    found = [(int(at.min()), int(at.max())) for at in np.nonzero(inside)[::-1]]  # x, y, z
    low, high = found.pop(axis)
    assert low == 40
    assert high in (63, 64)
    assert found == expected[:2]


def test_a_turned_part_with_a_face_on_a_plane_stays_inside_itself() -> None:
    """Drawn tilted, turned flat again: its top is horizontal within rounding and on the last plane."""
    outside = []
    for angle in range(5, 90, 5):
        for top in range(3, 40, 2):
            slab = meshes.box((20.0, 10.0, 0.1))
            pin = meshes.box((2.0, 2.0, (top + 0.5) * 0.1), (9.0, 4.0, 0.0))
            vertices, triangles = turned_about((angle, 0, 0), meshes.joined(slab, pin))
            minimum = vertices.min(axis=0)
            mesh = Mesh("", "", vertices - minimum, triangles, minimum, 1.0, False, ())
            _, placed = place(mesh, rotate_deg=(-angle, 0, 0))
            grid = Grid(200, 100, top + 1, (0.1, 0.1), 0.1)
            layer = make_slicer(placed, triangles, grid).runs(top, top + 1).solid()[0]
            layer[39:61, 89:111] = False  # the pin, and a pixel around it
            if layer.any():
                outside.append((angle, top, int(layer.sum())))
    assert not outside, f"pixels outside the part at (angle, layer, pixels): {outside}"


# ---------------------------------------------------------------------------------------------------------
# What must not matter


INVARIANT = ["torus", "island_in_cavity", "same_box_twice", "octahedron_on_planes", "random_boolean_1", "star"]


@pytest.mark.parametrize("name", INVARIANT)
@pytest.mark.parametrize("pitch_mm", [1 / 8, 0.1])
def test_order_of_triangles_and_corners_does_not_matter(name: str, pitch_mm: float) -> None:
    solid, _ = generated(name)
    grid = cover(solid[0].max(axis=0), (pitch_mm, pitch_mm), pitch_mm)
    expected = slice_all(solid, grid)
    random = np.random.default_rng(2)
    for _ in range(3):
        vertices, triangles = solid
        renumbered = random.permutation(len(vertices))
        shuffled = random.permutation(triangles)
        rolled = (np.arange(3) + random.integers(0, 3, len(triangles))[:, None]) % 3
        shuffled = np.argsort(renumbered)[np.take_along_axis(shuffled, rolled, axis=1)]
        found = slice_all((vertices[renumbered], shuffled), grid)
        np.testing.assert_array_equal(found.solid(), expected.solid())
        assert_same_runs(found, expected)


def assert_same_runs(found: Runs, expected: Runs) -> None:
    assert (found.layers, found.grid) == (expected.layers, expected.grid)
    for name in ("row", "start", "stop"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("name", INVARIANT)
@pytest.mark.parametrize("cuts", [(), (7,), (0, 1, 2, 3), (5, 5, 20), (13, 26, 39)])
def test_layers_in_pieces_are_the_same(name: str, cuts: tuple[int, ...]) -> None:
    solid, _ = generated(name)
    size = solid[0].max(axis=0)
    grid = cover(size, (0.1, 0.1), float(size[2]) / 40)
    slicer = make_slicer(solid[0], solid[1], grid)
    ends = [0, *cuts, grid.layers]
    pieces = [slicer.runs(a, b) for a, b in pairwise(ends)]
    together = slicer.runs(0, grid.layers)
    assert_same_runs(join_runs(pieces), together)
    stacked = np.concatenate([piece.solid() for piece in pieces])
    np.testing.assert_array_equal(stacked, together.solid())


def test_no_layers_and_layers_above_the_part_are_empty() -> None:
    slicer = make_slicer(*meshes.box(), Grid(3, 4, 9, (1.0, 1.0), 1.0))
    nothing = slicer.runs(2, 2)
    assert nothing.solid().shape == (0, 4, 3)
    assert nothing.pixels.shape == (0,)
    above = slicer.runs(5, 9)
    np.testing.assert_array_equal(above.pixels, [0, 0, 0, 0])
    assert not above.solid().any()


# Coordinates are multiples of 1/64, so that these moves are exact in float64.
MOVES = [(0.0, 0.0, 0.0), (1024.0, -4096.0, 0.015625), (-(2.0**30), 2.0**31, 2.0**32), (1 / 64, 1 / 32, -7.0)]


def test_exact_moves_change_nothing(tmp_path: Path) -> None:
    """From the file on, with a rotation and without."""
    vertices, triangles = meshes.random_boolean(3)
    solid = np.round(vertices * 64) / 64, triangles
    for angles in ((0.0, 0.0, 0.0), (20.0, 30.0, 40.0)):
        found = []
        for number, move in enumerate(MOVES):
            path = tmp_path / f"{number}.obj"
            path.write_bytes(meshes.obj(meshes.moved(solid, move)))
            mesh = read_mesh(path)
            placement, placed = place(mesh, rotate_deg=angles)
            grid = cover(placement.size_mm, (0.07, 0.09), 0.11)
            found.append(slice_all((placed, mesh.triangles), grid))
        assert found[0].pixels.sum() > 1000
        for runs in found[1:]:
            assert_same_runs(runs, found[0])


@pytest.mark.parametrize("name", SOLIDS)
def test_pixels_counts_what_solid_shows(name: str) -> None:
    solid, _ = generated(name)
    grid = cover(solid[0].max(axis=0), (0.11, 0.07), 0.13)
    runs = slice_all(solid, grid)
    inside = runs.solid()
    assert inside.shape == (grid.layers, grid.rows, grid.columns)
    np.testing.assert_array_equal(runs.pixels, inside.sum(axis=(1, 2)))
    part = make_slicer(solid[0], solid[1], grid).runs(3, grid.layers - 3)
    np.testing.assert_array_equal(part.pixels, runs.pixels[3:-3])


def test_runs_are_in_order_and_do_not_overlap() -> None:
    solid, _ = generated("island_in_cavity")
    runs = slice_all(solid, cover(solid[0].max(axis=0), (0.1, 0.1), 0.1))
    assert (runs.start < runs.stop).all()
    same = np.diff(runs.row) == 0
    assert (np.diff(runs.row) >= 0).all()
    assert (runs.stop[:-1] <= runs.start[1:])[same].all()


# ---------------------------------------------------------------------------------------------------------
# Leaks


def without(solid: Solid, triangle: int) -> Solid:
    return solid[0], np.delete(solid[1], triangle, axis=0)


# Half of a box's side x = 0 is missing: its corners are at (y, z) = (0, 0), (0, 5), (4, 5), so layer l has the
# hole y < 0.8 z, that is y below 0.4, 1.2, 2.0, 2.8 and 3.6 mm, which 0, 1, 2, 3 and 4 rows of 1 mm enter.
HOLED = make_slicer(*without(meshes.box(), 0), Grid(3, 4, 5, (1.0, 1.0), 1.0))


@pytest.mark.parametrize(
    ("layers", "layer", "z_mm"), [((0, 5), 1, 1.5), ((1, 2), 1, 1.5), ((2, 3), 2, 2.5), ((3, 5), 3, 3.5)]
)
def test_a_leak_is_refused_with_its_place(layers: tuple[int, int], layer: int, z_mm: float) -> None:
    np.testing.assert_array_equal(HOLED.runs(0, 1).pixels, [12])  # the hole has not begun
    with pytest.raises(PartError) as caught:
        HOLED.runs(*layers)
    message = str(caught.value)
    assert re.search(rf"\blayer {layer}\b", message)
    assert re.search(rf"z = {z_mm}0* mm", message)
    assert re.search(r"y = 0\.50* mm", message)
    assert caught.value.hint


@pytest.mark.parametrize(("layers", "rows"), [((1, 2), 1), ((2, 3), 2), ((3, 5), 3 + 4), ((0, 5), 1 + 2 + 3 + 4)])
def test_leaking_rows_are_counted(layers: tuple[int, int], rows: int) -> None:
    """Rows that close are none of them, even behind one that leaks."""
    with pytest.raises(PartError, match=rf"\b{rows} pixel rows?\b"):
        HOLED.runs(*layers)


@pytest.mark.parametrize("name", ["sphere", "torus", "octahedron_on_planes", "tetrahedron", "nested_shells"])
def test_no_missing_triangle_goes_unnoticed(name: str) -> None:
    """Unless it is seen from its side (no row enters through it) some row leaks."""
    solid, _ = generated(name)
    corners = solid[0][solid[1]]
    facing_x = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 0]) / 2
    grid = cover(solid[0].max(axis=0), (0.05, 0.02), 0.02)
    large = np.flatnonzero(facing_x > 0.05)
    assert len(large) > 1
    for triangle in large[:: max(1, len(large) // 8)]:
        with pytest.raises(PartError, match=r"leaks in layer \d+ .* y = \d"):
            slice_all(without(solid, int(triangle)), grid)


def test_volume_of_a_sphere_by_formula() -> None:
    """The icosphere of 1 280 triangles has 0.9 % less volume than the sphere; pixels add almost nothing."""
    solid, _ = generated("sphere")
    grid = cover(solid[0].max(axis=0), (0.04, 0.05), 0.03)
    found = int(slice_all(solid, grid).pixels.sum()) * grid.voxel_mm3
    assert 0.98 < found / (4 / 3 * math.pi * 27) < 1
