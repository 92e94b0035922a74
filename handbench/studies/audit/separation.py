"""What training and enrolment saw against what is scored, compared by value and apart from `protocol.resolve`.

`resolve` compares names of poses and rounded directions of lights. Here poses are compared by their joints and lights
one by one: directions by angle, points by distance, environments by their radiance, whatever they are called.
"""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import assert_never

import numpy as np

from ...bench.protocol import Selection
from ...scene import Directional, Environment, Frame, Light, Point, Single, Unknown, leaves, needed
from .evidence import Evidence
from .records import verdict_on

_ANGLE = 1e-3  # radians between directions that count as one light
_NEAR = 1e-4  # metres between point lights, and radians between joints, that count as one
_ALIKE = 1e-3  # relative difference of environments that count as one, whatever their brightness


def apart(evidence: Evidence) -> tuple[bool, str]:
    """No subject, pose or light of a scored frame was seen before, unless its column says so in `shares`."""
    protocol, every = evidence.protocol, tuple(evidence.frames.values())
    counted = {frame.key for frame in evidence.selected.enrol}  # raises what `resolve` finds
    train = [f for f in every if f.subject in protocol.trained and _picked(protocol.train, f)]
    enrol = [f for f in every if f.subject in protocol.subjects and _picked(protocol.enrol.frames, f)]
    if protocol.enrol.count is not None:
        enrol = [frame for frame in enrol if frame.key in counted]
    trouble, shared = [], []
    for column in evidence.plan.protocol.columns:
        scored = [evidence.frames[key] for key in column.queries]
        common = {
            "subject": {f.subject for f in scored} & {f.subject for f in train},
            "pose": set(_common_poses(scored, train)),
            "light": set(_common_lights(scored, [*train, *enrol])),
        }
        for axis, names in common.items():
            if names and axis not in column.shares:
                trouble.append(f"{column.name} scores a {axis} that training saw ({', '.join(sorted(names)[:2])})")
        seen = {f.key for f in scored} & {f.key for f in (*train, *enrol)}
        if seen and set(common) - set(column.shares):
            trouble.append(f"{column.name} scores {sorted(seen)[0]}, which was seen before")
        stated = [axis for axis in common if axis in column.shares]
        shared.append(f"{column.name} shares {' and '.join(stated) or 'nothing'}")
    return verdict_on(trouble, "as stated: " + "; ".join(shared))


def _picked(selection: Selection, frame: Frame) -> bool:
    asked = (
        (frame.segment, selection.segments),
        (frame.kind, selection.kinds),
        (frame.lighting, selection.lightings),
        (frame.pose_name, selection.poses),
        (frame.camera.name, selection.cameras),
    )
    return all(any(fnmatchcase(value, glob) for glob in globs) for value, globs in asked)


def _common_poses(scored: Iterable[Frame], seen: Iterable[Frame]) -> list[str]:
    """Scored poses whose joints, or mesh, are those of a seen pose of the same subject."""
    before = {frame.pose_key: frame for frame in seen}
    found = []
    for key, frame in {frame.pose_key: frame for frame in scored}.items():
        for other in before.values():
            if frame.subject == other.subject and (_same_joints(frame, other) or _same_mesh(frame, other)):
                found.append(key)
                break
    return found


def _same_joints(one: Frame, other: Frame) -> bool:
    a, b = needed(one.pose, "pose").joints, needed(other.pose, "pose").joints
    return a.shape == b.shape and float(np.abs(a - b).max()) < _NEAR


def _same_mesh(one: Frame, other: Frame) -> bool:
    return np.array_equal(needed(one.mesh, "mesh").vertices, needed(other.mesh, "mesh").vertices)


def _common_lights(scored: Iterable[Frame], seen: Iterable[Frame]) -> list[str]:
    """Scored lightings with a single light that a seen lighting has too."""
    before = _singles(seen)
    return [
        name for name, lights in _by_name(scored).items() if any(_is_among(light, before) for light in _each(lights))
    ]


def _by_name(frames: Iterable[Frame]) -> dict[str, list[Light]]:
    """The different lights by the lighting they are called; frames share them by the thousand."""
    lights: dict[str, dict[int, Light]] = {}
    for frame in frames:
        lights.setdefault(frame.lighting, {})[id(frame.light)] = frame.light
    return {name: list(found.values()) for name, found in lights.items()}


def _each(lights: Iterable[Light]) -> list[Single]:
    return [single for light in lights for single in leaves(light)]


def _singles(frames: Iterable[Frame]) -> list[Single]:
    return _each({id(frame.light): frame.light for frame in frames}.values())


def _is_among(light: Single, others: Iterable[Single]) -> bool:
    return any(_same_single(light, other) for other in others)


def _same_single(one: Single, other: Single) -> bool:
    match one:
        case Directional():
            return isinstance(other, Directional) and _same_direction(one, other)
        case Point():
            return isinstance(other, Point) and _same_place(one, other)
        case Environment():
            return isinstance(other, Environment) and _same_radiance(one, other)
        case Unknown():
            return isinstance(other, Unknown) and one.name == other.name
        case _:
            assert_never(one)


def _same_direction(one: Directional, other: Directional) -> bool:
    return float(np.linalg.norm(one.direction - other.direction)) < _ANGLE


def _same_place(one: Point, other: Point) -> bool:
    return float(np.linalg.norm(one.position - other.position)) < _NEAR


def _same_radiance(one: Environment, other: Environment) -> bool:
    """Equal up to brightness; maps of different sizes are told apart by their names."""
    a, b = one.radiance, other.radiance
    if a.shape != b.shape or not a.any() or not b.any():
        return one.name == other.name
    return float(np.abs(a / a.mean() - b / b.mean()).mean()) < _ALIKE
