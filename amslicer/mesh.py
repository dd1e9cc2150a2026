"""Reads a part's mesh and refuses what does not bound a solid.

The coordinates stay as the file stores them, but for rounding noise far below float32's (SNAP), and a mesh
that is inside out as a whole is turned over. Nothing is repaired.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import stat
import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amslicer.errors import PartError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
"""Length of each unit in mm, by definition."""
PLAUSIBLE_MM = (2.0, 2000.0)
"""Largest sides of printed parts: outside, the unit was probably mistaken."""
MAX_SIZE_MM = 1e7
"""10 km: a corrupt coordinate more likely than a part."""
MAX_STEP_MM = 1e-4
"""Coarsest step between coordinates: a hundredth of a fine printer's pixel."""
SNAP = 1e-12
"""Coordinates closer than this times the size are one: CAD writes 0 and -2.7e-16 for the same corner."""
FLAT = 1e-9
"""Volume over (area x size) that counts as none: float64 sums err by 1e-15, a 1 um film 1 m wide has 5e-7."""
CAVITY_SAMPLES = 16
"""Vertices of an inverted body that are tested: enough to see past a few that touch the outside."""
CAVITY_WORK = 10_000_000
"""Solid angles spent on finding cavities, about three seconds; beyond, fewer vertices are tested."""
SOLID_ANGLES_AT_ONCE = 500_000
"""Solid angles per step: temporaries of about 100 MB."""
OUTSIDE = 0.01
"""Winding number below which a point is clearly outside: rounding leaves 1e-10, an edge of 4 degrees 0.01."""

REPAIR = "repair it (in Blender's 3D Print Toolbox, MeshLab or PrusaSlicer) and export it again"
EXPORT = "export the part again, as STL for instance"

_STL_HEADER, _STL_TRIANGLE = 84, 50  # bytes: 80 of text and the count; 12 floats and 2 bytes
_OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.MULTILINE)
_OBJ_FACE = re.compile(rb"^[ \t]*f[ \t]+([^\r\n#]*)", re.MULTILINE)
_GLB_HEADER = 20  # bytes: magic, version, length; the first chunk's length and type
_GLB_LOOKS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_")  # extensions without shape


@dataclass(frozen=True)
class Mesh:
    """A closed, outward-oriented triangle mesh in mm, relative to its own bounding box minimum."""

    file: str  # file name without folder
    sha256: str  # of the file's bytes
    vertices: Floats  # (V, 3) mm, from minimum_mm; those that no triangle uses are left out
    triangles: Ints  # (T, 3), counter-clockwise seen from outside
    minimum_mm: Floats  # (3,) bounding box minimum in the file's frame
    volume_mm3: float  # signed volume, > 0; overlaps count twice
    turned: bool  # the whole mesh was inside out
    notes: tuple[str, ...]  # what to tell the user

    @property
    def size_mm(self) -> Floats:
        """(3,) side lengths of the bounding box."""
        return np.asarray(self.vertices.max(axis=0), dtype=np.float64)


@dataclass(frozen=True)
class _Soup:
    """What a file holds, before any check; in the file's unit."""

    vertices: Floats
    triangles: Ints
    unit_mm: float = 1.0
    unsupported: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Surface:
    """A mesh with its edges and bodies found."""

    vertices: Floats  # (V, 3) mm from the bounding box minimum
    triangles: Ints  # (T, 3)
    open_edges: Ints  # (E, 2) vertices of the edges whose directed uses do not cancel
    open_uses: Ints  # (E,) triangles at each of them
    open_body: Ints  # (E,) body of one of these triangles
    body: Ints  # (T,) body that each triangle belongs to
    volumes: Floats  # (B,) signed volume of each body
    flat: Floats  # (B,) volume below which a body counts as flat


