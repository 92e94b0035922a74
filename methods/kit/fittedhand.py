"""A person's hand as found in the pictures of an enrolment: posed as queries ask, and what its pictures show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from handbench.errors import Unsupported
from handbench.hand import HandModel, hand_model
from handbench.hand.fitting import QUICK, Picture, Settings, Unfittable, fit, pictures
from handbench.method import Avatar, PosedAvatar, Progress, Recording, silent
from handbench.recording import Need
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.unwrap import Projected, TexelSurface
from handbench.scene import Array, Frame, Light, Mesh, Pose, Prediction, Viewpoint, needed

FITTABLE: frozenset[Need] = frozenset({"image", "alpha", "camera", "keypoints"})
"""What enrolment must give for `fitted_hand`; depth and poses are used where they are given."""

LEAST_SURE = 0.5  # of a detector: key points that it is less sure of are often elsewhere
GRAZING = 0.15  # cosine below which what a picture shows of the surface is mostly its neighbourhood
_ENOUGH = 0.5  # of the pictures that must show the hand
_LEVEL = 1  # of the meshes' subdivision


@dataclass(frozen=True, eq=False)
class Sighting:
    """A frame in which the hand was found, and its pose there."""

    frame: Frame
    pose: Pose


@dataclass(frozen=True, eq=False)
class Shown:
    """What a frame shows of the texture, and the surface that it shows it of, both at the texels of an atlas."""

    frame: Frame
    surface: TexelSurface
    seen: Projected


@dataclass(frozen=True, eq=False)
class FittedHand:
    """One person's hand: shape (S,) of a hand model, and the frames in which it was found.

    Its meshes are of `level` of the model's subdivision, and share topology and UVs.
    """

    hand: HandModel
    shape: Array
    level: int
    sightings: tuple[Sighting, ...]

    def mesh(self, pose: Pose) -> Mesh:
        """The person's hand in a pose. Raises `Unsupported` for the pose of another hand model."""
        joints, expected = len(pose.joints), len(self.hand.joint_names)
        if joints != expected:
            raise Unsupported(f"the pose has {joints} joints, and the fitted hand ({self.hand.name}) has {expected}")
        return self.hand.mesh(self.shape, pose, self.level)

    def posed(self, viewpoint: Viewpoint) -> Mesh:
        """The person's hand in the pose of a viewpoint. Raises `Unsupported` if that tells none."""
        return self.mesh(needed(viewpoint.pose, "pose"))

    def atlas(self, size: int) -> Atlas:
        """The texels of the hand's textures of `size` x `size`."""
        return Atlas.of(self.hand.topology(self.level), size)

    def shown(self, enrolment: Recording, size: int) -> Iterator[Shown]:
        """What each frame shows of a texture of `size` x `size`."""
        atlas = self.atlas(size)
        for sighting in self.sightings:
            surface = TexelSurface.of(PosedMesh(self.mesh(sighting.pose)), atlas)
            seen = enrolment.observe(sighting.frame)
            found = surface.project(sighting.frame.camera, seen.image, needed(seen.alpha, "alpha"), GRAZING)
            yield Shown(sighting.frame, surface, found)


def fitted_hand(enrolment: Recording, settings: Settings = QUICK, progress: Progress = silent) -> FittedHand:
    """One subject's hand, the hand model that is shipped fitted to the frames of its enrolment.

    Depth and estimated poses are used where they are given. Frames in which no hand was found are left out. Raises
    `Unsupported`, with the fit's own reason, where that leaves fewer than half of them: a wrong hand is worse than
    none.
    """
    model = hand_model()
    try:
        found = fit(model, [_trusted(picture) for picture in pictures(enrolment)], settings, progress)
    except Unfittable as error:
        raise Unsupported(str(error)) from error
    frames = {frame.key: frame for frame in enrolment.frames}
    sightings = tuple(
        Sighting(frames[fitted.picture], fitted.pose)
        for fitted in found.pictures
        if fitted.converged and fitted.pose is not None
    )
    if len(sightings) < _ENOUGH * len(frames):
        fatal = [problem for problem in found.problems if problem.fatal]
        raise Unsupported(f"{fatal[0]} (a hand was found in {len(sightings)} of {len(frames)} pictures)")
    return FittedHand(model, found.shape, _LEVEL, sightings)


def _trusted(picture: Picture) -> Picture:
    """The picture without the key points that its detector doubts."""
    places = np.where(picture.sure[:, None] < LEAST_SURE, np.nan, picture.key_points)
    return replace(picture, key_points=np.c_[places, picture.sure])


class FittedAvatar(Avatar):
    """An avatar that is asked for viewpoints with the person's own fitted mesh, whatever mesh they bring."""

    def __init__(self, hand: FittedHand, inner: Avatar) -> None:
        self._hand, self._inner = hand, inner

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        mesh = self._hand.posed(viewpoint)
        return PosedFitted(self._inner.pose(replace(viewpoint, mesh=mesh)), mesh)


class PosedFitted(PosedAvatar):
    """A posed avatar whose pictures come with the fitted mesh."""

    def __init__(self, inner: PosedAvatar, mesh: Mesh) -> None:
        self._inner, self._mesh = inner, mesh

    def relight(self, light: Light) -> Prediction:
        return replace(self._inner.relight(light), mesh=self._mesh)
