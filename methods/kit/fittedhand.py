"""A person's hand as found in the pictures of an enrolment: posed as queries ask, and what its pictures show."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from handbench.errors import Unsupported
from handbench.hand import HandModel, hand_model, hand_of_poses
from handbench.hand.fitting import QUICK, FittingSettings, HandPicture, Unfittable, fit, pictures
from handbench.method import Avatar, PosedAvatar, Progress, Recording, silent
from handbench.recording import Need
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.unwrap import Projected, TexelSurface
from handbench.scene import Array, Baked, Camera, Frame, Light, Mesh, Pose, Prediction, Viewpoint, needed

from .weights import as_tensor, as_text, check_shapes, load_state, save_state

FITTABLE: frozenset[Need] = frozenset({"image", "alpha", "camera", "keypoints"})
"""What enrolment must give for `fitted_hand`; depth and poses are used where they are given."""

LEAST_SURE = 0.5  # of a detector: key points that it is less sure of are often elsewhere
GRAZING = 0.15  # cosine below which what a picture shows of the surface is mostly its neighbourhood
_ENOUGH = 0.5  # of the pictures that must show the hand
_LEVEL = 1  # of the meshes' subdivision
_NAME, _INNER = "fitted hand", "inner"  # of a kept avatar


@dataclass(frozen=True, eq=False)
class Sighting:
    """A frame in which the hand was found, and its pose there."""

    frame: Frame
    pose: Pose


@dataclass(frozen=True, eq=False)
class ShownTexels:
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

    def shown(self, enrolment: Recording, size: int) -> Iterator[ShownTexels]:
        """What each frame shows of a texture of `size` x `size`."""
        atlas = self.atlas(size)
        for sighting in self.sightings:
            surface = TexelSurface.of(PosedMesh(self.mesh(sighting.pose)), atlas)
            seen = enrolment.observe(sighting.frame)
            found = surface.project(sighting.frame.camera, seen.image, needed(seen.alpha, "alpha"), GRAZING)
            yield ShownTexels(sighting.frame, surface, found)


def fitted_hand(enrolment: Recording, settings: FittingSettings = QUICK, progress: Progress = silent) -> FittedHand:
    """One subject's hand: a hand model fitted to the frames of its enrolment, that of the poses if any are given.

    Depth and estimated poses are used where they are given. Frames in which no hand was found are left out. Raises
    `Unsupported`, with the fit's own reason, where that leaves fewer than half of them: a wrong hand is worse than
    none.
    """
    model = hand_of_poses(frame.pose for frame in enrolment.frames)
    settings = replace(settings, level=min(settings.level, model.levels))
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
    return FittedHand(model, found.shape, min(_LEVEL, model.levels), sightings)


def _trusted(picture: HandPicture) -> HandPicture:
    """The picture without the key points that its detector doubts."""
    places = np.where(picture.sure[:, None] < LEAST_SURE, np.nan, picture.key_points)
    return replace(picture, key_points=places)


class FittedAvatar(Avatar):
    """An avatar that is asked for viewpoints with the person's own fitted mesh, whatever mesh they bring."""

    def __init__(self, hand: FittedHand, inner: Avatar) -> None:
        self._hand, self._inner = hand, inner

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        mesh = self._hand.posed(viewpoint)
        return PosedFitted(self._inner.pose(replace(viewpoint, mesh=mesh)), mesh)

    def baked(self, viewpoint: Viewpoint) -> Baked:
        return self._inner.baked(replace(viewpoint, mesh=self._hand.posed(viewpoint)))

    @property
    def found(self) -> dict[str, Pose]:
        return {sighting.frame.pose_key: sighting.pose for sighting in self._hand.sightings}

    def save(self, folder: Path) -> None:
        """The hand, without the frames it was found in, and the avatar in a folder of its own."""
        hand = self._hand
        told = {"shape": np.array(hand.shape, dtype=np.float64), "level": np.array(hand.level)}
        state = {name: torch.from_numpy(value) for name, value in told.items()}
        save_state(folder, _NAME, {}, {**state, "hand": as_tensor(hand.hand.name)})
        (folder / _INNER).mkdir()
        self._inner.save(folder / _INNER)

    @classmethod
    def load(cls, folder: Path, inner: Callable[[Path, FittedHand], Avatar]) -> FittedAvatar:
        """The avatar that `save` wrote; `inner` reads the one in it. Raises `InputError` as `load_state` does."""
        state = load_state(folder, _NAME, {}, {"hand": (None,), "level": ()})
        model = hand_model(as_text(state["hand"]))
        check_shapes(folder, state, {"shape": (model.shape_size,)})
        hand = FittedHand(model, state["shape"].numpy(), int(state["level"]), ())
        model.topology(hand.level)  # raises for a level that there is not
        return cls(hand, inner(folder / _INNER, hand))


class PosedFitted(PosedAvatar):
    """A posed avatar whose pictures come with the fitted mesh."""

    def __init__(self, inner: PosedAvatar, mesh: Mesh) -> None:
        self._inner, self._mesh = inner, mesh

    def relight(self, light: Light) -> Prediction:
        return replace(self._inner.relight(light), mesh=self._mesh)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedFitted(self._inner.seen_by(camera), self._mesh)
