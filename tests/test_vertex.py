"""Fields painted on the vertices of the part's file, in each of its formats."""

from __future__ import annotations

import colorsys
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import lib3mf
import meshes
import numpy as np
import parts
import pytest
import trimesh
from meshes import Solid
from numpy.typing import NDArray
from pydantic import ValidationError

from amslicer.errors import JobError
from amslicer.fields import Frame, open_field, open_orientation
from amslicer.fields.source import Inputs, Part
from amslicer.fields.vertex import VertexSource
from amslicer.mesh import read_mesh
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]
NOTHING = Inputs(Path())
CORNER = np.array([5.0, -7.0, 2.0])  # of the parts in their files
UP = np.array([0.0, 0.0, 0.5])


def fine_box(cuts: int = 4, size: float = 4.0) -> Solid:
    """A cube of 2**cuts squares along each side; its lowest corner at CORNER."""
    mesh = trimesh.creation.box((size, size, size))
    for _ in range(cuts):
        mesh = mesh.subdivide()
    vertices, triangles = meshes.from_trimesh(mesh)
    return np.round(vertices + size / 2, 9) + CORNER, triangles


def write(path: Path, data: bytes) -> Frame:
    path.write_bytes(data)
    mesh = read_mesh(path)
    return Frame(mesh.minimum_mm, mesh.size_mm, None, lambda: Part(path, mesh))


