"""Captures in layouts that others publish, made from the light stage that ships, and not by the readers' code."""

from __future__ import annotations

import functools
import io
import json
import pickle
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from handbench.data.capture import Capture
from handbench.hand import HandModel, hand_model
from handbench.hand.conversion import converted
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import Raster
from handbench.scene import Camera, Frame

CAMERAS = {"dorsal": "400262", "palmar": "400451"}
# InterHand2.6M's key points: of each finger tip to knuckle, then the wrist
PALM = {  # of its evaluation: captures and cameras of the train split
    ("Capture0", "ROM03"): ("400262", "400451"),
    ("Capture0", "ROM04"): ("400275", "400418"),
    ("Capture0", "ROM05"): ("400270", "400488"),
    ("Capture1", "ROM03"): ("400456", "400486"),
    ("Capture1", "ROM04"): ("400266", "400439"),
    ("Capture1", "ROM05"): ("400314", "400469"),
}
FINGERS = ("thumb", "index", "middle", "ring", "little")


def shown(linear: np.ndarray) -> np.ndarray:
    x = np.clip(linear, 0, 1)
    return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)


def under(capture: Capture, lighting: str, subject: str = "s01") -> list[Frame]:
    return [f for f in capture.frames() if f.subject == subject and f.lighting == lighting]


@functools.cache
def fits(capture: Capture, mano: HandModel) -> dict[str, tuple[Any, Any]]:
    """Of each pose of s01 MANO's nearest pose and shape."""
    source, found, shape = hand_model(), {}, None
    for frame in under(capture, "env-hall"):
        if frame.pose_name not in found:
            near = converted(frame.pose, frame.shape, source, mano, shape)
            found[frame.pose_name], shape = (near.pose, near.shape), near.shape
    return found


# --- InterHand2.6M


def write_interhand(folder: Path, capture: Capture, mano: HandModel, moments: int = 3) -> dict[str, tuple[Any, Any]]:
    """Three poses (again and again, if there are more moments) in the train split; what is fitted, by frame number."""
    fitted = fits(capture, mano)
    cameras: dict[str, Any] = {"campos": {}, "camrot": {}, "focal": {}, "princpt": {}}
    points, params, told = {}, {}, {}
    frames = under(capture, "env-hall")
    poses = list(fitted)
    for number in range(moments):
        pose, shape = fitted[poses[number % len(poses)]]
        name = str(12001 + 3 * number)
        told[name] = pose, shape
        _, at = mano.posed(shape, pose)
        by_name = dict(zip(mano.joint_names, at, strict=False)) | dict(zip(FINGERS, at[16:], strict=True))
        right = [by_name[finger if k == 4 else f"{finger}{k}"] for finger in FINGERS for k in (4, 3, 2, 1)]
        world = 1000 * np.array([*right, by_name["wrist"], *np.zeros((21, 3))])
        valid = [[1]] * 21 + [[0]] * 21
        points[name] = {"world_coord": world.tolist(), "joint_valid": valid, "hand_type": "right",
                        "hand_type_valid": True, "seq": "ROM03_RT_No_Occlusion"}  # fmt: skip
        own = mano.parameters_of(pose, shape, flat_hand_mean=False)  # type: ignore[attr-defined]
        params[name] = {
            "right": {
                "pose": [*own["global_orient"].tolist(), *own["hand_pose"].tolist()],
                "shape": shape.tolist(),
                "trans": own["transl"].tolist(),
            },
            "left": None,
        }
        for frame in frames:
            if frame.pose_name != poses[number % len(poses)]:
                continue
            camera, identity = frame.camera, CAMERAS[frame.camera.name]
            cameras["campos"][identity] = (1000 * camera.centre).tolist()
            cameras["camrot"][identity] = camera.rotation.tolist()
            cameras["focal"][identity] = [camera.K[0, 0], camera.K[1, 1]]
            cameras["princpt"][identity] = [camera.K[0, 2] - 0.5, camera.K[1, 2] - 0.5]  # their first pixel is at 0
            place = folder / "images" / "train" / "Capture0" / "ROM03_RT_No_Occlusion" / f"cam{identity}"
            place.mkdir(parents=True, exist_ok=True)
            Image.fromarray(shown(capture.observe(frame).image)).save(place / f"image{name}.jpg", quality=97)
    points["99999"] = {**points["12001"], "hand_type": "left"}
    place = folder / "images" / "train" / "Capture0" / "ROM03_RT_No_Occlusion" / f"cam{CAMERAS['dorsal']}"
    Image.new("RGB", (8, 8)).save(place / "image99999.jpg")
    notes = folder / "annotations" / "train"
    notes.mkdir(parents=True)
    tables = {"camera": {"0": cameras}, "joint_3d": {"0": points}, "MANO_NeuralAnnot": {"0": params}}
    for kind, table in tables.items():
        (notes / f"InterHand2.6M_train_{kind}.json").write_text(json.dumps(table))
    return told


