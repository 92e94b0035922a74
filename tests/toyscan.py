"""A hand that turns before one camera in light of spherical harmonics: pictures that `joint` can explain exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from benchmarks.fitting import camera
from handbench.hand import hand_model, twins
from handbench.light.harmonics import cosine_lobe, harmonics
from handbench.methods.kit.fittedhand import FittedHand, Sighting
from handbench.recording import Recording
from handbench.render.see.raster import rasterise
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Array, Frame, Observation, Pose, Unknown

HAND = hand_model()
LEVEL, SIZE = 0, 64
LIGHT = np.array([1.6, 0.35, 0.5, -0.4, 0.1, -0.1, 0.15, 0.1, 0.05])[:, None] * [1.0, 0.9, 0.75]


@dataclass(frozen=True)
class Scan:
    """The enrolment, the hand as a perfect fit would find it, and the albedo (3, N) at the texels."""

    enrolment: Recording
    hand: FittedHand
    albedo: Array


def skin(back: float, palm: float) -> Array:
    """Albedo (3, N) of a hand with a back and a palm of these reflectances, mottled a little."""
    topology = HAND.topology(LEVEL)
    surface = PosedSurface(HAND.mesh(HAND.neutral(), HAND.named_pose("rest"), LEVEL), SIZE)
    facing = twins.palm(HAND) @ surface.normal.numpy() / np.linalg.norm(twins.palm(HAND))
    share = np.clip(0.5 + 1.5 * facing, 0.0, 1.0)
    mottle = 1.0 + 0.05 * np.random.default_rng(2).normal(size=surface.atlas.count)
    assert surface.atlas.topology is topology
    return np.array([[1.0], [0.75], [0.6]]) * (back + (palm - back) * share) * mottle


def scan(albedo: Array, light: Array = LIGHT, turns: int = 6) -> Scan:
    """The scan of a hand of an albedo (3, N) under a light (9, 3)."""
    seen, frames, sightings = {}, [], []
    lens, shape = camera(96, 128), np.asarray(HAND.neutral(), dtype=np.float64)
    for i in range(turns):
        pose = Pose(HAND.named_pose("rest").joints, (0.0, 2.0 * np.pi * i / turns, 0.0))
        surface = PosedSurface(HAND.mesh(shape, pose, LEVEL), SIZE)
        shading = harmonics(surface.normal.T.numpy(), 2) * cosine_lobe(2) @ light
        colour = torch.from_numpy(albedo * shading.T / np.pi).float()
        raster = rasterise(surface.mesh, lens)
        image = raster.sample(surface.atlas.dilate(surface.atlas.scatter(colour))).permute(1, 2, 0).numpy()
        frame = Frame("s01", f"moment-{i}", "room", None, None, lens, Unknown("room"), "scan", "environment")
        frames.append(frame)
        seen[frame.key] = Observation(image, raster.alpha)
        sightings.append(Sighting(frame, pose))
    enrolment = Recording(frames, lambda frame: seen[frame.key])
    return Scan(enrolment, FittedHand(HAND, shape, LEVEL, tuple(sightings)), albedo)
