"""What is drawn: the shipped hand in a natural pose, a camera, a constant reflectance and a real HDR environment.

The environment's texels are constant patches of sky, given so to every competitor. Constant reflectance leaves
only what is measured here, the integral of light: a texture's own resolution would add another error.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ...hand import hand_model
from ...light.skybox import skybox
from ...scene import Array, Camera, Environment, Mesh

LEVEL = 1
"""Subdivision of the hand: 13,984 triangles, as the tracked meshes of captures have."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A hand, a camera and an environment; albedo (3,) and, for the BRDF, one roughness (None: Lambert only)."""

    name: str
    title: str
    mesh: Mesh
    camera: Camera
    environment: Environment
    albedo: Array
    roughness: float | None = None

    @property
    def digest(self) -> str:
        """Of everything that decides the picture."""
        h = hashlib.sha256(f"{self.roughness} {self.camera.width} {self.camera.height}".encode())
        topology = self.mesh.topology
        for array in (
            self.mesh.vertices,
            topology.faces,
            *topology.unwrapped,
            self.camera.K,
            self.camera.world_to_camera,
            self.environment.radiance,
            self.albedo,
        ):
            h.update(f"{array.shape}{array.dtype}".encode() + np.ascontiguousarray(array).tobytes())
        return h.hexdigest()[:24]


def scenes(quick: bool = False) -> tuple[Scene, ...]:
    """Lambert under a sunny and an indoor 16 x 32 map, the BRDF under the indoor one, Lambert under a 32 x 64 map.

    `quick`: the first alone.
    """
    hand, camera, albedo = natural_hand(), palmar_camera(), np.array([0.65, 0.45, 0.35])
    sun, hall = skybox("brightday", 16, 32), skybox("hall", 16, 32)
    first = Scene("lambert-sun", "Lambert, sunny 16 × 32 map", hand, camera, sun, albedo)
    if quick:
        return (first,)
    return (
        first,
        replace(first, name="lambert-hall", title="Lambert, indoor 16 × 32 map", environment=hall),
        replace(first, name="brdf-hall", title="BRDF, indoor 16 × 32 map", environment=hall, roughness=0.45),
        replace(
            first, name="lambert-fine", title="Lambert, sunny 32 × 64 map", environment=skybox("brightday", 32, 64)
        ),
    )


@cache
def natural_hand(level: int = LEVEL) -> Mesh:
    """The mean adult's hand, slightly bent, so that fingers cast shadows on each other and on the palm."""
    hand = hand_model()
    return hand.mesh(hand.neutral(), hand.sample_pose(np.random.default_rng(3), 0.8), level)


def palmar_camera(width: int = 192, height: int = 256) -> Camera:
    """A camera 1 m in front of the palm that frames the hand."""
    focal = height / 0.31
    K = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    turn = np.diag([1.0, -1.0, -1.0])  # looks along -z, +y up in the picture
    eye = np.array([0.0, 0.07, 1.0])
    return Camera("palmar", width, height, K, np.concatenate([turn, -(turn @ eye)[:, None]], axis=1))


def moved(mesh: Mesh, step: int) -> Mesh:
    """The mesh as a pose nobody has seen: `step` tenths of a micrometre aside, so nothing that was kept for it fits."""
    return Mesh(mesh.vertices + np.array([1e-7 * step, 0.0, 0.0]), mesh.topology)
