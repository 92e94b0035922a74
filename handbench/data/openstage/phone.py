"""Scans by phone: a neutral hand turns in a room before one camera with depth; then other poses in known light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from ...hand.openhand import OpenHand, named_pose
from ...scene import Array, Camera, Pose
from ...scene.colour import eight_bit, linear
from .cast import Subject, pose
from .estimates import PHONE, estimated_poses, estimated_shape, keypoints
from .population import cast
from .presets import PhonePreset
from .production import Lighting, Performance, Production, Shot
from .rooms import PANELS, panels, room
from .stage import cameras, environment
from .wild import facing

_ROOMS = ("hall", "konzerthaus", "default", "pillars")
_RELIT = ("park", "nightlights", "brightday")


@dataclass(frozen=True)
class Phone:
    """What a phone's camera and depth sensor do to a picture.

    shot, dark      variance of a pixel's noise for each unit of its value, and its deviation in the dark
    depth, step     metres: deviation of the depth's noise at a metre, and the steps that it is told in
    grazing         cosine between normal and line of sight below which depth is lost
    edge            metres between neighbours across which depth is lost, mostly
    ragged          how far the noise moves the mask's edge
    holes           depth is lost here and there, where a smooth noise of variance 1 is above
    """

    shot: float = 6e-5
    dark: float = 2e-3
    depth: float = 1.5e-3
    step: float = 1e-3
    grazing: float = 0.2
    edge: float = 8e-3
    ragged: float = 0.2
    holes: float = 2.3

    def take(
        self, image: Array, alpha: Array, depth: Array, normal: Array, camera: Camera, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """The picture (H, W, 3) in 8-bit sRGB made linear again, a mask of 0 and 1, and depth with holes (0)."""
        noise = np.sqrt(self.shot * image + self.dark**2) * rng.normal(size=image.shape)
        codes = eight_bit(np.clip(image + noise, 0.0, 1.0))
        ragged = gaussian_filter(alpha, 1.0) + self.ragged * _smooth(rng, alpha.shape, 1.2)
        near = gaussian_filter(alpha, 3.0)
        mask = np.where((near > 0.02) & (near < 0.98), ragged, alpha) > 0.5
        told = depth + self.depth * depth**2 * rng.normal(size=depth.shape)
        told = np.where(self._lost(alpha, depth, normal, camera, rng), 0.0, np.round(told / self.step) * self.step)
        return linear(codes / np.float32(255.0)), mask.astype(np.float32), told.astype(np.float32)

    def _lost(self, alpha: Array, depth: Array, normal: Array, camera: Camera, rng: np.random.Generator) -> Array:
        """Where the sensor sees nothing: off the hand, at grazing angles, at steps of depth, and here and there."""
        height, width = alpha.shape
        rows, columns = np.mgrid[0:height, 0:width] + 0.5
        rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ camera.ray_matrix
        facing = -(normal * rays).sum(-1) / np.linalg.norm(rays, axis=-1)
        far = np.where(alpha > 0.5, depth, 10.0)
        steps = maximum_filter(far, 3) - minimum_filter(far, 3) > self.edge
        holes = _smooth(rng, alpha.shape, 2.0) > self.holes
        return (alpha < 0.5) | (facing < self.grazing) | (steps & (rng.random(alpha.shape) < 0.7)) | holes


def _smooth(rng: np.random.Generator, shape: tuple[int, ...], pixels: float) -> Array:
    """Noise of variance 1 that is smooth over some pixels."""
    return gaussian_filter(rng.normal(size=shape), pixels) * (2.0 * np.sqrt(np.pi) * pixels)


def production(preset: PhonePreset) -> Production:
    """A scan of each subject, which can be enrolled (segment "scan"), and the truth for new poses in known light
    ("relit"): environments, and panels of coloured light."""
    hand = OpenHand.load()
    views = cameras(preset, ("palmar", "oblique"))
    height = preset.environment_height
    known = tuple(Lighting(f"env-{name}", "environment", environment(name, height)) for name in _RELIT)
    known += tuple(Lighting(name, "environment", panels(name, height)) for name in PANELS)
    performances: list[Performance] = []
    rooms: list[Lighting] = []
    people = cast("openphone", preset.subjects, hand)
    for i, subject in enumerate(people):
        name = f"room-{subject.name}"
        light = room(name, _ROOMS[i % len(_ROOMS)], subject.look.seed, height)
        rooms.append(Lighting(name, "environment", light))
        performances += _scan(hand, subject, preset.moments, views[0], rooms[-1])
        performances += [
            Performance(subject, f"pose-{k}", pose(hand, subject, k), (Shot("relit", views, known),))
            for k in range(1, preset.poses + 1)
        ]
    shapes = {p.name: estimated_shape(hand, p.identity, np.random.default_rng([814, p.look.seed])) for p in people}
    return Production(preset, hand, views, (*rooms, *known), tuple(performances), estimates=shapes)


def _scan(hand: OpenHand, subject: Subject, count: int, camera: Camera, light: Lighting) -> list[Performance]:
    """The neutral hand turned once about its forearm, a little unsteadily."""
    rng = np.random.default_rng([813, subject.look.seed])
    wobble = np.radians(rng.normal(0.0, 2.0, (count, 3)))
    turns = 2.0 * np.pi * np.arange(count) / count
    still = named_pose("rest").joints
    poses = [Pose(still, facing(turn, tilt)) for turn, tilt in zip(turns, wobble, strict=True)]
    told = estimated_poses(hand, poses, PHONE, camera, rng)
    return [
        Performance(
            subject,
            f"moment-{k:02d}",
            true,
            (
                Shot(
                    "scan",
                    (camera,),
                    (light,),
                    estimated=True,
                    keypoints={camera.name: keypoints(hand, subject.identity, true, camera, rng)},
                    device=Phone(),
                ),
            ),
            k,
            told[k],
        )
        for k, true in enumerate(poses)
    ]