def ply(path: Path, solid: Solid, binary: bool = True, **values: NDArray[Any]) -> Frame:
    """A PLY file with a property of its own type for each keyword."""
    types = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
    columns = {**dict(zip("xyz", solid[0].T, strict=True)), **values}
    kinds = [(name, column.dtype.str[1:]) for name, column in columns.items()]
    head = "".join(f"property {types[kind]} {name}\n" for name, kind in kinds)
    header = (
        f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\nelement vertex {len(solid[0])}\n{head}"
        f"element face {len(solid[1])}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if not binary:
        rows = [" ".join(str(column[i]) for column in columns.values()) for i in range(len(solid[0]))]
        faces = [f"3 {a} {b} {c}" for a, b, c in solid[1].tolist()]
        return write(path, header + "\n".join([*rows, *faces, ""]).encode())
    table = np.zeros(len(solid[0]), [(name, "<" + kind) for name, kind in kinds])
    for name, column in columns.items():
        table[name] = column
    faces = np.zeros(len(solid[1]), [("n", "u1"), ("corners", "<i4", 3)])
    faces["n"], faces["corners"] = 3, solid[1]
    return write(path, header + table.tobytes() + faces.tobytes())


def values_of(frame: Frame, places: Floats, **spec: Any) -> Floats:
    field = open_field(VertexSource.model_validate(spec), frame, NOTHING)
    return np.broadcast_to(field.scalar(*(places - frame.minimum_mm).T), len(places))


def normals_of(frame: Frame, places: Floats, **spec: Any) -> Floats:
    field = open_orientation(VertexSource.model_validate(spec), frame, NOTHING)
    return field.normals(*(places - frame.minimum_mm).T)


def off_line_deg(found: Floats, expected: Floats) -> Floats:
    length = np.linalg.norm(found, axis=1) * np.linalg.norm(expected, axis=1)
    return np.rad2deg(np.arccos(np.clip(np.abs((found * expected).sum(axis=1)) / length, 0, 1)))


def on_box(count: int, below: float = 0.0, size: float = 4.0, seed: int = 0) -> Floats:
    """Places on the faces of fine_box, or below them; 0.3 mm from edges."""
    random = np.random.default_rng(seed)
    places = random.uniform(0.3 + below, size - 0.3 - below, (count, 3))
    axis = random.integers(3, size=count)
    places[np.arange(count), axis] = np.where(random.random(count) < 0.5, below, size - below)
    return places + CORNER


def linear(places: Floats) -> Floats:
    """0 … 1 over fine_box."""
    return np.asarray((places - CORNER) @ (0.5, 0.3, 0.2) / 4.0)


def flat(azimuth_deg: Floats) -> Floats:
    angle = np.deg2rad(azimuth_deg)
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def test_a_linear_field_near_the_surface(tmp_path: Path) -> None:
    solid = fine_box()
    box = ply(tmp_path / "part.ply", solid, quality=linear(solid[0]).astype("f4"))
    for below in (0.0, 0.05):
        places = on_box(2000, below)
        foot = on_box(2000, 0.0) if not below else places  # the nearest point of the surface
        foot = np.where(np.isclose(foot - CORNER, below), CORNER, foot)
        foot = np.where(np.isclose(foot - CORNER, 4 - below), CORNER + 4, foot)
        np.testing.assert_allclose(values_of(box, places, vertex="quality", grid_mm=0.1), linear(foot), atol=1e-5)


def test_deep_places_have_the_value_of_the_nearest_skin(tmp_path: Path) -> None:
    vertices, triangles = meshes.sphere(3.0, 4)
    ball = ply(tmp_path / "part.ply", (vertices, triangles), warm=vertices[:, 2])
    way = np.random.default_rng(0).normal(size=(1000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    for r, close in ((2.9, 0.02), (2.0, 0.05), (1.0, 0.2)):
        assert np.abs(values_of(ball, r * way, vertex="warm", grid_mm=0.2) - 3 * way[:, 2]).max() < close


def test_integers_are_shares_and_range_maps_them(tmp_path: Path) -> None:
    solid = fine_box(2)
    share = linear(solid[0])
    box = ply(
        tmp_path / "part.ply", solid, red=np.rint(share * 255).astype("u1"), wide=np.rint(share * 65535).astype("u2"),
        whole=np.full(len(share), 255, "u1"), tone=np.full(len(share), 51, "u1"), real=share.astype("f8"),
    )  # fmt: skip
    places = on_box(300)
    for name, close in (("red", 0.003), ("wide", 2e-5), ("real", 1e-6)):
        found = values_of(box, places, vertex=name, range=[2, 6], grid_mm=0.2)
        np.testing.assert_allclose(found, 2 + 4 * linear(places), atol=4 * close)
    assert (values_of(box, places, vertex="whole", range=[0.1, 0.7]) == 0.7).all()
    assert (values_of(box, places, vertex="tone") == 0.2).all()
    constant = open_field(VertexSource(vertex="tone"), box, NOTHING)
    assert constant.varies == (False, False, False)
    assert constant.bounds == (0.2, 0.2)


def test_skin_deep(tmp_path: Path) -> None:
    solid = fine_box(1)
    box = ply(tmp_path / "part.ply", solid, real=np.full(len(solid[0]), 0.8))
    z = np.array([-0.5, 0.0, 0.25, 0.5, 1.0, 1.01, 2.0])
    places = CORNER + np.stack([np.full(7, 2.0), np.full(7, 2.0), z], axis=1)
    found = values_of(box, places, vertex="real", depth=1.0, beyond=0.4, grid_mm=0.13)
    np.testing.assert_allclose(found, [0.8, 0.8, 0.7, 0.6, 0.4, 0.4, 0.4], atol=1e-6)
    exact = open_field(VertexSource(vertex="real", depth=1.0, beyond=0.4), box, NOTHING)
    samples, weights = exact.taps(*(places - CORNER).T)
    np.testing.assert_allclose((samples * weights).sum(axis=0), found, atol=1e-6)


# ---- formats


def coloured(path: Path, solid: Solid, rgb: NDArray[np.uint8]) -> Frame:
    """The same part with the same colours, in the format of a path."""
    kind = path.suffix[1:]
    if kind == "ply":
        return ply(path, solid, **{name: rgb[:, i] for i, name in enumerate(("red", "green", "blue"))})
    if kind == "obj":
        rows = [" ".join(repr(float(v)) for v in (*p, *(c / 255))) for p, c in zip(solid[0], rgb, strict=True)]
        half = len(solid[1]) // 2
        faces = [f"f {a} {b} {c}" for a, b, c in (solid[1] + 1).tolist()]
        lines = [*(f"v {row}" for row in rows), "o first", *faces[:half], "o second", *faces[half:], ""]
        return write(path, "\n".join(lines).encode())
    if kind == "glb":
        turn = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (4, 5, 6))
        local = trimesh.transformations.transform_points(solid[0], np.linalg.inv(turn))
        mesh = trimesh.Trimesh(local, solid[1], vertex_colors=rgb, process=False)
        scene = trimesh.Scene()
        scene.add_geometry(mesh, transform=turn)
        return write(path, bytes(scene.export(file_type="glb")))
    return write(path, threemf(solid, rgb))


def threemf(solid: Solid, rgb: NDArray[np.uint8], whole: bool = False) -> bytes:
    """A colour group with a colour for each vertex; or one base material for all."""
    model = lib3mf.get_wrapper().CreateModel()
    mesh = model.AddMeshObject()
    mesh.SetGeometry(
        [lib3mf.Position((lib3mf.ctypes.c_float * 3)(*row)) for row in (solid[0] - CORNER).tolist()],
        [lib3mf.Triangle((lib3mf.ctypes.c_uint32 * 3)(*row)) for row in solid[1].tolist()],
    )
    if whole:
        group = model.AddBaseMaterialGroup()
        number = group.AddMaterial("blue", lib3mf.Color(*rgb[0].tolist(), 255))
        mesh.SetObjectLevelProperty(group.GetResourceID(), number)
    else:
        group = model.AddColorGroup()
        numbers = [group.AddColor(lib3mf.Color(*row, 255)) for row in rgb.tolist()]
        mesh.SetAllTriangleProperties(
            [
                lib3mf.TriangleProperties(
                    group.GetResourceID(), (lib3mf.ctypes.c_uint32 * 3)(*(numbers[v] for v in row))
                )
                for row in solid[1].tolist()
            ]
        )
        mesh.SetObjectLevelProperty(group.GetResourceID(), numbers[0])
    moved = lib3mf.get_wrapper().GetTranslationTransform(*CORNER.tolist())
    model.AddBuildItem(mesh, moved)
    writer = model.QueryWriter("3mf")
    return bytes(writer.WriteToBuffer())


@pytest.mark.parametrize("kind", ["ply", "obj", "glb", "3mf"])
def test_colours_of_each_format(tmp_path: Path, kind: str) -> None:
    solid = fine_box(3)
    x, y, z = (solid[0] - CORNER).T / 4
    rgb = np.rint(255 * np.stack([x, y, z], axis=1)).astype(np.uint8)
    box = coloured(tmp_path / f"part.{kind}", solid, rgb)
    places = on_box(500)
    u, v, w = (places - CORNER).T / 4
    for name, expected in (("red", u), ("green", v), ("blue", w), ("grey", 0.299 * u + 0.587 * v + 0.114 * w)):
        np.testing.assert_allclose(values_of(box, places, vertex=name, grid_mm=0.2), expected, atol=0.004)


def test_a_base_material_of_a_whole_object(tmp_path: Path) -> None:
    solid = fine_box(0)
    box = write(tmp_path / "part.3mf", threemf(solid, np.array([[51, 102, 255]], np.uint8), whole=True))
    for name, expected in (("red", 0.2), ("green", 0.4), ("blue", 1.0), ("alpha", 1.0)):
        assert (values_of(box, on_box(20), vertex=name) == expected).all()


def test_ascii_ply_and_glb_attributes(tmp_path: Path) -> None:
    solid = fine_box(2)
    warm = linear(solid[0]).astype("f4")
    mesh = trimesh.Trimesh(*solid, process=False, vertex_attributes={"_warm": warm})
    places = on_box(200)
    for frame, name in (
        (ply(tmp_path / "part.ply", solid, binary=False, warm=warm), "warm"),
        (write(tmp_path / "part.glb", bytes(mesh.export(file_type="glb"))), "_warm"),
    ):
        np.testing.assert_allclose(values_of(frame, places, vertex=name, grid_mm=0.2), linear(places), atol=1e-5)


# ---- directions


def test_vectors(tmp_path: Path) -> None:
    """Lines that turn by 180° along x, written with alternating signs."""
    solid = fine_box(4)
    azimuth = 45.0 * (solid[0][:, 0] - CORNER[0])
    sign = np.where(np.arange(len(azimuth)) % 2, -1.0, 1.0)
    nx, ny, nz = (sign[:, None] * (flat(azimuth) + UP)).T
    box = ply(tmp_path / "part.ply", solid, nx=nx, ny=ny, nz=nz)
    places = on_box(500)
    expected = flat(45.0 * (places[:, 0] - CORNER[0])) + UP
    off = off_line_deg(normals_of(box, places, vertex=["nx", "ny", "nz"], reads="vector", grid_mm=0.1), expected)
    assert off.max() < 4


@pytest.mark.parametrize("kind", ["ply", "obj", "glb", "3mf"])
def test_hues(tmp_path: Path, kind: str) -> None:
    solid = fine_box(4)
    azimuth = 45.0 * (solid[0][:, 0] - CORNER[0])
    rgb = np.array([colorsys.hsv_to_rgb(a / 180 % 1, 0.8, 0.9) for a in azimuth.tolist()])
    box = coloured(tmp_path / f"part.{kind}", solid, np.rint(255 * rgb).astype(np.uint8))
    places = on_box(500)
    off = off_line_deg(
        normals_of(box, places, vertex="color", reads="hue", grid_mm=0.1), flat(45.0 * (places[:, 0] - CORNER[0]))
    )
    assert off.max() < 4


def test_angles_are_lines(tmp_path: Path) -> None:
    """1° and 179° beside each other: 0° between them, never 90°; by itself, and as an azimuth."""
    solid = fine_box(3)
    angle = np.where((np.rint(2 * (solid[0] - CORNER).sum(axis=1)) % 2) == 0, 1.0, 179.0)
    box = ply(tmp_path / "part.ply", solid, angle=angle)
    places = on_box(500)
    found = normals_of(box, places, vertex="angle", grid_mm=0.17)
    assert off_line_deg(found, flat(np.zeros(500))).max() < 1.001
    from amslicer.fields.orientation import Angles

    azimuth = Angles(open_field(VertexSource(vertex="angle"), box, NOTHING))
    found = azimuth.normals(*(places - CORNER).T)
    assert off_line_deg(found, flat(np.zeros(500))).max() < 1.001
    assert np.abs(found[:, 1]).max() > 0.01  # and not 0° everywhere


def textured_obj(solid: Solid, uv: Callable[[Floats], Floats]) -> bytes:
    corners = solid[0][solid[1]].reshape(-1, 3)
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in solid[0].tolist()]
    rows += [f"vt {u!r} {v!r}" for u, v in uv(corners).tolist()]
    rows += [
        f"f {a + 1}/{3 * i + 1} {b + 1}/{3 * i + 2} {c + 1}/{3 * i + 3}"
        for i, (a, b, c) in enumerate(solid[1].tolist())
    ]
    return "\n".join([*rows, ""]).encode()


def cylinder() -> Solid:
    return meshes.from_trimesh(trimesh.creation.cylinder(3.0, 4.0, sections=96))


@pytest.mark.parametrize("kind", ["obj", "glb", "ply"])
def test_along_u(tmp_path: Path, kind: str) -> None:
    """u grows along a slope in the xy plane and v across it, on the top and bottom of a box."""
    solid = fine_box(2)
    along, across = flat(np.array([30.0]))[0], flat(np.array([120.0]))[0]

    def uv(points: Floats) -> Floats:
        return np.stack([points @ along, points @ across + 0.9 * points[:, 2]], axis=1) / 10

    if kind == "obj":
        box = write(tmp_path / "part.obj", textured_obj(solid, uv))
    elif kind == "glb":
        mesh = trimesh.Trimesh(*solid, process=False, visual=trimesh.visual.TextureVisuals(uv=uv(solid[0])))
        box = write(tmp_path / "part.glb", bytes(mesh.export(file_type="glb")))
    else:
        s, t = uv(solid[0]).T
        box = ply(tmp_path / "part.ply", solid, s=s, t=t)
    places = on_box(500)
    places = places[np.isclose(places[:, 2], CORNER[2]) | np.isclose(places[:, 2], CORNER[2] + 4)]
    places[:, :2] = CORNER[:2] + 1.2 + (places[:, :2] - CORNER[:2]) * 0.4  # away from the edges' means
    off = off_line_deg(normals_of(box, places, vertex="uv", reads="uv", grid_mm=0.2), np.tile(along, (len(places), 1)))
    assert off.max() < 4


def test_around_a_cylinder(tmp_path: Path) -> None:
    """u is the angle around: directions are tangents, and the seam does not show."""
    solid = cylinder()

    def uv(points: Floats) -> Floats:
        u = (np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)).reshape(-1, 3)
        u = np.where((np.ptp(u, axis=1) > 0.5)[:, None] & (u < 0), u + 1, u)
        return np.stack([u.ravel(), points[:, 2] / 4], axis=1)

    tube = write(tmp_path / "part.obj", textured_obj(solid, uv))
    azimuth = np.random.default_rng(0).uniform(0, 360, 300)
    azimuth[:20] = np.linspace(178, 182, 20)
    places = 2.9 * flat(azimuth)
    places[:, 2] = np.random.default_rng(1).uniform(-1, 1, 300)
    off = off_line_deg(normals_of(tube, places, vertex="uv", reads="uv", grid_mm=0.15), flat(azimuth + 90))
    assert off.max() < 4


