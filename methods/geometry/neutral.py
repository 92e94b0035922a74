"""A subject in the neutral pose, brought rigidly into the reference frame: what tells who the hand belongs to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from handbench.errors import Unsupported
from handbench.hand import HandModel, hand_of
from handbench.method import Recording
from handbench.scene import Array, Pose, needed

from ..kit.host import on_host
from .scan import PointCloud, point_cloud
from .skeleton import nearest_turn, posed_points, regressor

_NEUTRAL = np.radians(5.0)  # how far a joint may be bent in a frame that counts as neutral
_BUMPS, _WIDTH = 8, 0.025  # of a warp: how many, and how wide in metres
_BUMP = 0.06  # metres of a bump, per unit of a warp's amount


@dataclass(frozen=True, eq=False)
class Neutral:
    """One subject's scan and key points (P, 3) in the reference frame, and its skeleton of a hand model.

    The reference frame is that of the template: a rigid motion brings the key points nearest to the template's, and
    the wrist to the origin. `rest` (P, 3) are the same key points in the frame that the capture's poses count from.
    """

    hand: HandModel
    scan: PointCloud
    points: Array
    rest: Array

    def observed(self, pose: Pose) -> Array:
        """Key points (P, 3) in the world: the subject's skeleton in the pose that the capture tracked."""
        return posed_points(self.hand, self.rest, pose)


def full_frames(recording: Recording) -> Recording:
    """The fully lit frames. Raises `Unsupported` if there are none."""
    lit = recording.of_kind("full")
    if not lit.frames:
        raise Unsupported("the geometry autoencoder looks at fully lit frames, and the frames it was given have none")
    return lit


def neutral(recording: Recording) -> Neutral:
    """The neutral hand of a recording's one subject, from its fully lit frames in the pose nearest to rest.

    Raises `Unsupported` without fully lit frames, without depth, without a pose near rest, and for another hand model.
    """
    lit = full_frames(recording)
    first = min(lit.frames, key=lambda frame: float(np.abs(needed(frame.pose, "pose").joints).max()))
    pose, mesh = needed(first.pose, "pose"), needed(first.mesh, "mesh")
    bent = float(np.abs(pose.joints).max())
    if bent > _NEUTRAL:
        raise Unsupported(
            f"the geometry autoencoder needs a fully lit frame of {first.subject} in the neutral pose, and the nearest "
            f"({first.pose_name}) bends a joint by {np.degrees(bent):.0f}°"
        )
    views = [frame for frame in lit.frames if frame.pose_key == first.pose_key]
    hand, level = hand_of(mesh.topology)
    world = regressor(hand, level) @ mesh.vertices
    placed = Rotation.from_rotvec(pose.rotation.copy()).as_matrix()
    aligned = _aligned(hand, point_cloud([(frame, lit.observe(frame)) for frame in views]), world)
    return Neutral(hand, *aligned, (world - pose.translation) @ placed)


def _aligned(hand: HandModel, seen: PointCloud, points: Array) -> tuple[PointCloud, Array]:
    """Scan and key points (P, 3) brought rigidly into the reference frame."""
    turn = on_host(nearest_turn(*(torch.tensor(each, dtype=torch.float64) for each in (points, hand.points))))
    shift = -turn @ points[hand.wrist]
    return seen.moved(turn, shift), points @ turn.T + shift


def warped(person: Neutral, amount: float, rng: np.random.Generator) -> tuple[PointCloud, Array]:
    """Scan and key points (P, 3) of another hand in the neutral pose: a person's, smoothly deformed and aligned again.

    The deformation is affine with entries of standard deviation `amount`, and bumps around key points that move them
    by a few millimetres at 0.1.
    """
    stretch = rng.normal(0.0, amount, (3, 3))
    middles = person.points[rng.choice(len(person.points), _BUMPS, replace=False)]
    pushes = rng.normal(0.0, _BUMP * amount, (_BUMPS, 3))

    def move(x: Array) -> Array:
        squared = (x**2).sum(axis=1)[:, None] + (middles**2).sum(axis=1) - 2.0 * x @ middles.T
        return x + x @ stretch + np.exp(-squared / (2.0 * _WIDTH**2)) @ pushes

    seen = person.scan
    return _aligned(person.hand, PointCloud(move(seen.points), seen.seen_from, seen.area), move(person.points))
