"""Reads the triangles of a 3MF package: lib3mf parses, this module guards and flattens.

The package is looked at before lib3mf sees it (sizes, names, DTDs, extensions), so that a small file cannot
ask for unbounded memory and a mesh that only stands in for something else is not taken for the part.
"""

from __future__ import annotations

import ctypes
import io
import math
import posixpath
import zipfile
import zlib
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from amslicer.errors import PartError

MAX_TRIANGLES = 20_000_000
"""Flattened triangles: about 2 GB while they are checked, what a desktop can spare."""
MAX_INSTANCES = 20_000
"""Placed objects and components: lib3mf takes a second for them, and quadratically more beyond."""
MAX_DEPTH = 64
"""Components within components: far above any exporter, far below Python's recursion limit."""
MAX_PACKAGE_BYTES = 4 << 30
"""Unpacked size of all members: MAX_TRIANGLES in XML take between 1 and 3 GB."""
MAX_MEMBERS = 10_000
"""Members of the package: one model part per object is the most that exporters write."""
CHUNK_BYTES = 1 << 20
"""Unpacked and dropped at a time, so that memory does not grow with the package."""

_ENCRYPTED_FLAG = 0x1  # bit 0 of a ZIP member's general purpose flags
_MODEL_RELATION = "/3dmodel"  # end of the relationship type that names a model part
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/"
# Extensions that leave the shape of the triangles alone: where objects are stored, colours, named groups.
_HARMLESS = (
    "/3dmanufacturing/core/",
    "/3dmanufacturing/production/",
    "/3dmanufacturing/material/",
    "/3dmanufacturing/trianglesets/",
)
# Extensions that define or change the shape: met anywhere, the mesh alone is not the part.
_SHAPING = {
    "/3dmanufacturing/slice/": "slice",
    "/3dmanufacturing/beamlattice/": "beam lattice",
    "/3dmanufacturing/volumetric/": "volumetric",
    "/3dmanufacturing/implicit/": "implicit",
    "/3dmanufacturing/displacement/": "displacement",
    "/3dmanufacturing/booleans/": "boolean operations",
    "/3dmanufacturing/securecontent/": "secure content",
}


@dataclass(frozen=True)
class Package:
    """The flattened triangles of a 3MF file, in the file's unit."""

    vertices: NDArray[np.float64]  # (V, 3)
    triangles: NDArray[np.int64]  # (T, 3)
    unit_mm: float  # length of the file's unit
    unsupported: tuple[str, ...]  # extensions that shape the part and are not implemented


Key = tuple[str, str]  # (part of the package, object id)


@dataclass
class _Scan:
    """What a first pass over the package's XML found."""

    triangles: dict[Key, int] = field(default_factory=dict)
    components: dict[Key, list[Key]] = field(default_factory=dict)
    items: dict[str, list[Key]] = field(default_factory=dict)  # by part: only the root's are built
    unsupported: set[str] = field(default_factory=set)
    model_parts: set[str] = field(default_factory=set)
    root: str = ""


def read_3mf(data: bytes) -> Package:
    """All build items of a 3MF package, components and repeated instances placed.

    Raises:
        PartError: for a package that is damaged, unsafe, too large or not readable by lib3mf.
    """
    scan = _scan_package(data)
    unsupported = tuple(sorted(scan.unsupported))
    expected = _count_build(scan)
    try:
        model, wrapper = _open_model(data)
        _check_counts(model, scan)
        vertices, triangles = _flatten(_placed_meshes(model), wrapper)
        if len(triangles) != expected:
            raise PartError(
                f"{expected} triangles expected from objects and instances, {len(triangles)} placed",
                hint="export the part as STL",
            )
        return Package(vertices, triangles, _unit_mm(model), unsupported)
    except PartError:
        raise
    except Exception as error:  # lib3mf raises its own and ctypes' errors
        if unsupported:
            return Package(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), 1.0, unsupported)
        raise PartError(
            f"lib3mf cannot read this 3MF file ({error})", hint="export it again, or export it as STL"
        ) from error