# ---- frames


def test_the_file_s_place_and_unit_do_not_matter(tmp_path: Path) -> None:
    solid = fine_box(2)
    colour = {"real": linear(solid[0])}
    box = ply(tmp_path / "part.ply", solid, **colour)
    path = tmp_path / "inch.ply"
    ply(path, ((solid[0] - CORNER + 16) / 25.4, solid[1]), **colour)
    mesh = read_mesh(path, "inch")
    inch = Frame(mesh.minimum_mm, mesh.size_mm, None, lambda: Part(path, mesh))
    places = on_box(200)
    there = values_of(inch, places - CORNER + 16, vertex="real", grid_mm=0.2)
    np.testing.assert_allclose(values_of(box, places, vertex="real", grid_mm=0.2), there, atol=1e-5)


def test_an_inside_out_mesh_is_painted_the_same(tmp_path: Path) -> None:
    solid = fine_box(2)
    box = ply(tmp_path / "part.ply", solid, real=linear(solid[0]))
    turned = ply(tmp_path / "turned.ply", meshes.turned(solid), real=linear(solid[0]))
    places = on_box(200, 0.2)
    spec = {"vertex": "real", "depth": 1.0, "beyond": 0.0, "grid_mm": 0.2}
    np.testing.assert_allclose(values_of(box, places, **spec), values_of(turned, places, **spec), atol=1e-6)


