"""Sound inputs about hands, made once: folders of pictures, published layouts, MANO files, avatars, meshes, poses."""

from __future__ import annotations

import io
import os
import struct
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from PIL import Image

TESTS = Path(__file__).resolve().parents[2] / "tests"


@dataclass(frozen=True)
class Hands:
    """Sound inputs: `captures` are folders by layout, `files` contents by name, such as meshes, poses, MANO's file."""

    mano: Path
    avatar: Path
    captures: dict[str, Path]
    files: dict[str, bytes]


def make_hands(folder: Path) -> Hands:
    """All of it, in some twenty seconds; look-alikes are those of the tests."""
    sys.path.insert(0, str(TESTS))
    import lookalikes
    import pairlookalike
    import phonelookalike
    import plainfolder
    import syntheticmano

    from handbench.data.openstage import open_capture
    from handbench.hand import hand_model
    from handbench.hand.known import forget

    mano = syntheticmano.write(folder / "mano")
    os.environ["HANDBENCH_MANO"] = str(mano)
    forget("mano-right", "mano-left")
    stage, right = open_capture("mini"), hand_model("mano-right")
    places = {
        name: folder / name
        for name in ("plain", "colmap", "interhand", "harp", "palm", "goliath", "pair", "own", "iphone")
    }
    for place in places.values():
        place.mkdir()
    plainfolder.write_folder(places["plain"], stage)
    plainfolder.write_folder(places["colmap"], stage, cameras="colmap", suffix=".jpg")
    lookalikes.write_interhand(places["interhand"], stage, right)
    lookalikes.write_harp(places["harp"], stage, right)
    lookalikes.write_dataset_palm(places["palm"], stage, right)
    lookalikes.write_goliath(places["goliath"], stage)
    pairlookalike.write(places["pair"], stage, right, hand_model("mano-left"))
    phonelookalike.write_own(places["own"], stage, right)
    phonelookalike.write_goliath(places["iphone"], stage, right)
    avatar, files = _avatar(folder / "a.avatar")
    obj = next(places["plain"].glob("meshes/*.obj"))
    files |= {
        "mesh.obj": obj.read_bytes(),
        "mesh.ply": _ply(),
        "poses.npz": next(places["plain"].glob("poses/*.npz")).read_bytes(),
        "transforms.json": (places["plain"] / "transforms.json").read_bytes(),
        "cameras.txt": (places["colmap"] / "sparse" / "0" / "cameras.txt").read_bytes(),
        "images.txt": (places["colmap"] / "sparse" / "0" / "images.txt").read_bytes(),
        "MANO_RIGHT.pkl": (mano / "MANO_RIGHT.pkl").read_bytes(),
        "map.ktx": _ktx(),
        **_binary_colmap(),
        **_pictures(),
    }
    return Hands(mano, avatar, places, files)


def _avatar(folder: Path) -> tuple[Path, dict[str, bytes]]:
    """An avatar of `physical` with a random skin, and what is exported of it."""
    import torch

    from handbench.avatars.folder import write_avatar
    from handbench.avatars.gltf import write_glb
    from handbench.avatars.portrait import Portrait
    from handbench.avatars.repertoire import Body, Repertoire
    from handbench.hand import hand_model
    from handbench.methods.reflectance.model import PRESETS, ReflectanceAvatar, ReflectancePrior
    from handbench.methods.reflectance.physical import INFO
    from handbench.scene import Camera

    hand, config = hand_model(), PRESETS["quick"]
    body = Body(hand.name, np.asarray(hand.neutral()), 0)
    postures = {name: body.posture(name, hand.named_pose("rest")) for name in ("rest", "again")}
    K = np.array([[40.0, 0, 12], [0, 40, 16], [0, 0, 1]])
    camera = Camera("front", 24, 32, K, np.c_[np.diag([1.0, -1.0, -1.0]), [0.0, 0.08, 0.4]])
    shown = Repertoire("me", postures, {"front": camera}, tuple((name, "front") for name in postures), body)
    prior = ReflectancePrior("physical", "brdf", config, (1.0, 0.5, 0.45))
    texture = torch.rand(3, config.texture, config.texture, generator=torch.Generator().manual_seed(3))
    avatar = ReflectanceAvatar(0.3 * texture, prior)
    portrait = Portrait("a", INFO, "quick", asdict(config), prior, avatar, shown, "made here", "none", "a")
    write_avatar(portrait, folder)
    write_glb(folder.with_name("a.glb"), avatar.baked(shown.viewpoint(postures["rest"], camera)), "a", "none")
    return folder, {"mesh.glb": folder.with_name("a.glb").read_bytes()}


def _ply() -> bytes:
    """A tetrahedron, as text."""
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    return (head + "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n").encode()


def _ktx() -> bytes:
    """A cube map of 4 texels a side in single precision."""
    faces = np.random.default_rng(2).random((6, 4, 4, 3)).astype("<f4")
    header = struct.pack("<13I", 0x04030201, 0x1406, 4, 0x1907, 0x8815, 0x1907, 4, 4, 0, 0, 6, 1, 0)
    return b"\xabKTX 11\xbb\r\n\x1a\n" + header + struct.pack("<I", faces[0].nbytes) + faces.tobytes()


def _binary_colmap() -> dict[str, bytes]:
    """A model of one camera and two pictures, as COLMAP writes it in binary."""
    cameras = struct.pack("<QiiQQ4d", 1, 1, 1, 24, 32, 40.0, 40.0, 12.0, 16.0)
    images = struct.pack("<Q", 2)
    for number in (1, 2):
        images += struct.pack("<i7di", number, 1.0, 0.0, 0.0, 0.0, 0.1 * number, 0.0, 0.4, 1)
        images += f"{number}.png".encode() + b"\0" + struct.pack("<Q", 1) + struct.pack("<ddq", 3.0, 4.0, -1)
    return {"cameras.bin": cameras, "images.bin": images}


def _pictures() -> dict[str, bytes]:
    """A small picture in each format that pictures of one's own may have and that is in no folder."""
    codes = np.random.default_rng(5).integers(0, 256, (16, 12, 3)).astype(np.uint8)
    found = {}
    for suffix, kind in (("jpg", "JPEG"), ("avif", "AVIF"), ("png", "PNG")):
        out = io.BytesIO()
        Image.fromarray(codes).save(out, kind)
        found[f"picture.{suffix}"] = out.getvalue()
    return found
