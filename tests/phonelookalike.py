"""Phone scans in the two layouts that UHM reads, made from the light stage that ships; not by the reader's code."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from lookalikes import FINGERS, fits, shown, under
from PIL import Image
from scipy.spatial.transform import Rotation

from handbench.data.capture import Capture
from handbench.hand import HandModel
from handbench.scene import Array, Frame

LISTED = {"train": 2, "test": 1}  # frames of each list


def _moments(capture: Capture, mano: HandModel) -> list[tuple[Frame, Array, Array, dict[str, Any]]]:
    """The stage's frames of one camera: each with MANO's vertices and joints in the world, and InterWild's estimate."""
    frames = {f.pose_name: f for f in under(capture, "env-hall") if f.camera.name == "dorsal"}
    found = []
    for name, (pose, shape) in fits(capture, mano).items():
        own = mano.parameters_of(pose, shape, flat_hand_mean=False)  # type: ignore[attr-defined]
        turn = Rotation.from_matrix(frames[name].camera.rotation) * Rotation.from_rotvec(own["global_orient"])
        told = {"root_pose": turn.as_rotvec().tolist(), "hand_pose": own["hand_pose"].tolist(),
                "shape": shape.tolist(), "root_trans": [9.0, 9.0, 9.0]}  # fmt: skip
        found.append((frames[name], *mano.posed(shape, pose), told))
    return found


def write_own(folder: Path, capture: Capture, mano: HandModel) -> list[tuple[Frame, Array]]:
    """A person's own scan, one video of three frames; the stage's frames and MANO's vertices, in order."""
    video = folder / "somebody" / "1"
    for place in ("frames", "masks", "keypoints", "mano_params/params", "depthmaps"):
        (video / place).mkdir(parents=True)
    told, lines = [], []
    for number, (frame, vertices, points, fit) in enumerate(_moments(capture, mano)):
        seen = capture.observe(frame)
        Image.fromarray(shown(seen.image)).save(video / "frames" / f"{number}.png")
        mask = np.round(255 * seen.alpha).astype(np.uint8)
        Image.fromarray(mask[..., None].repeat(3, axis=-1)).save(video / "masks" / f"{number}.png")
        (video / "keypoints" / f"{number}.json").write_text(json.dumps(_in_picture(frame, mano, points).tolist()))
        (video / "mano_params" / "params" / f"{number}.json").write_text(json.dumps(fit))
        behind = np.where(seen.alpha > 0.5, _depth(capture, frame), 2.0)[1::2, 1::2]  # of half the size
        (video / "depthmaps" / f"{number}.pkl").write_bytes(pickle.dumps(behind.astype(np.float32)))
        told.append((frame, vertices))
        lines.append(f"1 {number}\n")
    camera = told[0][0].camera
    param = {"focal": [camera.K[0, 0], camera.K[1, 1]], "princpt": camera.K[:2, 2].tolist()}
    (video / "cam_param.json").write_text(json.dumps(param))
    (folder / "somebody" / "frame_list_train.txt").write_text("".join(lines[:2]))
    (folder / "somebody" / "frame_list_test.txt").write_text("".join([*lines[2:], "1 77\n"]))
    return told


def write_goliath(folder: Path, capture: Capture, mano: HandModel) -> list[tuple[Frame, Array]]:
    """A scan as Goliath gives it out, in archives; the stage's frames and MANO's vertices, in order."""
    hands = folder / "m--20230306--0000--AXE977--pilot--ProjectGoliath--iPhone" / "Hands"
    side = hands / "Right"
    side.mkdir(parents=True)
    kinds = ("rgb", "segmentations_fgbg", "keypoints_2d", "mano", "depth")
    archives = {kind: zipfile.ZipFile(side / f"{kind}.zip", "w") for kind in kinds}
    told = []
    for number, (frame, vertices, points, fit) in enumerate(_moments(capture, mano), start=40):
        seen = capture.observe(frame)
        archives["rgb"].writestr(f"rgb/{number:06d}.avif", _bytes(shown(seen.image), "AVIF"))
        mask = np.round(255 * seen.alpha).astype(np.uint8)
        archives["segmentations_fgbg"].writestr(f"segmentations_fgbg/{number:06d}.png", _bytes(mask, "PNG"))
        every = np.zeros((63, 3), "<f4")
        places = _in_picture(frame, mano, points)
        of_finger = [places[1 + 4 * finger + k] for finger in range(5) for k in (3, 2, 1, 0)]
        every[21:42] = np.c_[np.array([*of_finger, places[0]]), np.ones(21)]
        archives["keypoints_2d"].writestr(f"{number:06d}.bin", every.tobytes())
        archives["mano"].writestr(f"mano/params/{number:06d}_right.json", json.dumps(fit))
        depth = np.where(seen.alpha > 0.5, _depth(capture, frame), 2.0)
        rows, columns = (np.arange(n) * m // n for n, m in zip((640, 360), depth.shape, strict=True))
        archives["depth"].writestr(
            f"depth/{number:06d}.bin", (1000 * depth[rows[:, None], columns]).astype("<f4").tobytes()
        )
        told.append((frame, vertices))
    for archive in archives.values():
        archive.close()
    K = told[0][0].camera.K
    block = "".join(" ".join(f"{x:.9f}" for x in row) + "\n" for row in K)
    rest = "0 0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n\n"
    (hands / "camera_calibration.txt").write_text(f"rgb\n{block}{rest}depth\n{block}{rest}")
    (hands / "frame_list_train.txt").write_text("Right 40 41\n")
    (hands / "frame_list_test.txt").write_text("Right 42 60\n")
    return told


def _in_picture(frame: Frame, hand: HandModel, points: Array) -> Array:
    """The 21 points in pixels: wrist, then each finger from knuckle to tip, thumb first."""
    at = dict(zip(hand.joint_names, points, strict=False)) | dict(zip(FINGERS, points[16:], strict=True))
    rows = [at["wrist"], *(at[f"{finger}{k}"] if k < 4 else at[finger] for finger in FINGERS for k in (1, 2, 3, 4))]
    seen = np.array(rows) @ frame.camera.rotation.T + frame.camera.world_to_camera[:, 3]
    flat = seen @ frame.camera.K.T
    places: Array = flat[:, :2] / flat[:, 2:]
    return places


def _depth(capture: Capture, frame: Frame) -> Array:
    from handbench.render.see.posedmesh import PosedMesh
    from handbench.render.see.raster import Raster

    return Raster(PosedMesh(frame.mesh), frame.camera, 1).depth_map


def _bytes(codes: Array, kind: str) -> bytes:
    held = io.BytesIO()
    more = {"quality": 100, "subsampling": "4:4:4"} if kind == "AVIF" else {}
    Image.fromarray(codes).save(held, kind, **more)
    return held.getvalue()