def test_a_turned_and_scaled_part_takes_its_field_along(tmp_path: Path) -> None:
    solid = fine_box(3)
    nx, ny, nz = (flat(45.0 * (solid[0][:, 0] - CORNER[0])) + UP).T
    ply(tmp_path / "part.ply", solid, real=linear(solid[0]), nx=nx, ny=ny, nz=nz)
    found = []
    for settings in ({}, {"rotate": [20, 40, 75], "scale": 1.5}):
        job = parts.job(
            tmp_path / "part.ply", ratio={"vertex": "real", "grid_mm": 0.2}, dimensions=3, settings=settings,
            orientation={"vertex": ["nx", "ny", "nz"], "reads": "vector", "grid_mm": 0.2},
        )  # fmt: skip
        found.append(prepare(job).painted)
    plain, turned = found
    field = (on_box(300, 0.1) - CORNER).T
    points, there = (np.stack(painted.placement.to_pattern(*field), axis=1) for painted in found)
    first, again = plain.ratios[0], turned.ratios[0]
    assert first is not None
    assert again is not None
    np.testing.assert_allclose(again.scalar(*turned.placement.to_field(*there.T)), first.scalar(*field), atol=1e-6)
    expected = turned.placement.rotation @ plain.normals(points).T
    assert off_line_deg(turned.normals(there), expected.T).max() < 1e-3


