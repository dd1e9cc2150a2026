"""Scale, rotation and bed against scipy's rotations and typed values."""

from __future__ import annotations

import meshes
import numpy as np
import pytest
from meshes import Solid
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from amslicer.mesh import Mesh
from amslicer.placement import Placement, place, rotation_matrix, rotation_matters

Floats = NDArray[np.float64]

IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
ANGLES = [
    (0.0, 0.0, 0.0),
    (30.0, 0.0, 0.0),
    (0.0, -47.0, 0.0),
    (0.0, 0.0, 123.456),
    (10.0, 20.0, 30.0),
    (90.0, 35.0, -90.0),
    (-200.0, 700.0, 0.001),
]
# One point of each octant and away from the axes, so that nothing cancels.
POINTS = np.random.default_rng(5).uniform(-30, 30, (40, 3))


def mesh_of(solid: Solid, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A mesh as if read from a file in which the solid stands at a place."""
    vertices = solid[0] + np.array(at)
    minimum = vertices.min(axis=0)
    return Mesh("part.stl", "", vertices - minimum, solid[1], minimum, 1.0, False, ())


def skewed() -> Mesh:
    """No symmetry, none of its bounding box's corners filled, far from the origin."""
    return mesh_of(meshes.random_boolean(2), (11.0, -7.0, 5.0))


def in_file(mesh: Mesh) -> Floats:
    return mesh.vertices + mesh.minimum_mm


def scipy_turn(points: Floats, angles: tuple[float, float, float]) -> Floats:
    """About the fixed x, then y, then z axis: lower case is extrinsic."""
    return np.asarray(Rotation.from_euler("xyz", angles, degrees=True).apply(points))


def apply(placement: Placement, points: Floats) -> Floats:
    matrix = np.array(placement.transform())
    assert matrix.shape == (4, 4)
    np.testing.assert_array_equal(matrix[3], [0, 0, 0, 1])
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize("angles", ANGLES)
def test_rotation_is_about_x_then_y_then_z(angles: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(POINTS @ rotation_matrix(angles).T, scipy_turn(POINTS, angles), atol=1e-11)


def test_another_order_would_be_noticed() -> None:
    wrong = Rotation.from_euler("XYZ", (10.0, 20.0, 30.0), degrees=True).apply(POINTS)
    assert np.abs(POINTS @ rotation_matrix((10.0, 20.0, 30.0)).T - wrong).max() > 1


@pytest.mark.parametrize(
    ("angles", "matrix"),
    [
        ((0, 0, 0), IDENTITY),
        ((90, 0, 0), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),  # y to z
        ((0, 90, 0), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),  # z to x
        ((0, 0, 90), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # x to y
        ((-90, 0, 0), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ((0, 0, 180), [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        ((0, 0, -180), [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        ((0, 0, 270), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
        ((360, -720, 1080), IDENTITY),
        ((450, 0, 0), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ((90, 0, 90), [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),  # y to z, then x to y
        ((90, 90, 90), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    ],
)
def test_quarter_turns_are_exact(angles: tuple[float, float, float], matrix: list[list[int]]) -> None:
    np.testing.assert_array_equal(rotation_matrix(angles), matrix)


def test_whole_turns_do_not_matter() -> None:
    assert not rotation_matters(rotation_matrix((360.0, 0.0, -360.0)), 1.0)
    assert rotation_matters(rotation_matrix((90.0, 0.0, 0.0)), 1.0)
    assert rotation_matters(rotation_matrix((0.0, 0.0, 0.0)), 2.0)


def test_nothing_to_do_changes_no_bit() -> None:
    mesh = skewed()
    placement, vertices = place(mesh, on_bed=False)
    np.testing.assert_array_equal(vertices, mesh.vertices)
    np.testing.assert_array_equal(placement.low_mm, [0, 0, 0])
    np.testing.assert_array_equal(placement.origin_mm, mesh.minimum_mm)
    np.testing.assert_array_equal(placement.file_minimum_mm, mesh.minimum_mm)
    np.testing.assert_array_equal(placement.size_mm, mesh.size_mm)
    np.testing.assert_array_equal(placement.transform(), [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert placement.lifted_mm == 0


def test_a_quarter_turn_of_a_box_by_hand() -> None:
    """3 x 4 x 5 from (10, 20, 30) about x: (x, y, z) goes to (x, -z, y), so y spans -35 ... -30."""
    mesh = mesh_of(meshes.box(), (10.0, 20.0, 30.0))
    placement, vertices = place(mesh, rotate_deg=(90, 0, 0), on_bed=False)
    np.testing.assert_array_equal(placement.size_mm, [3, 5, 4])
    np.testing.assert_array_equal(placement.origin_mm, [10, -35, 20])
    np.testing.assert_array_equal(vertices.min(axis=0), [0, 0, 0])
    np.testing.assert_array_equal(vertices.max(axis=0), [3, 5, 4])
    low, _ = place(mesh, rotate_deg=(90, 0, 0), on_bed=True)
    np.testing.assert_array_equal(low.origin_mm, [10, -35, 0])
    assert low.lifted_mm == -20


def test_scale_comes_before_the_bed_and_is_about_the_files_origin() -> None:
    mesh = mesh_of(meshes.box(), (10.0, 20.0, -30.0))
    placement, vertices = place(mesh, scale=2.0, on_bed=True)
    np.testing.assert_array_equal(placement.size_mm, [6, 8, 10])
    np.testing.assert_array_equal(placement.origin_mm, [20, 40, 0])
    np.testing.assert_array_equal(vertices, 2 * mesh.vertices)
    assert placement.lifted_mm == 60


@pytest.mark.parametrize("on_bed", [True, False])
@pytest.mark.parametrize("scale", [1.0, 0.3, 25.4])
@pytest.mark.parametrize("angles", ANGLES)
def test_transform_maps_the_file_to_the_printer(angles: tuple[float, float, float], scale: float, on_bed: bool) -> None:
    mesh = skewed()
    placement, vertices = place(mesh, scale=scale, rotate_deg=angles, on_bed=on_bed)
    expected = scipy_turn(scale * in_file(mesh), angles)
    lowest = expected[:, 2].min()
    if on_bed:
        expected[:, 2] -= lowest
        np.testing.assert_allclose(placement.lifted_mm, -lowest, atol=1e-9)
        assert placement.origin_mm[2] == 0
    else:
        assert placement.lifted_mm == 0
    np.testing.assert_allclose(apply(placement, in_file(mesh)), expected, atol=1e-9)
    np.testing.assert_allclose(vertices + placement.origin_mm, expected, atol=1e-9)
    np.testing.assert_allclose(placement.origin_mm, expected.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(placement.size_mm, np.ptp(expected, axis=0), atol=1e-9)
    np.testing.assert_array_equal(vertices.min(axis=0), [0, 0, 0])


@pytest.mark.parametrize("angles", ANGLES)
def test_the_bed_keeps_x_and_y(angles: tuple[float, float, float]) -> None:
    mesh = skewed()
    flying, above = place(mesh, rotate_deg=angles, on_bed=False)
    lying, below = place(mesh, rotate_deg=angles, on_bed=True)
    np.testing.assert_array_equal(lying.origin_mm[:2], flying.origin_mm[:2])
    np.testing.assert_array_equal(above, below)
    assert lying.origin_mm[2] == 0
    np.testing.assert_allclose(flying.origin_mm[2], -lying.lifted_mm)
    assert abs(lying.lifted_mm) > 0.1  # otherwise nothing was tested


@pytest.mark.parametrize("scale", [1.0, 0.3, 25.4])
@pytest.mark.parametrize("angles", ANGLES)
def test_to_field_is_the_way_back(angles: tuple[float, float, float], scale: float) -> None:
    """Any point, inside the part or not: file, printer, pattern frame, and back to the field frame."""
    mesh = skewed()
    placement, vertices = place(mesh, scale=scale, rotate_deg=angles)
    pattern = scipy_turn(scale * POINTS, angles)
    pattern -= scipy_turn(scale * in_file(mesh), angles).min(axis=0)
    x, y, z = placement.to_field(*pattern.T)
    np.testing.assert_allclose(np.stack([x, y, z], axis=1), POINTS - mesh.minimum_mm, atol=1e-9)
    back = np.stack(placement.to_field(*vertices.T), axis=1)
    np.testing.assert_allclose(back, mesh.vertices, atol=1e-9)
    assert back.dtype == np.float64


def test_to_field_broadcasts_and_keeps_what_does_not_vary_small() -> None:
    mesh = skewed()
    x, y, z = np.arange(5.0), np.arange(4.0)[:, None], np.array(2.0)
    unturned, _ = place(mesh)
    field = unturned.to_field(x, y, z)
    assert [side.shape for side in field] == [(5,), (4, 1), ()]
    for side, given in zip(field, (x, y, z), strict=True):
        np.testing.assert_array_equal(side, given)
    for angles in ((0.0, 0.0, 90.0), (0.0, 0.0, 40.0), (20.0, 30.0, 40.0)):
        turned, _ = place(mesh, rotate_deg=angles)
        on_grid = np.broadcast_arrays(*turned.to_field(x, y, z), np.zeros((4, 5)))[:3]
        points = np.stack([np.broadcast_to(side, (4, 5)).ravel() for side in (x, y, z)])
        one_by_one = turned.to_field(*points)
        for side, expected in zip(on_grid, one_by_one, strict=True):
            np.testing.assert_allclose(side.ravel(), expected, atol=1e-12)


def test_a_quarter_turn_back_to_the_field_by_hand() -> None:
    """About z, file x points along printer y: printer (px, py) was file (py, 4 - px) of a 3 x 4 box."""
    placement, _ = place(mesh_of(meshes.box(), (10.0, 20.0, 30.0)), rotate_deg=(0, 0, 90))
    x, y, z = placement.to_field(np.array([1.0]), np.array([2.0]), np.array([3.0]))
    assert (float(x[0]), float(y[0]), float(z[0])) == (2, 3, 3)


@pytest.mark.parametrize("angles", ANGLES)
@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_directions_turn_without_scale_or_shift(angles: tuple[float, float, float], scale: float) -> None:
    directions = POINTS / np.linalg.norm(POINTS, axis=1)[:, None]
    placement, _ = place(skewed(), scale=scale, rotate_deg=angles)
    np.testing.assert_allclose(placement.turn(directions), scipy_turn(directions, angles), atol=1e-12)


def test_a_direction_along_x_turned_about_z_points_along_y() -> None:
    placement, _ = place(skewed(), rotate_deg=(0, 0, 90))
    np.testing.assert_array_equal(placement.turn(np.array([[1.0, 0.0, 0.0]])), [[0, 1, 0]])


@pytest.mark.parametrize(
    ("angles", "varies", "expected"),
    [
        ((0, 0, 0), (True, True, False), False),
        ((0, 0, 0), (False, False, True), True),
        ((0, 0, 37), (True, True, False), False),
        ((0, 0, 37), (False, False, True), True),
        ((90, 0, 0), (False, True, False), True),  # file y is printer z
        ((90, 0, 0), (True, False, True), False),
        ((0, 90, 0), (True, False, False), True),  # file x is printer -z
        ((30, 40, 0), (True, False, False), True),
        ((30, 40, 0), (False, False, False), False),
    ],
)
def test_depends_on_z(angles: tuple[float, float, float], varies: tuple[bool, bool, bool], expected: bool) -> None:
    assert place(skewed(), rotate_deg=angles)[0].depends_on_z(varies) is expected


def test_moving_the_file_moves_only_the_origin() -> None:
    near, far = mesh_of(meshes.octahedron(), (0.0, 0.0, 0.0)), mesh_of(meshes.octahedron(), (64.0, -128.0, 32.0))
    (one, here), (other, there) = (place(mesh, rotate_deg=(20, 30, 40)) for mesh in (near, far))
    np.testing.assert_array_equal(here, there)
    np.testing.assert_array_equal(one.size_mm, other.size_mm)
    np.testing.assert_array_equal(one.low_mm, other.low_mm)
    shift = scipy_turn(np.array([[64.0, -128.0, 32.0]]), (20, 30, 40))[0]
    np.testing.assert_allclose((other.origin_mm - one.origin_mm)[:2], shift[:2], atol=1e-10)


def test_place_leaves_the_mesh_alone() -> None:
    mesh = skewed()
    vertices, minimum = mesh.vertices.copy(), mesh.minimum_mm.copy()
    place(mesh, scale=2.0, rotate_deg=(20, 30, 40))
    place(mesh)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.minimum_mm, minimum)