def write_palm(folder: Path, capture: Capture, mano: HandModel, moments: int = 4) -> None:
    """The twelve sequences that PALM evaluates on, all showing the same."""
    write_interhand(folder, capture, mano, moments)
    root, first = folder / "images" / "train", "Capture0/ROM03_RT_No_Occlusion"
    names = {"ROM03": "ROM03_RT_No_Occlusion", "ROM04": "ROM04_RT_Occlusion", "ROM05": "ROM05_RT_Wrist_ROM"}
    notes = {
        k: folder / f"annotations/train/InterHand2.6M_train_{k}.json"
        for k in ("camera", "joint_3d", "MANO_NeuralAnnot")
    }
    tables = {kind: json.loads(path.read_text()) for kind, path in notes.items()}
    for (where, movement), cameras in PALM.items():
        for camera, of in zip(cameras, CAMERAS.values(), strict=True):
            place = root / where / names[movement] / f"cam{camera}"
            if not place.exists():
                shutil.copytree(root / first / f"cam{of}", place)
            told = tables["camera"].setdefault(where[-1], {key: {} for key in tables["camera"]["0"]})
            for key, values in told.items():
                values[camera] = tables["camera"]["0"][key][of]
        for kind in ("joint_3d", "MANO_NeuralAnnot"):
            tables[kind].setdefault(where[-1], tables[kind]["0"])
    for kind, path in notes.items():
        path.write_text(json.dumps(tables[kind]))


# --- HARP


