"""Binary glTF."""

from __future__ import annotations

import io
import json
import struct

import numpy as np

from amslicer.errors import PartError
from amslicer.meshfiles.soup import Soup, expect, joined, place

_LENGTHS_AT = 8  # behind magic and version: length of the file, length of the first chunk
_CHUNK_AT = 20  # behind the first chunk's length and type
_LOOKS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_")  # extensions without shape


def read_glb(data: bytes) -> Soup:
    """Every mesh of the scene, placed by its node; lines and points are left out.

    Raises:
        PartError: the file is cut short, or requires an extension that may change the shape.
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
    scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False, skip_materials=True)
    pieces = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh):
            vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
            pieces.append(place(vertices, triangles, np.asarray(matrix, np.float64).T[:, :3]))
    return joined(pieces)
