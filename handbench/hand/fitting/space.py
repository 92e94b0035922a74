"""Where a fit looks: the natural shapes and poses of a hand model, as its own samples tell them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene import Array
from ..handmodel import HandModel
from .rig import Rest, Rig

_SAMPLES = 400  # of shapes and of poses; the largest space here has 60 numbers
LIMIT = np.radians(1.0)  # by which a joint may be beyond its limit while a fit goes on, about
_SLACK = np.radians(12.0)  # by which a natural angle may miss what the samples tell, standard deviation
_STEP = 2e-4  # metres: a shape coordinate that moves the surface less (root mean square) is left out


@dataclass(frozen=True)
class Space:
    """The unknowns of a hand in numbers that are standard normal where the hand is natural.

    shape = shape_mean + shape_basis @ z, z (K,); of the axis-angles (J, 3), flat, only `free` (F,) move, between
    `least` and `most`; pose_whitening @ (angles - pose_mean) is standard normal.
    """

    rig: Rig
    shape_mean: Array
    shape_basis: Array
    free: Array
    least: Array
    most: Array
    pose_mean: Array
    pose_whitening: Array

    @staticmethod
    def of(hand: HandModel, level: int) -> Space:
        """The space of a model, which keeps it."""
        return hand.kept(("space", level), lambda: _space(hand, Rig.of(hand, level)))

    def shape(self, z: Array) -> Array:
        """The shape (S,) at coordinates (K,)."""
        return self.shape_mean + self.shape_basis @ z

    def rest(self, z: Array) -> Rest:
        """The rows of the rig at rest. How they move with z is told for the mean shape: shapes are nearly linear."""
        return Rest(self.rig.at_rest(self.shape(z)), self._by_shape())

    def _by_shape(self) -> Array:
        rig = self.rig
        return rig.hand.kept(("rows by shape", rig.level), lambda: rig.along(self.shape_mean, self.shape_basis))

    def still(self, z: Array) -> Rest:
        """The same, where the shape stays."""
        rows = self.rig.at_rest(self.shape(z))
        return Rest(rows, np.zeros((len(rows), 3, 0)))

    def beyond(self, angles: Array) -> Array:
        """By how many `LIMIT` angles (..., F) are beyond the joints' limits: negative below, zero between."""
        return (np.minimum(angles - self.least, 0.0) + np.maximum(angles - self.most, 0.0)) / LIMIT

    def turns(self, angles: Array) -> Array:
        """Axis-angles (..., J, 3) of free components (..., F)."""
        flat = np.zeros((*angles.shape[:-1], 3 * self.rig.joints))
        flat[..., self.free] = angles
        return flat.reshape(*angles.shape[:-1], -1, 3)


def _space(hand: HandModel, rig: Rig) -> Space:
    rng = np.random.default_rng(0)
    shapes = np.array([np.asarray(hand.sample_identity(rng), dtype=np.float64) for _ in range(_SAMPLES)])
    mean = shapes.mean(axis=0)
    size, spread, _ = np.linalg.svd((shapes - mean).T / np.sqrt(_SAMPLES - 1), full_matrices=False)
    root = size * spread  # root @ root.T is the covariance
    moved = rig.along(mean, root)[: rig.vertices]
    _, reach, turn = np.linalg.svd(moved.reshape(-1, root.shape[1]), full_matrices=False)
    kept = reach / np.sqrt(rig.vertices) > _STEP
    poses = np.array([hand.sample_pose(rng).joints.ravel() for _ in range(_SAMPLES)])
    middle, deviation = poses.mean(axis=0), poses.std(axis=0)
    if hand.limits is not None:
        least, most = hand.limits.reshape(-1, 2).T
        moves = most > least
    else:
        width = 3.0 * np.hypot(deviation, _SLACK)
        least, most, moves = middle - width, middle + width, deviation > 1e-3
    moves[3 * hand.parents.index(-1) :][:3] = False  # the placement turns the root
    free = np.flatnonzero(moves)
    covariance = np.cov(poses[:, free].T) + _SLACK**2 * np.eye(len(free))
    return Space(
        rig,
        mean,
        root @ turn[kept].T,
        free,
        least[free],
        most[free],
        middle[free],
        np.linalg.inv(np.linalg.cholesky(covariance)),
    )
