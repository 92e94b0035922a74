"""What capture.json says of a production."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from ...scene import Camera, Directional, Point, Pose
from .manifest import Manifest
from .presets import GENERATOR_VERSION, SCHEMA
from .production import Lighting, Performance, Production, Shot


def describe(production: Production) -> Manifest:
    """A production as plain values. A shot's cameras or lightings are None where they are all that there are."""
    preset = production.preset
    people = []
    for group in production.by_subject:
        subject = group[0].subject
        told = production.estimates.get(subject.name)
        people.append(
            {
                "name": subject.name,
                "look": asdict(subject.look),
                "shape": np.asarray(subject.identity).tolist(),
                "estimated_shape": None if told is None else told.tolist(),
                "poses": [_performance(production, performance) for performance in group],
            }
        )
    return {
        "schema": SCHEMA,
        "generator": GENERATOR_VERSION,
        "capture": preset.capture,
        "preset": asdict(preset),
        "recipe": preset.recipe,
        "joints": list(production.hand.joint_names),
        "meshes": production.meshes,
        "mesh_level": production.mesh_level,
        "cameras": [_camera(camera) for camera in production.cameras],
        "olat": [
            {"direction": lit.light.direction.tolist(), "irradiance": lit.light.irradiance.tolist()}
            for lit in production.lightings
            if isinstance(lit.light, Directional)
        ],
        "lightings": [_lighting(lighting) for lighting in production.lightings],
        "subjects": people,
    }


def _camera(camera: Camera) -> dict[str, Any]:
    size = {"width": camera.width, "height": camera.height}
    return {"name": camera.name, **size, "K": camera.K.tolist(), "world_to_camera": camera.world_to_camera.tolist()}


def _lighting(lighting: Lighting) -> dict[str, Any]:
    weights = None if lighting.weights is None else lighting.weights.tolist()
    told = {"name": lighting.name, "kind": lighting.kind, "weights": weights}
    if isinstance(lighting.light, Point):
        told["point"] = {"position": lighting.light.position.tolist(), "intensity": lighting.light.intensity.tolist()}
    return told


def _performance(production: Production, performance: Performance) -> dict[str, Any]:
    estimate = performance.estimate
    return {
        "name": performance.name,
        "moment": performance.moment,
        **_pose(performance.pose),
        "estimate": None if estimate is None else _pose(estimate),
        "shots": [_shot(production, shot) for shot in performance.shots],
    }


def _shot(production: Production, shot: Shot) -> dict[str, Any]:
    return {
        "segment": shot.segment,
        "cameras": _names(shot.cameras, production.cameras),
        "lightings": _names(shot.lightings, production.lightings),
        "estimated": shot.estimated,
        "keypoints": {name: np.round(seen, 3).tolist() for name, seen in shot.keypoints.items()},
        "device": None if shot.device is None else vars(shot.device),
    }


def _names(some: tuple[Any, ...], every: tuple[Any, ...]) -> list[str] | None:
    return None if some == every else [each.name for each in some]


def _pose(pose: Pose) -> dict[str, Any]:
    return {
        "joints": pose.joints.tolist(), "rotation": pose.rotation.tolist(), "translation": pose.translation.tolist()
    }  # fmt: skip