def write_harp(folder: Path, capture: Capture, mano: HandModel) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Sequences 1 and 6 of subject_1, two pictures each; pixels of all vertices and parameters, by pose name."""
    size, told = 224, {}
    poses = list(fits(capture, mano).values())
    for sequence in ("1", "6"):
        for number, (pose, shape) in enumerate(poses[:2]):
            rot, trans = np.array([0.1 * number, 0.2, -1.2]), np.array([0.001, 0.002, 0.003])
            cam = np.array([4.5 + 0.5 * number, 0.02, -0.01])
            relative = mano.parameters_of(pose, shape, flat_hand_mean=False)["hand_pose"]  # type: ignore[attr-defined]
            own = mano.pose_of(relative, rot, trans, shape, flat_hand_mean=False)  # type: ignore[attr-defined]
            vertices, joints = mano.posed(shape, own)
            # as HARP draws it with PyTorch3D, whose x is left and y is up
            focal = 2000.0 * size / 448
            placed = vertices * [-1, -1, 1] + [-cam[1], -cam[2], 2 * focal / (size * cam[0] + 1e-9)]
            pixels = size / 2 - focal * placed[:, :2] / placed[:, 2:]
            for place in ("unscreen_cropped", "mask", "metro_mano"):
                (folder / "subject_1" / sequence / place).mkdir(parents=True, exist_ok=True)
            root, name = folder / "subject_1" / sequence, f"{number + 1:04d}"
            in_opencv = placed * [-1, -1, 1]
            K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
            raster = Raster(_mesh(mano, in_opencv), Camera("camera", size, size, K, np.eye(3, 4)), 2)
            alpha = raster.alpha[..., None]
            Image.fromarray(shown(0.4 * alpha.repeat(3, -1))).save(
                root / "unscreen_cropped" / f"{name}.jpg", quality=97
            )
            Image.fromarray(np.round(255 * alpha[..., 0]).astype(np.uint8)).save(root / "mask" / f"{name}_mask.jpg")
            table = {"joints": joints[None], "verts": vertices[None], "rot": rot[None], "pose": relative[None],
                     "shape": shape[None], "trans": trans[None], "cam": cam}  # fmt: skip
            table = {key: value.astype(np.float32) for key, value in table.items()}
            (root / "metro_mano" / f"{name}_mano.pkl").write_bytes(pickle.dumps(table))
            told[f"{sequence}-{name}"] = pixels, relative
    return told


def _mesh(hand: HandModel, vertices: np.ndarray) -> PosedMesh:
    from handbench.scene import Mesh

    return PosedMesh(Mesh(vertices, hand.topology(0)))


# --- PALM


def write_dataset_palm(folder: Path, capture: Capture, mano: HandModel) -> dict[str, tuple[Any, Any]]:
    """One person, three poses before two cameras; what is fitted, by the picture's number."""
    fitted = fits(capture, mano)
    root, told = folder / "folders" / "0001", {}
    shape = next(iter(fitted.values()))[1]
    rows: dict[str, list[np.ndarray]] = {"global_orient": [], "hand_pose": [], "transl": []}
    cameras: dict[str, Any] = {}
    for number, (name, (pose, _)) in enumerate(fitted.items(), start=1):
        own = mano.parameters_of(pose, shape, flat_hand_mean=False)  # type: ignore[attr-defined]
        for key, values in rows.items():
            values.append(own[key])
        told[f"{number:06d}"] = pose, shape
        for frame in under(capture, "env-hall"):
            if frame.pose_name != name:
                continue
            camera, identity = frame.camera, {"dorsal": "MCU_01", "palmar": "MCU_04"}[frame.camera.name]
            Rt = np.concatenate([camera.world_to_camera, [[0, 0, 0, 1.0]]])
            cameras[identity] = {"K": camera.K, "Rt": Rt, "height": camera.height, "width": camera.width}
            for kind in ("images", "masks"):
                (root / kind / identity).mkdir(parents=True, exist_ok=True)
            seen = capture.observe(frame)
            Image.fromarray(shown(seen.image)).save(root / "images" / identity / f"{number:06d}.png")
            mask = Image.fromarray(np.round(255 * seen.alpha).astype(np.uint8))
            mask.save(root / "masks" / identity / f"{number:06d}.png")
    np.save(root / "cameras.npy", {"cameras": cameras}, allow_pickle=True)  # type: ignore[arg-type]
    poses = {key: np.array(values, np.float32) for key, values in rows.items()}
    np.save(root / "poses.npy", {**poses, "betas": np.tile(shape, (3, 1))}, allow_pickle=True)  # type: ignore[arg-type]
    return told


# --- Goliath

FRAMES = {100: ("pose-0", "full"), 101: ("pose-0", "group-0"), 104: ("pose-1", "full"), 300: ("pose-2", "group-0")}