# ---- refusals


def refused(frame: Frame, message: str, **spec: Any) -> None:
    source = VertexSource.model_validate(spec)
    with pytest.raises(JobError, match=message):
        open_field(source, frame, NOTHING)


def test_refusals(tmp_path: Path) -> None:
    solid = fine_box(0)
    heat = np.zeros(len(solid[0]))
    heat[3] = np.nan
    box = ply(tmp_path / "part.ply", solid, heat=heat, red=np.zeros(8, "u1"))
    refused(box, r"part\.ply has no 'warm' at its vertices; it has heat, red\n", vertex="warm")
    refused(box, r"no 'grey'", vertex="grey")
    refused(box, r"'heat' is nan at vertex 3", vertex="heat")
    refused(box, "makes directions, and numbers are asked for", vertex="color", reads="hue")
    hues = VertexSource(vertex="color", reads="hue")
    with pytest.raises(JobError, match="has no 'green'"):
        open_orientation(hues, box, NOTHING)
    with pytest.raises(JobError, match="no texture coordinates"):
        open_orientation(VertexSource(vertex="uv", reads="uv"), box, NOTHING)
    grey = np.full(8, 77, "u1")
    with pytest.raises(JobError, match="nothing painted on it makes a direction"):
        open_orientation(hues, ply(tmp_path / "grey.ply", solid, red=grey, green=grey, blue=grey), NOTHING)
    refused(write(tmp_path / "part.stl", meshes.binary_stl(solid)), "stl files hold no values", vertex="red")
    refused(write(tmp_path / "part.off", meshes.off(solid)), "off files hold no values", vertex="red")
    refused(write(tmp_path / "plain.obj", meshes.obj(solid)), "it has no values at all", vertex="red")
    half = meshes.obj(solid).replace(b"\nv ", b" 1 1 1\nv ", 3)
    refused(write(tmp_path / "half.obj", half), "vertex 4 has no colour", vertex="red")
    plain = meshes.threemf(meshes.model_object(1, solid), '<item objectid="1"/>')
    refused(write(tmp_path / "plain.3mf", plain), "triangle 0 of object 1 has no colour", vertex="red")


