"""A pose of one hand model as one of another: bones are turned alike, then key points are brought together.

Two skeletons put their joints in different places, so no pose fits exactly: what is left between the key points is part
of the answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ..errors import Unsupported
from ..scene import Array, Pose
from .fitting.rig import Rest, Rig, cross_matrix
from .handmodel import HandModel
from .twins import palm

_STEPS = 12
_POINT = 1e-3  # metres: how near key points should come
_ANGLE = np.radians(6.0)  # how far a joint may leave the direction of the other hand's bone for that
_PEOPLE = 64  # from whom the spread of shapes is taken


@dataclass(frozen=True, eq=False)
class Converted:
    """A pose and a shape of the other hand model, and how far apart the 21 key points are then, (21,) metres."""

    pose: Pose
    shape: Array
    residual: Array

    def __str__(self) -> str:
        mean, most = 1e3 * float(self.residual.mean()), 1e3 * float(self.residual.max())
        return f"key points differ by {mean:.1f} mm on average, {most:.1f} mm at most"


def converted(
    pose: Pose, shape: ArrayLike, source: HandModel, target: HandModel, target_shape: ArrayLike | None = None
) -> Converted:
    """The pose and shape of `target` that are nearest to those of `source`, with what is left between them.

    Every finger bone is turned as the source's is, from the rest of one hand to the rest of the other; then pose and
    shape are refined by least squares on the 21 key points. With `target_shape` the shape stays: that of the first pose
    of a person serves the others. Joints that the target has none of (metacarpals, forearm) are lost.
    Raises `Unsupported` for a left hand as a right one.
    """
    if source.side != target.side:
        raise Unsupported(
            f"{source.name} is a {source.side} hand and {target.name} a {target.side} one; mirror it first"
        )
    _, points = source.posed(shape, pose)
    wanted = points[list(source.key_points)]
    start = _aligned(pose, source, target, points[source.wrist])
    fixed = None if target_shape is None else np.asarray(target_shape, np.float64)
    return _refined(start, fixed, target, wanted)


def _aligned(pose: Pose, source: HandModel, target: HandModel, wrist: Array) -> Pose:
    """Each bone of the target turned as the source's of that name."""
    turned = _turns(source, pose)
    own, theirs, roles = _bones(source), _bones(target), _roles(target)
    world: list[Array] = []
    joints = np.zeros((len(target.parents), 3))
    by_role = {role: joint for joint, role in _roles(source).items()}
    placed = turned[source.wrist] @ own[source.wrist] @ theirs[target.wrist].T
    for j, parent in enumerate(target.parents):
        role = roles.get(j)
        above = placed if parent < 0 else world[parent]
        if role is None or j == target.wrist:
            world.append(above)
            continue
        match = by_role[role]
        world.append(turned[match] @ own[match] @ theirs[j].T)
        local = target.frames[j].T @ above.T @ world[j] @ target.frames[j]
        joints[j] = Rotation.from_matrix(local).as_rotvec()
    return Pose(joints, Rotation.from_matrix(placed).as_rotvec(), wrist)


def _roles(hand: HandModel) -> dict[int, tuple[int, int]]:
    """Finger and place in it of each joint; the wrist is (-1, 0), other joints are not there."""
    found = {joint: (f, k) for f, chain in enumerate(hand.chains) for k, joint in enumerate(chain)}
    return {hand.wrist: (-1, 0), **found}


def _turns(hand: HandModel, pose: Pose) -> Array:
    """How every joint is turned in the world against rest, (J, 3, 3)."""
    local = hand.frames @ Rotation.from_rotvec(pose.joints.copy()).as_matrix() @ hand.frames.transpose(0, 2, 1)
    found = np.empty_like(local)
    placed = Rotation.from_rotvec(pose.rotation.copy()).as_matrix()
    for j, parent in enumerate(hand.parents):
        found[j] = (placed if parent < 0 else found[parent]) @ local[j]
    return found


def _bones(hand: HandModel) -> dict[int, Array]:
    """Axes (3, 3), as columns, of the bones at rest: along the bone, and out of the palm's plane."""
    knuckles = np.array([hand.points[chain[0]] for chain in hand.chains[1:]])
    middle = knuckles.mean(axis=0) - hand.points[hand.wrist]
    out = palm(hand)
    along = {joint: hand.points[hand.ends[joint]] - hand.points[joint] for chain in hand.chains for joint in chain}
    found = {}
    for joint, y in {**along, hand.wrist: middle}.items():
        y = y / np.linalg.norm(y)
        z = out - (out @ y) * y
        z /= np.linalg.norm(z)
        found[joint] = np.stack([np.cross(y, z), y, z], axis=-1)
    return found


def _refined(start: Pose, fixed: Array | None, hand: HandModel, wanted: Array) -> Converted:
    """Gauss-Newton on angles, placement and shape, each held to where it starts."""
    rig, roles = Rig.of(hand, 0), _roles(hand)
    free = np.array([3 * j + c for j in roles if j != hand.wrist for c in range(3) if _moves(hand, j, c)])
    spread = np.zeros(0) if fixed is not None else _spread(hand)
    basis = np.zeros((hand.shape_size, 0)) if fixed is not None else np.diag(spread)[:, spread > 0]
    shape = np.asarray(hand.neutral() if fixed is None else fixed, np.float64)
    joints = start.joints.copy()
    rotation, place = Rotation.from_rotvec(start.rotation.copy()), start.translation.copy()
    told = np.zeros(basis.shape[1])
    limits = np.concatenate([np.full(len(free), 1 / _ANGLE), np.ones(len(told)), np.zeros(6)])
    for _ in range(_STEPS):
        rest = Rest(rig.at_rest(shape), rig.along(shape, basis))
        posed = rig.pose(rest, joints[None], free, rig.key_points)
        turn = rotation.as_matrix()
        rows = posed.rows[0] @ turn.T
        by_joints, by_shape = (np.einsum("ab,nbf->naf", turn, d[0]) for d in (posed.by_joints, posed.by_shape))
        jacobian = np.concatenate([by_joints, by_shape, -cross_matrix(rows), np.tile(np.eye(3), (21, 1, 1))], axis=2)
        left = (wanted - rows - place).ravel() / _POINT
        away = np.concatenate([(joints - start.joints).ravel()[free], told, np.zeros(6)]) * limits
        system = np.concatenate([jacobian.reshape(63, -1) / _POINT, np.diag(limits)])
        step = np.linalg.lstsq(system, np.concatenate([left, -away]), rcond=None)[0]
        angles, told_step, spin, shift = np.split(step, np.cumsum([len(free), len(told), 3]))
        joints.ravel()[free] += angles
        told, shape = told + told_step, shape + basis @ told_step
        rotation, place = Rotation.from_rotvec(spin) * rotation, place + shift
    pose = Pose(joints, rotation.as_rotvec(), place)
    _, points = hand.posed(shape, pose)
    return Converted(pose, shape, np.linalg.norm(points[list(hand.key_points)] - wanted, axis=1))


def _moves(hand: HandModel, joint: int, component: int) -> bool:
    return hand.limits is None or bool(np.ptp(hand.limits[joint, component]) > 0)


def _spread(hand: HandModel) -> Array:
    """Standard deviations (S,) of the shape's numbers among people."""

    def make() -> Array:
        rng = np.random.default_rng(0)
        return np.std([np.asarray(hand.sample_identity(rng)) for _ in range(_PEOPLE)], axis=0)

    return hand.kept("spread of shapes", make)
