"""Where on the hand each texel lies: the anatomy that procedural skin is drawn by.

Everything is measured on the neutral hand at rest, whose texels are those of every identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import cKDTree

from ...hand.openhand import OpenHand
from ...hand.openhand.template import FINGERS
from ...render.uv.atlas import Atlas
from ...render.uv.surface import vertex_normals
from ...scene import Array

_LEVEL = 3


@dataclass(frozen=True, eq=False)
class Places:
    """Per covered texel (N): position (N, 3) metres, unit normal (N, 3) and what follows from the joints.

    finger (N,): 0 thumb … 4 little, -1 elsewhere. along (N,): metres from the finger's first joint towards the
    tip. across (N,): metres from the finger's axis, towards the thumb side. facing (N,): 1 where the surface faces
    as the palm does, -1 on the back. hand (N,): 1 on the hand, 0 on the forearm. knuckles (5, 4): `along` of the
    joints and the tip; joints (5, 4, 3) their places. nail (N,), nail_along (N,), nail_across (N,): mask and
    coordinates from root -1 to tip 1. texel: metres that a texel measures on the hand. float32 throughout.
    """

    atlas: Atlas
    position: Array
    normal: Array
    finger: Array
    along: Array
    across: Array
    facing: Array
    hand: Array
    knuckles: Array
    joints: Array
    nail: Array
    nail_along: Array
    nail_across: Array
    texel: float

    @cached_property
    def tree(self) -> cKDTree:
        """Finds the texels near a point of the surface."""
        return cKDTree(self.position, leafsize=32, balanced_tree=False, compact_nodes=False)

    def shows(self, size: float) -> float:
        """How far detail of some size in metres (of a line: twice its width) shows at this texture size, 0 … 1."""
        return float(smoothstep(1.5 * self.texel, 3.5 * self.texel, np.asarray(size)))


def smoothstep(low: float, high: float, values: Array) -> Array:
    """0 below `low`, 1 above `high`, smooth between; falls if low > high."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@lru_cache(maxsize=4)
def places(hand: OpenHand, size: int) -> Places:
    """The anatomy at the texels of a size x size texture; kept for the next subject."""
    atlas = Atlas.of(hand.topology(_LEVEL), size)
    rest = hand.rest_position(_LEVEL)
    position = atlas.interpolate(rest)
    normal = atlas.interpolate(vertex_normals(rest, hand.topology(_LEVEL).faces))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    weights = np.empty((len(position), len(hand.joint_names)))
    for joint, of_joint in enumerate(hand.weights(_LEVEL).T):  # one at a time: all at once take three times the memory
        weights[:, joint] = atlas.interpolate(of_joint[:, None])[:, 0]
    nail = atlas.interpolate(hand.vertex_map("nail", _LEVEL)[:, None])[:, 0]

    names = hand.joint_names
    finger = np.full(len(position), -1)
    along, across = np.zeros(len(position)), np.zeros(len(position))
    palmar = weights @ hand.frames[:, :, 2]
    facing = (normal * palmar).sum(axis=1) / np.linalg.norm(palmar, axis=1)
    facing[(normal[:, 1] < -0.7) & (position[:, 1] < -0.05)] = -1.0  # the end of the forearm has the tone of its back
    knuckles, chain = np.zeros((len(FINGERS), 4)), np.zeros((len(FINGERS), 4, 3))
    nail_along, nail_across = np.zeros(len(position)), np.zeros(len(position))
    for f, name in enumerate(FINGERS):
        joints = [names.index(f"{name}{k}") for k in (1, 2, 3)]
        points = hand.template.points[[*joints, len(names) + f]]
        chain[f] = points
        mine = weights[:, joints].sum(axis=1) > (0.5 if f else 0.35)
        knuckles[f] = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        which, length = _along(points, position[mine], knuckles[f])
        frames = hand.frames[joints][which]
        finger[mine] = f
        along[mine] = length
        across[mine] = ((position[mine] - points[which]) * frames[:, :, 0]).sum(axis=1)
        _nail_coordinates(mine, nail, along, across, nail_along, nail_across)
    below = smoothstep(-0.02, 0.0, position[:, 1])
    return Places(
        atlas=atlas,
        position=_single(position),
        normal=_single(normal),
        finger=finger.astype(np.int8),
        along=_single(along),
        across=_single(across),
        facing=_single(facing),
        hand=_single(below),
        knuckles=_single(knuckles),
        joints=_single(chain),
        nail=_single(nail),
        nail_along=_single(nail_along),
        nail_across=_single(nail_across),
        texel=_texel(atlas, position),
    )


def _single(field: Array) -> Array:
    return field.astype(np.float32)


def _texel(atlas: Atlas, position: Array) -> float:
    """Median distance of texels side by side on the hand."""
    beside = (np.diff(atlas.texels) == 1) & (position[1:, 1] > 0.0)
    return float(np.median(np.linalg.norm(np.diff(position, axis=0)[beside], axis=1)))


def _along(points: Array, position: Array, knuckles: Array) -> tuple[Array, Array]:
    """Nearest segment (N,) of a chain of four points, and the arc length (N,) along it; open at both ends."""
    best = np.full(len(position), np.inf)
    which, length = np.zeros(len(position), int), np.zeros(len(position))
    for k in range(3):
        axis = points[k + 1] - points[k]
        reach = np.linalg.norm(axis)
        t = (position - points[k]) @ axis / reach
        inside = np.clip(t, 0 if k else -np.inf, reach if k < 2 else np.inf)
        distance = np.linalg.norm(position - points[k] - inside[:, None] * (axis / reach), axis=1)
        nearer = distance < best
        best[nearer], which[nearer], length[nearer] = distance[nearer], k, knuckles[k] + inside[nearer]
    return which, length


def _nail_coordinates(
    mine: Array, nail: Array, along: Array, across: Array, nail_along: Array, nail_across: Array
) -> None:
    """Fill -1…1 from the root of the finger's nail to its tip, and from one fold to the other."""
    on = mine & (nail > 0.5)
    for source, target in ((along, nail_along), (across, nail_across)):
        low, high = source[on].min(), source[on].max()
        target[mine] = 2 * (source[mine] - low) / (high - low) - 1
