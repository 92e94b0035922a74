"""The light stage: cameras, lights and their combinations, and what is made of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...hand.openhand import OpenHand
from ...light.environment import solid_angles
from ...light.skybox import skybox
from ...light.stage import stage_directions
from ...scene import Array, Camera, Directional, Environment, FrameKind, Group
from .cast import Subject, pose
from .inventory import olat_name
from .population import cast
from .presets import Preset, StagePreset
from .production import Lighting, Performance, Production, Shot

# Irradiance of one stage light on a surface that faces it; skin of albedo 0.5 then reaches 0.5 on a 0..1 display.
LIGHT_IRRADIANCE = 3.0
# Groups are dimmed, and the fully lit stage shares the power of 3.4 lights, so that both expose like a single light.
GROUP_SIZE, GROUP_DIMMING, FULL_POWER = 3, 0.7, 3.4
# Mean irradiance over all directions to which every environment is exposed.
ENVIRONMENT_IRRADIANCE = 1.8

_TARGET = np.array([0.0, 0.07, 0.0])  # the cut end of the forearm stays below the picture, long fingers inside it
_DISTANCE, _HEIGHT = 1.0, 0.31  # metres from the target, metres of the scene that the picture's height covers
_VIEWS = {  # direction from the target to the camera; palm faces +z, thumb +x, fingers +y
    "dorsal": (0.0, 0.0, -1.0),
    "palmar": (0.0, 0.0, 1.0),
    "oblique": (0.75, 0.35, -0.75),
    "radial": (1.0, 0.1, 0.25),
    "ulnar": (-1.0, 0.1, 0.25),
    "fingertip": (0.15, 0.85, 0.65),
    "back-ulnar": (-0.75, 0.35, -0.75),
    "palm-radial": (0.75, 0.3, 0.75),
    "palm-ulnar": (-0.75, 0.3, 0.75),
}


def cameras(preset: Preset, names: Sequence[str]) -> tuple[Camera, ...]:
    """Cameras with the preset's pictures, looking at the middle of the hand from where their names say."""
    focal = preset.height * _DISTANCE / _HEIGHT
    K = np.array([[focal, 0, preset.width / 2], [0, focal, preset.height / 2], [0, 0, 1]])
    return tuple(Camera(name, preset.width, preset.height, K, _look_at(_VIEWS[name])) for name in names)


def _look_at(view: tuple[float, float, float]) -> Array:
    """World-to-camera (3, 4) of an OpenCV camera at `view` from the target, with the fingers up in the picture."""
    backward = np.asarray(view) / np.linalg.norm(view)
    forward = -backward
    down = -np.array([0.0, 1.0, 0.0])
    right = np.cross(down, forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    centre = _TARGET + _DISTANCE * backward
    return np.concatenate([rotation, -(rotation @ centre)[:, None]], axis=1)


def stage_lights(preset: StagePreset) -> tuple[Directional, ...]:
    """The stage lights, spread over the sphere, in an order that spreads the held-out ones as well."""
    directions = stage_directions(preset.lights)
    order = np.random.default_rng(7).permutation(preset.lights)
    return tuple(Directional(directions[i], np.full(3, LIGHT_IRRADIANCE)) for i in order)


def environment(name: str, height: int) -> Environment:
    """An environment map of height x 2 height, exposed to `ENVIRONMENT_IRRADIANCE`."""
    return exposed(skybox(name, height, 2 * height))


def exposed(raw: Environment) -> Environment:
    """A map scaled to `ENVIRONMENT_IRRADIANCE`."""
    weights = solid_angles(*raw.radiance.shape[:2])[..., None]
    luminance = float((raw.radiance * weights).sum() / 3.0)  # integral of radiance over the sphere
    return raw.scaled(4.0 * ENVIRONMENT_IRRADIANCE / luminance)  # mean irradiance over directions is a quarter of it


def lightings(preset: StagePreset) -> tuple[Lighting, ...]:
    """Every lighting of a preset: single lights, groups of trained lights, the full stage, environments."""
    lights = stage_lights(preset)
    identity = np.eye(preset.lights)
    found = [Lighting(olat_name(i), "olat", light, identity[i]) for i, light in enumerate(lights)]
    trained = preset.lights - preset.held_out_lights
    for k in range(trained // GROUP_SIZE):
        members = range(k, trained, trained // GROUP_SIZE)[:GROUP_SIZE]
        found.append(_combined(f"group-{k}", "group", lights, GROUP_DIMMING * identity[list(members)].sum(0)))
    # without the held-out lights: mean textures are made from fully lit frames, and must not have seen them either
    found.append(_combined("full", "full", lights, FULL_POWER / trained * identity[:trained].sum(0)))
    for name in preset.environments:
        found.append(Lighting(f"env-{name}", "environment", environment(name, preset.environment_height)))
    return tuple(found)


def _combined(name: str, kind: FrameKind, lights: tuple[Directional, ...], weights: Array) -> Lighting:
    members = tuple(light.scaled(w) for light, w in zip(lights, weights, strict=True) if w > 0)
    return Lighting(name, kind, Group(members), weights)


def production(preset: StagePreset) -> Production:
    """The light stage of a preset: subjects in poses of their own, before every camera and in every light."""
    hand = OpenHand.load()
    seen, lit = cameras(preset, preset.cameras), lightings(preset)

    def performance(subject: Subject, k: int) -> Performance:
        segment = "train" if k < preset.train_poses else "held-out"
        return Performance(subject, f"pose-{k}", pose(hand, subject, k), (Shot(segment, seen, lit),))

    people = cast("openstage", preset.subjects, hand)
    poses = range(preset.train_poses + preset.held_out_poses)
    performances = tuple(performance(subject, k) for subject in people for k in poses)
    return Production(preset, hand, seen, lit, performances, "tracked", preset.tracked_level)
