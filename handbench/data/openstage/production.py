"""What a capture consists of, decided before the first ray: people, poses, cameras, lights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from ...hand.openhand import OpenHand
from ...scene import Array, Camera, FrameKind, Light, Mesh, Pose
from .cast import Subject
from .presets import Preset

MeshKind = Literal["tracked", "scan"]
"""Meshes that are kept of every pose: coarse ones as a tracker finds them, or fine ones as a scanner does."""


@dataclass(frozen=True, eq=False)
class Lighting:
    """One way to light a hand. `weights` (lights,) over the capture's single lights gives its picture exactly.

    None for a light that is no sum of single lights.
    """

    name: str
    kind: FrameKind
    light: Light
    weights: Array | None = None

    @property
    def traced(self) -> bool:
        """Whether its pictures are rendered; the others are sums."""
        return self.weights is None or self.kind == "olat"


class Sensor(Protocol):
    """What takes pictures less well than they are rendered; a frozen dataclass of numbers."""

    def take(
        self, image: Array, alpha: Array, depth: Array, normal: Array, camera: Camera, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """The picture, the mask and the depth that it tells of the true picture, alpha, depth and normals."""


@dataclass(frozen=True, eq=False)
class Shot:
    """Frames of one pose that belong to one segment: before each of some cameras, under each of some lightings.

    estimated   frames tell the pose's estimate, else the truth
    keypoints   what a detector sees in a camera's pictures, (21, 3), by the camera's name
    device      what took the pictures; None keeps them as they are rendered
    """

    segment: str
    cameras: tuple[Camera, ...]
    lightings: tuple[Lighting, ...]
    estimated: bool = False
    keypoints: Mapping[str, Array] = field(default_factory=dict)
    device: Sensor | None = None


@dataclass(frozen=True, eq=False)
class RenderTask:
    """A pose before one camera and all that is rendered of it there, in one go."""

    camera: Camera
    lightings: tuple[Lighting, ...]
    device: Sensor | None = None


@dataclass(frozen=True, eq=False)
class Performance:
    """A pose of a subject and the shots that are taken of it: what one process makes, since its views share work.

    `moment` is its place in a sequence, None without one; `estimate` is what frames tell of the pose where that is not
    the truth. `mesh` is kept of it, if the capture keeps meshes.
    """

    subject: Subject
    name: str
    pose: Pose
    shots: tuple[Shot, ...]
    moment: int | None = None
    estimate: Pose | None = None

    @property
    def key(self) -> str:
        return f"{self.subject.name}/{self.name}"

    @property
    def views(self) -> tuple[RenderTask, ...]:
        """Every camera of its shots once, with the lightings that are traced there."""
        views: dict[str, RenderTask] = {}
        for shot in self.shots:
            lit = tuple(lighting for lighting in shot.lightings if lighting.traced)
            for camera in shot.cameras:
                before = views[camera.name].lightings if camera.name in views else ()
                views[camera.name] = RenderTask(camera, (*before, *lit), shot.device)
        return tuple(views.values())


@dataclass(frozen=True, eq=False)
class Production:
    """A whole capture, planned. Performances of a subject follow one another, so that its skin is made once.

    meshes, mesh_level  what meshes are kept of every pose, and their level of subdivision
    estimates           by subject's name the shape that frames tell, where that is not the truth
    """

    preset: Preset
    hand: OpenHand
    cameras: tuple[Camera, ...]
    lightings: tuple[Lighting, ...]
    performances: tuple[Performance, ...]
    meshes: MeshKind | None = None
    mesh_level: int = 1
    estimates: Mapping[str, Array] = field(default_factory=dict)

    @property
    def by_subject(self) -> list[tuple[Performance, ...]]:
        """Performances that share a subject, together, in order."""
        groups: dict[str, list[Performance]] = {}
        for performance in self.performances:
            groups.setdefault(performance.subject.name, []).append(performance)
        return [tuple(group) for group in groups.values()]

    def surface(self, performance: Performance) -> Mesh:
        """The true surface of a pose without its relief, at the level that is traced."""
        return self.hand.mesh(performance.subject.identity, performance.pose, self.preset.truth_level)