def test_a_file_that_changed_is_refused(tmp_path: Path) -> None:
    solid = fine_box(0)
    box = ply(tmp_path / "part.ply", solid, real=np.zeros(8))
    (tmp_path / "part.ply").write_bytes(b"ply")
    refused(box, "changed while it was read", vertex="real")


def test_vectors_of_a_turned_node_are_refused(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(*fine_box(0), process=False)
    mesh.vertex_attributes = {"_way": np.ones((8, 3), np.float32)}
    scene = trimesh.Scene()
    scene.add_geometry(mesh, transform=trimesh.transformations.rotation_matrix(0.5, (0, 0, 1)))
    box = write(tmp_path / "part.glb", bytes(scene.export(file_type="glb")))
    way = VertexSource(vertex=("_way.x", "_way.y", "_way.z"), reads="vector")
    with pytest.raises(JobError, match="turns the mesh"):
        open_orientation(way, box, NOTHING)


def test_sparse_accessors_are_refused(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(*fine_box(0), process=False, vertex_attributes={"_warm": np.zeros(8, np.float32)})
    data = bytes(mesh.export(file_type="glb"))
    (length,) = struct.unpack_from("<I", data, 12)
    header = json.loads(data[20 : 20 + length])
    del header["accessors"][header["meshes"][0]["primitives"][0]["attributes"]["_warm"]]["bufferView"]
    text = json.dumps(header, separators=(",", ":")).encode().ljust(length)
    assert len(text) == length
    box = write(tmp_path / "part.glb", data[:20] + text + data[20 + length :])
    refused(box, "is sparse, empty or a matrix", vertex="_warm")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"vertex": ["a", "b"]}, "vertex"),
        ({"vertex": ["a", "b", "c"]}, "three names go with reads: vector"),
        ({"vertex": "a", "reads": "vector"}, "three names"),
        ({"vertex": "a", "depth": 1}, "depth and beyond go together"),
        ({"vertex": "color", "reads": "hue", "depth": 1, "beyond": 0}, "reads is hue"),
        ({"vertex": "color", "reads": "hue", "range": [0, 2]}, "means nothing to reads: hue"),
        ({"vertex": "a", "range": [0, float("inf")]}, "finite"),
    ],
)
def test_wrong_settings(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        VertexSource.model_validate(wrong)


@pytest.mark.parametrize("grid_mm", [1e-300, 5e-324, 1e-4])
def test_too_many_nodes_are_refused(tmp_path: Path, grid_mm: float) -> None:
    solid = fine_box(1)
    box = ply(tmp_path / "part.ply", solid, angle=linear(solid[0]))
    for opening in (open_field, open_orientation):
        with pytest.raises(JobError, match=r"a field by vertex with grid_mm: .* nodes over the part"):
            opening(VertexSource(vertex="angle", grid_mm=grid_mm), box, NOTHING)


@pytest.mark.parametrize("count", [5, 20])
def test_attributes_of_another_length_are_refused(tmp_path: Path, count: int) -> None:
    """The accessor says so: the values are there, and not those of the vertices."""
    values = np.arange(20, dtype=np.float32)
    mesh = trimesh.Trimesh(*fine_box(0), process=False, vertex_attributes={"_warm": values[:8]})
    data = bytes(mesh.export(file_type="glb"))
    (length,) = struct.unpack_from("<I", data, 12)
    header, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    accessor = header["accessors"][header["meshes"][0]["primitives"][0]["attributes"]["_warm"]]
    header["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
    accessor |= {"bufferView": len(header["bufferViews"]) - 1, "byteOffset": 0, "count": count}
    binary += values.tobytes()
    header["buffers"][0]["byteLength"] = len(binary)
    text = json.dumps(header).encode()
    text = text.ljust(-(-len(text) // 4) * 4)
    head = struct.pack("<3I", 0x46546C67, 2, 28 + len(text) + len(binary)) + struct.pack("<2I", len(text), 0x4E4F534A)
    whole = head + text + struct.pack("<2I", len(binary), 0x004E4942) + binary
    box = write(tmp_path / "part.glb", whole)
    refused(box, f"8 vertices, but {count} values of '_warm'", vertex="_warm")


def test_a_part_painted_on_is_read_once_for_several_fields(tmp_path: Path) -> None:
    solid = fine_box(1)
    box = ply(tmp_path / "part.ply", solid, angle=linear(solid[0]))
    part = box.part("vertex")
    same = replace(box, load_part=lambda: part)
    one, two = (open_field(VertexSource(vertex="angle"), same, NOTHING) for _ in range(2))
    assert one.painted is two.painted  # type: ignore[attr-defined]
