"""Binary glTF."""

from __future__ import annotations

import io
import json
import struct
from collections import Counter
from typing import Any

import numpy as np

from amslicer.errors import PartError
from amslicer.meshfiles.soup import EXPORT, MAX_INSTANCES, MAX_TRIANGLES, Soup, expect, joined, place

_LENGTHS_AT = 8  # behind magic and version: length of the file, length of the first chunk
_CHUNK_AT = 20  # behind the first chunk's length and type
_LOOKS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_")  # extensions without shape


def read_glb(data: bytes) -> Soup:
    """Every mesh of the scene, placed by its node; lines and points are left out.

    Raises:
        PartError: the file is cut short, asks for more than it holds or than is read, or requires an extension
            that may change the shape.
    """
    import trimesh

    length, chunk = struct.unpack_from("<2I", data, _LENGTHS_AT)
    expect(length, len(data), "GLB bytes")
    header = json.loads(data[_CHUNK_AT : _CHUNK_AT + chunk])
    shaping = [name for name in header.get("extensionsRequired", []) if not name.startswith(_LOOKS)]
    if shaping:
        raise PartError(
            f"needs the glTF extension '{shaping[0]}', which is not implemented",
            hint="export without compression and extensions, or as STL",
        )
    _check_counts(header, length)
    scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False, skip_materials=True)
    pieces, names = [], []
    for _, name, node in _places(header, scene):
        matrix, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if isinstance(mesh, trimesh.Trimesh):
            vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
            pieces.append(place(vertices, triangles, np.asarray(matrix, np.float64).T[:, :3]))
            names.append(name)
    return joined(pieces, names)


def _places(header: dict[str, Any], scene: Any) -> list[tuple[int, str, str]]:
    """Number and name in the file of each node with a mesh, in order, and what trimesh's scene calls it."""
    from trimesh.util import unique_name

    nodes, meshes = header.get("nodes", []), header.get("meshes", [])
    numbers: dict[str, int] = {}
    counts: dict[str | None, int] = {}
    for number, node in enumerate(nodes):
        numbers[unique_name(node.get("name", str(number)), numbers, counts=counts)] = number
    places = []
    for node in scene.graph.nodes_geometry:
        # The pieces of a mesh of several materials are nodes below the file's own.
        number = numbers.get(node, numbers.get(scene.graph.transforms.parents.get(node), -1))
        own = nodes[number] if number >= 0 else {}
        name = own.get("name") or ("mesh" in own and meshes[own["mesh"]].get("name")) or ""
        places.append((number, str(name), node))
    return sorted(places, key=lambda place: place[0])


def _check_counts(header: dict[str, Any], length: int) -> None:
    """What the header declares, before anything is made of it: accessors without data are arrays of zeros."""
    accessors, meshes, nodes = (header.get(name, []) for name in ("accessors", "meshes", "nodes"))
    counts = [accessor.get("count", 0) for accessor in accessors]
    if max(counts, default=0) > length:
        raise PartError(
            f"accessor {counts.index(max(counts))} declares {max(counts)} elements, in a file of {length} bytes",
            hint=EXPORT,
        )
    scenes = header.get("scenes", [])[header.get("scene", 0) :][:1]
    listed = Counter(child for parent in (*scenes, *nodes) for child in parent.get("children", parent.get("nodes", [])))
    twice = [node for node, count in listed.items() if count > 1]
    if twice:
        raise PartError(f"node {twice[0]} is listed {listed[twice[0]]} times; glTF allows one parent", hint=EXPORT)
    placed = [node["mesh"] for node in nodes if "mesh" in node]
    corners = [
        sum(counts[part["indices"]] if "indices" in part else counts[part["attributes"]["POSITION"]] for part in parts)
        for parts in (mesh["primitives"] for mesh in meshes)
    ]
    triangles = sum(corners[mesh] for mesh in placed) // 3
    if len(placed) > MAX_INSTANCES or triangles > MAX_TRIANGLES:
        raise PartError(
            f"{len(placed)} placed meshes with {triangles} triangles in all, more than {MAX_INSTANCES} or "
            f"{MAX_TRIANGLES}",
            hint="export fewer copies, or a coarser mesh",
        )