def read_mesh(path: str | os.PathLike[str], units: str | None = None) -> Mesh:
    """The solid in a file (stl obj ply off glb 3mf); units None is the file's own (3mf), or mm.

    Raises:
        PartError: the file cannot be read, or its mesh does not bound a solid.
    """
    path = Path(path)
    try:
        if units is not None and units not in UNIT_MM:
            raise PartError(f"unknown unit {units!r}", hint=f"use one of {', '.join(UNIT_MM)}")
        data = _read_bytes(path)
        soup = _read_soup(data, path)
        unit_mm = soup.unit_mm if units is None else UNIT_MM[units]
        return _solid(soup, path.name, hashlib.sha256(data).hexdigest(), unit_mm)
    except PartError as error:
        raise PartError(f"{path.name}: {error.message}", hint=error.hint) from error


def _solid(soup: _Soup, name: str, sha256: str, unit_mm: float) -> Mesh:
    needs = ""
    if soup.unsupported:
        extensions = ", ".join(soup.unsupported)
        needs = f"needs the 3MF extension {extensions} (not implemented): its mesh may only stand in for the part"
    try:
        _check_arrays(soup.vertices, soup.triangles)
        used, corners = np.unique(soup.triangles, return_inverse=True)
        stored, triangles = soup.vertices[used], np.asarray(corners.reshape(-1, 3), dtype=np.int64)
        _check_scale(stored, unit_mm)
        minimum = stored.min(axis=0)
        # Differences first: moving the file's mesh changes no bit of them. Adding 0 makes -0.0 a plain 0.
        vertices = _without_noise((stored - minimum) * unit_mm + 0.0)
        surface = _surface(vertices, triangles)
        _check_closed(surface, minimum * unit_mm)
        turned = _must_turn(surface, minimum * unit_mm)
    except PartError as error:
        message = f"{error.message}; it also {needs}" if needs else error.message
        raise PartError(message, hint=error.hint) from error
    if needs:
        raise PartError(needs, hint="export the part as a plain mesh (3MF core or STL)")
    notes = ["the whole mesh was inside out and has been turned over"] if turned else []
    notes += _unit_notes(float(vertices.max()), unit_mm)
    return Mesh(
        name,
        sha256,
        vertices,
        np.ascontiguousarray(triangles[:, ::-1]) if turned else triangles,
        minimum * unit_mm,
        abs(float(surface.volumes.sum())),
        turned,
        tuple(notes),
    )


def _read_bytes(path: Path) -> bytes:
    try:
        kind = path.stat().st_mode
        if stat.S_ISDIR(kind):
            raise PartError("is a folder, not a mesh file", hint="name the file inside it")
        if not stat.S_ISREG(kind):
            raise PartError("is not a regular file", hint="copy the mesh to a file first")
        if _suffix(path) not in _READERS:
            raise PartError(f"unsupported file type '{path.suffix}'", hint=f"use one of {', '.join(_READERS)}")
        data = path.read_bytes()
    except FileNotFoundError:
        raise PartError(f"no such file ({path})", hint="check the path of the part") from None
    except (OSError, ValueError) as error:
        raise PartError(f"cannot be opened ({error})", hint="check the path and its permissions") from error
    if not data:
        raise PartError("the file is empty (0 bytes)", hint="copy or export it again")
    return data


def _suffix(path: Path) -> str:
    return path.suffix.lower().removeprefix(".")


def _read_soup(data: bytes, path: Path) -> _Soup:
    try:
        return _READERS[_suffix(path)](data)
    except PartError:
        raise
    except Exception as error:  # parsers raise whatever they trip over
        raise PartError(f"cannot be read as {_suffix(path)} ({type(error).__name__}: {error})", hint=EXPORT) from error


def _trimesh_reader(data: bytes, suffix: str) -> dict[str, Any]:
    """The reader alone: trimesh's own mesh class may merge vertices and drop faces."""
    from trimesh.exchange.load import mesh_loaders

    reader: Any = mesh_loaders[suffix]
    return dict(reader(file_obj=io.BytesIO(data), file_type=suffix, skip_materials=True))


