"""What an inversion looks at: crops of a posed hand, and how its texture is drawn in them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.evenly import evenly
from handbench.hand import hand_model, hand_of_poses
from handbench.hand.known import SHIPPED
from handbench.light.lightset import light_samples
from handbench.method import Progress, Recording
from handbench.render.see.raster import Raster, rasterise
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Camera, Light, Mesh, Observation, Unknown, leaves, needed
from handbench.scene.colour import srgb

from ..kit.crop import Crop
from ..kit.enrolled import Enrolled, enrolled
from ..kit.shading import Shading
from .config import HandyConfig
from .generator import SIZE
from .lobe import Lobe

_EATEN = 1  # times the mask's edge is eaten by 3 x 3 before colours are compared
_SUPERSAMPLE = 2
_ROUNDING = 1e-5  # of UVs in files


@dataclass(frozen=True, eq=False)
class DisplayCrop:
    """A crop: its display values (3, h, w), where they are compared, inside (h, w) bool, and the hand's raster.

    diffuse (3, R, R): the irradiance over pi, and specular (3, h, w): what the surface mirrors of the light, both of
    the light that is told; None where it is not, or is not to be used.
    """

    image: Tensor
    inside: Tensor
    raster: Raster
    diffuse: Tensor | None = None
    specular: Tensor | None = None

    def drawn(self, albedo: Tensor, exposure: Tensor) -> Tensor:
        """The picture (3, h, w), linear, of a hand with an albedo (3, R, R), linear; differentiable in both.

        `exposure` (1,) or (3,) is how bright a texture is in a picture that is drawn without its light.
        """
        if self.diffuse is None or self.specular is None:
            return exposure[:, None, None] * self.raster.sample(albedo)
        return self.raster.sample(albedo * self.diffuse) + self.specular


@dataclass(frozen=True, eq=False)
class Sitting:
    """The pictures of a person, and its fitted hand, or None where tracked meshes are given."""

    shots: tuple[DisplayCrop, ...]
    hand: Enrolled | None


def sitting(enrolment: Recording, config: HandyConfig, lobe: Lobe, progress: Progress) -> Sitting:
    """What is looked at of an enrolment: its fully lit frames, or all where there are none.

    A tracked mesh of the open hand is taken as it is. Without one the hand is fitted to key points, masks and depth.
    Raises `Unsupported` if neither is given, and if no picture shows the hand.
    """
    full = enrolment.of_kind("full")
    chosen = full if full.frames else enrolment
    hand = None
    if chosen.frames and _is_open_hand(chosen.frames[0].mesh):
        posed = list(_tracked(chosen, config.frames))
    elif "keypoints" in chosen.gives:
        named = hand_of_poses(frame.pose for frame in chosen.frames).name
        if named != SHIPPED:
            raise Unsupported(
                f"poses are those of {named}, and textures here are for the open hand; give poses of that"
            )
        hand = enrolled(chosen, config.frames, progress=progress)
        level = min(config.level, hand.hand.levels)
        posed = [(each.camera, each.observation, each.light, hand.mesh(each.pose, level)) for each in hand.pictures]
    else:
        raise Unsupported(
            "a texture is sought on tracked meshes of the open hand, or on a hand fitted to key points; give either"
        )
    surfaces: dict[int, PosedSurface] = {}  # the cameras of a pose share one, and its shadows
    shots = []
    for camera, seen, light, mesh in posed:
        if id(mesh) not in surfaces:
            surfaces[id(mesh)] = PosedSurface(mesh, SIZE)
        surface = surfaces[id(mesh)]
        crop = Crop.of(camera, seen.image, needed(seen.alpha, "alpha"), config.side)
        shots.append(_shot(crop, surface, light, config, lobe))
    showing = tuple(shot for shot in shots if shot.inside.any())
    if not showing:
        raise Unsupported(
            f"no picture of {enrolment.subjects[0]} shows its hand inside the mask; check meshes and masks"
        )
    return Sitting(showing, hand)


def _is_open_hand(mesh: Mesh | None) -> bool:
    """Whether the generator's textures fit a mesh: they are for the UVs of the open hand."""
    if mesh is None or mesh.topology.uvs is None:
        return False
    uvs, uv_faces = mesh.topology.unwrapped
    hand = hand_model()
    for level in range(hand.levels + 1):
        ours, our_faces = hand.topology(level).unwrapped
        if np.array_equal(uv_faces, our_faces):
            return bool(np.abs(uvs - ours).max() < _ROUNDING)
    return False


def _tracked(recording: Recording, most: int) -> Iterator[tuple[Camera, Observation, Light, Mesh]]:
    """At most `most` frames, spread evenly over the recording."""
    for frame in evenly(recording.frames, most):
        yield frame.camera, recording.observe(frame), frame.light, needed(frame.mesh, "mesh")


def _shot(crop: Crop, surface: PosedSurface, light: Light, config: HandyConfig, lobe: Lobe) -> DisplayCrop:
    raster = rasterise(surface.mesh, crop.camera, _SUPERSAMPLE)
    image = torch.from_numpy(np.moveaxis(srgb(crop.image), -1, 0).copy())
    inside = torch.from_numpy(crop.inner(_EATEN) & (raster.alpha > 0.99))
    if not config.lit or any(isinstance(leaf, Unknown) for leaf in leaves(light)):
        return DisplayCrop(image, inside, raster)
    lights = light_samples(light, environment_error=config.environment_error)
    diffuse, specular = Shading(surface, crop.camera.centre).features(lights, lobe.roughness, lobe.model)
    atlas = surface.atlas
    diffuse, specular = (atlas.dilate(atlas.scatter(part)) for part in (diffuse / math.pi, lobe.strength * specular))
    return DisplayCrop(image, inside, raster, diffuse, raster.sample(specular))
