"""3MF: the package is looked through and counted, lib3mf parses it, and its instances are placed.

Looking first means that a small file cannot ask for unbounded memory, that a mesh which only stands in for
something else is not taken for the part, and that every triangle in the XML is known to have been read.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import PartError
from amslicer.meshfiles.soup import Soup, joined, place
from amslicer.meshfiles.threemf_package import scan_package

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.meshfiles.threemf_scan import Scan

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

_UNIT_MM = {
    "MicroMeter": 0.001,
    "MilliMeter": 1.0,
    "CentiMeter": 10.0,
    "Inch": 25.4,
    "Foot": 304.8,
    "Meter": 1000.0,
}


def read_3mf(data: bytes) -> Soup:
    """All build items of a 3MF package, components and repeated instances placed.

    Raises:
        PartError: the package is damaged, unsafe, too large or not readable by lib3mf.
    """
    scan = scan_package(data)
    extensions = ", ".join(sorted(scan.unsupported))
    missing = f"the 3MF extension {extensions}" if extensions else ""
    expected = scan.count_build()
    try:
        soup = _read_model(data, scan)
    except PartError:
        raise
    except Exception as error:  # lib3mf raises its own and ctypes' errors
        if missing:
            return replace(joined([]), missing=missing)
        raise PartError(
            f"lib3mf cannot read this 3MF file ({error})", hint="export it again, or export it as STL"
        ) from error
    if len(soup.triangles) != expected:
        raise PartError(
            f"{expected} triangles expected from objects and instances, {len(soup.triangles)} placed",
            hint="export the part as STL",
        )
    return replace(soup, missing=missing)


def _read_model(data: bytes, scan: Scan) -> Soup:
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    # The binding's ReadFromBuffer makes a Python integer of every byte.
    buffer = (ctypes.c_uint8 * len(data)).from_buffer_copy(data)
    call = wrapper.lib.lib3mf_reader_readfrombuffer
    wrapper.checkError(reader, call(reader._handle, ctypes.c_uint64(len(data)), buffer))
    _check_counts(model, scan)
    unit_mm = _UNIT_MM[lib3mf.ModelUnit(model.GetUnit()).name]
    placed = list(_placed(model, wrapper))
    return replace(joined([mesh for _, mesh in placed], [name for name, _ in placed]), unit_mm=unit_mm)


def _check_counts(model: Any, scan: Scan) -> None:
    """Every triangle that the XML holds has been read by lib3mf."""
    meshes = model.GetMeshObjects()
    while meshes.MoveNext():
        mesh = meshes.GetCurrentMeshObject()
        key = (mesh.PackagePart().GetPath().lower(), str(mesh.GetModelResourceID()))
        held, read = scan.triangles[key], mesh.GetTriangleCount()
        if read != held:
            raise PartError(
                f"object {key[1]} in {key[0]} has {held} triangles, {read} of them valid",
                hint="an index out of range or a triangle with a repeated vertex: repair and export again",
            )


def _placed(model: Any, wrapper: Any) -> Iterator[tuple[str, tuple[Floats, Ints]]]:
    """The name, and the (V, 3) vertices and (T, 3) triangles of every instance, where the build puts it."""
    read: dict[int, tuple[Floats, Ints]] = {}
    items = model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        for name, mesh, transform in _meshes(item.GetObjectResource(), _matrix(item.GetObjectTransform()), ""):
            key = int(mesh.GetUniqueResourceID())
            if key not in read:
                read[key] = _arrays(mesh, wrapper)
            yield name, place(*read[key], transform)


def _meshes(resource: Any, transform: Floats, name: str) -> Iterator[tuple[str, Any, Floats]]:
    """The mesh objects that an object is made of, each with its name, or that of what it is in, and 4 x 3 transform."""
    name = str(resource.GetName()) or name
    if resource.IsMeshObject():
        yield name, resource, transform
    elif resource.IsComponentsObject():
        for index in range(resource.GetComponentCount()):
            component = resource.GetComponent(index)
            combined = _matrix(component.GetTransform()) @ transform[:3]
            combined[3] += transform[3]
            yield from _meshes(component.GetObjectResource(), combined, name)


def _matrix(transform: Any) -> Floats:
    """Rows: images of x, y, z, then the translation (a point is a row vector, as in 3MF)."""
    return np.array([list(row) for row in transform.Fields], dtype=np.float64)


def _arrays(mesh: Any, wrapper: Any) -> tuple[Floats, Ints]:
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