def _joined(pieces: list[tuple[Any, Any]]) -> _Soup:
    """(vertices, faces) pieces as one mesh; faces may have any number of corners."""
    from trimesh.geometry import triangulate_quads

    vertices, triangles, start = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for points, faces in pieces:
        if faces is not None and len(faces):
            split = np.asarray(triangulate_quads(faces), dtype=np.int64).reshape(-1, 3)
            _check_indices(split, len(points))
            vertices.append(np.asarray(points, dtype=np.float64))
            triangles.append(split + start)
            start += len(points)
    return _Soup(np.concatenate(vertices), np.concatenate(triangles))


def _expect(declared: int, found: int, what: str) -> None:
    if declared != found:
        raise PartError(
            f"{declared} {what} declared, {found} found",
            hint="the file is damaged or cut short: copy or export it again",
        )


def _read_stl(data: bytes) -> _Soup:
    declared = int.from_bytes(data[80:84], "little")
    if len(data) != _STL_HEADER + declared * _STL_TRIANGLE:
        if data.lstrip()[:5].lower() != b"solid" or b"\0" in data:
            size = _STL_HEADER + declared * _STL_TRIANGLE
            _expect(size, len(data), f"bytes (binary STL of {declared} triangles)")
        declared = len(re.findall(rb"^\s*facet\b", data, re.IGNORECASE | re.MULTILINE))
    loaded = _trimesh_reader(data, "stl")
    solids = list(loaded["geometry"].values()) if "geometry" in loaded else [loaded]
    soup = _joined([(solid["vertices"], solid["faces"]) for solid in solids])
    _expect(declared, len(soup.triangles), "STL triangles")
    return soup


def _read_obj(data: bytes) -> _Soup:
    """v and f lines; not trimesh, which takes index 0 as 1 and relative indices from the end of the file."""
    text = re.sub(rb"\\\r?\n", b" ", data)
    points = re.findall(_OBJ_VERTEX, text)
    values = np.fromstring(b" ".join(points).decode(), sep=" ")
    _expect(3 * len(points), len(values), "OBJ coordinates")
    vertices = values.reshape(-1, 3)
    lines = [re.sub(rb"/\S*", b"", line) for line in re.findall(_OBJ_FACE, text)]
    if not lines:
        return _Soup(vertices, np.zeros((0, 3), dtype=np.int64))
    sizes = np.array([len(line.split()) for line in lines])
    if sizes.min() < 3:
        raise PartError(f"face {int(sizes.argmin())} has {int(sizes.min())} corners", hint=EXPORT)
    given = np.fromstring(b" ".join(lines).decode(), sep=" ", dtype=np.int64)
    _expect(int(sizes.sum()), len(given), "OBJ indices")
    if (given == 0).any():
        raise PartError("a face uses vertex 0, but OBJ counts from 1", hint=EXPORT)
    if (given < 0).any():
        points_at, faces_at = ([m.start() for m in re.finditer(k, text)] for k in (_OBJ_VERTEX, _OBJ_FACE))
        before = np.repeat(np.searchsorted(points_at, faces_at), sizes)
        given = np.where(given < 0, given + before + 1, given)
    ragged = np.ptp(sizes) > 0
    faces = np.split(given - 1, np.cumsum(sizes)[:-1]) if ragged else (given - 1).reshape(len(sizes), -1)
    return _joined([(vertices, faces)])


def _read_ply(data: bytes) -> _Soup:
    loaded = _trimesh_reader(data, "ply")
    for name, element in loaded["metadata"]["_ply_raw"].items():
        columns = element.get("data")
        if name in ("vertex", "face") and element["length"]:
            rows = columns if isinstance(columns, np.ndarray) else next(iter((columns or {"": ()}).values()))
            _expect(element["length"], len(rows), f"PLY {name} rows")
    if "vertices" not in loaded:
        return _joined([])
    return _joined([(loaded["vertices"], loaded.get("faces"))])


def _read_off(data: bytes) -> _Soup:
    lines = re.sub(rb"#[^\n]*", b"", data).split(b"OFF", 1)[-1].splitlines()
    rows = [line for line in lines if line.strip()]
    declared = [int(count) for count in rows[0].split()[:2]]
    _expect(sum(declared), min(len(rows) - 1, sum(declared)), "OFF vertices and faces")
    loaded = _trimesh_reader(data, "off")
    return _joined([(loaded["vertices"], loaded["faces"])])


