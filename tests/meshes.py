"""Closed solids for the tests, and writers of the formats that users bring; all deterministic."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable, Iterable
from typing import Any

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

Solid = tuple[NDArray[np.float64], NDArray[np.int64]]  # (V, 3) vertices, (T, 3) outward triangles
Point = tuple[float, float, float]

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
RELATIONSHIPS = "http://schemas.openxmlformats.org/package/2006"
MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"


def box(size: Point = (3.0, 4.0, 5.0), at: Point = (0.0, 0.0, 0.0)) -> Solid:
    """A box with its lowest corner at a point."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))]
    return corners * np.array(size) + np.array(at), np.array(triangles, dtype=np.int64)


def joined(*solids: Solid) -> Solid:
    """Several solids as one mesh, each keeping its own vertices."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in solids)])
    shifted = [triangles + start for (_, triangles), start in zip(solids, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in solids]), np.concatenate(shifted)


def turned(solid: Solid) -> Solid:
    """The same surface facing inward."""
    return solid[0], solid[1][:, ::-1].copy()


def moved(solid: Solid, by: Point) -> Solid:
    return solid[0] + np.array(by), solid[1]


def octahedron(radius: float = 2.0) -> Solid:
    """All six vertices, and the whole waist, on layer planes of any pitch that divides the radius."""
    vertices = radius * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    top = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4)]
    bottom = [(2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    return vertices.astype(np.float64), np.array(top + bottom, dtype=np.int64)


def tetrahedron(edge: float = 1.0, at: Point = (0.0, 0.0, 0.0)) -> Solid:
    """The corner of a cube: volume edge**3 / 6."""
    vertices = edge * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + np.array(at)
    return vertices, np.array([(0, 2, 1), (0, 3, 2), (0, 1, 3), (1, 2, 3)], dtype=np.int64)


def staircase(steps: int = 5) -> Solid:
    """Horizontal faces at every whole z."""
    outline = [(0.0, 0.0), (float(steps), 0.0)]
    for step in range(steps, 0, -1):
        outline += [(float(step), float(steps - step + 1)), (float(step - 1), float(steps - step + 1))]
    profile = manifold3d.CrossSection([np.array(outline[:-1])])
    return from_manifold(profile.extrude(2.0).rotate([90.0, 0.0, 0.0]))


def from_trimesh(mesh: trimesh.Trimesh) -> Solid:
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)


def from_manifold(solid: manifold3d.Manifold) -> Solid:
    mesh = solid.to_mesh()
    return np.array(mesh.vert_properties[:, :3], dtype=np.float64), np.array(mesh.tri_verts, dtype=np.int64)


def to_manifold(solid: Solid) -> manifold3d.Manifold:
    """For slices and volumes to compare with; one closed 2-manifold body only."""
    vertices, triangles = solid
    return manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), triangles.astype(np.uint32)))


def sphere(radius: float = 3.0, subdivisions: int = 3) -> Solid:
    return from_trimesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def torus(major: float = 4.0, minor: float = 1.5) -> Solid:
    return from_trimesh(trimesh.creation.torus(major_radius=major, minor_radius=minor))


def nested_shells() -> Solid:
    """A box with a box-shaped cavity."""
    return joined(box((6.0, 6.0, 6.0)), turned(box((2.0, 3.0, 2.0), (2.0, 1.0, 2.0))))


def island_in_cavity() -> Solid:
    return joined(nested_shells(), box((1.0, 1.0, 1.0), (2.5, 2.0, 2.5)))


def star(twist_degrees: float = 0.0) -> Solid:
    turn = np.arange(10) * np.pi / 5
    radius = np.where(np.arange(10) % 2, 1.5, 4.0)
    outline = manifold3d.CrossSection([np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])])
    return from_manifold(outline.extrude(5.0, 12 if twist_degrees else 0, twist_degrees))


def perforated_plate() -> Solid:
    plate = manifold3d.Manifold.cube((12.0, 9.0, 1.27))
    for column in range(4):
        for row in range(3):
            hole = manifold3d.Manifold.cylinder(3.0, 0.8, -1.0, 24)
            plate -= hole.translate((1.5 + 3 * column, 1.5 + 3 * row, -1.0))
    return from_manifold(plate)


def random_boolean(seed: int) -> Solid:
    """A few rotated boxes, spheres and cylinders, added or cut."""
    random = np.random.default_rng(seed)
    solid = manifold3d.Manifold.cube((4.0, 4.0, 4.0), True)
    makers: list[Callable[[], manifold3d.Manifold]] = [
        lambda: manifold3d.Manifold.cube((3.0, 2.0, 1.5), True),
        lambda: manifold3d.Manifold.sphere(1.6, 20),
        lambda: manifold3d.Manifold.cylinder(5.0, 0.9, 0.5, 16, True),
    ]
    for step in range(6):
        other = makers[int(random.integers(len(makers)))]()
        other = other.rotate(random.uniform(0, 360, 3)).translate(random.uniform(-2, 2, 3))
        solid = solid + other if step % 2 else solid - other
    return from_manifold(solid)


GENERATED: list[tuple[str, Callable[[], Solid]]] = [
    ("box", box),
    ("sphere", sphere),
    ("torus", torus),
    ("cylinder", lambda: from_trimesh(trimesh.creation.cylinder(2.0, 5.0, sections=40))),
    ("cone", lambda: from_trimesh(trimesh.creation.cone(2.0, 4.0, sections=24))),
    ("capsule", lambda: from_trimesh(trimesh.creation.capsule(3.0, 1.0, count=(12, 12)))),
    ("tube", lambda: from_trimesh(trimesh.creation.annulus(1.0, 2.0, 3.0, sections=32))),
    ("nested_shells", nested_shells),
    ("island_in_cavity", island_in_cavity),
    ("overlapping_boxes", lambda: joined(box(), box((3.0, 3.0, 3.0), (1.5, 2.5, 2.0)))),
    ("box_inside_box", lambda: joined(box((5.0, 5.0, 5.0)), box((1.0, 2.0, 3.0), (1.0, 1.0, 1.0)))),
    ("same_box_twice", lambda: joined(box(), box())),
    ("boxes_sharing_edge", lambda: joined(box((1.0, 1.0, 1.0)), box((1.0, 1.0, 1.0), (1.0, 1.0, 0.0)))),
    ("boxes_sharing_vertex", lambda: joined(box((1.0, 1.0, 1.0)), box((2.0, 1.0, 1.0), (1.0, 1.0, 1.0)))),
    ("boxes_sharing_face", lambda: joined(box((1.0, 1.0, 1.0)), box((1.0, 1.0, 1.0), (0.0, 0.0, 1.0)))),
    ("octahedron_on_planes", octahedron),
    ("staircase_on_planes", staircase),
    ("star", star),
    ("twisted_star", lambda: star(100.0)),
    ("perforated_plate", perforated_plate),
    ("random_boolean_1", lambda: random_boolean(1)),
    ("random_boolean_2", lambda: random_boolean(2)),
    ("random_boolean_3", lambda: random_boolean(3)),
]


def binary_stl(solid: Solid, header: bytes = b"") -> bytes:
    vertices, triangles = solid
    record = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("tag", "<u2")])
    with np.errstate(over="ignore"):
        record["corners"] = vertices[triangles]
    return header.ljust(80, b" ") + len(triangles).to_bytes(4, "little") + record.tobytes()


def ascii_stl(*solids: Solid) -> bytes:
    lines: list[str] = []
    for number, (vertices, triangles) in enumerate(solids):
        lines.append(f"solid body{number}")
        for corners in vertices[triangles].tolist():
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += [f"vertex {x!r} {y!r} {z!r}" for x, y, z in corners]
            lines += ["endloop", "endfacet"]
        lines.append(f"endsolid body{number}")
    return "\n".join([*lines, ""]).encode()


def obj(solid: Solid, faces: Iterable[str] | None = None) -> bytes:
    vertices, triangles = solid
    if faces is None:
        faces = (f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist())
    return "\n".join([*(f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()), *faces, ""]).encode()


def _rows(solid: Solid) -> str:
    vertices, triangles = solid
    points = [f"{x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join([*points, *(f"3 {a} {b} {c}" for a, b, c in triangles.tolist()), ""])


def ply(solid: Solid, more_vertices: int = 0, more_faces: int = 0) -> bytes:
    """ASCII PLY; the header may declare more than there is."""
    vertices, triangles = solid
    properties = "\n".join(f"property double {axis}" for axis in "xyz")
    return (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices) + more_vertices}\n{properties}\n"
        f"element face {len(triangles) + more_faces}\nproperty list uchar int vertex_indices\nend_header\n"
        f"{_rows(solid)}"
    ).encode()


def off(solid: Solid, more_faces: int = 0) -> bytes:
    return f"OFF\n{len(solid[0])} {len(solid[1]) + more_faces} 0\n{_rows(solid)}".encode()


def glb(solid: Solid, matrix: NDArray[np.float64] | None = None, requires: str | None = None) -> bytes:
    """GLB with one placed mesh; it may claim to require an extension."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(*solid, process=False), transform=matrix)
    exported: Any = scene.export(file_type="glb")
    content = bytes(exported)
    if requires is None:
        return content
    (length,) = struct.unpack_from("<I", content, 12)
    header = json.dumps(json.loads(content[20 : 20 + length]) | {"extensionsRequired": [requires]}).encode()
    header += b" " * (-len(header) % 4)
    total = len(content) - length + len(header)
    start = struct.pack("<4s4I", b"glTF", 2, total, len(header), 0x4E4F534A)
    return start + header + content[20 + length :]


