"""Joints of a tracked mesh, the rigid way to a reference, and the rotations that joint positions already tell.

Key points (P, 3) are the points of a `HandModel`: its joints followed by the five finger tips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.hand import HandModel
from handbench.hand.skinning import linear_blend
from handbench.scene import Array, Pose

_REACH = 0.008  # metres around a key point whose vertices say most about it


def regressor(hand: HandModel, level: int) -> Array:
    """Weights (P, V) that give the key points of a hand at rest from its vertices.

    The weights nearest to a bell around each point that are exact on the template; as rows sum to one, they are exact
    on every affine image of it too, so on hands of another size or width.
    """
    return hand.kept(("regressor", level), lambda: _regressor(hand, level))


def _regressor(hand: HandModel, level: int) -> Array:
    vertices, skin = hand.rest_position(level), hand.weights(level)
    points, parents = hand.points, hand.parents
    homogeneous = np.column_stack([np.ones(len(vertices)), vertices])
    found = np.empty((len(points), len(vertices)))
    tips = [chain[-1] for chain in hand.chains]
    for p, point in enumerate(points):
        joint = p if p < len(parents) else tips[p - len(parents)]
        near = skin[:, [joint, max(parents[joint], 0)]].sum(axis=1)  # of its own finger, not of the next one
        squared = ((vertices - point) ** 2).sum(axis=1)
        reach = max(_REACH**2, squared[near > 0.5].min())
        bell = near * np.exp(-squared / (2.0 * reach))
        bell /= bell.sum()
        wanted = np.concatenate([[1.0], point]) - homogeneous.T @ bell
        gram = (homogeneous * bell[:, None]).T @ homogeneous
        found[p] = bell * (1.0 + homogeneous @ np.linalg.solve(gram, wanted))
    found.flags.writeable = False
    return found


def posed_points(hand: HandModel, rest: Array, pose: Pose) -> Array:
    """Key points (P, 3) in the world of a skeleton with key points `rest` (P, 3), wrist at the origin."""
    joints = torch.from_numpy(pose.joints.copy())
    turn, shift = torch.from_numpy(pose.rotation.copy()), torch.from_numpy(pose.translation.copy())
    points = torch.from_numpy(rest.copy())
    weights = torch.from_numpy(hand.point_weights)
    return forward(hand, points, points, weights, joints, turn, shift).numpy()


def forward(
    hand: HandModel, carried: Tensor, rest: Tensor, weights: Tensor, joints: Tensor, turn: Tensor, shift: Tensor
) -> Tensor:
    """Linear blend skinning of points (N, 3) with weights (N, J) by a skeleton with key points `rest` (P, 3)."""
    dtype = carried.dtype
    heads = rest[: len(hand.parents)]
    frames = torch.tensor(hand.frames, dtype=dtype, device=carried.device)
    return linear_blend(carried, heads, hand.parents, weights.to(dtype), frames, joints, turn, shift)


def bone_weights(hand: HandModel) -> Array:
    """(V, P) by which coarse vertices at rest follow the key points: each between the two ends of its bones.

    Points of a scan do not tell how far skin slides along a finger, so a longer bone has to carry it along.
    """
    return hand.kept("bone weights", lambda: _bone_weights(hand))


def _bone_weights(hand: HandModel) -> Array:
    vertices, weights, points = hand.rest_position(0), hand.weights(0), hand.points
    found = np.zeros((len(vertices), len(points)))
    for j, end in enumerate(hand.ends):
        bone = points[end] - points[j]
        along = np.clip((vertices - points[j]) @ bone / (bone @ bone), 0.0, 1.0)
        found[:, j] += weights[:, j] * (1.0 - along)
        found[:, end] += weights[:, j] * along
    found.flags.writeable = False
    return found


@dataclass(frozen=True, eq=False)
class ToldPose:
    """A `Pose` as tensors, float64: axis-angles joints (J, 3), rotation (3, 3), translation (3,)."""

    joints: Tensor
    rotation: Tensor
    translation: Tensor


@torch.no_grad()
def pose_told_by(hand: HandModel, rest: Tensor, observed: Tensor) -> ToldPose:
    """The pose that observed key points (P, 3) tell of a skeleton `rest` (P, 3) in closed form; both float64.

    The palm's points give the hand's rotation, the forearm's direction, where there is a forearm, splits the wrist's
    off, and every other joint takes the shortest turn that brings its bone to where it points. What is left open is
    turns about the bones.
    """
    parents, wrist = hand.parents, hand.wrist
    forearm = parents[wrist]
    palm = [wrist, *(j for j, parent in enumerate(parents) if parent == wrist)]
    palm += [p for p in (hand.chains[1][0], hand.chains[2][0]) if p not in palm]
    ends = torch.tensor(hand.ends, device=rest.device)
    bones, seen = (torch.nn.functional.normalize(x[ends] - x[: len(parents)]) for x in (rest, observed))
    world = {wrist: nearest_turn(rest[palm], observed[palm])}
    turns = [torch.zeros_like(rest[0])] * len(parents)
    if forearm >= 0:  # its bone ends in the wrist
        turn, back = _swing(bones[forearm, None], seen[forearm, None] @ world[wrist])
        world[forearm], turns[wrist] = world[wrist] @ turn[0], -back[0]
    while len(world) < len(parents):  # all joints at once that hang on those that are known
        next_ones = [j for j, parent in enumerate(parents) if parent in world and j not in world]
        above = torch.stack([world[parents[j]] for j in next_ones])
        turn, vector = _swing(bones[next_ones], torch.einsum("jc,jcd->jd", seen[next_ones], above))
        world.update(zip(next_ones, above @ turn, strict=True))
        for j, its in zip(next_ones, vector, strict=True):
            turns[j] = its
    frames = torch.tensor(hand.frames, device=rest.device)
    joints = torch.einsum("jcd,jc->jd", frames, torch.stack(turns))
    return ToldPose(joints, world[parents.index(-1)], observed[wrist])


def nearest_turn(source: Tensor, target: Tensor) -> Tensor:
    """The rotation (3, 3) that with a shift brings points (N, 3) nearest to others (Kabsch)."""
    left, _, right = torch.linalg.svd((target - target.mean(dim=0)).T @ (source - source.mean(dim=0)))
    left = torch.cat([left[:, :2], left[:, 2:] * torch.linalg.det(left @ right)], dim=1)  # no mirror
    return left @ right


def _swing(start: Tensor, end: Tensor) -> tuple[Tensor, Tensor]:
    """The shortest rotations that turn unit vectors (K, 3) into others, as matrices (K, 3, 3) and axis-angles (K, 3).

    Opposite bones, which many turns bring together, do not occur in hands.
    """
    axis, cosine = torch.linalg.cross(start, end), (start * end).sum(dim=1)
    eye = torch.eye(3, dtype=start.dtype, device=start.device)
    across = torch.linalg.cross(axis[:, None], eye[None]).mT
    sine = axis.norm(dim=1)
    angle = torch.atan2(sine, cosine) / sine.clamp_min(torch.finfo(sine.dtype).tiny)
    return eye + across + across @ across / (1.0 + cosine)[:, None, None], angle[:, None] * axis
