"""Colours of 3MF triangles: colour groups and base materials."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import JobError
from amslicer.meshfiles.painted_mesh import COLOURS, Paint
from amslicer.meshfiles.soup import place
from amslicer.meshfiles.threemf import _arrays, _matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

FULL = 255  # of a colour's components
EXPORT = "give every triangle a colour group or a base material, or export it as PLY with vertex colours"


def read_painted_3mf(data: bytes) -> Paint:
    """red, green, blue and alpha at the corners of all build items' triangles."""
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    buffer = (ctypes.c_uint8 * len(data)).from_buffer_copy(data)
    call = wrapper.lib.lib3mf_reader_readfrombuffer
    wrapper.checkError(reader, call(reader._handle, ctypes.c_uint64(len(data)), buffer))
    palette = _palette(model)
    read: dict[int, tuple[Floats, Ints, Floats]] = {}
    corners, colours = [], []
    items = model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        for mesh, transform in _instances(item.GetObjectResource(), _matrix(item.GetObjectTransform())):
            key = int(mesh.GetUniqueResourceID())
            if key not in read:
                read[key] = (*_arrays(mesh, wrapper), _colours(mesh, wrapper, palette))
            vertices, triangles, painted = read[key]
            moved, faces = place(vertices, triangles, transform)
            corners.append(moved[faces].reshape(-1, 3))
            mirrored = faces[0, 0] != triangles[0, 0]
            colours.append((painted[:, ::-1] if mirrored else painted).reshape(-1, len(COLOURS)))
    points = np.concatenate(corners)
    values = dict(zip(COLOURS, np.concatenate(colours).T, strict=True))
    return Paint(points, np.arange(len(points)).reshape(-1, 3), values)


def _instances(resource: Any, transform: Floats) -> Iterator[tuple[Any, Floats]]:
    """The mesh objects that an object is made of, each with its 4 x 3 transform."""
    if resource.IsMeshObject():
        yield resource, transform
        return
    for index in range(resource.GetComponentCount()):
        component = resource.GetComponent(index)
        combined = _matrix(component.GetTransform()) @ transform[:3]
        combined[3] += transform[3]
        yield from _instances(component.GetObjectResource(), combined)


def _palette(model: Any) -> dict[tuple[int, int], tuple[float, ...]]:
    """Colours by resource and property."""
    found: dict[tuple[int, int], tuple[float, ...]] = {}
    for groups, colour in (
        (model.GetColorGroups(), "GetColor"),
        (model.GetBaseMaterialGroups(), "GetDisplayColor"),
    ):
        while groups.MoveNext():
            group = groups.GetCurrent()
            resource = int(group.GetResourceID())
            for number in group.GetAllPropertyIDs():
                c = getattr(group, colour)(number)
                found[resource, int(number)] = (c.Red / FULL, c.Green / FULL, c.Blue / FULL, c.Alpha / FULL)
    return found


def _colours(mesh: Any, wrapper: Any, palette: dict[tuple[int, int], tuple[float, ...]]) -> Floats:
    """(T, 3, 4) of a mesh's corners."""
    import lib3mf

    found = np.zeros((mesh.GetTriangleCount(), 4), np.uint32)  # resource, then a property for each corner
    pointer = found.ctypes.data_as(ctypes.POINTER(lib3mf.TriangleProperties))
    call = wrapper.lib.lib3mf_meshobject_getalltriangleproperties
    wrapper.checkError(mesh, call(mesh._handle, ctypes.c_uint64(len(found)), ctypes.c_uint64(0), pointer))
    resource, number, has = mesh.GetObjectLevelProperty()
    if has:
        found[found[:, 0] == 0] = (resource, number, number, number)
    pairs = np.stack([np.repeat(found[:, 0], 3), found[:, 1:].reshape(-1)], axis=1)
    kinds, which = np.unique(pairs, axis=0, return_inverse=True)
    unknown = [i for i, pair in enumerate(kinds.tolist()) if tuple(pair) not in palette]
    if unknown:
        first = int(np.flatnonzero(np.isin(which.reshape(-1), unknown))[0]) // 3
        raise JobError(
            f"triangle {first} of object {mesh.GetModelResourceID()} has no colour of a colour group or base material",
            hint=EXPORT,
        )
    colours = np.array([palette[tuple(pair)] for pair in kinds.tolist()])
    return np.asarray(colours[which.reshape(-1)].reshape(-1, 3, len(COLOURS)))
