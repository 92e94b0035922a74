"""A baked surface as binary glTF 2.0 (.glb): one mesh, and base colour, roughness and normal maps inside of the file.

glTF's metallic-roughness material is the lobe of URHand (GGX, alpha = roughness^2, F0 = 0.04) with a diffuse part of
albedo / pi; KHR_materials_specular holds the lobe's scale. Source: "glTF 2.0 Specification", Khronos, 2021.
"""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .. import __version__
from ..files import whole
from ..render.see.posedmesh import PosedMesh
from ..scene import Array
from ..scene.baked import Baked
from ..scene.colour import eight_bit

_FLOAT, _UINT, _ARRAY, _ELEMENTS = 5126, 5125, 34962, 34963


def write_glb(path: Path, baked: Baked, name: str, licence: str) -> tuple[str, ...]:
    """Write a surface as .glb, whole or not at all; returns what glTF cannot say of it, in sentences.

    Raises `StorageError` if it cannot be written, `Unsupported` for a mesh without UVs.
    """
    pack = _Pack()
    vertices, normals, tangents, uvs, faces = _surface(baked)
    attributes = {
        "POSITION": pack.array(vertices, "VEC3", bounds=True),
        "NORMAL": pack.array(normals, "VEC3"),
        "TANGENT": pack.array(tangents, "VEC4"),
        "TEXCOORD_0": pack.array(uvs, "VEC2"),
    }
    indices = pack.array(faces.reshape(-1, 1), "SCALAR", _UINT, _ELEMENTS)
    codes = np.rint(255.0 * np.clip(baked.roughness, 0.0, 1.0)).astype(np.uint8)
    zero = np.zeros_like(codes)
    surface: dict[str, Any] = {
        "baseColorTexture": {"index": pack.picture(eight_bit(baked.albedo))},
        "metallicRoughnessTexture": {"index": pack.picture(np.stack([zero, codes, zero], axis=-1))},
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
    }
    material: dict[str, Any] = {"name": name, "pbrMetallicRoughness": surface}
    if baked.normal is not None:
        shown = np.rint(127.5 * baked.normal + 127.5).clip(0, 255).astype(np.uint8)
        material["normalTexture"] = {"index": pack.picture(shown)}
    material["extensions"] = {"KHR_materials_specular": {"specularFactor": min(baked.specular, 1.0)}}
    tree = {
        "asset": {"version": "2.0", "generator": f"handbench {__version__}", "copyright": licence},
        "extensionsUsed": ["KHR_materials_specular"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [material],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
    }
    with whole(path) as part:
        part.write_bytes(_file(tree | pack.tree(), bytes(pack.data)))
    remarks = []
    if (most := float(baked.albedo.max())) > 1.0:
        share = float((baked.albedo > 1.0).any(axis=-1).mean())
        remarks.append(f"albedo reaches {most:.2f}, and glTF ends at 1: {share:.1%} of the texels are cut off")
    if baked.specular > 1.0:
        remarks.append(f"the specular lobe is {baked.specular:.2f} times a dielectric's, and glTF ends at 1")
    return tuple(remarks)


class _Pack:
    """Arrays and pictures one after the other in one buffer."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []

    def array(self, values: Array, kind: str, code: int = _FLOAT, target: int = _ARRAY, bounds: bool = False) -> int:
        """The number of the accessor of values (n, width)."""
        stored = np.ascontiguousarray(values, "<u4" if code == _UINT else "<f4")
        view = self._view(stored.tobytes(), {"target": target})
        accessor = {"bufferView": view, "componentType": code, "count": len(stored), "type": kind}
        if bounds:
            accessor |= {"min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist()}
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def picture(self, codes: Array) -> int:
        """The number of the texture of a picture (H, W, 3) uint8."""
        out = io.BytesIO()
        Image.fromarray(codes).save(out, "PNG")
        self._images.append({"bufferView": self._view(out.getvalue(), {}), "mimeType": "image/png"})
        return len(self._images) - 1

    def tree(self) -> dict[str, Any]:
        return {
            "buffers": [{"byteLength": len(self.data)}],
            "bufferViews": self._views,
            "accessors": self._accessors,
            "images": self._images,
            "textures": [{"sampler": 0, "source": i} for i in range(len(self._images))],
        }

    def _view(self, content: bytes, more: dict[str, Any]) -> int:
        self._views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content), **more})
        self.data += content + bytes(-len(content) % 4)
        return len(self._views) - 1


def _file(tree: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(tree, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _surface(baked: Baked) -> tuple[Array, Array, Array, Array, Array]:
    """Vertices, unit normals (n, 3), tangents (n, 4), UVs from the top (n, 2), faces (F, 3): a vertex for each of its
    UVs."""
    posed = PosedMesh.of(baked.mesh)
    faces = baked.mesh.topology.faces
    uvs, uv_faces = baked.mesh.topology.unwrapped
    pairs, index = np.unique(np.stack([faces.ravel(), uv_faces.ravel()], axis=1), axis=0, return_inverse=True)
    split = index.reshape(-1, 3)
    vertices, normals, places = posed.vertices[pairs[:, 0]], posed.normals[pairs[:, 0]], uvs[pairs[:, 1]]
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    a, b = (vertices[split[:, k]] - vertices[split[:, 0]] for k in (1, 2))
    (s, t), (p, q) = ((places[split[:, k]] - places[split[:, 0]]).T for k in (1, 2))
    along = np.sign(s * q - t * p)[:, None] * (a * q[:, None] - b * t[:, None])  # in which u grows
    tangents = np.zeros_like(vertices)
    np.add.at(tangents, split.ravel(), np.repeat(along, 3, axis=0))
    tangents -= (tangents * normals).sum(axis=1, keepdims=True) * normals
    length = np.linalg.norm(tangents, axis=1, keepdims=True)
    aside = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
    tangents = np.where(length > 1e-12, tangents / np.maximum(length, 1e-20), aside)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    # w = 1: the second axis is normal x tangent, as `Baked` has it, mirrored charts included
    return vertices, normals, np.c_[tangents, np.ones(len(tangents))], np.c_[places[:, 0], 1.0 - places[:, 1]], split
