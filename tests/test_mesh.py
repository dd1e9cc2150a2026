"""What read_mesh accepts, with volumes known independently, and what it refuses, with the reason."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable
from pathlib import Path

import manifold3d
import meshes
import numpy as np
import pytest
import trimesh
from meshes import Solid
from scipy.sparse import coo_array, csgraph

from amslicer.components import connected_components
from amslicer.errors import PartError
from amslicer.mesh import Mesh, read_mesh
from amslicer.meshfiles import threemf_package
from amslicer.meshfiles.stl import read_stl

BOX = meshes.box()  # 3 x 4 x 5
HOLED: Solid = (BOX[0], BOX[1][:-2])  # without the face at z = 5
NS_3MF = "http://schemas.microsoft.com/3dmanufacturing"


def put(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def with_vertex(solid: Solid, index: int, value: tuple[float, float, float]) -> Solid:
    vertices = solid[0].copy()
    vertices[index] = value
    return vertices, solid[1]


def with_corner(solid: Solid, index: int) -> Solid:
    triangles = solid[1].copy()
    triangles[4, 1] = index
    return solid[0], triangles


def assert_solid(mesh: Mesh, volume_mm3: float, size_mm: tuple[float, float, float]) -> None:
    """Volume and size, the first corner at 0, and trimesh's own volume of the very same arrays."""
    np.testing.assert_allclose(mesh.volume_mm3, volume_mm3, rtol=1e-5)
    np.testing.assert_allclose(mesh.size_mm, size_mm, rtol=1e-5)
    np.testing.assert_array_equal(mesh.vertices.min(axis=0), 0)
    independent = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    np.testing.assert_allclose(independent.volume, volume_mm3, rtol=1e-5)


# Each format, the same box at (1, 2, 3).
WRITERS: dict[str, Callable[[Solid], bytes]] = {
    "part.stl": meshes.binary_stl,
    "PART.STL": lambda solid: meshes.binary_stl(solid, b"solid lies"),
    "text.stl": meshes.ascii_stl,
    "part.obj": meshes.obj,
    "part.ply": meshes.ply,
    "binary.ply": lambda solid: bytes(trimesh.Trimesh(*solid, process=False).export(file_type="ply")),
    "part.off": meshes.off,
    "part.glb": meshes.glb,
    "part.3mf": lambda solid: meshes.threemf(meshes.model_object(1, solid), '<item objectid="1"/>'),
}


@pytest.mark.parametrize("name", WRITERS)
def test_reads_every_format(tmp_path: Path, name: str) -> None:
    content = WRITERS[name](meshes.box(at=(1.0, 2.0, 3.0)))
    mesh = read_mesh(put(tmp_path, name, content))
    assert_solid(mesh, 60, (3, 4, 5))
    np.testing.assert_array_equal(mesh.minimum_mm, (1, 2, 3))
    assert (mesh.file, mesh.sha256) == (name, hashlib.sha256(content).hexdigest())
    assert (mesh.turned, mesh.notes) == (False, ())


@pytest.mark.parametrize(("name", "make"), meshes.GENERATED, ids=[name for name, _ in meshes.GENERATED])
def test_accepts_every_closed_solid(tmp_path: Path, name: str, make: Callable[[], Solid]) -> None:
    solid = make()
    again = make()
    np.testing.assert_array_equal(solid[0], again[0])
    expected = trimesh.Trimesh(*solid, process=False)
    mesh = read_mesh(put(tmp_path, f"{name}.stl", meshes.binary_stl(solid)))
    np.testing.assert_allclose(mesh.volume_mm3, expected.volume, rtol=1e-5)
    np.testing.assert_allclose(mesh.size_mm, expected.extents, rtol=1e-5)
    assert not mesh.turned


@pytest.mark.parametrize("header", [b"", b"solid lies"])
def test_a_binary_stl_holds_what_trimesh_reads(header: bytes) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    data = meshes.binary_stl((sphere.vertices, sphere.faces), header)
    soup, other = read_stl(data), trimesh.load(io.BytesIO(data), file_type="stl", process=False)
    np.testing.assert_array_equal(soup.vertices[soup.triangles], other.triangles)


