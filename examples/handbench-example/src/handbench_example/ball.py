"""A capture: balls with a painted pattern, Lambertian, drawn in closed form, so that nothing needs to be stored."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from handbench.data.capture import Capture
from handbench.errors import unknown_name
from handbench.light.lightset import light_samples
from handbench.method import Progress, silent
from handbench.scene import Array, Camera, Directional, Frame, Group, Light, Mesh, Observation, Pose, Topology

RADIUS, DISTANCE, SIZE, RINGS, SLICES = 0.05, 0.4, 48, 24, 48
PAINT = {"red": (0.6, 0.15, 0.1), "blue": (0.1, 0.2, 0.6)}
PLACES = {"pose-0": ("train", 0.0), "pose-1": ("held-out", 0.01)}  # how far the ball is moved along x, in metres
OLATS = [Directional(np.array(d) / np.linalg.norm(d), np.full(3, 2.0)) for d in product((-1, 1), (-1, 0, 1), (1,))]
LIGHTS: dict[str, tuple[str, Light]] = {
    **{f"olat-{i}": ("olat", light) for i, light in enumerate(OLATS)},
    "full": ("full", Group(tuple(light.scaled(0.3) for light in OLATS[:4]))),  # the others are kept for scoring
}


def _topology() -> tuple[Array, Topology]:
    """Unit vertices (V, 3) of a sphere of rings and slices, and what connects them; UVs are unrolled longitudes."""
    v, u = np.meshgrid(np.linspace(0, 1, RINGS + 1), np.linspace(0, 1, SLICES + 1), indexing="ij")
    theta, phi = np.pi * v.ravel(), 2 * np.pi * u.ravel()
    unit = np.stack([np.sin(theta) * np.sin(phi), -np.cos(theta), np.sin(theta) * np.cos(phi)], axis=1)
    corner = np.arange(len(unit)).reshape(RINGS + 1, SLICES + 1)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    upper, lower = np.stack([a, b, c], -1)[1:], np.stack([a, c, d], -1)[:-1]  # a pole has one triangle a slice
    faces = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return unit, Topology(faces, np.stack([u.ravel(), v.ravel()], axis=1), faces)


def _camera(name: str, angle: float) -> Camera:
    """A camera at an angle about +y that looks at the origin."""
    backward = np.array([np.sin(angle), 0.0, np.cos(angle)])
    rotation = np.stack([np.cross([0.0, 1.0, 0.0], backward), [0.0, -1.0, 0.0], -backward])
    focal = 0.35 * SIZE * DISTANCE / RADIUS
    K = np.array([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]])
    return Camera(name, SIZE, SIZE, K, np.column_stack([rotation, [0.0, 0.0, DISTANCE]]))


class BallCapture(Capture):
    name = "example-ball-tiny"
    digest = "example-ball-1"  # another one whenever frames() or observe() would give something else

    def __init__(self) -> None:
        unit, topology = _topology()
        cameras = [_camera("front", 0.0), _camera("side", 1.0)]
        self._frames = tuple(
            Frame(subject, place, lighting, Pose(np.zeros((1, 3)), translation=shift), mesh, camera, light, part, kind)
            for subject, (place, (part, x)) in product(PAINT, PLACES.items())
            for shift in [np.array([x, 0.0, 0.0])]
            for mesh in [Mesh(RADIUS * unit + shift, topology)]
            for camera, (lighting, (kind, light)) in product(cameras, LIGHTS.items())
        )

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    def observe(self, frame: Frame) -> Observation:
        """Where the ray of a pixel meets the ball: colour = albedo / pi sum_i E_i max(0, n . w_i)."""
        camera, rays = frame.camera, frame.camera.rays()
        away = camera.centre - frame.pose.translation
        a, b, c = (rays**2).sum(-1), rays @ away, away @ away - RADIUS**2
        root = b**2 - a * c
        hit = root > 0
        depth = np.where(hit, (-b - np.sqrt(np.maximum(root, 0.0))) / a, 0.0)
        normal = np.where(hit[..., None], (away + depth[..., None] * rays) / RADIUS, 0.0)
        bands = 0.75 + 0.25 * np.sign(np.sin(12 * np.arctan2(normal[..., 0], normal[..., 2])))
        lights = light_samples(frame.light)
        shading = np.maximum(normal @ lights.directions.T, 0.0) @ lights.irradiance
        image = np.array(PAINT[frame.subject]) * bands[..., None] * shading / np.pi
        return Observation(image, hit, normal, depth)


def open_ball(size: str = "tiny", folder: Path | None = None, progress: Progress = silent) -> Capture:
    """The capture; there is one size."""
    if size != "tiny":
        raise unknown_name("example-ball size", size, ["tiny"])
    return BallCapture()