def _scan_package(data: bytes) -> _Scan:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _check_members(archive.infolist())
            return _scan_members(archive)
    except (
        zipfile.BadZipFile,
        zipfile.LargeZipFile,
        NotImplementedError,
        EOFError,
        OSError,
        ValueError,
        RuntimeError,
        zlib.error,
    ) as error:
        raise PartError(
            f"not a readable 3MF (ZIP) package ({error})",
            hint="the file is damaged or cut short: copy or export it again",
        ) from error


def _check_members(members: list[zipfile.ZipInfo]) -> None:
    hint = "export the part again from the program that made it"
    if len(members) > MAX_MEMBERS:
        raise PartError(f"{len(members)} members in the package, more than {MAX_MEMBERS}", hint=hint)
    total = sum(member.file_size for member in members)
    if total > MAX_PACKAGE_BYTES:
        raise PartError(f"unpacks to {total} bytes, more than {MAX_PACKAGE_BYTES}", hint=hint)
    seen: set[str] = set()
    for member in members:
        plain = member.filename.replace("\\", "/")
        if ".." in plain.split("/"):
            raise PartError(f"member {member.filename!r} points outside the package", hint=hint)
        if plain.lower() in seen:
            raise PartError(f"member {member.filename!r} is there twice", hint=hint)
        if member.flag_bits & _ENCRYPTED_FLAG:
            raise PartError(f"member {member.filename!r} is encrypted", hint="export the part without a password")
        seen.add(plain.lower())


def _scan_members(archive: zipfile.ZipFile) -> _Scan:
    """Every member is unpacked once (checking its size and CRC); the XML ones are parsed."""
    scan = _Scan()
    members = [member for member in archive.infolist() if not member.is_dir()]
    relations_first = sorted(members, key=lambda member: not member.filename.lower().endswith(".rels"))
    for member in relations_first:
        part = "/" + member.filename.replace("\\", "/").lstrip("/")
        lower = part.lower()
        is_model = lower.endswith(".model") or lower in scan.model_parts
        is_xml = is_model or lower.endswith(".rels") or lower == "/[content_types].xml"
        parser = _xml_parser(scan, part, is_model) if is_xml else None
        with archive.open(member) as stream:
            try:
                while chunk := stream.read(CHUNK_BYTES):
                    if parser is not None:
                        parser.Parse(chunk, False)
                if parser is not None:
                    parser.Parse(b"", True)
            except expat.ExpatError as error:
                raise PartError(
                    f"{part} is not valid XML ({error})", hint="the file is damaged: export it again"
                ) from error
    return scan


def _xml_parser(scan: _Scan, part: str, is_model: bool) -> expat.XMLParserType:
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.ordered_attributes = True

    def refuse_doctype(*_: object) -> None:
        raise PartError(f"{part} has a DOCTYPE, which 3MF forbids", hint="export the part again")

    parser.StartDoctypeDeclHandler = refuse_doctype
    reader = _model_reader(parser, scan, part) if is_model else _relation_reader(scan, part)
    parser.StartElementHandler = reader
    return parser


def _relation_reader(scan: _Scan, part: str) -> Any:
    """A handler that notes the model parts that a .rels part names."""
    base = posixpath.dirname(posixpath.dirname(part))

    def start(element: str, attributes: list[str]) -> None:
        if element.endswith(" Relationship"):
            pairs = dict(zip(attributes[::2], attributes[1::2], strict=True))
            if pairs.get("Type", "").endswith(_MODEL_RELATION):
                target = posixpath.normpath(posixpath.join(base, pairs.get("Target", "")))
                scan.model_parts.add(target.lower())
                if base == "/":
                    scan.root = target.lower()

    return start


