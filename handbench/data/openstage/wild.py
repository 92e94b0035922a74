"""Hands in the wild: one camera, one environment that nobody measured, a hand that moves; and what it would have looked
like later, from elsewhere, and in other light."""

from __future__ import annotations

import numpy as np
import torch
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from ...hand.collision import penetration, relaxed
from ...hand.openhand import OpenHand
from ...scene import Array, Camera, Point, Pose
from .cast import Subject, own_pose
from .estimates import ONE_CAMERA, estimated_poses, estimated_shape, keypoints
from .population import cast
from .presets import WildPreset
from .production import Lighting, Performance, Production, Shot
from .rooms import turned
from .stage import cameras, environment

_OWN = ("brightday", "hall", "park", "streetlamp", "pillars", "nightlights", "park2", "default")
_RELIT = ("crossroads", "konzerthaus")
_LAMP = Point(np.array([0.35, 0.5, 0.5]), np.array([1.9, 1.7, 1.4]))  # metres, watts per steradian: a warm desk lamp
_KEYS = 3  # poses that a path leads through
_SHRINK = 0.8  # of a path whose hand runs through itself
_WRIST = 0.5  # share of the bends of the wrist, which would take the hand out of the picture
_MARGIN = 0.04  # of the picture that stays free of key points


def production(preset: WildPreset) -> Production:
    """A sequence of each subject. Segments: "sequence" can be enrolled, with estimates and key points; "later",
    "elsewhere" and "relit" are the truth for the same light later, other cameras, and the same moments in other light.
    """
    hand = OpenHand.load()
    views = cameras(preset, ("palmar", "palm-radial", "palm-ulnar"))
    height = preset.environment_height
    relit = tuple(Lighting(f"relit-{name}", "environment", environment(name, height)) for name in _RELIT)
    others = (*relit, Lighting("lamp", "olat", _LAMP))
    performances: list[Performance] = []
    own: list[Lighting] = []
    people = cast("openwild", preset.subjects, hand)
    for i, subject in enumerate(people):
        rng = np.random.default_rng([713, subject.look.seed])
        name = f"own-{subject.name}"
        light = turned(name, _OWN[i % len(_OWN)], int(rng.integers(2 * height)), height)
        own.append(Lighting(name, "environment", light))
        poses = path(hand, subject, preset.moments + preset.later, views[0], rng)
        told = estimated_poses(hand, poses, ONE_CAMERA, views[0], rng)
        for k, pose in enumerate(poses):
            here, lit = views[:1], (own[-1],)
            if k < preset.moments:
                seen = {views[0].name: keypoints(hand, subject.identity, pose, views[0], rng)}
                shots = [Shot("sequence", here, lit, estimated=True, keypoints=seen)]
                if k % preset.every == 0:
                    shots += [Shot("elsewhere", views[1:], lit), Shot("relit", here, others)]
            else:
                shots = [Shot("later", here, lit)]
            performances.append(Performance(subject, f"moment-{k:02d}", pose, tuple(shots), k, told[k]))
    shapes = {p.name: estimated_shape(hand, p.identity, np.random.default_rng([714, p.look.seed])) for p in people}
    return Production(preset, hand, views, (*own, *others), tuple(performances), estimates=shapes)


def path(hand: OpenHand, subject: Subject, count: int, camera: Camera, rng: np.random.Generator) -> list[Pose]:
    """A smooth motion of joints and hand through a few natural poses.

    The hand never runs through itself and stays in the camera's picture.
    """
    while True:
        found = _path(hand, subject, count, rng)
        if all(_inside(hand, subject, pose, camera) for pose in found):
            return found


def _path(hand: OpenHand, subject: Subject, count: int, rng: np.random.Generator) -> list[Pose]:
    keys = [relaxed(hand, subject.identity, own_pose(hand, rng)).joints.copy() for _ in range(_KEYS)]
    for joints in keys:
        joints[hand.wrist] *= _WRIST
    turns = rng.uniform(0.0, 2.0 * np.pi) + np.radians(rng.normal(0.0, 25.0, _KEYS))
    tilts = np.radians(rng.normal(0.0, [7.0, 0.0, 6.0], (_KEYS, 3)))
    places = rng.normal(0.0, [0.008, 0.005, 0.015], (_KEYS, 3))
    times, moments = np.linspace(0.0, 1.0, _KEYS), np.linspace(0.0, 1.0, count)
    joints, turns, tilts, places = (
        PchipInterpolator(times, np.asarray(values), axis=0)(moments) for values in (keys, turns, tilts, places)
    )
    amount = 1.0
    while not all(_free(hand, subject, amount * joint) for joint in joints):
        amount *= _SHRINK
    rotations = [facing(turn, tilt) for turn, tilt in zip(turns, tilts, strict=True)]
    return [Pose(amount * joint, *placed) for joint, *placed in zip(joints, rotations, places, strict=True)]


def facing(turn: float, tilt: Array) -> Array:
    """The rotation (3,) of a hand that is turned about the vertical, then tilted a little; radians."""
    return (Rotation.from_rotvec(tilt) * Rotation.from_rotvec([0.0, turn, 0.0])).as_rotvec()


def _inside(hand: OpenHand, subject: Subject, pose: Pose, camera: Camera) -> bool:
    places, _ = camera.project(hand.posed(subject.identity, pose)[1][list(hand.key_points)])
    size = np.array([camera.width, camera.height])
    return bool(((places > _MARGIN * size) & (places < (1.0 - _MARGIN) * size)).all())


def _free(hand: OpenHand, subject: Subject, joints: Array) -> bool:
    return penetration(hand, hand.skin(subject.identity, joints, dtype=torch.float64).numpy()).free
