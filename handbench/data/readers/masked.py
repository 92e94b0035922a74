"""Masks of pictures that come without: what the hand covers as it is tracked."""

from __future__ import annotations

from ...render.see.posedmesh import PosedMesh
from ...render.see.raster import Raster
from ...scene import Array, Camera, Mesh

_SUPERSAMPLE = 2


def covered(mesh: Mesh, camera: Camera) -> Array:
    """The alpha (H, W) of a mesh before a camera."""
    return Raster(PosedMesh(mesh), camera, _SUPERSAMPLE).alpha