def _model_reader(parser: expat.XMLParserType, scan: _Scan, part: str) -> Any:
    """A handler that counts what the part holds and notes extensions that shape it."""
    part = part.lower()
    declared: dict[str | None, str] = {}
    harmless: set[str] = set()
    current: Key = (part, "")

    def declare(prefix: str | None, uri: str | None) -> None:
        declared[prefix] = uri or ""

    def refer(pairs: dict[str, str]) -> Key:
        path = next((value for name, value in pairs.items() if name.endswith(" path")), part)
        return path.lower(), pairs.get("objectid", "")

    def start(element: str, attributes: list[str]) -> None:
        nonlocal current
        local = element.rpartition(" ")[2]
        if local == "triangle":
            scan.triangles[current] = scan.triangles.get(current, 0) + 1
        elif local in ("object", "component", "item", "model"):
            pairs = dict(zip(attributes[::2], attributes[1::2], strict=True))
            if local == "object":
                current = (part, pairs.get("id", ""))
            elif local == "component":
                scan.components.setdefault(current, []).append(refer(pairs))
            elif local == "item":
                scan.items.setdefault(part, []).append(refer(pairs))
            else:
                scan.unsupported.update(_required(pairs.get("requiredextensions", ""), declared))
        for qualified in (element, *attributes[::2]):
            if qualified not in harmless:
                shaping = [title for marker, title in _SHAPING.items() if marker in qualified]
                scan.unsupported.update(shaping)
                harmless.add(qualified)

    parser.StartNamespaceDeclHandler = declare
    return start


def _required(prefixes: str, declared: dict[str | None, str]) -> set[str]:
    """Names of the required extensions that are not implemented."""
    unsupported = set()
    for prefix in prefixes.split():
        uri = declared.get(prefix, prefix)
        if not any(marker in uri for marker in _HARMLESS):
            known = (title for marker, title in _SHAPING.items() if marker in uri)
            unsupported.add(next(known, uri))
    return unsupported


def _count_build(scan: _Scan) -> int:
    """Triangles of the build, each object counted once; nothing is expanded."""
    counted: dict[Key, tuple[int, int]] = {}
    totals = [_count(item, scan, counted, ()) for item in scan.items.get(scan.root, [])]
    instances, triangles = sum(total[0] for total in totals), sum(total[1] for total in totals)
    if instances > MAX_INSTANCES or triangles > MAX_TRIANGLES:
        raise PartError(
            f"{instances} placed objects with {triangles} triangles in all, more than {MAX_INSTANCES} or "
            f"{MAX_TRIANGLES}",
            hint="export fewer copies, or a coarser mesh",
        )
    return triangles


def _count(key: Key, scan: _Scan, counted: dict[Key, tuple[int, int]], above: tuple[Key, ...]) -> tuple[int, int]:
    """(instances, triangles) of an object with its components."""
    if key in above or len(above) > MAX_DEPTH:
        raise PartError(
            f"object {key[1]} in {key[0]} contains itself, or components nest deeper than {MAX_DEPTH}",
            hint="export the part again, or as STL",
        )
    if key not in counted:
        parts = [_count(part, scan, counted, (*above, key)) for part in scan.components.get(key, [])]
        counted[key] = (
            1 + sum(part[0] for part in parts),
            scan.triangles.get(key, 0) + sum(part[1] for part in parts),
        )
    return counted[key]


def _open_model(data: bytes) -> tuple[Any, Any]:
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    # The binding's ReadFromBuffer makes a Python integer of every byte.
    buffer = (ctypes.c_uint8 * len(data)).from_buffer_copy(data)
    wrapper.checkError(
        reader, wrapper.lib.lib3mf_reader_readfrombuffer(reader._handle, ctypes.c_uint64(len(data)), buffer)
    )
    return model, wrapper


def _check_counts(model: Any, scan: _Scan) -> None:
    """Every triangle that the XML holds has been read by lib3mf."""
    meshes = model.GetMeshObjects()
    while meshes.MoveNext():
        mesh = meshes.GetCurrentMeshObject()
        key = (mesh.PackagePart().GetPath().lower(), str(mesh.GetModelResourceID()))
        held = scan.triangles.get(key, 0)
        if mesh.GetTriangleCount() != held:
            raise PartError(
                f"object {key[1]} in {key[0]} has {held} triangles, {mesh.GetTriangleCount()} of them valid",
                hint="an index out of range or a triangle with a repeated vertex: repair and export again",
            )


