"""Binary glTF 2.0 (.glb): the triangles of its meshes, placed by their nodes, with the first set of UVs.

Only what is inside the file is read: buffers and pictures elsewhere, skins, animations and compression are refused or
not looked at.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import check_value
from ...scene import Array, Mesh
from .surface import welded

_TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_NODES = 4096


def parse_glb(content: bytes) -> Mesh:
    """The mesh in a GLB file: all triangles of its scene together."""
    if content[:4] != b"glTF" or len(content) < 20:
        raise InputError("it is no binary glTF; export it as .glb")
    if struct.unpack_from("<I", content, 4)[0] != 2:
        raise InputError("it is glTF of another version than 2; export it as glTF 2.0")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= len(content):
        length, kind = struct.unpack_from("<I4s", content, at)
        chunks.setdefault(kind, content[at + 8 : at + 8 + length])
        at += 8 + length
    tree = json.loads(chunks.get(b"JSON", b"{}"))
    check_value(tree, "its JSON")
    if not isinstance(tree, dict):
        raise InputError("its JSON is no object; export it anew")
    if required := tree.get("extensionsRequired"):
        raise InputError(f"it needs the extensions {', '.join(map(str, required))}; export it without compression")
    if any("uri" in buffer for buffer in tree.get("buffers", [])):
        raise InputError("its data are in another file; export it as one .glb")
    data = chunks.get(b"BIN\0", b"")
    parts = [_primitive(tree, data, p, place) for mesh, place in _meshes(tree) for p in mesh["primitives"]]
    if not parts:
        raise InputError("it holds no mesh; export a surface")
    counts = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _, _ in parts])
    faces = np.concatenate([faces + start for (_, faces, _), start in zip(parts, counts, strict=False)])
    unwrapped = [uvs for _, _, uvs in parts if uvs is not None]
    if unwrapped and len(unwrapped) < len(parts):
        raise InputError("a part of it has no UVs; unwrap all of it")
    return welded(vertices, faces, np.concatenate(unwrapped) if unwrapped else None)


def _meshes(tree: dict[str, Any]) -> list[tuple[dict[str, Any], Array]]:
    """Each mesh of the scene with the (4, 4) matrix of its node."""
    nodes = tree.get("nodes", [])
    scenes = tree.get("scenes", [])
    roots = scenes[tree.get("scene", 0)].get("nodes", []) if scenes else list(range(len(nodes)))
    found, waiting, seen = [], [(root, np.eye(4)) for root in roots], 0
    while waiting:
        number, above = waiting.pop()
        seen += 1
        if seen > _NODES:
            raise InputError(f"its scene has more than {_NODES} nodes, or they go round in a circle; export it anew")
        node = nodes[number]
        place = above @ _matrix(node)
        if "mesh" in node:
            found.append((tree["meshes"][node["mesh"]], place))
        waiting += [(child, place) for child in node.get("children", [])]
    return found


def _matrix(node: dict[str, Any]) -> Array:
    from scipy.spatial.transform import Rotation

    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    placed = np.eye(4)
    placed[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix() * node.get("scale", [1, 1, 1])
    placed[:3, 3] = node.get("translation", [0, 0, 0])
    return placed


def _primitive(
    tree: dict[str, Any], data: bytes, primitive: dict[str, Any], place: Array
) -> tuple[Array, Array, Array | None]:
    """Vertices (V, 3), faces (F, 3) and UVs (V, 2) from the bottom, of one primitive."""
    if primitive.get("mode", 4) != 4:
        raise InputError("a part of it is no plain triangles; export it with triangles")
    attributes = primitive["attributes"]
    vertices = _accessor(tree, data, attributes["POSITION"]).astype(np.float64)
    vertices = vertices @ place[:3, :3].T + place[:3, 3]
    corners = (
        _accessor(tree, data, primitive["indices"]).ravel() if "indices" in primitive else np.arange(len(vertices))
    )
    faces = corners.astype(np.int64).reshape(-1, 3)
    if np.linalg.det(place[:3, :3]) < 0:  # a mirror turns the surface inside out
        faces = faces[:, ::-1]
    if "TEXCOORD_0" not in attributes:
        return vertices, faces, None
    uvs = _accessor(tree, data, attributes["TEXCOORD_0"]).astype(np.float64)
    return vertices, faces, np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=-1)


def _accessor(tree: dict[str, Any], data: bytes, number: int) -> Array:
    accessor = tree["accessors"][number]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise InputError("its arrays are sparse; export it anew without that")
    view = tree["bufferViews"][accessor["bufferView"]]
    dtype, width, count = np.dtype("<" + _TYPES[accessor["componentType"]]), _WIDTH[accessor["type"]], accessor["count"]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", dtype.itemsize * width)
    if min(start, count - 1) < 0 or stride < dtype.itemsize * width:
        raise InputError("its arrays have no size; it is damaged, export it anew")
    if start + stride * (count - 1) + dtype.itemsize * width > len(data):
        raise InputError("it is cut off; export it anew")
    values = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize))
    if accessor.get("normalized"):
        return values.astype(np.float64) / np.iinfo(dtype).max
    return values
