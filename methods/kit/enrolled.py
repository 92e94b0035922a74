"""What an avatar is made of that is optimised on pictures: some of an enrolment's, and the hand that they show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handbench.hand import HandModel
from handbench.hand.fitting import QUICK, Settings
from handbench.method import Progress, Recording, silent
from handbench.scene import Array, Camera, Mesh, Observation, Pose

from .fittedhand import fitted_hand


@dataclass(frozen=True, eq=False)
class Seen:
    """A picture in which the hand was found, in a pose; `pose_key` is its frame's."""

    pose_key: str
    camera: Camera
    observation: Observation
    pose: Pose


@dataclass(frozen=True, eq=False)
class Enrolled:
    """A hand model in a shape (S,), `size` times as large, and the pictures that show it."""

    hand: HandModel
    shape: Array
    size: float
    pictures: tuple[Seen, ...]

    @property
    def found(self) -> dict[str, Pose]:
        """The poses by the keys of their frames' poses."""
        return {seen.pose_key: seen.pose for seen in self.pictures}

    def mesh(self, pose: Pose, level: int) -> Mesh:
        """The hand in a pose; its size is about the wrist."""
        mesh = self.hand.mesh(self.shape, pose, level)
        return Mesh(pose.translation + self.size * (mesh.vertices - pose.translation), mesh.topology)


def enrolled(enrolment: Recording, most: int, settings: Settings = QUICK, progress: Progress = silent) -> Enrolled:
    """The hand in at most `most` pictures of an enrolment, spread evenly over it.

    One camera cannot tell a small near hand from a large far one, and a fit takes the usual size. So where poses are
    told, and no depth, the hand is moved along its rays to the told distance (their median) and scaled as much.
    Raises `Unsupported` with the fit's reason where no hand is found.
    """
    frames = enrolment.frames
    keys = {frames[i].key for i in np.linspace(0, len(frames) - 1, most).round().astype(int)}
    found = fitted_hand(enrolment.where(lambda frame: frame.key in keys), settings, progress=progress)
    seen = [(each.frame, enrolment.observe(each.frame), each.pose) for each in found.sightings]
    ratios = [
        _distance(frame.camera, frame.pose) / _distance(frame.camera, pose)
        for frame, observation, pose in seen
        if frame.pose is not None and observation.depth is None
    ]
    size = float(np.median(ratios)) if ratios else 1.0
    pictures = tuple(
        Seen(f.pose_key, f.camera, observation, _moved(pose, f.camera, size)) for f, observation, pose in seen
    )
    return Enrolled(found.hand, found.shape, size, pictures)


def _distance(camera: Camera, pose: Pose) -> float:
    return float(np.linalg.norm(pose.translation - camera.centre))


def _moved(pose: Pose, camera: Camera, factor: float) -> Pose:
    return Pose(pose.joints, pose.rotation, camera.centre + factor * (pose.translation - camera.centre))
