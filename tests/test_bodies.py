"""The bodies of a part: names, which pixels are whose, and fields for each."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
import trimesh
from meshes import Solid
from numpy.typing import NDArray
from pydantic import TypeAdapter

import amslicer.bodies as module
from amslicer import JobError
from amslicer.bodies import NO_BODY, BodyIndex, body_index
from amslicer.bodynames import body_table, find_bodies
from amslicer.fields import FieldSpec, Frame, Inputs, open_field, open_orientation
from amslicer.fields.source import Part
from amslicer.grid import Grid, cover
from amslicer.mask import make_slicer
from amslicer.mesh import Mesh, read_mesh
from amslicer.pipeline import prepare
from amslicer.placement import place

Floats = NDArray[np.float64]

LEFT, RIGHT = meshes.box((2.0, 3.0, 1.0)), meshes.box((2.0, 3.0, 1.0), (2.0, 0.0, 0.0))
TOUCHING = meshes.joined(LEFT, RIGHT)


def stl(folder: Path, *solids: Solid) -> Mesh:
    return read_mesh(parts.stl(folder, meshes.joined(*solids)))


def written(folder: Path, content: bytes, suffix: str) -> Mesh:
    file = folder / f"part.{suffix}"
    file.write_bytes(content)
    return read_mesh(file)


def obj(named: list[tuple[str, Solid]]) -> bytes:
    """An OBJ; names are whole lines such as `o left`."""
    lines, start = [], 1
    for line, (vertices, triangles) in named:
        lines += [line] if line else []
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (triangles + start).tolist()]
        start += len(vertices)
    return "\n".join(lines).encode()


def threemf(named: list[tuple[str, Solid]]) -> bytes:
    objects = [
        meshes.model_object(i, solid).replace('type="model"', f'type="model" name="{name}"' if name else 'type="model"')
        for i, (name, solid) in enumerate(named, 1)
    ]
    items = "".join(f'<item objectid="{i}"/>' for i in range(1, len(named) + 1))
    return meshes.threemf("".join(objects), items)


def glb(named: list[tuple[str, Solid]]) -> bytes:
    scene = trimesh.Scene()
    for name, solid in named:
        scene.add_geometry(trimesh.Trimesh(*solid, process=False), node_name=name, geom_name=f"mesh of {name}")
    return bytes(scene.export(file_type="glb"))  # type: ignore[arg-type]


NAMED = [("sole", LEFT), ("upper part", RIGHT)]
WRITTEN: dict[str, bytes] = {
    "3mf": threemf(NAMED),
    "obj": obj([(f"o {name}", solid) for name, solid in NAMED]),
    "glb": glb(NAMED),
}


# Names


@pytest.mark.parametrize("suffix", WRITTEN)
def test_named_objects_are_bodies(tmp_path: Path, suffix: str) -> None:
    table = body_table(written(tmp_path, WRITTEN[suffix], suffix))
    assert [row.name for row in table] == ["sole", "upper part"]
    assert [row.triangles for row in table] == [12, 12]
    assert [row.volume_mm3 for row in table] == pytest.approx([6, 6])
    np.testing.assert_allclose(table[0].bbox_mm, [[0, 0, 0], [2, 3, 1]])
    np.testing.assert_allclose(table[1].bbox_mm, [[2, 0, 0], [4, 3, 1]])


def test_groups_are_bodies_where_there_are_no_objects(tmp_path: Path) -> None:
    groups = [("g heel", LEFT), ("g toe  # front", RIGHT)]
    assert [row.name for row in body_table(written(tmp_path, obj(groups), "obj"))] == ["heel", "toe"]
    both = [("o shoe\ng heel", LEFT), ("g toe", RIGHT)]
    table = body_table(written(tmp_path, obj(both), "obj"))
    assert [(row.name, row.triangles) for row in table] == [("shoe", 24)]


def test_quads_count_as_two_triangles(tmp_path: Path) -> None:
    corners = LEFT[0].tolist()
    quads = ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
    text = "\n".join(["o block", *(f"v {x} {y} {z}" for x, y, z in corners), *quads, "o more", ""]).encode()
    right = obj([("", RIGHT)]).decode().replace("f ", "f @")
    moved = "\n".join(
        " ".join(["f", *(str(int(n.strip("@")) + 8) for n in line.split()[1:])]) if line.startswith("f") else line
        for line in right.splitlines()
    )
    table = body_table(written(tmp_path, text + moved.encode(), "obj"))
    assert [(row.name, row.triangles, round(row.volume_mm3, 9)) for row in table] == [("block", 12, 6), ("more", 12, 6)]


BOX_QUADS = ((2, 4, 3, 1), (7, 8, 6, 5), (5, 6, 2, 1), (4, 8, 7, 3), (3, 7, 5, 1), (6, 8, 4, 2))


def faces_obj(named: list[tuple[str, list[tuple[float, float, float]], list[tuple[int, ...]]]]) -> bytes:
    """An OBJ of lines such as `o left`, corners, and faces that count from 1 in each."""
    lines, start = [], 0
    for line, corners, faces in named:
        lines += [line, *(f"v {x} {y} {z}" for x, y, z in corners)]
        lines += ["f " + " ".join(str(corner + start) for corner in face) for face in faces]
        start += len(corners)
    return "\n".join(lines).encode()


def quad_box(x: float, cut: int) -> tuple[list[tuple[float, float, float]], list[tuple[int, ...]]]:
    """A cube of side 3 at x; the first `cut` of its quads as two triangles."""
    corners = [(x + 3 * i, 3.0 * j, 3.0 * k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    faces = [[q] if n >= cut else [(q[0], q[1], q[2]), (q[0], q[2], q[3])] for n, q in enumerate(BOX_QUADS)]
    return corners, [tuple(face) for some in faces for face in some]


def prism(x: float) -> tuple[list[tuple[float, float, float]], list[tuple[int, ...]]]:
    """A pentagonal prism of radius 2 and height 3: pentagons and quads."""
    turn = 2 * np.pi * np.arange(5) / 5
    ring = [(float(x + 2 * np.cos(a)), float(2 * np.sin(a))) for a in turn]
    sides = [(i + 1, (i + 1) % 5 + 1, (i + 1) % 5 + 6, i + 6) for i in range(5)]
    corners = [(*xy, z) for z in (0.0, 3.0) for xy in ring]
    return corners, [(5, 4, 3, 2, 1), *sides, (6, 7, 8, 9, 10)]


@pytest.mark.parametrize("cuts", [(0, 0), (6, 0), (0, 6), (2, 4), (6, 6)])
def test_names_belong_to_the_faces_below_them_whatever_their_corners(tmp_path: Path, cuts: tuple[int, int]) -> None:
    content = faces_obj([("o left", *quad_box(0, cuts[0])), ("o right", *quad_box(10, cuts[1]))])
    left, right = body_table(written(tmp_path, content, "obj"))
    assert (left.name, left.triangles, right.name, right.triangles) == ("left", 12, "right", 12)
    np.testing.assert_allclose(left.bbox_mm, [[0, 0, 0], [3, 3, 3]])
    np.testing.assert_allclose(right.bbox_mm, [[10, 0, 0], [13, 3, 3]])


def test_names_of_prisms_and_boxes(tmp_path: Path) -> None:
    content = faces_obj([("o a", *prism(0)), ("o b", *quad_box(10, 1)), ("o c", *prism(20)), ("o d", *prism(30))])
    table = body_table(written(tmp_path, content, "obj"))
    assert [(row.name, row.triangles) for row in table] == [("a", 16), ("b", 12), ("c", 16), ("d", 16)]
    pentagon = 2.5 * 2**2 * np.sin(2 * np.pi / 5)
    assert [row.volume_mm3 for row in table] == pytest.approx([3 * pentagon, 27, 3 * pentagon, 3 * pentagon])


def test_groups_that_are_parts_of_a_surface_are_no_bodies(tmp_path: Path) -> None:
    corners, faces = quad_box(0, 0)
    lines = faces_obj([("g top", corners, faces[:2]), ("g sides", [], [])]).decode()
    more = "\n".join("f " + " ".join(map(str, face)) for face in faces[2:])
    groups = f"{lines}\n{more}\n".encode()
    assert [(row.name, row.volume_mm3) for row in body_table(written(tmp_path, groups, "obj"))] == [("1", 27)]
    with pytest.raises(JobError, match="'top', 'sides' are objects of the file, but only part of a solid"):
        find_bodies(written(tmp_path, groups.replace(b"g ", b"o "), "obj"))


@pytest.mark.parametrize("suffix", ["glb", "3mf"])
def test_named_objects_that_are_no_solids_are_refused(tmp_path: Path, suffix: str) -> None:
    vertices, triangles = LEFT
    named = [("lid", (vertices, triangles[:2])), ("rest", (vertices, triangles[2:])), ("whole", RIGHT)]
    mesh = written(tmp_path, (glb if suffix == "glb" else threemf)(named), suffix)
    with pytest.raises(JobError, match="'lid', 'rest' are objects of the file, but only part") as caught:
        find_bodies(mesh)
    assert caught.value.hint


def test_objects_of_an_open_mesh_may_be_open_where_it_is(tmp_path: Path) -> None:
    content = faces_obj([("o a", quad_box(0, 0)[0], quad_box(0, 0)[1][1:]), ("o b", *quad_box(10, 0))])
    (tmp_path / "open.obj").write_bytes(content)
    assert find_bodies(read_mesh(tmp_path / "open.obj", allow_open=True)).names == ("a", "b")


def test_what_a_name_is(tmp_path: Path) -> None:
    far = meshes.moved(LEFT, (10, 0, 0))

    def names(*named: tuple[str, Solid], end: bytes = b"") -> tuple[str, ...]:
        return find_bodies(written(tmp_path, obj(list(named)) + end, "obj")).names

    assert names(("o a#1", LEFT), ("o a#2 # the second", far)) == ("a#1", "a#2")
    assert names(("", LEFT), ("", far), end=b"\no last\n") == ("1", "2")
    assert names(("o none\ng a", LEFT), ("g b", far), end=b"\n") == ("none",)
    assert names(("g a", LEFT), ("g b", far), end=b"\no last\n") == ("a", "b")
    assert names(("", LEFT), ("o 1", far)) == ("1 (unnamed)", "1")


def test_objects_of_one_name_are_one_body_and_some_may_have_none(tmp_path: Path) -> None:
    far = meshes.moved(LEFT, (10, 0, 0))
    for content, suffix in (
        (threemf([("a", LEFT), ("", RIGHT), ("a", far)]), "3mf"),
        (obj([("o a", LEFT), ("o b", RIGHT), ("o a", far)]), "obj"),
    ):
        table = body_table(written(tmp_path, content, suffix))
        assert [row.name for row in table] == ["a", "2" if suffix == "3mf" else "b"]
        assert [row.triangles for row in table] == [24, 12]


def test_components_have_their_own_names_or_that_of_the_whole(tmp_path: Path) -> None:
    named = meshes.model_object(1, LEFT).replace("<object", '<object name="sole"')
    plain = meshes.model_object(2, RIGHT)
    whole = meshes.model_components(3, ['<component objectid="1"/>', '<component objectid="2"/>'])
    whole = whole.replace("<object", '<object name="shoe"')
    mesh = written(tmp_path, meshes.threemf(named + plain + whole, '<item objectid="3"/>'), "3mf")
    assert find_bodies(mesh).names == ("sole", "shoe")


@pytest.mark.parametrize(
    ("solids", "volumes"),
    [
        ([meshes.box()], [60]),
        ([LEFT, RIGHT], [6, 6]),
        ([meshes.nested_shells()], [204]),
        ([meshes.island_in_cavity()], [204, 1]),
        ([meshes.box(), meshes.box()], [60, 60]),
        ([meshes.nested_shells(), meshes.moved(meshes.nested_shells(), (6, 0, 0))], [204, 204]),
        ([meshes.box((9, 9, 9)), meshes.moved(meshes.nested_shells(), (1, 1, 1))], [729, 204]),
    ],
)
def test_outward_surfaces_are_numbered_bodies_with_their_cavities(
    tmp_path: Path, solids: list[Solid], volumes: list[float]
) -> None:
    for mesh in (stl(tmp_path, *solids), written(tmp_path, threemf([("", s) for s in solids]), "3mf")):
        table = body_table(mesh)
        assert [row.name for row in table] == [str(i + 1) for i in range(len(volumes))]
        assert [row.volume_mm3 for row in table] == pytest.approx(volumes)
        assert sum(row.volume_mm3 for row in table) == pytest.approx(mesh.volume_mm3)


def test_a_body_seen_from_inside_out_is_turned_with_the_part(tmp_path: Path) -> None:
    mesh = stl(tmp_path, meshes.turned(LEFT), meshes.turned(RIGHT))
    assert mesh.turned
    assert [row.volume_mm3 for row in body_table(mesh)] == pytest.approx([6, 6])


# Places


def index_of(mesh: Mesh, pitch: tuple[float, float, float] = (0.1, 0.13, 0.07), **settings: Any) -> BodyIndex:
    priorities = settings.pop("priorities", None)
    placement, _ = place(mesh, **settings)
    return body_index(mesh, placement, cover(placement.size_mm.tolist(), pitch[:2], pitch[2]), priorities)


def alone(mesh: Mesh, body: int, grid: Grid, layer: int, **settings: Any) -> NDArray[np.bool_]:
    """What is solid of one body, sliced by itself."""
    _, vertices = place(mesh, **settings)
    triangles = mesh.triangles[find_bodies(mesh).of_triangle == body]
    return make_slicer(vertices, triangles, grid).runs(layer, layer + 1).solid()[0]


PARTS: dict[str, list[Solid]] = {
    "touching": [LEFT, RIGHT],
    "cavities": [meshes.nested_shells(), meshes.moved(meshes.nested_shells(), (6, 0, 0))],
    "round": [meshes.sphere(2.0, 2), meshes.moved(meshes.torus(4.0, 1.0), (0.3, 0.2, 0.1))],
    "overlapping": [meshes.box(), meshes.box((3, 3, 3), (1.5, 2.5, 2.0)), meshes.sphere(2.0, 2)],
}


@pytest.mark.parametrize("turn", [(0, 0, 0), (0, 90, 0), (20, 30, 40)])
@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("pitch", [(0.1, 0.13, 0.07), (0.5, 0.25, 0.5)])
def test_labels_are_those_of_each_body_sliced_alone(
    tmp_path: Path, name: str, turn: tuple[float, float, float], pitch: tuple[float, float, float]
) -> None:
    """Faces of the boxes lie on centres of 0.5 mm pixels, where half-open rules decide."""
    mesh = stl(tmp_path, *PARTS[name])
    index = index_of(mesh, pitch, rotate_deg=turn)
    grid = index.grid
    _, vertices = place(mesh, rotate_deg=turn)
    whole = make_slicer(vertices, mesh.triangles, grid)
    for layer in {0, grid.layers // 3, grid.layers // 2, grid.layers - 1}:
        expected = np.full((grid.rows, grid.columns), NO_BODY)
        for body in range(len(PARTS[name])):
            expected[alone(mesh, body, grid, layer, rotate_deg=turn)] = body
        labels = index.labels(layer)
        np.testing.assert_array_equal(labels, expected)
        np.testing.assert_array_equal(labels != NO_BODY, whole.runs(layer, layer + 1).solid()[0])
        assert labels.dtype == np.int16


def test_where_bodies_overlap_the_later_or_the_one_of_higher_priority_counts(tmp_path: Path) -> None:
    mesh = stl(tmp_path, meshes.box((4, 4, 1)), meshes.box((4, 4, 1), (2, 0, 0)), meshes.box((4, 4, 1), (3, 1, 0)))
    place_ = (np.array([1.0, 2.5, 3.5, 5.5, 6.5]), np.full(5, 2.5), np.full(5, 0.5))
    assert index_of(mesh).at(*place_).tolist() == [0, 1, 2, 2, 2]
    assert index_of(mesh, priorities={"1": 1}).at(*place_).tolist() == [0, 0, 0, 2, 2]
    assert index_of(mesh, priorities={"1": -1, "2": 5}).at(*place_).tolist() == [0, 1, 1, 1, 2]
    with pytest.raises(JobError, match="bodies: the part has no body 'x'"):
        index_of(mesh, priorities={"x": 1})


@pytest.mark.parametrize("name", PARTS)
def test_places_have_the_label_of_their_pixel(tmp_path: Path, name: str) -> None:
    index = index_of(stl(tmp_path, *PARTS[name]))
    grid = index.grid
    random = np.random.default_rng(2)
    column, row, layer = (random.integers(0, n, 3000) for n in (grid.columns, grid.rows, grid.layers))
    within = random.uniform(0.01, 0.99, (3, 3000))
    x, y = (column + within[0]) * grid.pitch_mm[0], (row + within[1]) * grid.pitch_mm[1]
    found = index.at(x, y, (layer + within[2]) * grid.layer_mm)
    labels = np.array([index.labels(int(k))[i, j] for i, j, k in zip(row, column, layer, strict=True)])
    inside = labels != NO_BODY
    assert inside.sum() > 300
    np.testing.assert_array_equal(found[inside], labels[inside])
    assert (found != NO_BODY).all()


def test_places_in_no_body_take_the_next_one(tmp_path: Path) -> None:
    mesh = stl(tmp_path, meshes.box((2, 2, 2)), meshes.box((0.05, 2, 2), (9.95, 0, 0)))
    index = index_of(mesh)
    x = np.array([-50.0, 2.1, 3.0, 5.5, 6.5, 9.0, 9.9, 10.1, 90.0])
    assert index.at(x, np.full(9, 1.0), np.full(9, 1.0)).tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1]
    assert index.at(np.array([1.0, 10.0]), np.array([9.0, -9.0]), np.array([-3.0, 30.0])).tolist() == [0, 1]


def test_a_raster_is_its_points_in_any_order_and_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = stl(tmp_path, *PARTS["round"])
    index = index_of(mesh)
    x, y = np.linspace(-1, 12, 57)[None, :], np.linspace(-1, 12, 43)[:, None]
    rasters = [index.at(x, y, np.asarray(z)) for z in np.linspace(-0.5, 4.5, 9)]
    monkeypatch.setattr(module, "KEPT_BYTES", 1)
    monkeypatch.setattr(module, "BLOCK_LAYERS", 3)
    other = index_of(read_mesh(tmp_path / "part.stl"))
    assert other is not index

    def points(z: float) -> NDArray[np.int16]:
        return other.at(*(np.ravel(c) for c in np.broadcast_arrays(x, y, np.asarray(z)))).reshape(43, 57)

    with ThreadPoolExecutor(4) as pool:
        for one, two in zip(rasters, pool.map(points, np.linspace(-0.5, 4.5, 9)), strict=True):
            np.testing.assert_array_equal(one, two)
    assert len(other._blocks) == 1
    rows = y[[30, 2, 41]]
    np.testing.assert_array_equal(index.at(x, rows, np.asarray(2.0)), index.at(x, y, np.asarray(2.0))[[30, 2, 41]])


def test_fields_and_materials_look_at_the_same_index(tmp_path: Path) -> None:
    mesh = stl(tmp_path, LEFT, RIGHT)
    assert index_of(mesh) is not None
    first = index_of(mesh)
    assert index_of(mesh) is first
    assert index_of(mesh, priorities={"1": 0}) is first
    assert index_of(mesh, priorities={"1": 1}) is not first


# Fields by body


def frame_of(mesh: Mesh, grid: Grid | None = None) -> Frame:
    placement, _ = place(mesh)
    return Frame(mesh.minimum_mm, mesh.size_mm, placement, lambda: Part(Path("p"), mesh), grid)


def spec(**fields: Any) -> Any:
    return TypeAdapter(FieldSpec).validate_python({"per_body": fields})


HALVES = np.array([[0.5, 1, 0.5], [1.99, 2, 0.1], [2.01, 2, 0.9], [3.5, 0.1, 0.2], [-3, 1, 1], [9, 1, 1]])


@pytest.mark.parametrize("suffix", WRITTEN)
def test_per_body_of_named_objects(tmp_path: Path, suffix: str) -> None:
    mesh = written(tmp_path, WRITTEN[suffix], suffix)
    field = open_field(spec(sole=0.2, **{"upper part": 0.7}), frame_of(mesh), Inputs(Path()))
    assert field.scalar(*HALVES.T).tolist() == [0.2, 0.2, 0.7, 0.7, 0.2, 0.7]
    assert field.bounds == (0.2, 0.7)
    assert field.varies == (True, True, True)


def test_per_body_takes_directions_and_keeps_them(tmp_path: Path) -> None:
    mesh = stl(tmp_path, LEFT, RIGHT)
    vertical = {"gradient": {"axis": "y", "from": 1, "to": 179}}
    lines = open_orientation(spec(**{"1": 179, "rest": vertical}), frame_of(mesh), Inputs(Path()))
    angle = np.rad2deg(np.arctan2(*lines.normals(*HALVES.T)[:, 1::-1].T))
    expected = np.where(HALVES[:, 0] < 2, 179, 1 + 178 * np.clip(HALVES[:, 1] / 3, 0, 1))
    np.testing.assert_allclose(angle, expected)
    assert lines.turns


def test_a_field_that_all_have_is_that_field(tmp_path: Path) -> None:
    mesh = stl(tmp_path, LEFT, RIGHT)
    field = open_field(spec(rest={"gradient": {"axis": "x", "from": 0, "to": 1}}), frame_of(mesh), Inputs(Path()))
    assert field.varies == (True, False, False)
    single = open_field(spec(**{"1": 0.3}), frame_of(stl(tmp_path, LEFT)), Inputs(Path()))
    assert single.varies == (False, False, False)


def test_per_body_refusals(tmp_path: Path) -> None:
    mesh = written(tmp_path, WRITTEN["obj"], "obj")
    with pytest.raises(JobError, match="per_body: the part has no body 'soul'") as caught:
        open_field(spec(soul=0.2, rest=0.1), frame_of(mesh), Inputs(Path()))
    assert "'sole', 'upper part'" in str(caught.value.hint)
    with pytest.raises(JobError, match="the body 'upper part' of the part has no field"):
        open_field(spec(sole=0.2), frame_of(mesh), Inputs(Path()))
    with pytest.raises(JobError, match="needs the part's mesh"):
        open_field(spec(sole=0.2), Frame(np.zeros(3), np.ones(3)), Inputs(Path()))
    bed: Any = TypeAdapter(FieldSpec).validate_python({"per_body": {"sole": 1, "rest": 0}, "frame": "bed"})
    with pytest.raises(JobError, match="made from the part itself"):
        open_field(bed, frame_of(mesh), Inputs(Path()))


@pytest.mark.parametrize("settings", [{}, {"rotate": [0, 0, 90]}, {"rotate": [90, 0, 0], "scale": 1.5}])
def test_in_a_job_each_body_has_its_ratio(tmp_path: Path, settings: dict[str, Any]) -> None:
    """Ratios 0 and 1 are plain fills: every pixel is that of its body, as it is sliced alone."""
    part = tmp_path / "part.obj"
    part.write_bytes(WRITTEN["obj"])
    job = parts.job(part, ratio={"per_body": {"sole": 1, "upper part": 0}}, settings=settings)
    prepared = prepare(job)
    index = body_index(prepared.mesh, prepared.placement, prepared.grid)
    labels = parts.labels(job)
    for layer, found in enumerate(labels):
        np.testing.assert_array_equal(found[::-1].astype(int) - 1, index.labels(layer))
    assert set(np.unique(labels)) >= {1, 2}