def _read_glb(data: bytes) -> _Soup:
    """Every mesh of the scene, placed by its node."""
    import trimesh

    from amslicer.threemf import apply_transform, orient

    length, chunk = struct.unpack_from("<2I", data, 8)
    _expect(length, len(data), "GLB bytes")
    header = json.loads(data[_GLB_HEADER : _GLB_HEADER + chunk])
    shaping = [name for name in header.get("extensionsRequired", []) if not name.startswith(_GLB_LOOKS)]
    if shaping:
        raise PartError(
            f"needs the glTF extension '{shaping[0]}', which is not implemented",
            hint="export without compression and extensions, or as STL",
        )
    scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False, skip_materials=True)
    pieces = []
    for node in scene.graph.nodes_geometry:
        matrix, key = scene.graph[node]
        mesh, transform = scene.geometry[key], np.asarray(matrix, dtype=np.float64).T[:, :3]
        if isinstance(mesh, trimesh.Trimesh):
            pieces.append(
                (
                    apply_transform(np.asarray(mesh.vertices, dtype=np.float64), transform),
                    orient(np.asarray(mesh.faces, dtype=np.int64), transform),
                )
            )
    return _joined(pieces)


def _read_3mf(data: bytes) -> _Soup:
    from amslicer.threemf import read_3mf

    package = read_3mf(data)
    return _Soup(package.vertices, package.triangles, package.unit_mm, package.unsupported)


_READERS = {
    "stl": _read_stl,
    "obj": _read_obj,
    "ply": _read_ply,
    "off": _read_off,
    "glb": _read_glb,
    "3mf": _read_3mf,
}


def _check_indices(triangles: Ints, count: int) -> None:
    bad = (triangles < 0) | (triangles >= count)
    if bad.any():
        first = int(np.flatnonzero(bad.any(axis=1))[0])
        raise PartError(
            f"{int(bad.sum())} vertex indices are out of range 0..{count - 1}, first "
            f"{int(triangles[first][bad[first]][0])} in triangle {first}",
            hint=EXPORT,
        )


def _check_arrays(vertices: Floats, triangles: Ints) -> None:
    if not len(triangles):
        raise PartError(
            "no triangles" + (f", only {len(vertices)} points" if len(vertices) else ""),
            hint="export a surface mesh (points, curves and empty scenes have no inside)",
        )
    _check_indices(triangles, len(vertices))
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if bad.size:
        raise PartError(
            f"{bad.size} vertices are NaN or infinite, first vertex {bad[0]}: {vertices[bad[0]].tolist()}",
            hint=EXPORT,
        )


def _check_scale(stored: Floats, unit_mm: float) -> None:
    with np.errstate(over="ignore"):
        farthest = float(np.abs(stored).max() * unit_mm)
        size = float(np.ptp(stored, axis=0).max() * unit_mm)
    if not size <= MAX_SIZE_MM:
        raise PartError(
            f"largest side {size:.6g} mm, more than {MAX_SIZE_MM:.0e} mm",
            hint="a damaged coordinate or the wrong --units: check the file",
        )
    step = float(np.spacing(farthest))
    if not step <= MAX_STEP_MM:
        raise PartError(
            f"{farthest:.6g} mm from the origin, where coordinates have steps of {step:.1g} mm",
            hint="move the part to the origin before exporting it",
        )


def _without_noise(vertices: Floats) -> Floats:
    """Vertices whose coordinates within SNAP of each other take the lowest one's value."""
    tolerance = SNAP * float(vertices.max())
    for axis in range(3):
        values = np.unique(vertices[:, axis])
        steps = np.diff(values)
        if (steps <= tolerance).any():
            groups = np.concatenate([[0], np.cumsum(steps > tolerance)])
            lowest = values[np.searchsorted(groups, groups)]
            vertices[:, axis] = lowest[np.searchsorted(values, vertices[:, axis])]
    return vertices


