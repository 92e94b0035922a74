"""Joints of a tracked mesh, the rigid way to a reference, and the rotations that joint positions already tell.

Key points (P, 3) are the points of a `HandModel`: its joints followed by the five finger tips.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation
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


def rigid(source: Array, target: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) that bring points (N, 3) nearest to others: target = R source + t (Kabsch)."""
    middle, other = source.mean(axis=0), target.mean(axis=0)
    turn = Rotation.align_vectors(target - other, source - middle)[0].as_matrix()
    return turn, other - turn @ middle


def directions(hand: HandModel, rest: Array, observed: Array) -> Pose:
    """The pose that observed key points (P, 3) tell of a skeleton `rest` (P, 3) in closed form.

    The palm's points give the hand's rotation, the forearm's direction, where there is a forearm, splits the wrist's
    off, and every other joint takes the shortest turn that brings its bone to where it points. What is left open is
    turns about the bones.
    """
    count, frames, ends, wrist = len(hand.parents), hand.frames, hand.ends, hand.wrist
    forearm = hand.parents[wrist]
    palm = [wrist, *(j for j, parent in enumerate(hand.parents) if parent == wrist)]
    palm += [p for p in (hand.chains[1][0], hand.chains[2][0]) if p not in palm]
    world = np.empty((count, 3, 3))
    world[wrist], _ = rigid(rest[palm], observed[palm])
    turned = [j for j in range(count) if j not in (forearm, wrist)]
    local = np.empty((count, 3, 3))
    if forearm >= 0:
        arm = observed[wrist] - observed[forearm]
        local[wrist] = _swing(rest[wrist] - rest[forearm], world[wrist].T @ arm).T
        world[forearm] = world[wrist] @ local[wrist].T
    for j in turned:
        above = world[hand.parents[j]]
        local[j] = _swing(rest[ends[j]] - rest[j], above.T @ (observed[ends[j]] - observed[j]))
        world[j] = above @ local[j]
    if forearm >= 0:
        turned.append(wrist)
    joints = np.zeros((count, 3))
    joints[turned] = Rotation.from_matrix(
        np.swapaxes(frames, 1, 2)[turned] @ local[turned] @ frames[turned]
    ).as_rotvec()
    return Pose(joints, Rotation.from_matrix(world[hand.parents.index(-1)]).as_rotvec(), observed[wrist])


def _swing(start: Array, end: Array) -> Array:
    """The shortest rotation (3, 3) that turns one direction into another; opposite bones do not occur in hands."""
    one, other = start / np.linalg.norm(start), end / np.linalg.norm(end)
    (a, b, c), (d, e, f) = one, other
    x, y, z = b * f - c * e, c * d - a * f, a * e - b * d
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + across + across @ across / (1.0 + one @ other)
