"""Scans of many people, for priors: a few poses in one studio, many cameras, and the surface as a scanner finds it."""

from __future__ import annotations

import numpy as np

from ...hand.openhand import OpenHand
from ...scene import Camera
from .cast import Subject, pose
from .estimates import SCANNER, estimated_poses, estimated_shape
from .population import cast
from .presets import ScansPreset
from .production import Lighting, Performance, Production, Shot
from .rooms import studio
from .stage import cameras


def production(preset: ScansPreset) -> Production:
    """Every subject in the neutral pose and in poses of its own. Poses and shapes are told with a scanner's errors."""
    hand = OpenHand.load()
    seen = cameras(preset, preset.cameras)
    light = Lighting("studio", "environment", studio(preset.environment_height))
    people = cast("openscans", preset.subjects, hand)
    performances = [p for subject in people for p in _performances(hand, subject, preset.poses, seen, light)]
    shapes = {p.name: estimated_shape(hand, p.identity, np.random.default_rng([611, p.look.seed])) for p in people}
    return Production(preset, hand, seen, (light,), tuple(performances), "scan", preset.scan_level, shapes)


def _performances(
    hand: OpenHand, subject: Subject, count: int, seen: tuple[Camera, ...], light: Lighting
) -> list[Performance]:
    rng = np.random.default_rng([612, subject.look.seed])
    poses = [pose(hand, subject, k) for k in range(count)]
    shots = (Shot("scan", seen, (light,), estimated=True),)
    told = estimated_poses(hand, poses, SCANNER, seen[0], rng)
    return [
        Performance(subject, f"pose-{k}", true, shots, estimate=estimate)
        for k, (true, estimate) in enumerate(zip(poses, told, strict=True))
    ]
