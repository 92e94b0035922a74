"""What one posed mesh shares between lights, cameras and methods, computed once: maps, shadows, rasters."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from ..light.lightset import LightSet
from ..scene import Array, Camera, Mesh
from .atlas import Atlas
from .raster import Raster, rasterise
from .surface import surface_maps
from .visibility import visibility

# Bounds of what is kept: a pose's shadows of 600 lights at 128 texels are about 1 MB, a raster about 5 MB.
_POSES, _RASTERS = 64, 96


class PosedSurface:
    """A posed mesh at the covered texels of an atlas: position and unit normal (3, N), float32."""

    def __init__(self, mesh: Mesh, size: int) -> None:
        self.mesh = mesh
        self.atlas = Atlas.of(mesh.topology, size)
        maps = surface_maps(mesh, self.atlas)
        self.position: Tensor = self.atlas.gather(maps.position)
        self.normal: Tensor = self.atlas.gather(maps.normal)
        self._shadows: dict[bytes, Array] = {}  # light -> packed bits over the texels

    @staticmethod
    def of(mesh: Mesh, size: int) -> PosedSurface:
        """The surface of a mesh at R x R texels; the last few dozen are kept."""
        return _posed(mesh, size)

    def visibility(self, lights: LightSet) -> Tensor:
        """Which texels each light reaches, (L + P, N) bool: hard shadows of the mesh on itself, kept per light."""
        distant = [b"distant" + row.tobytes() for row in lights.directions]
        near = [b"near" + row.tobytes() for row in lights.positions]
        new_distant = [i for i, key in enumerate(distant) if key not in self._shadows]
        new_near = [i for i, key in enumerate(near) if key not in self._shadows]
        if new_distant or new_near:
            keys = [distant[i] for i in new_distant] + [near[i] for i in new_near]
            fresh = visibility(self.mesh, self.atlas, lights.directions[new_distant], lights.positions[new_near])
            self._shadows.update(zip(keys, np.packbits(fresh, axis=1), strict=True))
        if not len(lights):
            return torch.zeros((0, self.atlas.count), dtype=torch.bool)
        packed = np.stack([self._shadows[key] for key in distant + near])
        return torch.from_numpy(np.unpackbits(packed, axis=1, count=self.atlas.count).view(bool))


@lru_cache(_POSES)
def _posed(mesh: Mesh, size: int) -> PosedSurface:
    return PosedSurface(mesh, size)


@lru_cache(_RASTERS)
def raster(mesh: Mesh, camera: Camera) -> Raster:
    """The raster of a mesh in a camera; the last few dozen are kept."""
    return rasterise(mesh, camera)