@pytest.mark.parametrize("links", [0, 10, 300, 1000, 3000])
def test_components_are_scipys(links: int) -> None:
    a, b = np.random.default_rng(links).integers(0, 1000, (2, links))
    matrix = coo_array((np.ones(links, np.int8), (a, b)), shape=(1000, 1000))
    _, expected = csgraph.connected_components(matrix, directed=False)
    np.testing.assert_array_equal(connected_components(1000, a, b), expected)


def test_components_of_a_path_in_any_order() -> None:
    path = np.random.default_rng(0).permutation(10_000)
    assert not connected_components(10_000, path[:-1], path[1:]).any()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_volume_is_manifold3ds(tmp_path: Path, seed: int) -> None:
    solid = meshes.random_boolean(seed)
    mesh = read_mesh(put(tmp_path, "part.ply", meshes.ply(solid)))
    assert mesh.volume_mm3 == pytest.approx(meshes.to_manifold(solid).volume(), rel=1e-5)


@pytest.mark.parametrize(("units", "factor"), [(None, 1), ("mm", 1), ("cm", 10), ("m", 1000), ("inch", 25.4)])
def test_units_scale_coordinates(tmp_path: Path, units: str | None, factor: float) -> None:
    mesh = read_mesh(put(tmp_path, "part.stl", meshes.binary_stl(meshes.moved(BOX, (1, 1, 1)))), units)
    np.testing.assert_array_equal(mesh.size_mm, np.array([3, 4, 5]) * factor)
    np.testing.assert_array_equal(mesh.minimum_mm, np.array([1, 1, 1]) * factor)


@pytest.mark.parametrize(
    ("size", "units", "said"),
    [
        ((0.05, 0.06, 0.2), None, ["0.2 mm", "--units m (200 mm)", "--units cm (2 mm)"]),
        (
            (30.0, 40.0, 50.0),
            "m",
            ["5e+04 mm", "--units mm (50 mm)", "--units cm (500 mm)", "inch (1270 mm)"],
        ),
        ((9e3, 9e3, 9e3), None, ["9000 mm", "--scale"]),
    ],
)
def test_notes_an_unlikely_unit(tmp_path: Path, size: meshes.Point, units: str | None, said: list[str]) -> None:
    (note,) = read_mesh(put(tmp_path, "part.ply", meshes.ply(meshes.box(size))), units).notes
    assert [word for word in said if word not in note] == []


def test_turns_a_mesh_that_is_inside_out(tmp_path: Path) -> None:
    mesh = read_mesh(put(tmp_path, "part.stl", meshes.binary_stl(meshes.turned(meshes.nested_shells()))))
    assert_solid(mesh, 6**3 - 2 * 3 * 2, (6, 6, 6))
    assert mesh.turned
    assert "turned over" in mesh.notes[0]


@pytest.mark.parametrize("move", [(0.0, 0.0, 0.0), (4096.0, -8192.0, 65536.0), (2.0**30, 2.0**30, 2.0**30)])
def test_moving_changes_no_bit(tmp_path: Path, move: meshes.Point) -> None:
    quarter = np.round(meshes.sphere()[0] * 4) / 4, meshes.sphere()[1]
    here = read_mesh(put(tmp_path, "here.ply", meshes.ply(quarter)), "inch")
    there = read_mesh(put(tmp_path, "there.ply", meshes.ply(meshes.moved(quarter, move))), "inch")
    assert here.vertices.tobytes() == there.vertices.tobytes()
    np.testing.assert_array_equal(here.triangles, there.triangles)


def test_rounding_noise_around_zero_is_no_hole(tmp_path: Path) -> None:
    soup = BOX[0][BOX[1]].reshape(-1, 3)
    soup[5][soup[5] == 0] = -2.7e-16
    soup[7][soup[7] == 0] = -0.0
    solid = soup, np.arange(len(soup)).reshape(-1, 3)
    mesh = read_mesh(put(tmp_path, "noise.ply", meshes.ply(solid)))
    assert_solid(mesh, 60, (3, 4, 5))
    assert len(np.unique(mesh.vertices, axis=0)) == 8


def test_drops_vertices_that_no_triangle_uses(tmp_path: Path) -> None:
    solid = np.concatenate([[[-100.0, 0, 0]], BOX[0]]), BOX[1] + 1
    assert_solid(read_mesh(put(tmp_path, "part.ply", meshes.ply(solid))), 60, (3, 4, 5))


