"""What an avatar is made of that is optimised on pictures: some of an enrolment's, and the hand that they show."""

from __future__ import annotations

from dataclasses import dataclass, field

from handbench.errors import Unsupported
from handbench.evenly import evenly
from handbench.hand import HandModel
from handbench.hand.fitting import QUICK, FittingSettings
from handbench.method import Progress, Recording, silent
from handbench.scene import Array, Camera, Light, Mesh, Observation, Pose, Unknown

from .fittedhand import fitted_hand


@dataclass(frozen=True, eq=False)
class PosedPicture:
    """A picture in which the hand was found, in a pose; `pose_key` and `light` are those of its frame."""

    pose_key: str
    camera: Camera
    observation: Observation
    pose: Pose
    light: Light = field(default_factory=lambda: Unknown("as enrolled"))


@dataclass(frozen=True, eq=False)
class Enrolled:
    """A hand model in a shape (S,), and the pictures that show it."""

    hand: HandModel
    shape: Array
    pictures: tuple[PosedPicture, ...]

    @property
    def found(self) -> dict[str, Pose]:
        """The poses by the keys of their frames' poses."""
        return {seen.pose_key: seen.pose for seen in self.pictures}

    def mesh(self, pose: Pose, level: int) -> Mesh:
        """The hand in a pose."""
        return self.hand.mesh(self.shape, pose, level)


def enrolled(
    enrolment: Recording, most: int, settings: FittingSettings = QUICK, progress: Progress = silent
) -> Enrolled:
    """The hand in at most `most` pictures of an enrolment, spread evenly over it.

    Raises `Unsupported` with the fit's reason where no hand is found.
    """
    frames = enrolment.frames
    if not frames:
        raise Unsupported("the enrolment has no frames, and a hand is sought in those; give at least one")
    keys = {frame.key for frame in evenly(frames, most)}
    found = fitted_hand(enrolment.where(lambda frame: frame.key in keys), settings, progress=progress)
    seen = ((each.frame, each.pose) for each in found.sightings)
    pictures = tuple(PosedPicture(f.pose_key, f.camera, enrolment.observe(f), pose, f.light) for f, pose in seen)
    return Enrolled(found.hand, found.shape, pictures)
