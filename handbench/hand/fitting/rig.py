"""A hand model in numpy for fitting: posed points, and in closed form how they move with shape and pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch

from ...scene import Array
from ..handmodel import HandModel


@dataclass(frozen=True)
class Rest:
    """The rows of a `Rig` at rest, (N, 3), and by_shape (N, 3, K): how they move with the coordinates of the shape."""

    rows: Array
    by_shape: Array


@dataclass(frozen=True)
class PosedRig:
    """Rows (B, N, 3) of B posed hands, wrist at the origin, and their derivatives.

    by_joints (B, N, 3, F) with the F free components of the axis-angles; by_shape (B, N, 3, K) with the shape's
    coordinates.
    """

    rows: Array
    by_joints: Array
    by_shape: Array


class Rig:
    """Rows N = V + P: the coarse vertices of a hand model, then its joints and finger tips.

    key_points (21,) are the rows of the usual key points; `fine` (V_level, V) carries coarse vertices to the level
    at which the surface is compared with pictures, with faces (F, 3).
    """

    def __init__(self, hand: HandModel, level: int) -> None:
        self.hand, self.level = hand, level
        count, joints = len(hand.weights(0)), len(hand.parents)
        self.vertices, self.joints = count, joints
        self.weights: Array = np.concatenate([hand.weights(0), hand.point_weights])
        tips = hand.tip_vertices
        rows = [p if tips is not None and p >= joints else count + p for p in hand.key_points]
        if tips is not None:
            rows = [tips[p - joints] if p >= joints else row for p, row in zip(hand.key_points, rows, strict=True)]
        self.key_points: Array = np.array(rows)
        self.faces: Array = hand.topology(level).faces.astype(np.int64)
        self.fine: sp.csr_array = _subdivision(hand, level)
        self.below = np.zeros((joints, joints))  # [j, k]: whether k is j or hangs on it
        for k in range(joints):
            j = k
            while j >= 0:
                self.below[j, k], j = 1.0, hand.parents[j]
        self.turned = [j for j, parent in enumerate(hand.parents) if parent >= 0]

    @staticmethod
    def of(hand: HandModel, level: int) -> Rig:
        """The rig of a model, which keeps it."""
        return hand.kept(("rig", level), lambda: Rig(hand, level))

    def at_rest(self, shape: Array) -> Array:
        """The rows (N, 3) of a shape (S,)."""
        return np.concatenate([part.numpy() for part in self.hand.rest_points(torch.from_numpy(shape), torch.float64)])

    def along(self, shape: Array, basis: Array, step: float = 1e-3) -> Array:
        """How the rows move, (N, 3, K), with steps along the columns of a basis (S, K), by central differences.

        Exact for models that are linear in the shape; for others good to the square of the step.
        """
        ends = [(self.at_rest(shape + step * way) - self.at_rest(shape - step * way)) / (2 * step) for way in basis.T]
        return np.stack(ends, axis=-1) if ends else np.zeros((len(self.weights), 3, 0))

    def pose(self, rest: Rest, turns: Array, free: Array, chosen: Array | None = None) -> PosedRig:
        """Rows of the hand with joints turned by axis-angles (B, J, 3); `chosen` picks rows, `free` the derivatives."""
        hand, count = self.hand, self.joints
        pick = np.arange(len(self.weights)) if chosen is None else chosen
        weights, rows = self.weights[pick], rest.rows[pick]
        heads = rest.rows[self.vertices : self.vertices + count]
        spin, left = rodrigues(turns)
        local = hand.frames @ spin @ np.swapaxes(hand.frames, 1, 2)
        axes = hand.frames @ left  # columns: about what each component turns, before the parents do
        rotation, place = np.empty_like(local), np.empty(turns.shape)
        world_axes = np.empty_like(axes)
        for j, parent in enumerate(hand.parents):
            above = rotation[:, parent] if parent >= 0 else np.broadcast_to(np.eye(3), local[:, 0].shape)
            rotation[:, j], world_axes[:, j] = above @ local[:, j], above @ axes[:, j]
            step = heads[j] - (heads[parent] if parent >= 0 else 0.0)
            place[:, j] = (place[:, parent] if parent >= 0 else 0.0) + above @ step
        start = rows if hand.pose_shapes is None else (rows + self._bent(local, pick))[:, None]
        offset = place - (rotation @ heads[:, :, None])[..., 0]
        # every bone carries the rows along by its weight: (B, J, N, 3)
        carried = weights.T[:, :, None] * (start @ np.swapaxes(rotation, 2, 3) + offset[:, :, None])
        blend = (weights @ rotation.reshape(-1, count, 9)).reshape(-1, len(rows), 3, 3)
        moved = (self.below @ carried.reshape(-1, count, carried[0, 0].size)).reshape(carried.shape)
        moved -= (self.below @ weights.T)[:, :, None] * place[:, :, None]
        # d x / d angle = axis × (what hangs on the joint, about the joint)
        joint, component = np.divmod(free, 3)
        across = cross_matrix(world_axes[:, joint, :, component].swapaxes(0, 1))
        by_joints = np.moveaxis(moved[:, joint] @ np.swapaxes(across, 2, 3), 1, 3)
        if hand.pose_shapes is not None:
            by_joints = by_joints + blend @ self._bent_by(local, axes, pick)[..., free]
        return PosedRig(carried.sum(axis=1), by_joints, self._by_shape(rest, pick, weights, rotation, blend))

    def _by_shape(self, rest: Rest, pick: Array, weights: Array, rotation: Array, blend: Array) -> Array:
        heads = rest.by_shape[self.vertices : self.vertices + self.joints]
        places = np.empty((len(rotation), *heads.shape))
        for j, parent in enumerate(self.hand.parents):
            if parent < 0:
                places[:, j] = heads[j]
            else:
                places[:, j] = places[:, parent] + rotation[:, parent] @ (heads[j] - heads[parent])
        shift = places - rotation @ heads
        spread = np.tensordot(weights, shift, axes=(1, 1)).swapaxes(0, 1)
        return blend @ rest.by_shape[pick] + spread

    def _bent(self, local: Array, pick: Array) -> Array:
        """What pose blend shapes add, (B, N, 3)."""
        bent = (local - np.eye(3))[:, self.turned].reshape(len(local), -1)
        return np.einsum("nif,bf->bni", self._pose_shapes[pick], bent)

    def _bent_by(self, local: Array, axes: Array, pick: Array) -> Array:
        """How that changes with the axis-angles, (B, N, 3, 3 J)."""
        turning = np.cross(np.moveaxis(axes, 2, 3)[..., None, :], np.swapaxes(local, 2, 3)[:, :, None])
        turning = np.swapaxes(turning, 3, 4).reshape(*axes.shape[:2], 3, 9)  # (B, J, component, entry of R)
        shapes = self._pose_shapes[pick]
        found = np.zeros((len(local), len(shapes), 3, 3 * self.joints))
        for number, j in enumerate(self.turned):
            own = shapes[..., 9 * number : 9 * number + 9]
            found[..., 3 * j : 3 * j + 3] = np.einsum("nif,bcf->bnic", own, turning[:, j])
        return found

    @property
    def _pose_shapes(self) -> Array:
        assert self.hand.pose_shapes is not None
        still = np.zeros((len(self.weights) - self.vertices, *self.hand.pose_shapes.shape[1:]))
        return np.concatenate([self.hand.pose_shapes, still])


def rodrigues(turns: Array) -> tuple[Array, Array]:
    """Rotations (..., 3, 3) of axis-angles (..., 3), and their left Jacobians: d R = [J d turn]× R."""
    angle = np.linalg.norm(turns, axis=-1)[..., None, None]
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0 - angle**2 / 6, np.sin(safe) / safe)
    cosine = np.where(small, 0.5 - angle**2 / 24, (1.0 - np.cos(safe)) / safe**2)
    third = np.where(small, 1.0 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    cross = cross_matrix(turns)
    square = cross @ cross
    return np.eye(3) + sine * cross + cosine * square, np.eye(3) + cosine * cross + third * square


def cross_matrix(vectors: Array) -> Array:
    """(..., 3, 3) matrices that take the cross product of vectors (..., 3) with what they are applied to."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vectors.shape, 3)


def _subdivision(hand: HandModel, level: int) -> sp.csr_array:
    """The matrix (V_level, V) of the model's subdivision, from what it does to unit vectors."""
    count = len(hand.weights(0))
    return sp.csr_array(hand.subdivide(torch.eye(count, dtype=torch.float64), level).numpy())
