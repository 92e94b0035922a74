"""Meshes of OBJ, PLY and GLB files: the same surface from each, and a sentence for what is none."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from handbench.data.meshfile import read_mesh
from handbench.errors import InputError
from handbench.hand import hand_model
from handbench.scene import Mesh

HAND = hand_model()
MESH = HAND.mesh(HAND.neutral(), HAND.named_pose("rest"), 0)


def split(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and UVs of one index, as PLY and glTF have them: repeated at seams."""
    uvs, uv_faces = mesh.topology.unwrapped
    pairs = np.stack([mesh.topology.faces, uv_faces], axis=-1).reshape(-1, 2)
    kept, place = np.unique(pairs, axis=0, return_inverse=True)
    return mesh.vertices[kept[:, 0]], place.reshape(-1, 3), uvs[kept[:, 1]]


def write_obj(path: Path, mesh: Mesh) -> None:
    uvs, uv_faces = mesh.topology.unwrapped
    lines = ["# a hand", "o hand", *(f"v {x} {y} {z}" for x, y, z in mesh.vertices.tolist())]
    lines += [f"vt {u} {v}" for u, v in uvs.tolist()]
    for face, uv_face in zip((mesh.topology.faces + 1).tolist(), (uv_faces + 1).tolist(), strict=True):
        lines.append("f " + " ".join(f"{v}/{t}" for v, t in zip(face, uv_face, strict=True)))
    path.write_text("\n".join(lines) + "\n")


def write_ply(path: Path, mesh: Mesh, binary: bool = True) -> None:
    vertices, faces, uvs = split(mesh)
    kind = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {kind} 1.0\ncomment a hand\nelement vertex {len(vertices)}\n"
    head += "".join(f"property double {name}\n" for name in "xyzst")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.concatenate([vertices, uvs], axis=1)
    if binary:
        body = rows.astype("<f8").tobytes() + b"".join(struct.pack("<B3i", 3, *face) for face in faces.tolist())
    else:
        body = "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()).encode()
        body += "".join(f"3 {a} {b} {c}\n" for a, b, c in faces.tolist()).encode()
    path.write_bytes(head.encode() + body)


def write_glb(path: Path, mesh: Mesh, **extra: object) -> None:
    vertices, faces, uvs = split(mesh)
    parts = [
        vertices.astype("<f4").tobytes(),
        np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=-1).astype("<f4").tobytes(),
        faces.astype("<u4").tobytes(),
    ]
    starts = np.cumsum([0, *(len(part) for part in parts)]).tolist()
    views = [{"buffer": 0, "byteOffset": s, "byteLength": len(p)} for s, p in zip(starts, parts, strict=False)]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
        {"bufferView": 1, "componentType": 5126, "count": len(uvs), "type": "VEC2"},
        {"bufferView": 2, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
    ]
    primitive = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "translation": [0, 0, 1]}, {"mesh": 0, "translation": [0, 0, -1]}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": views,
        "accessors": accessors,
        **extra,
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(parts)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


WRITERS = {"obj": write_obj, "ply": write_ply, "glb": write_glb}


@pytest.mark.parametrize("kind", WRITERS)
def test_the_surface_comes_back(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"hand.{kind}"
    WRITERS[kind](path, MESH)
    found = read_mesh(path)
    atol = 1e-6 if kind == "glb" else 1e-12
    assert len(found.vertices) == len(MESH.vertices), "seams are no slits"
    corners, expected = found.vertices[found.topology.faces], MESH.vertices[MESH.topology.faces]
    assert np.allclose(corners, expected, atol=atol)
    (uvs, uv_faces), (true, true_faces) = found.topology.unwrapped, MESH.topology.unwrapped
    assert np.allclose(uvs[uv_faces], true[true_faces], atol=max(atol, 1e-12))
    assert np.allclose(read_mesh(path, 0.001).vertices, 0.001 * found.vertices)


def test_ascii_is_as_binary(tmp_path: Path) -> None:
    for binary in (True, False):
        write_ply(tmp_path / f"{binary}.ply", MESH, binary)
    one, two = (read_mesh(tmp_path / f"{binary}.ply") for binary in (True, False))
    assert np.array_equal(one.vertices, two.vertices) and one.topology.digest == two.topology.digest


def test_an_obj_without_uvs_is_a_mesh_without_uvs_and_polygons_are_cut(tmp_path: Path) -> None:
    path = tmp_path / "square.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n")
    found = read_mesh(path)
    assert found.topology.uvs is None and found.topology.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.stl", b"solid", "unknown type; expected a file ending in .obj, .ply, .glb"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 9\n", "point outside the 3"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3 cannot be read"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 1 1 0\nf 1 2 3\n", "NaN"),
        ("a.obj", b"v 0 0 0\n", "has no faces"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nf 1/1 2/1 3/1\nf 1 2 3\n", "1 of its 2 faces have no UVs"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 7 0\nf 1/1 2/1 3/1\n", "uvs reach from 0 to 7"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "header is cut off"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 9999999\nproperty float x\nend_header\n", "or more than 4"),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\n"
                  b"property float y\nproperty float z\nend_header\n", "or more than 4"),
        ("a.glb", b"glTF\2\0\0\0", "no binary glTF"),
        ("a.glb", b"", "no binary glTF"),
    ],
)  # fmt: skip
def test_bad_files_are_one_sentence(name: str, content: bytes, told: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=told):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize(
    ("extra", "told"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "without compression"),
        ({"buffers": [{"uri": "../../etc/passwd"}]}, "one .glb"),
        ({"nodes": [{"children": [0]}]}, "round in a circle"),
        ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**9, "type": "VEC3"}] * 3}, "cut off"),
        ({"meshes": []}, "damaged"),
    ],
)
def test_bad_gltf_is_one_sentence(extra: dict, told: str, tmp_path: Path) -> None:
    write_glb(tmp_path / "a.glb", MESH, **extra)
    with pytest.raises(InputError, match=told):
        read_mesh(tmp_path / "a.glb")


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    write_obj(tmp_path / "a.obj", MESH)
    with pytest.raises(InputError, match="more than the 1,000 that such a file may have"):
        read_mesh(tmp_path / "a.obj", limit=1000)