def write_goliath(folder: Path, capture: Capture) -> Path:
    """One capture, of s01: two fully lit frames, a group between them, and a group far from any registration."""
    root = folder / "m--20230101--0000--6641280--pilot--ProjectGoliath--Hands--right"
    for place in ("image", "segmentation_fgbg", "kinematic_tracking", "lights"):
        (root / place).mkdir(parents=True)
    frames = {(f.pose_name, f.lighting, f.camera.name): f for f in capture.frames() if f.subject == "s01"}
    cameras = {f.camera.name: f.camera for f in frames.values()}
    entries = [{"cameraId": "999999", "K": np.eye(3).tolist(), "T": np.eye(4).tolist()}]
    for name, camera in cameras.items():
        K = camera.K.copy()
        K[:2, :2] *= 2
        K[:2, 2] = 2 * (camera.K[:2, 2] - 0.5 + 0.5) - 0.5  # twice as large; the first pixel is at 0
        T = np.eye(4)
        T[:3] = camera.world_to_camera * [1, 1, 1, 1000]
        entries.append({"cameraId": CAMERAS[name], "K": K.T.tolist(), "T": T.T.tolist()})
        with (
            zipfile.ZipFile(root / "image" / f"cam{CAMERAS[name]}.zip", "w") as images,
            zipfile.ZipFile(root / "segmentation_fgbg" / f"cam{CAMERAS[name]}.zip", "w") as masks,
        ):
            for number, (pose, lighting) in FRAMES.items():
                seen = capture.observe(frames[pose, lighting, name])
                stored = np.round(255 * np.clip(0.5 * seen.image, 0, 1) / [1.4, 1.1, 1.6] + [2, 1, 2])
                codes = Image.fromarray(np.clip(stored, 0, 255).astype(np.uint8))
                images.writestr(f"cam{CAMERAS[name]}/{number:06d}.avif", _bytes(codes, "AVIF"))
                if lighting == "full":
                    inside = Image.fromarray(np.where(seen.alpha > 0.5, 7, 0).astype(np.uint8))
                    masks.writestr(f"cam{CAMERAS[name]}/{number:06d}.png", _bytes(inside, "PNG"))
    (root / "camera_calibration.json").write_text(json.dumps({"KRT": entries}))
    split = "".join(f"{number},{'train' if number < 200 else 'test'}\n" for number in FRAMES)
    (root / "frame_splits_list.csv").write_text("frame,split\n" + split + "500,test\n")
    with zipfile.ZipFile(root / "kinematic_tracking" / "registration_vertices.zip", "w") as archive:
        for number, (pose, lighting) in FRAMES.items():
            if lighting == "full":
                vertices = 1000 * frames[pose, "full", "dorsal"].mesh.vertices
                head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
                head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
                archive.writestr(
                    f"registration_vertices/{number:06d}.ply", head.encode() + vertices.astype("<f4").tobytes()
                )
    with zipfile.ZipFile(root / "kinematic_tracking" / "pose.zip", "w") as archive:
        for number in FRAMES:  # where it is, then 62 numbers of the rig
            numbers = [number, -2.0, 3.5, *np.linspace(0, 1, 62).tolist()]
            archive.writestr(f"pose/{number:06d}.txt", "".join(f"{value}\n" for value in numbers))
    directions = [frames["pose-0", f"olat-0{i}", "dorsal"].light.direction for i in range(6)]
    patterns = [[[i, 5555] for i in range(6)], [[i, 1111 * (i + 1)] for i in range(5)], [[0, 5555]]]
    positions = [(1100 * d).tolist() for d in directions]
    meta = {"light_positions": positions, "light_patterns": [{"light_index_durations": p} for p in patterns]}
    (root / "lights" / "light_pattern_metadata.json").write_text(json.dumps(meta))
    shone = [[number, 0 if lighting == "full" else 1] for number, (_, lighting) in FRAMES.items()]
    (root / "lights" / "light_pattern_per_frame.json").write_text(json.dumps([*shone, [500, 2]]))
    uvs, uv_faces = frames["pose-0", "full", "dorsal"].mesh.topology.unwrapped
    faces = frames["pose-0", "full", "dorsal"].mesh.topology.faces
    lines = [f"v {i} 0 0" for i in range(len(frames["pose-0", "full", "dorsal"].mesh.vertices))]
    lines += [f"vt {u} {v}" for u, v in uvs.tolist()]
    for face, corners in zip((faces + 1).tolist(), (uv_faces + 1).tolist(), strict=True):
        lines.append("f " + " ".join(f"{v}/{t}" for v, t in zip(face, corners, strict=True)))
    (folder / "topology.obj").write_text("\n".join(lines))
    return root


def _bytes(image: Image.Image, kind: str) -> bytes:
    held = io.BytesIO()
    image.save(held, kind, **({"quality": 100, "subsampling": "4:4:4"} if kind == "AVIF" else {}))
    return held.getvalue()
