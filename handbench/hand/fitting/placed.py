"""A hand before a camera: as a fit moves it, and as a pose in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...scene import Array, Camera, Pose
from .rig import rodrigues
from .space import Space


@dataclass(frozen=True)
class Placed:
    """The hand of one picture in the camera's frame: angles (F,), rotation (3, 3) and translation (3,)."""

    angles: Array
    rotation: Array
    translation: Array

    def moved(self, step: Array) -> Placed:
        """After a step (6 + F,): turned in the camera's frame, shifted, joints turned."""
        turn = rodrigues(step[:3])[0]
        return Placed(self.angles + step[6:], turn @ self.rotation, self.translation + step[3:6])


def in_world(space: Space, hand: Placed, camera: Camera) -> Pose:
    """The pose of a hand in the world, joints within their limits."""
    turn = Rotation.from_matrix(camera.rotation.T @ hand.rotation).as_rotvec()
    angles = np.clip(hand.angles, space.least, space.most)
    return Pose(space.turns(angles), turn, camera.rotation.T @ (hand.translation - camera.world_to_camera[:, 3]))


def in_camera(space: Space, pose: Pose, camera: Camera) -> Placed:
    """A pose in the world as a camera sees it."""
    turn = camera.rotation @ rodrigues(pose.rotation)[0]
    angles = np.clip(pose.joints.ravel()[space.free], space.least, space.most)
    return Placed(angles, turn, camera.rotation @ pose.translation + camera.world_to_camera[:, 3])