def _unit_mm(model: Any) -> float:
    import lib3mf

    units = lib3mf.ModelUnit
    table = {
        units.MicroMeter: 0.001,
        units.MilliMeter: 1.0,
        units.CentiMeter: 10.0,
        units.Inch: 25.4,
        units.Foot: 304.8,
        units.Meter: 1000.0,
    }
    return table[units(model.GetUnit())]


def _placed_meshes(model: Any) -> list[tuple[Any, NDArray[np.float64]]]:
    """(mesh object, 4 x 3 transform) of every instance."""
    placed: list[tuple[Any, NDArray[np.float64]]] = []
    items = model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        _expand(item.GetObjectResource(), _matrix(item.GetObjectTransform()), placed)
    return placed


def _expand(resource: Any, transform: NDArray[np.float64], placed: list[tuple[Any, NDArray[np.float64]]]) -> None:
    if resource.IsMeshObject():
        placed.append((resource, transform))
    elif resource.IsComponentsObject():
        for part, inner in _components(resource):
            combined = inner @ transform[:3]
            combined[3] += transform[3]
            _expand(part, combined, placed)


def _components(resource: Any) -> list[tuple[Any, NDArray[np.float64]]]:
    parts = (resource.GetComponent(index) for index in range(resource.GetComponentCount()))
    return [(part.GetObjectResource(), _matrix(part.GetTransform())) for part in parts]


def _matrix(transform: Any) -> NDArray[np.float64]:
    """Rows: images of x, y, z, then the translation (a point is a row vector, as in 3MF)."""
    return np.array([list(row) for row in transform.Fields], dtype=np.float64)


def _flatten(
    placed: list[tuple[Any, NDArray[np.float64]]], wrapper: Any
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    read: dict[int, tuple[NDArray[np.float64], NDArray[np.int64]]] = {}
    all_vertices = [np.zeros((0, 3))]
    all_triangles = [np.zeros((0, 3), dtype=np.int64)]
    start = 0
    for mesh, transform in placed:
        key = int(mesh.GetUniqueResourceID())
        if key not in read:
            read[key] = _arrays(mesh, wrapper)
        vertices, triangles = read[key]
        all_vertices.append(apply_transform(vertices, transform))
        all_triangles.append(orient(triangles, transform) + start)
        start += len(vertices)
    return np.concatenate(all_vertices), np.concatenate(all_triangles)


def apply_transform(vertices: NDArray[np.float64], transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows times a 4 x 3 transform; written out, as BLAS may round differently from machine to machine."""
    if np.array_equal(transform[:3], np.eye(3)):
        return np.asarray(vertices + transform[3], dtype=np.float64)
    x, y, z = vertices[:, 0:1], vertices[:, 1:2], vertices[:, 2:3]
    placed = ((x * transform[0] + y * transform[1]) + z * transform[2]) + transform[3]
    return np.asarray(placed, dtype=np.float64)


def orient(triangles: NDArray[np.int64], transform: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangles that still face outward after a 4 x 3 transform: mirroring turns them over."""
    determinant = float(np.linalg.det(transform[:3]))
    return triangles[:, ::-1] if math.isfinite(determinant) and determinant < 0 else triangles


def _arrays(mesh: Any, wrapper: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A mesh's (V, 3) vertices and (T, 3) triangles, filled by lib3mf without a Python object for each."""
    import lib3mf

    vertices = np.zeros((mesh.GetVertexCount(), 3), dtype=np.float32)
    triangles = np.zeros((mesh.GetTriangleCount(), 3), dtype=np.uint32)
    library = wrapper.lib
    for array, entry, call in (
        (vertices, lib3mf.Position, library.lib3mf_meshobject_getvertices),
        (triangles, lib3mf.Triangle, library.lib3mf_meshobject_gettriangleindices),
    ):
        pointer = array.ctypes.data_as(ctypes.POINTER(entry))
        needed = ctypes.c_uint64(0)
        wrapper.checkError(mesh, call(mesh._handle, ctypes.c_uint64(len(array)), needed, pointer))
    return vertices.astype(np.float64), triangles.astype(np.int64)
