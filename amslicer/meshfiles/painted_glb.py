"""Vertex colours, attributes and texture coordinates of binary glTF."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import JobError
from amslicer.meshfiles.painted_mesh import COLOURS, Paint, shares
from amslicer.meshfiles.soup import place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # glTF 2.0, 3.6.2.2
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES, SHAPES = 4, (4, 5, 6)  # primitive modes: separate triangles; those with an area
AXES = "xyzw"
EXPORT = "export it with plain triangles and attributes, or as PLY"
_HEADER_AT = 12  # behind magic, version and length
TURN = 1e-6  # of a node's matrix: rounding of its float32 entries


def read_painted_glb(data: bytes) -> Paint:
    """COLOR_0, TEXCOORD_0, NORMAL and custom attributes of every mesh of the scene; vectors' axes as NAME.x, .y, .z."""
    (length,) = struct.unpack_from("<I", data, _HEADER_AT)
    header = json.loads(data[_HEADER_AT + 8 : _HEADER_AT + 8 + length])
    binary = data[_HEADER_AT + 16 + length :]
    vertices, triangles, values, uvs, start, turns = [], [], [], [], 0, False
    for matrix, mesh in _placed(header):
        for primitive in header["meshes"][mesh]["primitives"]:
            mode = primitive.get("mode", TRIANGLES)
            if mode not in SHAPES:
                continue
            if mode != TRIANGLES:
                raise JobError("it holds strips or fans of triangles, whose colours are not read", hint=EXPORT)
            named = {name: _accessor(header, binary, number) for name, number in primitive["attributes"].items()}
            points = named.pop("POSITION").astype(np.float64)
            for name, array in named.items():
                if len(array) != len(points):
                    raise JobError(f"{len(points)} vertices, but {len(array)} values of '{name}'", hint=EXPORT)
            if "indices" in primitive:
                faces = _accessor(header, binary, primitive["indices"]).astype(np.int64).reshape(-1, 3)
            else:
                faces = np.arange(len(points)).reshape(-1, 3)
            points, faces = place(points, faces, matrix)
            uvs.append(shares(named.pop("TEXCOORD_0"))[faces] if "TEXCOORD_0" in named else None)
            vertices.append(points)
            triangles.append(faces + start)
            values.append(_columns(named))
            start += len(points)
            turns = turns or _turns(matrix[:3])
    if not vertices:
        raise JobError("it holds no triangles", hint=EXPORT)
    common = set.intersection(*(set(columns) for columns in values))
    whole = [uv for uv in uvs if uv is not None]
    return Paint(
        np.concatenate(vertices),
        np.concatenate(triangles),
        {name: np.concatenate([columns[name] for columns in values]) for name in sorted(common)},
        np.concatenate(whole) if len(whole) == len(uvs) else None,
        turns,
    )


def _columns(named: dict[str, NDArray[Any]]) -> dict[str, Floats]:
    columns: dict[str, Floats] = {}
    for name, array in named.items():
        if name == "COLOR_0":
            columns |= dict(zip(COLOURS, shares(array).T, strict=False))
        elif array.shape[1] == 1:
            columns[name] = shares(array)[:, 0]
        else:
            columns |= {f"{name}.{axis}": column for axis, column in zip(AXES, shares(array).T, strict=False)}
    return columns


def _accessor(header: dict[str, Any], binary: bytes, number: int) -> NDArray[Any]:
    """(count, components) of an accessor."""
    accessor = header["accessors"][number]
    if "sparse" in accessor or "bufferView" not in accessor or accessor["type"] not in COMPONENTS:
        raise JobError(f"accessor {number} is sparse, empty or a matrix, which is not read", hint=EXPORT)
    view = header["bufferViews"][accessor["bufferView"]]
    if view.get("buffer", 0) != 0 or "uri" in header["buffers"][0]:
        raise JobError(f"accessor {number} lies outside the file", hint=EXPORT)
    kind, count = np.dtype(TYPES[accessor["componentType"]]), COMPONENTS[accessor["type"]]
    stride = view.get("byteStride", kind.itemsize * count)
    offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.ndarray((accessor["count"], count), kind, binary, offset, (stride, kind.itemsize)).copy()


def _placed(header: dict[str, Any]) -> Iterator[tuple[Floats, int]]:
    """The scene's meshes, each with the 4 x 3 transform of its node: images of x, y, z, then the translation."""
    nodes = header.get("nodes", [])
    scenes = header.get("scenes", [])
    open_ = [(number, np.eye(4)) for number in scenes[header.get("scene", 0)].get("nodes", [])]
    while open_:
        number, above = open_.pop()
        node = nodes[number]
        matrix = above @ _matrix(node)
        if "mesh" in node:
            yield matrix.T[:, :3], node["mesh"]
        open_ += [(child, matrix) for child in node.get("children", [])]


def _matrix(node: dict[str, Any]) -> Floats:
    """(4, 4) of a node; points are columns."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = np.array(
        [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
         [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
         [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    )  # fmt: skip
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _turns(linear: Floats) -> bool:
    scale = abs(float(linear[0, 0]))
    return bool(np.abs(linear - scale * np.eye(3)).max() > TURN * max(scale, float(np.abs(linear).max())))