def model_object(number: int, solid: Solid, extra: str = "") -> str:
    """An <object> of a 3MF model; extra goes behind its triangles."""
    vertices, triangles = solid
    points = "".join(f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in vertices.tolist())
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles.tolist())
    mesh = f"<mesh><vertices>{points}</vertices><triangles>{faces}</triangles>{extra}</mesh>"
    return f'<object id="{number}" type="model">{mesh}</object>'


def model_components(number: int, components: Iterable[str]) -> str:
    return f'<object id="{number}"><components>{"".join(components)}</components></object>'


def threemf(
    resources: str,
    items: str,
    unit: str = "millimeter",
    attributes: str = "",
    before: str = "",
    members: dict[str, bytes] | None = None,
) -> bytes:
    """A 3MF package with one model part, and further members as given."""
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?>{before}<model unit="{unit}" xmlns="{CORE}" {attributes}>'
        f"<resources>{resources}</resources><build>{items}</build></model>"
    )
    types = "".join(
        f'<Default Extension="{extension}" ContentType="application/vnd.{kind}+xml"/>'
        for extension, kind in (
            ("rels", "openxmlformats-package.relationships"),
            ("model", "ms-package.3dmanufacturing-3dmodel"),
        )
    )
    relation = f'<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="{MODEL_TYPE}"/>'
    relations = f'<Relationships xmlns="{RELATIONSHIPS}/relationships">{relation}</Relationships>'
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{RELATIONSHIPS}/content-types">{types}</Types>'.encode(),
        "_rels/.rels": relations.encode(),
        "3D/3dmodel.model": model.encode(),
    } | (members or {})
    package = io.BytesIO()
    with zipfile.ZipFile(package, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return package.getvalue()
