"""A pose that a picture brings, as a term: a tracker's, which is off by a little, or sometimes altogether."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .picture import CloseUp
from .placed import Placed, in_camera
from .quadratic import Quadratic
from .space import Space


@dataclass(frozen=True)
class PoseNoise:
    """By how much poses that pictures bring are off, standard deviations: radians of each joint's angle and of the
    hand's rotation about each axis, metres across the camera's line of sight and along it.

    Beyond `far` of them the pull stays as it is there: a pose that is far off does not keep a hand from its picture.
    """

    joints: float = np.radians(2.5)
    rotation: float = np.radians(2.5)
    across: float = 0.003
    along: float = 0.006
    far: float = 3.0

    def add(self, total: Quadratic, weight: float, hand: Placed, told: Placed) -> None:
        """Add `weight` times the squares of deviations."""
        turn = Rotation.from_matrix(hand.rotation @ told.rotation.T).as_rotvec()
        off = np.concatenate([turn, hand.translation - told.translation, hand.angles - told.angles])
        one = [*[self.rotation] * 3, self.across, self.across, self.along, *[self.joints] * len(hand.angles)]
        off, per_step = off / one, np.zeros((len(off), len(total.gradient)))
        per_step[:, : len(off)] = np.diag(1.0 / np.array(one))
        size = np.abs(off)
        loss = np.where(size < self.far, size**2, self.far * (2 * size - self.far))
        pull = 2 * weight * np.minimum(1.0, self.far / np.maximum(size, 1e-12))
        total.add(weight * float(loss.sum()), pull, off, per_step)


def told_pose(space: Space, view: CloseUp) -> Placed | None:
    """The pose that a picture brings, as its camera sees it; None without one."""
    return None if view.picture.start is None else in_camera(space, view.picture.start, view.picture.camera)
