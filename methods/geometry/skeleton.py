"""Joints of a tracked mesh, the rigid way to a reference, and the rotations that joint positions already tell.

Key points (P, 3) are the hand's joints followed by the five finger tips, in the order of `Template.points`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from handbench.errors import Unsupported
from handbench.hand import OpenHand
from handbench.hand.anatomy import bone_ends
from handbench.hand.skinning import linear_blend
from handbench.hand.template import FINGERS
from handbench.scene import Array, Mesh, Pose

_REACH = 0.008  # metres around a key point whose vertices say most about it
_LEVELS = 4


def level_of(mesh: Mesh) -> int:
    """The subdivision level of the open hand that a mesh has. Raises `Unsupported` for another surface."""
    hand = OpenHand.load()
    faces = mesh.topology.faces
    for level in range(_LEVELS + 1):
        if len(faces) == 2 * len(hand.quads(level)):
            if np.array_equal(faces, hand.topology(level).faces):
                return level
            break
    raise Unsupported(
        f"the geometry autoencoder deforms the open hand, and the capture's meshes ({len(mesh.vertices)} vertices) "
        "are another one; use a capture tracked with the open hand"
    )


@lru_cache(maxsize=_LEVELS)
def regressor(level: int) -> Array:
    """Weights (P, V) that give the key points of a hand at rest from its vertices.

    The weights nearest to a bell around each point that are exact on the template; as rows sum to one, they are exact
    on every affine image of it too, so on hands of another size or width.
    """
    hand = OpenHand.load()
    vertices, skin = hand.rest_position(level), hand.weights(level)
    points, parents = hand.template.points, hand.parents
    homogeneous = np.column_stack([np.ones(len(vertices)), vertices])
    found = np.empty((len(points), len(vertices)))
    tips = [hand.joint_names.index(f"{finger}3") for finger in FINGERS]
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


def posed_points(rest: Array, pose: Pose) -> Array:
    """Key points (P, 3) in the world of a skeleton with key points `rest` (P, 3), wrist at the origin."""
    joints = torch.from_numpy(pose.joints.copy())
    turn, shift = torch.from_numpy(pose.rotation.copy()), torch.from_numpy(pose.translation.copy())
    points = torch.from_numpy(rest.copy())
    return forward(points, points, key_weights(), joints, turn, shift).numpy()


def forward(carried: Tensor, rest: Tensor, weights: Tensor, joints: Tensor, turn: Tensor, shift: Tensor) -> Tensor:
    """Linear blend skinning of points (N, 3) with weights (N, J) by a skeleton with key points `rest` (P, 3)."""
    hand, dtype = OpenHand.load(), carried.dtype
    heads = rest[: len(hand.parents)]
    frames = torch.tensor(hand.frames, dtype=dtype)
    return linear_blend(carried, heads, hand.parents, weights.to(dtype), frames, joints, turn, shift)


@lru_cache(maxsize=1)
def bone_weights() -> Array:
    """(V, P) by which coarse vertices at rest follow the key points: each between the two ends of its bones.

    Points of a scan do not tell how far skin slides along a finger, so a longer bone has to carry it along.
    """
    template = OpenHand.load().template
    ends = bone_ends(template)
    found = np.zeros((len(template.vertices), len(template.points)))
    for j, end in enumerate(ends):
        bone = template.points[end] - template.points[j]
        along = np.clip((template.vertices - template.points[j]) @ bone / (bone @ bone), 0.0, 1.0)
        found[:, j] += template.weights[:, j] * (1.0 - along)
        found[:, end] += template.weights[:, j] * along
    found.flags.writeable = False
    return found


@lru_cache(maxsize=1)
def key_weights() -> Tensor:
    """Skinning weights (P, J) of the key points: each goes with its joint, a tip with its finger's last."""
    names = OpenHand.load().joint_names
    carriers = [*range(len(names)), *(names.index(f"{finger}3") for finger in FINGERS)]
    return torch.eye(len(names), dtype=torch.float64)[carriers]


def rigid(source: Array, target: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) that bring points (N, 3) nearest to others: target = R source + t (Kabsch)."""
    middle, other = source.mean(axis=0), target.mean(axis=0)
    turn = Rotation.align_vectors(target - other, source - middle)[0].as_matrix()
    return turn, other - turn @ middle


def directions(rest: Array, observed: Array) -> Pose:
    """The pose that observed key points (P, 3) tell of a skeleton `rest` (P, 3) in closed form.

    The palm's points give the hand's rotation, the forearm's direction splits the wrist's off, and every other joint
    takes the shortest turn that brings its bone to where it points. What is left open is turns about the bones.
    """
    hand = OpenHand.load()
    names, frames, ends = hand.joint_names, hand.frames, bone_ends(hand.template)
    forearm, wrist = names.index("forearm"), names.index("wrist")
    palm = [wrist, *(j for j, parent in enumerate(hand.parents) if parent == wrist)]
    palm += [names.index("index1"), names.index("middle1")]
    world = np.empty((len(names), 3, 3))
    world[wrist], _ = rigid(rest[palm], observed[palm])
    arm = observed[wrist] - observed[forearm]
    bent = _swing(rest[wrist] - rest[forearm], world[wrist].T @ arm).T
    world[forearm] = world[wrist] @ bent.T
    joints = np.zeros((len(names), 3))
    joints[wrist] = Rotation.from_matrix(frames[wrist].T @ bent @ frames[wrist]).as_rotvec()
    for j, parent in enumerate(hand.parents):
        if j not in (forearm, wrist):
            local = _swing(rest[ends[j]] - rest[j], world[parent].T @ (observed[ends[j]] - observed[j]))
            world[j] = world[parent] @ local
            joints[j] = Rotation.from_matrix(frames[j].T @ local @ frames[j]).as_rotvec()
    return Pose(joints, Rotation.from_matrix(world[forearm]).as_rotvec(), observed[wrist])


def _swing(start: Array, end: Array) -> Array:
    """The shortest rotation (3, 3) that turns one direction into another."""
    axis = np.cross(start, end)
    sine, cosine = np.linalg.norm(axis), float(start @ end)
    if sine < 1e-12 * np.linalg.norm(start) * np.linalg.norm(end):
        return np.eye(3)  # parallel; opposite bones do not occur in hands
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)).as_matrix()