def test_several_solids_of_a_text_stl_are_kept(tmp_path: Path) -> None:
    content = meshes.ascii_stl(BOX, meshes.box((1.0, 1.0, 1.0), (9.0, 0.0, 0.0)))
    assert_solid(read_mesh(put(tmp_path, "two.stl", content)), 61, (10, 4, 5))


def test_obj_relative_indices_count_from_where_they_stand(tmp_path: Path) -> None:
    relative = [f"f {a} {b} {c}" for a, b, c in (BOX[1] - 8).tolist()]
    content = meshes.obj(BOX, relative) + meshes.obj(meshes.moved(BOX, (10, 0, 0)), relative)
    assert_solid(read_mesh(put(tmp_path, "two.obj", content)), 120, (13, 4, 5))


def test_obj_polygons_of_mixed_size(tmp_path: Path) -> None:
    prism = manifold3d.CrossSection.circle(2.0, 5).extrude(3.0)
    pentagon = np.array([[2 * np.cos(a), 2 * np.sin(a)] for a in np.arange(5) * 2 * np.pi / 5])
    points = np.vstack([np.c_[pentagon, np.zeros(5)], np.c_[pentagon, np.full(5, 3.0)]])
    sides = [f"f {i + 1}/1 {(i + 1) % 5 + 1}/2 {(i + 1) % 5 + 6}/3 {i + 6}/4" for i in range(5)]
    content = meshes.obj((points, BOX[1]), ["f 5 4 3 2 1", "f 6 7 8 9 10", *sides])
    mesh = read_mesh(put(tmp_path, "prism.obj", content))
    assert mesh.volume_mm3 == pytest.approx(prism.volume(), rel=1e-5)


@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_glb_nodes_place_and_mirror(tmp_path: Path, flip: float) -> None:
    matrix = np.array([[2.0, 0, 0, 7], [0, 1, 0, 0], [0, 0, flip, 0], [0, 0, 0, 1]])
    mesh = read_mesh(put(tmp_path, "part.glb", meshes.glb(BOX, matrix)))
    assert_solid(mesh, 120, (6, 4, 5))
    assert mesh.minimum_mm[0] == 7
    assert not mesh.turned


ITEM = '<item objectid="1"/>'
THREEMF_SOLIDS: list[tuple[str, str, str, dict[str, str], float, meshes.Point]] = [
    ("unit scales transforms too", "", '<item objectid="1" transform="1 0 0 0 1 0 0 0 1 1 0 0"/>' + ITEM,
     {"unit": "inch"}, 2 * 60 * 25.4**3, (4 * 25.4, 4 * 25.4, 5 * 25.4)),
    ("mirrored item", "", '<item objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/>', {}, 60, (3, 4, 5)),
    ("mirrored twice", meshes.model_components(
        2, ['<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/>']),
     '<item objectid="2" transform="1 0 0 0 -1 0 0 0 2 0 0 0"/>', {}, 120, (3, 4, 10)),
    ("nested components, turned", meshes.model_components(2, [
        '<component objectid="1"/>', '<component objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'])
     + meshes.model_components(3, ['<component objectid="2" transform="0 1 0 -1 0 0 0 0 1 0 0 0"/>']),
     '<item objectid="3"/><item objectid="3" transform="1 0 0 0 1 0 0 0 1 0 0 20"/>', {}, 240, (4, 13, 25)),
    ("extension declared, not used", "", ITEM, {"attributes": f'xmlns:s="{NS_3MF}/slice/2015/07"'}, 60,
     (3, 4, 5)),
]  # fmt: skip


@pytest.mark.parametrize("case", THREEMF_SOLIDS, ids=[case[0] for case in THREEMF_SOLIDS])
def test_3mf_places_what_it_builds(
    tmp_path: Path, case: tuple[str, str, str, dict[str, str], float, meshes.Point]
) -> None:
    _, resources, items, options, volume_mm3, size_mm = case
    content = meshes.threemf(meshes.model_object(1, BOX) + resources, items, **options)
    assert_solid(read_mesh(put(tmp_path, "part.3mf", content)), volume_mm3, size_mm)


def required(name: str, year: str, extra: str = "") -> bytes:
    attributes = f'requiredextensions="q" xmlns:q="{NS_3MF}/{name}/{year}"'
    return meshes.threemf(meshes.model_object(1, BOX, extra), ITEM, attributes=attributes)


