"""Exported assets, read by others: open3d reads material and pictures, our reader of meshes the surface."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handbench.avatars.gltf import write_glb
from handbench.avatars.portrait import Portrait
from handbench.data.meshfile import read_mesh
from handbench.errors import Unsupported
from handbench.method import Avatar
from handbench.scene.baked import Baked
from handbench.scene.colour import eight_bit


@pytest.fixture(scope="module")
def baked(portrait: Portrait) -> Baked:
    shown = portrait.repertoire
    return portrait.avatar.baked(shown.viewpoint(shown.posture("rest"), shown.camera("front")))


def test_reflectance_is_that_of_the_shading(portrait: Portrait, baked: Baked) -> None:
    texture = portrait.avatar._texture.permute(1, 2, 0).numpy()  # type: ignore[attr-defined]
    np.testing.assert_allclose(baked.albedo, math.pi * texture, rtol=1e-6)  # k_d = 1
    assert (baked.roughness == np.float32(0.45)).all() and baked.specular == 0.5


def test_open3d_and_our_reader_see_what_was_baked(baked: Baked, tmp_path: Path) -> None:
    o3d = pytest.importorskip("open3d")
    normal = np.zeros_like(baked.albedo)
    normal[..., 2] = 1.0
    normal[:4, :4] = [0.6, 0.0, 0.8]
    given = replace(baked, albedo=np.clip(baked.albedo, 0, 1), normal=normal)
    assert write_glb(tmp_path / "hand.glb", given, "me", "none") == ()
    model = o3d.io.read_triangle_model(str(tmp_path / "hand.glb"))
    material = model.materials[0]
    assert np.array_equal(np.asarray(material.albedo_img)[..., :3], eight_bit(given.albedo))
    assert (
        np.asarray(material.roughness_img)[..., 1 if np.asarray(material.roughness_img).ndim == 3 else ...] == 115
    ).all()
    assert np.asarray(material.normal_img)[0, 0, :3].tolist() == [204, 128, 230]
    assert len(model.meshes[0].mesh.triangles) == len(baked.mesh.topology.faces)
    found = read_mesh(tmp_path / "hand.glb")
    faces, true = found.topology.faces, baked.mesh.topology
    np.testing.assert_allclose(found.vertices[faces], baked.mesh.vertices[true.faces], atol=1e-6)
    uvs, uv_faces = found.topology.unwrapped
    np.testing.assert_allclose(uvs[uv_faces], true.unwrapped[0][true.unwrapped[1]], atol=1e-6)


def test_tangents_follow_the_texture(baked: Baked, tmp_path: Path) -> None:
    write_glb(tmp_path / "hand.glb", baked, "me", "none")
    content = (tmp_path / "hand.glb").read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    tree, data = json.loads(content[20 : 20 + length]), content[28 + length :]

    def array(name: str, width: int) -> np.ndarray:
        accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"][name]]
        start = tree["bufferViews"][accessor["bufferView"]]["byteOffset"]
        return np.frombuffer(data, "<f4", accessor["count"] * width, start).reshape(-1, width)

    tangent, normal = array("TANGENT", 4), array("NORMAL", 3)
    for values in (tangent[:, :3], normal):
        np.testing.assert_allclose(np.linalg.norm(values, axis=1), 1.0, atol=1e-5)
    assert np.abs((tangent[:, :3] * normal).sum(axis=1)).max() < 1e-4 and (tangent[:, 3] == 1).all()
    position, uv = array("POSITION", 3), array("TEXCOORD_0", 2)
    faces = np.frombuffer(data, "<u4", 3 * len(baked.mesh.topology.faces), tree["bufferViews"][4]["byteOffset"])
    corners = faces.reshape(-1, 3)
    edge, du = position[corners[:, 1]] - position[corners[:, 0]], uv[corners[:, 1], 0] - uv[corners[:, 0], 0]
    clear = np.abs(du) > np.quantile(np.abs(du), 0.8)  # edges along u
    cosine = (edge * tangent[corners[:, 0], :3]).sum(axis=1) / np.linalg.norm(edge, axis=1)
    assert np.median((np.sign(du) * cosine)[clear]) > 0.8
    assert tree["materials"][0]["extensions"]["KHR_materials_specular"]["specularFactor"] == 0.5
    assert tree["asset"]["copyright"] == "none"


def test_what_gltf_cannot_hold_is_told(portrait: Portrait, baked: Baked, tmp_path: Path) -> None:
    bright = replace(baked, albedo=2.0 * baked.albedo, specular=1.5)
    remarks = write_glb(tmp_path / "hand.glb", bright, "me", "none")
    assert "glTF ends at 1" in remarks[0] and "1.50 times" in remarks[1]

    class Learned(Avatar):
        def pose(self, viewpoint):  # type: ignore[no-untyped-def]
            raise AssertionError

    shown = portrait.repertoire
    with pytest.raises(Unsupported, match="Learned has no reflectance"):
        Learned().baked(shown.viewpoint(shown.posture("rest"), shown.camera("front")))
