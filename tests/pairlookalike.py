"""A capture in Re:InterHand's layout, made from the light stage that ships and a drawn left hand; not by the reader's
code."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lookalikes import CAMERAS, FINGERS, fits, shown, under
from PIL import Image

from handbench.data.capture import Capture
from handbench.hand import HandModel
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import Raster
from handbench.scene import Array, Mesh, Pose

PERSON, LISTED = "RNS217", {12: "0001_clasp", 15: "0002_touch"}


@dataclass(frozen=True)
class Moment:
    """What is told of a frame: MANO's right hand and the left one that lies partly before it."""

    pose: Pose
    shape: Array
    left: Mesh


def write(folder: Path, capture: Capture, right: HandModel, left: HandModel) -> dict[tuple[str, str], Moment]:
    """Three moments before two cameras, the first two listed; each moment's hands by camera and number."""
    root = folder / f"m--20221215--0949--{PERSON}--pilot--ProjectGoliathScript--Hands--two-hands"
    for place in ("mano_fits/params", "orig_fits/right/Keypoints", "Mugsy_cameras"):
        (root / place).mkdir(parents=True)
    cameras: dict[str, Any] = {}
    told = {}
    frames = under(capture, "env-hall")
    for number, (name, (pose, shape)) in zip((12, 15, 18), fits(capture, right).items(), strict=True):
        vertices, points = right.posed(shape, pose)
        _write_joints(root / f"orig_fits/right/Keypoints/keypoint-{number:06d}.json", right, points)
        own = right.parameters_of(pose, shape, flat_hand_mean=False)  # type: ignore[attr-defined]
        turn = own["global_orient"] * [1, -1, -1]
        fingers = (own["hand_pose"].reshape(15, 3) * [1, -1, -1]).ravel()
        first = next(f for f in frames if f.pose_name == name)
        towards = first.camera.centre - vertices.mean(axis=0)
        at = vertices.mean(axis=0) + 0.12 * towards / np.linalg.norm(towards) + [0.02, 0, 0]
        there = left.pose_of(fingers, turn, np.zeros(3), shape, flat_hand_mean=False)  # type: ignore[attr-defined]
        trans = at - left.posed(shape, there)[0].mean(axis=0)
        placed = left.pose_of(fingers, turn, trans, shape, flat_hand_mean=False)  # type: ignore[attr-defined]
        other = Mesh(left.posed(shape, placed)[0], left.topology(0))
        for side, parameters in (
            ("right", own),
            ("left", {"global_orient": turn, "hand_pose": fingers, "transl": trans}),
        ):
            fit = {"pose": [*parameters["global_orient"].tolist(), *parameters["hand_pose"].tolist()],
                   "shape": shape.tolist(), "trans": parameters["transl"].tolist()}  # fmt: skip
            (root / f"mano_fits/params/{number}_{side}.json").write_text(json.dumps(fit))
        for frame in frames:
            if frame.pose_name != name:
                continue
            camera, identity = frame.camera, CAMERAS[frame.camera.name]
            told[identity, f"{number:06d}"] = Moment(pose, shape, other)
            cameras[identity] = {
                "R": camera.rotation.tolist(), "t": (1000 * camera.world_to_camera[:, 3]).tolist(),
                "focal": [camera.K[0, 0], camera.K[1, 1]], "princpt": (camera.K[:2, 2] - 0.5).tolist(),
            }  # fmt: skip
            seen = capture.observe(frame)
            behind, before = (Raster(PosedMesh(m), camera, 1).depth_map for m in (frame.mesh, other))
            drawn = np.where((before > 0) & ((behind == 0) | (before < behind)), 1.0, 0.0)
            picture = shown(seen.image * (1 - drawn[..., None]) + 0.3 * drawn[..., None])
            mask = np.round(255 * np.maximum(seen.alpha, drawn)).astype(np.uint8)
            for kind in ("envmap_per_frame", "envmap_per_segment"):
                for what, codes in (("images", picture), ("masks", mask)):
                    place = root / "Mugsy_cameras" / kind / what / identity
                    place.mkdir(parents=True, exist_ok=True)
                    Image.fromarray(codes).save(place / f"{number:06d}.png")
    (root / "Mugsy_cameras" / "cam_params.json").write_text(json.dumps(cameras))
    (root / "frame_list.txt").write_text("".join(f"{name} {number}\n" for number, name in LISTED.items()))
    return told


def _write_joints(path: Path, hand: HandModel, points: Array) -> None:
    """24 joints in millimetres: wrist, thumb 0 to 4, three fingers 1 to 4, little finger 0 to 4, forearm."""
    at = dict(zip(hand.joint_names, points, strict=False)) | dict(zip(FINGERS, points[16:], strict=True))
    nowhere = np.full(3, -9.0)
    rows = [at["wrist"]]
    for finger in ("thumb", "index", "middle", "ring", "little"):
        rows += [nowhere] if finger in ("thumb", "little") else []
        rows += [at[f"{finger}1"], at[f"{finger}2"], at[f"{finger}3"], at[finger]]
    path.write_text(json.dumps([(1000 * row).tolist() for row in (*rows, nowhere)]))