def _check_closed(surface: _Surface, minimum_mm: Floats) -> None:
    count = len(surface.open_edges)
    if count and (surface.open_uses % 2 == 0).all():
        bodies = np.unique(surface.open_body)
        edges = int((surface.open_body == bodies[0]).sum())
        raise PartError(
            f"{_describe(surface, int(bodies[0]), minimum_mm)} is partly inside out: {edges} edges where "
            f"neighbouring triangles face opposite sides{_and_more(len(bodies))}",
            hint="make its normals consistent (recalculate outside) and export it again",
        )
    if count:
        z = surface.vertices[surface.open_edges, 2] + minimum_mm[2]
        raise PartError(
            f"the mesh is open: {count} open edges between z = {z.min():.6g} and {z.max():.6g} mm (of "
            f"{len(surface.triangles)} triangles)",
            hint=f"a hole, or a vertex on a neighbour's edge that does not split it (T-junction): {REPAIR}",
        )


def _describe(surface: _Surface, body: int, minimum_mm: Floats) -> str:
    own = surface.vertices[surface.triangles[surface.body == body]].reshape(-1, 3) + minimum_mm
    low, high = (", ".join(f"{value:.6g}" for value in end) for end in (own.min(axis=0), own.max(axis=0)))
    return (
        f"body {body} of {len(surface.volumes)} (from ({low}) to ({high}) mm, volume {surface.volumes[body]:.6g} mm3)"
    )


def _and_more(bodies: int) -> str:
    return f" ({bodies} bodies are)" if bodies > 1 else ""


def _must_turn(surface: _Surface, minimum_mm: Floats) -> bool:
    """Whether the whole mesh is inside out.

    Raises:
        PartError: nothing has a volume, or one body is inside out and no cavity.
    """
    solid = np.abs(surface.volumes) > surface.flat
    if not solid.any():
        raise PartError(
            f"no volume ({surface.volumes.sum():.3g} mm3): a sheet without thickness",
            hint="give it a thickness before exporting it",
        )
    total = float(surface.volumes.sum())
    bad = _inverted_bodies(surface, 1.0)
    if total < 0 and not _inverted_bodies(surface, -1.0).size:
        return True
    if bad.size:
        raise PartError(
            f"{_describe(surface, int(bad[0]), minimum_mm)} is inside out and no cavity of another"
            f"{_and_more(bad.size)}",
            hint="turn its normals over (flip faces) and export it again",
        )
    if total <= 0:
        raise PartError(f"its cavities are larger than its bodies (volume {total:.6g} mm3)", hint=REPAIR)
    return False


def _unit_notes(largest_mm: float, unit_mm: float) -> list[str]:
    low, high = PLAUSIBLE_MM
    if low <= largest_mm <= high:
        return []
    sizes = {unit: largest_mm / unit_mm * length for unit, length in UNIT_MM.items()}
    fitting = [f"--units {unit} ({size:.4g} mm)" for unit, size in sizes.items() if low <= size <= high]
    advice = f"; perhaps {' or '.join(fitting)}" if fitting else "; check --units and --scale"
    return [f"the largest side is {largest_mm:.4g} mm{advice}"]