def package(resources: str, items: str = ITEM, **options: str) -> bytes:
    return meshes.threemf(meshes.model_object(1, BOX) + resources, items, **options)


def tens(levels: int) -> bytes:
    """Components of ten components each: 10**levels boxes from a few kB."""
    objects = (
        meshes.model_components(level + 1, [f'<component objectid="{level}"/>'] * 10) for level in range(1, levels + 1)
    )
    return package("".join(objects), f'<item objectid="{levels + 1}"/>')


STL = meshes.binary_stl(BOX)
FILM = meshes.box((5.0, 5.0, 0.0))
INSIDE_OUT = meshes.joined(BOX, meshes.turned(meshes.box((1.0, 1.0, 1.0), (10.0, 0.0, 0.0))))
TOUCHING = meshes.joined(BOX, meshes.turned(meshes.box((1.0, 1.0, 1.0), (3.0, 4.0, 0.0))))
HALF_TURNED = BOX[0], np.concatenate([BOX[1][:6], BOX[1][6:, ::-1]])
CRACKED = meshes.joined(  # a box whose side z = 0 .. 5 meets a vertex that splits it only on one side
    (
        np.concatenate([BOX[0], [[0.0, 0.0, 2.5]]]),
        np.concatenate([BOX[1][2:], [(0, 8, 2), (8, 1, 3), (8, 3, 2)]]),
    )
)

