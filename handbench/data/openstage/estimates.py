"""What methods are told of a hand instead of the truth: shapes, poses and key points with the errors of real trackers.

Errors of a sequence are correlated in time (an AR(1) process): a tracker that is off stays off for a while.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...hand.openhand import Identity, OpenHand
from ...hand.openhand.model import NAMED_SPREAD
from ...scene import Array, Camera, Pose


@dataclass(frozen=True)
class TrackerNoise:
    """Standard deviations of a tracker's errors, each of a single angle or coordinate.

    joints, rotation    degrees of each angle of a joint, and of each axis of the hand's rotation
    across, along       metres across a camera's line of sight, and along it
    memory              correlation of errors of neighbouring moments
    """

    joints: float
    rotation: float
    across: float
    along: float
    memory: float = 0.0


SCANNER = TrackerNoise(joints=0.8, rotation=0.4, across=0.5e-3, along=0.5e-3)
"""Many calibrated cameras round the hand."""
ONE_CAMERA = TrackerNoise(joints=1.3, rotation=1.2, across=1.5e-3, along=3.5e-3, memory=0.9)
"""One camera without depth, which tells least along its line of sight."""
PHONE = TrackerNoise(joints=1.3, rotation=1.0, across=1e-3, along=2e-3, memory=0.9)
"""One camera with depth."""

_BLEND, _LENGTH, _WIDTH = 0.4, 0.02, 0.03  # of a shape: its coefficients over their spread, and factors of bones
_PIXELS = (1.0, 2.0)  # error of key points in a picture of 256 rows, least and greatest
_OUTLIERS, _ASTRAY = 0.03, 25.0  # share of key points that are not where they are told, and how far, same pixels
_ROWS = 256.0


def estimated_shape(hand: OpenHand, identity: Identity, rng: np.random.Generator) -> Array:
    """The shape (S,) that a fit to pictures would find."""
    spread = np.array([NAMED_SPREAD.get(name, 1.0) for name in hand.shape_names])
    blend = identity.blend + _BLEND * spread * rng.normal(size=identity.blend.shape)
    factors = [
        values * np.exp(size * rng.normal(size=values.shape))
        for values, size in ((identity.bone_length, _LENGTH), (identity.bone_width, _WIDTH))
    ]
    return np.asarray(Identity(blend, *factors))


def estimated_poses(
    hand: OpenHand, poses: list[Pose], tracker: TrackerNoise, camera: Camera, rng: np.random.Generator
) -> list[Pose]:
    """The poses that a tracker would tell, in the order of time; joints stay within their limits."""
    low, high = hand.limits[..., 0], hand.limits[..., 1]
    joints = np.radians(tracker.joints) * _walk(rng, len(poses), low.shape, tracker.memory) * (high > low)
    turns = np.radians(tracker.rotation) * _walk(rng, len(poses), (3,), tracker.memory)
    steps = np.array([tracker.across, tracker.across, tracker.along])
    steps = (steps * _walk(rng, len(poses), (3,), tracker.memory)) @ camera.rotation
    return [
        Pose(
            np.clip(pose.joints + joints[i], np.minimum(low, pose.joints), np.maximum(high, pose.joints)),
            (Rotation.from_rotvec(turns[i]) * Rotation.from_rotvec(pose.rotation.copy())).as_rotvec(),
            pose.translation + steps[i],
        )
        for i, pose in enumerate(poses)
    ]


def keypoints(hand: OpenHand, identity: Identity, pose: Pose, camera: Camera, rng: np.random.Generator) -> Array:
    """What a detector sees of a hand: (21, 3) of x and y in pixels, and how sure it is, 0 to 1.

    It is less sure of what it sees badly, but not always wrong where it is unsure.
    """
    _, points = hand.posed(identity, pose)
    places, _ = camera.project(points[list(hand.key_points)])
    count, scale = len(places), camera.height / _ROWS
    error = rng.uniform(*_PIXELS, count)
    astray = rng.random(count) < _OUTLIERS
    found = places + scale * error[:, None] * rng.normal(size=(count, 2))
    found[astray] += scale * _ASTRAY * rng.normal(size=(int(astray.sum()), 2))
    sure = 1.0 - 0.15 * (error - _PIXELS[0]) - 0.1 * rng.random(count)
    sure[astray] *= rng.uniform(0.3, 0.9, int(astray.sum()))
    return np.concatenate([found, np.clip(sure, 0.0, 1.0)[:, None]], axis=1)


def _walk(rng: np.random.Generator, count: int, shape: tuple[int, ...], memory: float) -> Array:
    """(count, *shape) of variance 1 whose neighbours have the correlation `memory`."""
    fresh = rng.normal(size=(count, *shape))
    for i in range(1, count):
        fresh[i] = memory * fresh[i - 1] + np.sqrt(1.0 - memory**2) * fresh[i]
    return fresh