def _surface(vertices: Floats, triangles: Ints) -> _Surface:
    """Edges and bodies over places: vertices with exactly the same coordinates are one."""
    corners = _places(vertices)[triangles]
    whole = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))  # no repeated corner
    ends = corners[whole][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key = ends.min(axis=1) * (int(corners.max()) + 1) + ends.max(axis=1)
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    edge = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(order)))
    owner = whole[order // 3]
    sign = np.where(ends[:, 0] < ends[:, 1], 1, -1)[order]
    unbalanced = starts[np.bincount(edge, weights=sign, minlength=len(starts)) != 0]
    used = triangles[whole][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    body = _bodies(edge, owner, sign, len(triangles))
    corner_points = vertices[triangles]
    a, b, c = corner_points[:, 0], corner_points[:, 1], corner_points[:, 2]
    six_volumes = np.einsum("ij,ij->i", a, np.cross(b, c))
    volumes: Floats = np.bincount(body, weights=six_volumes).astype(np.float64) / 6
    double_areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    areas: Floats = np.bincount(body, weights=double_areas).astype(np.float64) / 2
    return _Surface(
        vertices,
        triangles,
        used[order[unbalanced]],
        np.bincount(edge)[edge[unbalanced]],
        body[owner[unbalanced]],
        body,
        volumes,
        FLAT * areas * float(vertices.max()),
    )


def _places(vertices: Floats) -> Ints:
    """(V,) number of each vertex's place; exact, never within a tolerance."""
    order = np.lexsort(vertices.T)
    inorder = vertices[order]
    number = np.zeros(len(vertices), dtype=np.int64)
    number[order[1:]] = np.cumsum((inorder[1:] != inorder[:-1]).any(axis=1))
    return number


def _bodies(edge: Ints, owner: Ints, sign: Ints, count: int) -> Ints:
    """(T,) body of each triangle; bodies that only touch in a vertex or an edge stay apart.

    Triangles are joined across edges that two share. Where more meet, they are joined only if the bodies
    found so far do not close there by themselves.
    """
    uses = np.bincount(edge)[edge]
    body = _connected(edge, owner, uses == 2, count)
    pair = edge * count + body[owner]
    _, which = np.unique(pair, return_inverse=True)
    unclosed = np.zeros(int(edge.max(initial=-1)) + 1, dtype=bool)
    unclosed[edge[(np.bincount(which, weights=sign) != 0)[which]]] = True
    return _connected(edge, owner, (uses == 2) | unclosed[edge], count)


def _connected(edge: Ints, owner: Ints, joins: NDArray[np.bool_], count: int) -> Ints:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    linked = np.flatnonzero(joins[1:] & (edge[1:] == edge[:-1]))
    links = (np.ones(len(linked), dtype=np.int8), (owner[linked], owner[linked + 1]))
    _, body = connected_components(coo_array(links, shape=(count, count)), directed=False)
    return np.asarray(body, dtype=np.int64)


def _inverted_bodies(surface: _Surface, facing: float) -> Ints:
    """Bodies of negative volume outside those of positive volume; facing -1: of the mesh turned over."""
    volumes = surface.volumes * facing
    negative = np.flatnonzero(volumes < -surface.flat)
    positive = surface.triangles[(volumes > surface.flat)[surface.body]]
    if not negative.size or not len(positive):
        return negative
    samples = int(np.clip(CAVITY_WORK // (len(positive) * negative.size), 1, CAVITY_SAMPLES))
    order = np.argsort(surface.body, kind="stable")
    bounds = np.searchsorted(surface.body[order], np.arange(len(volumes) + 1))
    outside = []
    for body in negative:
        own = np.unique(surface.triangles[order[bounds[body] : bounds[body + 1]]])
        tested = surface.vertices[own[np.linspace(0, len(own) - 1, min(samples, len(own))).astype(int)]]
        winding = _winding_numbers(tested, surface.vertices[positive]) * facing
        # A cavity may touch the surface from inside, where the winding number is a fraction.
        if winding.min() < OUTSIDE or winding.mean() < 0.5:
            outside.append(body)
    return np.array(outside, dtype=np.int64)


def _winding_numbers(points: Floats, corners: Floats) -> Floats:
    """(P,) turns of triangles (T, 3, 3) around points: solid angles of Van Oosterom and Strackee (1983)."""
    total = np.zeros(len(points))
    steps = range(0, len(corners), SOLID_ANGLES_AT_ONCE)
    for first, last in pairwise([*steps, len(corners)]):
        for index, point in enumerate(points):
            a, b, c = np.moveaxis(corners[first:last] - point, 1, 0)
            la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
            above = np.einsum("ij,ij->i", a, np.cross(b, c))
            below = (
                la * lb * lc
                + np.einsum("ij,ij->i", a, b) * lc
                + np.einsum("ij,ij->i", b, c) * la
                + np.einsum("ij,ij->i", c, a) * lb
            )
            total[index] += np.arctan2(above, below).sum() / (2 * np.pi)
    return total
