"""Plain folders made from the light stage that ships, by another hand than the reader's: from docs/own-hands.md."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image
from scipy.spatial.transform import Rotation

from handbench.data.capture import Capture
from handbench.scene import Frame, Topology

LIGHTING = "env-hall"


def frames_of(capture: Capture, lighting: str = LIGHTING) -> list[Frame]:
    return [f for f in capture.frames() if f.subject == "s01" and f.lighting == lighting]


def shown(linear: np.ndarray) -> np.ndarray:
    """sRGB codes, by IEC 61966-2-1."""
    x = np.clip(linear, 0, 1)
    return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)


def write_folder(
    folder: Path,
    capture: Capture,
    *,
    suffix: str = ".png",
    cameras: str = "nerfstudio",
    unit: float = 1.0,
    z_up: bool = False,
    **more: str,
) -> Path:
    """Pictures, masks, meshes, poses and cameras of one subject under one light; `more` are lines of TOML."""
    names = {1.0: "metres", 0.01: "centimetres", 0.001: "millimetres"}
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if z_up else np.eye(3)  # ours into the folder's world
    frames = frames_of(capture)
    for frame in frames:
        seen, name = capture.observe(frame), frame.pose_name
        picture, mask = (folder / kind / frame.camera.name / name for kind in ("images", "masks"))
        for place in (picture, mask, folder / "meshes" / name, folder / "poses" / name):
            place.parent.mkdir(parents=True, exist_ok=True)
        save(picture.with_suffix(suffix), seen.image)
        Image.fromarray(np.round(255 * seen.alpha).astype(np.uint8)).save(mask.with_suffix(".png"))
        mesh = (folder / "meshes" / name).with_suffix(".obj")
        if not mesh.exists():  # another camera sees the same
            vertices = (frame.mesh.vertices @ turn.T / unit).tolist()
            mesh.write_text("\n".join(f"v {x} {y} {z}" for x, y, z in vertices) + surface(frame.mesh.topology))
        rotation = (Rotation.from_matrix(turn) * Rotation.from_rotvec(frame.pose.rotation.copy())).as_rotvec()
        np.savez(
            (folder / "poses" / name).with_suffix(".npz"),
            joints=frame.pose.joints, rotation=rotation, translation=turn @ frame.pose.translation / unit,
            shape=frame.shape,
        )  # fmt: skip
    write_cameras(folder, frames, cameras, suffix, unit, turn)
    said = {"cameras": 'file = "transforms.json"' if cameras == "nerfstudio" else 'colmap = "sparse/0"'}
    lines = [
        'format = "handbench folder"', "version = 1", 'hand = "openhand"', f'units = "{names[unit]}"',
        f'up = "{"z" if z_up else "y"}"', f'images = "images/{{camera}}/{{pose}}{suffix}"',
        'masks = "masks/{camera}/{pose}.png"', 'meshes = "meshes/{pose}.obj"', 'poses = "poses/{pose}.npz"',
        'lighting = "room"', *(f"{key} = {value}" for key, value in more.items()), "[cameras]", said["cameras"],
    ]  # fmt: skip
    (folder / "handbench.toml").write_text("\n".join(lines) + "\n")
    return folder


@cache
def surface(topology: Topology) -> str:
    """The lines of an OBJ file after its vertices."""
    uvs, uv_faces = topology.unwrapped
    lines = [f"\nvt {u} {v}" for u, v in uvs.tolist()]
    for face, corners in zip((topology.faces + 1).tolist(), (uv_faces + 1).tolist(), strict=True):
        lines.append("\nf " + " ".join(f"{v}/{t}" for v, t in zip(face, corners, strict=True)))
    return "".join(lines)


def save(path: Path, image: np.ndarray) -> None:
    if path.suffix == ".exr":
        channels = {name: np.ascontiguousarray(image[..., i], np.float32) for i, name in enumerate("RGB")}
        OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))
    elif path.suffix == ".png":
        Image.fromarray(shown(image)).save(path)
    else:
        Image.fromarray(shown(image)).save(path, quality=95)


def write_cameras(folder: Path, frames: list[Frame], kind: str, suffix: str, unit: float, turn: np.ndarray) -> None:
    if kind == "nerfstudio":
        rows = []
        for frame in frames:
            to_world = np.eye(4)
            to_world[:3, :3] = turn @ frame.camera.rotation.T @ np.diag([1.0, -1, -1])  # OpenGL: y up, z back
            to_world[:3, 3] = turn @ frame.camera.centre / unit
            K = frame.camera.K
            rows.append({
                "file_path": f"./images/{frame.camera.name}/{frame.pose_name}{suffix}",
                "transform_matrix": to_world.tolist(),
                "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2],
            })  # fmt: skip
        size = {"w": frames[0].camera.width, "h": frames[0].camera.height, "camera_model": "OPENCV", "k1": 0.0}
        (folder / "transforms.json").write_text(json.dumps({**size, "frames": rows}))
        return
    place = folder / "sparse" / "0"
    place.mkdir(parents=True)
    cameras = list({f.camera.name: f.camera for f in frames}.values())
    numbers = {camera.name: i + 1 for i, camera in enumerate(cameras)}
    text = ["# Camera list"]
    for camera in cameras:
        K = camera.K
        text.append(
            f"{numbers[camera.name]} PINHOLE {camera.width} {camera.height} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}"
        )
    (place / "cameras.txt").write_text("\n".join(text))
    text = ["# Image list"]
    for i, frame in enumerate(frames):
        x, y, z, w = Rotation.from_matrix(frame.camera.rotation @ turn.T).as_quat().tolist()
        t = " ".join(map(str, (frame.camera.world_to_camera[:, 3] / unit).tolist()))
        text += [
            f"{i} {w} {x} {y} {z} {t} {numbers[frame.camera.name]} {frame.camera.name}/{frame.pose_name}{suffix}",
            "",
        ]
    (place / "images.txt").write_text("\n".join(text))