REFUSED: list[tuple[str, str, bytes, list[str]]] = [
    ("unsupported suffix", "part.step", b"ISO-10303", ["unsupported", ".step", "stl"]),
    ("no suffix", "part", STL, ["unsupported"]),
    ("empty file", "part.stl", b"", ["empty"]),
    ("no triangles", "part.stl", meshes.binary_stl((BOX[0], BOX[1][:0])), ["no triangles"]),
    ("points only obj", "part.obj", meshes.obj(BOX, []), ["no triangles", "8 points"]),
    ("points only ply", "part.ply", meshes.ply((BOX[0], BOX[1][:0])), ["no triangles"]),
    ("points only off", "part.off", meshes.off((BOX[0], BOX[1][:0])), ["no triangles"]),
    ("empty build", "part.3mf", package("", ""), ["no triangles"]),
    ("truncated binary stl", "part.stl", STL[:-70], ["684 bytes", "12 triangles", "614 found"]),
    ("truncated, header says solid", "part.stl", meshes.binary_stl(BOX, b"solid")[:-70], ["12 triangles"]),
    ("bytes behind binary stl", "part.stl", STL + bytes(50), ["684 bytes", "734 found"]),
    ("stl of 10 bytes", "part.stl", b"0123456789", ["10 found"]),
    ("truncated text stl", "part.stl", meshes.ascii_stl(BOX)[:-200], ["STL triangles declared"]),
    ("damaged number in text stl", "part.stl", meshes.ascii_stl(BOX).replace(b"5.0", b"5_0", 1), ["stl"]),
    ("missing ply faces", "part.ply", meshes.ply(BOX, more_faces=3), ["15", "12 found"]),
    ("missing ply vertices", "part.ply", meshes.ply(BOX, more_vertices=1), ["found"]),
    ("missing off faces", "part.off", meshes.off(BOX, more_faces=2), ["22", "20 found"]),
    ("truncated glb", "part.glb", meshes.glb(BOX)[:-40], ["GLB bytes"]),
    ("truncated 3mf", "part.3mf", package("")[:-30], ["ZIP"]),
    ("NaN in stl", "part.stl", meshes.binary_stl(with_vertex(BOX, 2, (np.nan, 0, 0))), ["NaN", "first"]),
    ("infinity in ply", "part.ply", meshes.ply(with_vertex(BOX, 2, (0, np.inf, 0))), ["vertex 2"]),
    ("1e400 in obj", "part.obj", meshes.obj(BOX).replace(b"5.0", b"1e400", 1), ["infinite", "vertex 1"]),
    ("1e400 in text stl", "part.stl", meshes.ascii_stl(BOX).replace(b"5.0", b"1e400", 1), ["infinite"]),
    ("NaN in 3mf", "part.3mf", meshes.threemf(
        meshes.model_object(1, with_vertex(BOX, 2, (np.nan, 0, 0))), ITEM), ["lib3mf", "coordinates"]),
    ("word in obj", "part.obj", meshes.obj(BOX).replace(b"5.0", b"five", 1), ["obj"]),
    ("index beyond in obj", "part.obj", meshes.obj(with_corner(BOX, 8)), ["0..7, first 8 in triangle 4"]),
    ("index 0 in obj", "part.obj", meshes.obj(with_corner(BOX, -1)), ["vertex 0"]),
    ("index beyond in ply", "part.ply", meshes.ply(with_corner(BOX, 99)), ["first 99"]),
    ("index -1 in ply", "part.ply", meshes.ply(with_corner(BOX, -1)), ["first -1", "triangle 4"]),
    ("index beyond in off", "part.off", meshes.off(with_corner(BOX, 8)), ["range"]),
    ("index -1 in off", "part.off", meshes.off(with_corner(BOX, -1)), ["range"]),
    ("index beyond in 3mf", "part.3mf", meshes.threemf(meshes.model_object(1, with_corner(BOX, 8)), ITEM),
     ["lib3mf", "index"]),
    ("3e38 mm", "part.stl", meshes.binary_stl(with_vertex(BOX, 7, (3e38, 0, 0))), ["side 3e+38 mm"]),
    ("1e308 mm", "part.obj", meshes.obj(with_vertex(BOX, 7, (1e308, 0, 0))), ["largest side"]),
    ("too far away", "part.obj", meshes.obj(meshes.moved(BOX, (1e13, 0, 0))), ["from the origin", "1e+13"]),
    ("flat sheet", "part.stl", meshes.binary_stl(FILM), ["no volume"]),
    ("all in one point", "part.ply", meshes.ply((BOX[0] * 0, BOX[1])), ["no volume"]),
    ("hole", "part.stl", meshes.binary_stl(HOLED), ["4 open edges", "z = 5 and 5 mm", "10 triangles"]),
    ("T-junction", "part.ply", meshes.ply(CRACKED), ["3 open edges", "z = 0 and 5 mm"]),
    ("one face turned", "part.ply", meshes.ply(HALF_TURNED), ["body 0", "partly inside out"]),
    ("one body inside out", "part.stl", meshes.binary_stl(INSIDE_OUT),
     ["body 1 of 2", "inside out", "(10, 0, 0) to (11, 1, 1)", "volume -1 mm3"]),
    ("the same, sharing an edge", "part.stl", meshes.binary_stl(TOUCHING), ["body 1 of 2", "inside out"]),
    ("the larger body inside out", "part.stl",
     meshes.binary_stl(meshes.joined(meshes.turned(BOX), meshes.box((1.0, 1.0, 1.0), (10.0, 0.0, 0.0)))),
     ["body 0 of 2", "volume -60 mm3"]),
    ("garbage ply", "part.ply", b"\0\1\2", ["ply"]),
    ("garbage off", "part.off", b"\0\1\2", ["off"]),
    ("garbage glb", "part.glb", b"glTF\2\0\0\0", ["glb"]),
    ("garbage 3mf", "part.3mf", b"\0\1\2", ["ZIP"]),
    ("compressed glb", "part.glb", meshes.glb(BOX, requires="KHR_draco_mesh_compression"), ["draco"]),
    ("slice extension required", "part.3mf", required("slice", "2015/07"), ["slice"]),
    ("beam lattice", "part.3mf", required("beamlattice", "2017/02",
        '<q:beamlattice radius="1" minlength="0.1"><q:beams/></q:beamlattice>'),
     ["beam lattice"]),
    ("volumetric", "part.3mf", required("volumetric", "2022/01"), ["volumetric"]),
    ("unknown extension", "part.3mf", required("teleport", "2031/01"), ["teleport"]),
    ("DOCTYPE", "part.3mf", package("", before='<!DOCTYPE model [<!ENTITY a "b">]>'), ["DOCTYPE"]),
    ("cycle of components", "part.3mf", package(
        meshes.model_components(2, ['<component objectid="3"/>'])
        + meshes.model_components(3, ['<component objectid="2"/>']), '<item objectid="3"/>'),
     ["contains itself"]),
    ("component bomb", "part.3mf", tens(10), ["placed objects"]),
    ("many items", "part.3mf", package("", ITEM * 20_001), ["20001 placed objects"]),
    ("member outside", "part.3mf", meshes.threemf("", "", members={"../x": b""}), ["'../x'", "outside"]),
    ("member twice", "part.3mf", meshes.threemf("", "", members={"3d/3DMODEL.model": b""}), ["twice"]),
    ("broken XML", "part.3mf", meshes.threemf("<object>", ""), ["not valid XML"]),
]  # fmt: skip


