"""A posed surface with its reflectance baked into textures, for renderers elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .arrays import Array, checked, put
from .mesh import Mesh


@dataclass(frozen=True, eq=False)
class Baked:
    """A mesh with UVs and textures of R x R, row 0 at the top (v = 1).

    albedo (R, R, 3) linear, not negative; roughness (R, R) of a GGX lobe of alpha = roughness^2 with F0 = 0.04, which
    `specular` scales; normal (R, R, 3) unit in the frame of the surface, x along u, z its normal, y = z x x; None: the
    mesh's own.
    """

    mesh: Mesh
    albedo: Array
    roughness: Array
    specular: float = 1.0
    normal: Array | None = None

    def __post_init__(self) -> None:
        put(self, "albedo", checked("baked surface", "albedo", self.albedo, (None, None, 3), np.float32))
        size = self.albedo.shape[:2]
        put(self, "roughness", checked("baked surface", "roughness", self.roughness, size, np.float32))
        if self.normal is not None:
            put(self, "normal", checked("baked surface", "normal", self.normal, (*size, 3), np.float32))
        if (self.albedo < 0).any() or not 0.0 <= self.specular < np.inf:
            raise InputError("baked surface: albedo and specular cannot be negative")
        self.mesh.topology.unwrapped  # noqa: B018  (raises without UVs)
