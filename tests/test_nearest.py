"""Nearest points of a surface and depths below it, against brute force and formulas."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import meshes
import numpy as np
import pytest
from meshes import Solid
from numpy.typing import NDArray

from amslicer.nearest import Surface, barycentric, surface_of

Floats = NDArray[np.float64]


def surface(solid: Solid) -> Surface:
    return Surface.of(*solid)


def points(count: int, low: float, high: float, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def segment_distance(p: Floats, a: Floats, b: Floats) -> Floats:
    along = np.clip(((p - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0, 1)[..., None]
    return np.asarray(np.linalg.norm(p - a - along * (b - a), axis=-1))


def brute_force(solid: Solid, places: Floats) -> Floats:
    """Distances by the plane where the foot lies in the triangle, else by its three sides."""
    a, b, c = np.moveaxis(solid[0][solid[1]], 1, 0)
    p = places[:, None, :]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sides = np.stack([(np.cross(e - s, p - s) * normal).sum(-1) for s, e in ((a, b), (b, c), (c, a))])
    plane = np.where((sides >= 0).all(axis=0), np.abs(((p - a) * normal).sum(-1)), np.inf)
    edges = np.min([segment_distance(p, s, e) for s, e in ((a, b), (b, c), (c, a))], axis=0)
    return np.asarray(np.minimum(plane, edges).min(axis=1))


def box_depth(places: Floats, size: float) -> Floats:
    """Signed distance to a cube from 0 to size: positive inside."""
    q = np.abs(places - size / 2) - size / 2
    return -(np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0))


@pytest.mark.parametrize(
    "name", ["star", "random_boolean_1", "perforated_plate", "nested_shells", "octahedron_on_planes"]
)
def test_distance_is_that_of_brute_force(name: str) -> None:
    solid = dict(meshes.GENERATED)[name]()
    places = points(400, -6, 12)
    found, piece, closest = surface(solid).nearest(places)
    np.testing.assert_allclose(found, brute_force(solid, places), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(places - closest, axis=1), found, atol=1e-9)
    assert brute_force(solid, closest).max() < 1e-9
    on_piece = barycentric(surface(solid).corners[piece], closest)
    np.testing.assert_allclose(np.einsum("nk,nkc->nc", on_piece, surface(solid).corners[piece]), closest, atol=1e-9)


def test_depth_of_a_cube_through_its_skin() -> None:
    places = points(5000, -1, 5)
    found = surface(meshes.box((4.0, 4.0, 4.0))).depths(places, -100, 100, 0.1)
    np.testing.assert_allclose(found, box_depth(places, 4.0), atol=1e-9)


@pytest.mark.parametrize("spacing", [0.01, 0.1, 1.0])
@pytest.mark.parametrize(("low", "high"), [(-0.2, 0.5), (-0.05, 0.3), (-1.0, 3.0)])
def test_blocks_change_no_value(spacing: float, low: float, high: float) -> None:
    of = surface(meshes.sphere(3.0, 3))
    places = points(3000, -3.5, 3.5)
    each = np.clip(np.where(of.inside(places), 1, -1) * of.nearest(places)[0], low, high)
    np.testing.assert_array_equal(of.depths(places, low, high, spacing), each)
    np.testing.assert_array_equal(of.depths(places[::-1][:777], low, high, spacing), each[::-1][:777])


def test_ties_do_not_depend_on_the_other_points() -> None:
    of = surface(meshes.sphere(3.0, 2))
    steps = np.linspace(-3, 3, 13)  # many of them equally near to several triangles
    places = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    for found, again in zip(of.nearest(places), of.nearest(places[::-1][:500]), strict=True):
        np.testing.assert_array_equal(found[::-1][:500], again)


def test_triangles_without_area_do_not_matter() -> None:
    vertices, triangles = meshes.box((4.0, 4.0, 4.0))
    sliver = np.array([[0, 0, 1], [0, 7, 0]])
    places = points(500, -1, 5)
    found = Surface.of(vertices, np.concatenate([sliver, triangles])).depths(places, -9, 9, 0.5)
    np.testing.assert_allclose(found, box_depth(places, 4.0), atol=1e-9)


def test_touching_bodies_have_no_wall_between() -> None:
    solid = meshes.joined(meshes.box((4.0, 4.0, 2.0)), meshes.box((4.0, 4.0, 2.0), (0.0, 0.0, 2.0)))
    places = points(3000, -1, 5)
    outer = surface(solid).without_inner_walls()
    np.testing.assert_allclose(outer.depths(places, -9, 9, 0.2), box_depth(places, 4.0), atol=1e-9)
    assert surface(solid).depths(np.array([[2.0, 2.0, 2.0]]), -9, 9, 0.2)[0] == pytest.approx(0, abs=1e-9)


def test_overlapping_bodies_are_one_solid() -> None:
    """A bar through a cube: near the crossing walls are cut to 1/200 of the size, elsewhere exact."""
    solid = meshes.joined(meshes.box((4.0, 4.0, 4.0)), meshes.box((8.0, 2.0, 2.0), (-2.0, 1.0, 1.0)))
    outer = surface(solid).without_inner_walls()
    places = points(20000, 0.0, 4.0)
    x, y, z = places.T
    outside_bar = np.maximum(np.abs(y - 2), np.abs(z - 2)) - 1
    # Solid: the cube, and beyond x = 0 and 4 the bar. The walls at x = 0 and 4 are open where the bar goes through.
    to_sides = np.minimum(np.minimum(y, 4 - y), np.minimum(z, 4 - z))
    end = np.minimum(x, 4 - x)
    hole = np.where(outside_bar >= 0, end, np.hypot(end, -np.minimum(outside_bar, 0)))
    expected = np.minimum(to_sides, hole)
    found = outer.depths(places, -9, 9, 0.2)
    assert np.abs(found - expected).max() < 8 / 200
    assert np.median(np.abs(found - expected)) < 1e-9
    wall = np.array([[0.0, 2.0, 2.0], [-1.0, 2.0, 2.0]])
    assert surface(solid).depths(wall, -9, 9, 0.2)[0] == pytest.approx(0)
    np.testing.assert_allclose(outer.depths(wall, -9, 9, 0.2), [1.0, 1.0], atol=8 / 200)


def test_a_body_within_another_is_no_surface() -> None:
    solid = meshes.joined(meshes.box((4.0, 4.0, 4.0)), meshes.box((1.0, 2.0, 1.0), (1.0, 1.0, 1.0)))
    places = points(2000, 0, 4)
    found = surface(solid).without_inner_walls().depths(places, -9, 9, 0.2)
    np.testing.assert_allclose(found, box_depth(places, 4.0), atol=1e-9)


def test_cavities_stay() -> None:
    solid = meshes.joined(meshes.box((6.0, 6.0, 6.0)), meshes.turned(meshes.box((2.0, 2.0, 2.0), (2.0, 2.0, 2.0))))
    places = points(2000, 0, 6)
    found = surface(solid).without_inner_walls().depths(places, -9, 9, 0.2)
    expected = np.minimum(box_depth(places, 6.0), -box_depth(places - 2.0, 2.0))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_depth_below_the_top_of_a_cube() -> None:
    of = surface(meshes.box((4.0, 4.0, 4.0)))
    top = of.only(of.normals[:, 2] > 0.9)
    inside = points(1000, 0.01, 3.99)
    np.testing.assert_allclose(top.depths(inside, -1, 9, 0.1), 4 - inside[:, 2], atol=1e-9)
    above, beside = np.array([[2.0, 2.0, 4.3]]), np.array([[4.001, 2.0, 1.0], [-0.001, 2.0, 3.5]])
    np.testing.assert_allclose(top.depths(above, -1, 9, 0.1), [-0.3], atol=1e-9)
    np.testing.assert_allclose(top.depths(beside, -1, 9, 0.1), [3.0, 0.5], atol=1e-3)


def test_barycentric() -> None:
    corners = points(30, -1, 1).reshape(10, 3, 3)
    shares = np.random.default_rng(1).dirichlet((1, 1, 1), 10)
    found = barycentric(corners, np.einsum("nk,nkc->nc", shares, corners))
    np.testing.assert_allclose(found, shares, atol=1e-9)


def test_thin_walls_stay_the_surface_and_do_not_hide_touching_ones() -> None:
    """A film, and a block under one corner of it."""
    film = meshes.box((200.0, 200.0, 0.015), (0.0, 0.0, 10.0))
    solid = meshes.joined(film, meshes.box((20.0, 20.0, 10.0)))
    outer = surface(solid).without_inner_walls()
    middle = np.array([[100.0, 100.0, 10.0075]])
    np.testing.assert_allclose(outer.depths(middle, -1, 1, 0.5), [0.0075], atol=1e-9)
    under = np.array([[10.0, 10.0, 9.0]])  # the block's top is no surface: 1.015 mm below the film's
    np.testing.assert_allclose(outer.depths(under, -9, 9, 0.5), [1.015], atol=1e-3)


@pytest.mark.parametrize("shift", [(2.5, 0.0, 0.0), (5.0, 0.4, 0.1), (9.0, 0.0, 0.0)])
def test_walls_of_spheres_that_overlap_are_those_of_formulas(shift: tuple[float, float, float]) -> None:
    solid = meshes.joined(meshes.sphere(3.0, 4), meshes.moved(meshes.sphere(3.0, 4), shift))
    corners = surface(solid).without_inner_walls().corners
    centres = corners.mean(axis=1)
    size = float(np.ptp(solid[0], axis=0).max())
    for middle in (np.zeros(3), np.array(shift)):
        assert np.linalg.norm(centres - middle, axis=1).min() > 3.0 - size / 100
    # What two spheres have in common is twice a cap's height deep.
    cap = max(3.0 - np.linalg.norm(shift) / 2, 0.0)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(2 * (4 * np.pi * 9 - 2 * np.pi * 3 * cap), rel=0.01)


def test_only_triangles_in_another_bodys_box_are_looked_at() -> None:
    solid = meshes.joined(meshes.sphere(3.0, 4), meshes.moved(meshes.sphere(3.0, 4), (5.0, 0.0, 0.0)))
    met = surface(solid)._may_be_within_another()
    centres = solid[0][solid[1]].mean(axis=1)
    assert not met[(centres[:, 0] < 1.5) | (centres[:, 0] > 3.5)].any()
    assert met[(centres[:, 0] > 2) & (centres[:, 0] < 3)].all()


def test_a_surface_is_made_once_for_several_fields() -> None:
    vertices, triangles = meshes.joined(meshes.box(), meshes.box((1.0, 1.0, 9.0), (1.0, 1.0, 1.0)))
    with ThreadPoolExecutor(4) as pool:
        made = list(pool.map(lambda _: surface_of(vertices, triangles), range(8)))
    assert all(one is made[0] for one in made)
    walls = surface_of(vertices, triangles, inner_walls=True)
    assert len(walls.corners) == 24
    some = made[0].only(made[0].normals[:, 2] > 0.5)
    del made
    assert surface_of(vertices, triangles) is some.parts_of