@pytest.mark.parametrize("case", REFUSED, ids=[case[0] for case in REFUSED])
def test_refuses(tmp_path: Path, case: tuple[str, str, bytes, list[str]]) -> None:
    _, name, content, said = case
    with pytest.raises(PartError) as caught:
        read_mesh(put(tmp_path, name, content))
    assert caught.value.message.startswith(f"{name}: ")
    assert caught.value.hint
    assert [word for word in said if word.lower() not in str(caught.value).lower()] == []


def test_refuses_what_is_not_a_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "folder.stl").mkdir()
    for name, reason in (
        ("none.stl", "no such file"),
        ("folder.stl", "folder"),
        ("pipe.stl", "regular file"),
    ):
        with pytest.raises(PartError, match=reason):
            read_mesh(tmp_path / name)
    with pytest.raises(PartError, match="unknown unit 'furlong'"):
        read_mesh(put(tmp_path, "part.stl", STL), "furlong")


def test_refuses_bombs_before_unpacking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """10^60 placed objects: whoever unpacks them first never answers."""
    with pytest.raises(PartError, match="placed objects"):
        read_mesh(put(tmp_path, "components.3mf", tens(60)))
    monkeypatch.setattr(threemf_package, "MAX_PACKAGE_BYTES", 1 << 20)
    with pytest.raises(PartError, match="unpack to"):
        read_mesh(put(tmp_path, "zip.3mf", meshes.threemf("", "", members={"a.png": bytes(1 << 20)})))


def test_reads_a_large_sphere(tmp_path: Path) -> None:
    solid = meshes.sphere(20.0, subdivisions=6)
    path = put(tmp_path, "large.stl", meshes.binary_stl(solid))
    assert_solid(read_mesh(path), float(trimesh.Trimesh(*solid, process=False).volume), (40, 40, 40))


DATA = os.environ.get("AMSLICER_TEST_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="AMSLICER_TEST_DATA is not set")

# Volumes as the data folder's README gives them; overlaps of shells count twice in ours, so those bound it.
DATA_SOLIDS = [
    ("featuretype.STL", 3476, 11.628, 11.628),
    ("plate_holes.STL", None, 767_400, 767_400),
    ("pyramids.3mf", 3276, 195_000, 195_000),
    ("torus.3mf", None, 776.8, 776.8),
    ("negative_indices.obj", 12, 8, 8),
    ("two_objects.obj", 16, 1.0, 1.0 + 1 / 6),
    ("shared.STL", 24, 2, 2),
    ("Globo.3mf", None, 60_960, 2 * 60_960),
    ("large_block_obb.STL", 12, None, None),
]
DATA_REFUSED = [
    ("2ProductionBoxes.3mf", ["open", "of 25 triangles"]),
    ("sphere_sliced.3mf", ["slice"]),
    ("multibody.stl", ["body", "of 2", "inside out"]),
    ("sphereWithHole.stl", ["9 open edges", "z ="]),
    ("soup.stl", ["open edges"]),
    ("stl_empty_bin.stl", ["no triangles"]),
]


@needs_data
@pytest.mark.parametrize(("name", "triangles", "least", "most"), DATA_SOLIDS)
def test_users_solids(name: str, triangles: int | None, least: float | None, most: float | None) -> None:
    mesh = read_mesh(Path(DATA or "") / "meshes" / name)
    assert triangles in (None, len(mesh.triangles))
    if least is not None and most is not None:
        assert least * (1 - 1e-3) <= mesh.volume_mm3 <= most * (1 + 1e-3)
    assert not mesh.turned


@needs_data
@pytest.mark.parametrize(("name", "said"), DATA_REFUSED)
def test_users_files_refused(name: str, said: list[str]) -> None:
    with pytest.raises(PartError) as caught:
        read_mesh(Path(DATA or "") / "meshes" / name)
    assert [word for word in said if word not in caught.value.message] == []
