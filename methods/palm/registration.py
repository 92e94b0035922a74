"""A hand model fitted to scans: where the told poses and shape of a person are a few millimetres off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from handbench.hand import HandModel
from handbench.hand.fitting.rig import Rest, Rig
from handbench.hand.fitting.space import Space
from handbench.render.uv.surface import vertex_normals
from handbench.scene import Array, Mesh, Pose

_STEPS = 10
_ROWS = 900  # vertices of the hand model that are compared with a scan, about
_FAR = 0.012  # metres: what is farther from the scan has no place on it
_SOFT = 1.5e-3  # metres from which on a distance pulls less
_FACING = 0.5  # least cosine between normals
_NOISE = 1e-3  # metres that a distance to a scan counts one
# one standard deviation of what is told: of angles, of the hand's rotation, of its place, and in the shape's own ones
_ANGLE, _TURN, _SHIFT, _SHAPE = np.radians(1.0), np.radians(0.5), 0.7e-3, 0.7


@dataclass
class _Hand:
    """One pose while it is fitted."""

    joints: Array
    turn: Array
    shift: Array
    scan: Mesh
    tree: cKDTree
    normals: Array
    moved: Array  # (6 + F,) so far: turn, shift, angles


def registered(
    hand: HandModel, shape: Array, poses: Sequence[Pose], scans: Sequence[Mesh]
) -> tuple[Array, tuple[Pose, ...]]:
    """The shape (S,) and poses of one person with which the hand model comes closest to a scan of each pose.

    Gauss-Newton on distances from the model's vertices along the normals of the scans' nearest vertices, from what is
    told, and held to that as far as scanners err. PALM's data come with such a registration.
    """
    rig = Rig.of(hand, 0)
    space = Space.of(hand, 0)
    by_shape = space.rest(np.zeros(space.shape_basis.shape[1])).by_shape
    rows = np.arange(0, rig.vertices, max(1, rig.vertices // _ROWS))
    bodies = [_begun(pose, scan, len(space.free)) for pose, scan in zip(poses, scans, strict=True)]
    z = np.zeros(by_shape.shape[2])
    for _ in range(_STEPS):
        rest = Rest(rig.at_rest(np.asarray(shape, dtype=np.float64) + space.shape_basis @ z), by_shape)
        z = z + _step(rig, space, rest, rows, bodies, z)
    told = tuple(Pose(b.joints, Rotation.from_matrix(b.turn).as_rotvec(), b.shift) for b in bodies)
    return shape + space.shape_basis @ z, told


def _begun(pose: Pose, scan: Mesh, free: int) -> _Hand:
    turn = Rotation.from_rotvec(pose.rotation.copy()).as_matrix()
    normals = vertex_normals(scan.vertices, scan.topology.faces)
    return _Hand(
        pose.joints.copy(), turn, pose.translation.copy(), scan, cKDTree(scan.vertices), normals, np.zeros(6 + free)
    )


def _step(rig: Rig, space: Space, rest: Rest, rows: Array, bodies: Sequence[_Hand], z: Array) -> Array:
    """One step of all poses; the shape's is returned."""
    size, count = 6 + len(space.free), len(z)
    told = 1.0 / np.array([*[_TURN] * 3, *[_SHIFT] * 3, *[_ANGLE] * len(space.free)]) ** 2
    top = len(bodies) / _SHAPE**2 * np.eye(count)
    right = -len(bodies) / _SHAPE**2 * z
    own = []
    for body in bodies:
        slope, missed, weight = _missed(rig, space, rest, rows, body)
        squared = slope.T @ (weight[:, None] * slope)
        pull = -slope.T @ (weight * missed)
        squared[np.arange(size), np.arange(size)] += told
        pull[:size] -= told * body.moved
        solved = np.linalg.solve(squared[:size, :size], np.c_[pull[:size], squared[:size, size:]])
        own.append(solved)
        top = top + squared[size:, size:] - squared[size:, :size] @ solved[:, 1:]
        right = right + pull[size:] - squared[size:, :size] @ solved[:, 0]
    dz = np.linalg.solve(top, right)
    for body, solved in zip(bodies, own, strict=True):
        move = solved[:, 0] - solved[:, 1:] @ dz
        body.turn = Rotation.from_rotvec(move[:3]).as_matrix() @ body.turn
        body.shift = body.shift + move[3:6]
        body.joints.reshape(-1)[space.free] += move[6:]
        body.moved = body.moved + move
    return dz


def _missed(rig: Rig, space: Space, rest: Rest, rows: Array, body: _Hand) -> tuple[Array, Array, Array]:
    """Of the compared vertices how distances to the scan change with turn, shift, angles and shape (N, 6 + F + K), the
    distances (N,) in units of `_NOISE`, and their weights (N,)."""
    every = rig.pose(rest, body.joints[None], space.free)
    vertices = every.rows[0] @ body.turn.T
    facing = vertex_normals(vertices[: rig.vertices], rig.faces)[rows]
    at = vertices[rows]
    distance, nearest = body.tree.query(at + body.shift)
    normal = body.normals[nearest]
    missed = ((at + body.shift - body.scan.vertices[nearest]) * normal).sum(axis=1)
    weight = (distance < _FAR) * ((facing * normal).sum(axis=1) > _FACING) / (1.0 + (missed / _SOFT) ** 2)
    local = normal @ body.turn
    slope = np.concatenate(
        [
            np.cross(at, normal),
            normal,
            np.einsum("ni,nif->nf", local, every.by_joints[0][rows]),
            np.einsum("ni,nik->nk", local, every.by_shape[0][rows]),
        ],
        axis=1,
    )
    return slope / _NOISE, missed / _NOISE, weight
