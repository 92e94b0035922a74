"""Pinhole cameras: OpenCV (x right, y down, z forward), K in pixels, pixel centres at +0.5."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .arrays import Array, checked, put


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera: K (3, 3) in pixels, world_to_camera (3, 4) rigid, width and height in pixels."""

    name: str
    width: int
    height: int
    K: Array
    world_to_camera: Array

    def __post_init__(self) -> None:
        owner = f"camera {self.name!r}"
        if self.width < 1 or self.height < 1:
            raise InputError(f"{owner}: size {self.width}x{self.height} must be at least 1x1")
        put(self, "K", checked(owner, "K", self.K, (3, 3), np.float64))
        put(self, "world_to_camera", checked(owner, "world_to_camera", self.world_to_camera, (3, 4), np.float64))
        if abs(np.linalg.det(self.K)) < 1e-12:
            raise InputError(f"{owner}: K has no inverse; give focal lengths in pixels")
        rotation = self.world_to_camera[:, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
            raise InputError(f"{owner}: world_to_camera is not a rigid transform; check its handedness and scale")

    @property
    def centre(self) -> Array:
        """Position of the camera in the world, (3,) metres."""
        return -self.world_to_camera[:, :3].T @ self.world_to_camera[:, 3]
