"""Masks of pictures that come without: what the hand covers as it is tracked."""

from __future__ import annotations

import numpy as np

from ...render.see.posedmesh import PosedMesh
from ...render.see.raster import Raster
from ...scene import Array, Camera, Mesh, Topology

_SUPERSAMPLE = 2


def covered(mesh: Mesh, camera: Camera) -> Array:
    """The alpha (H, W) of a mesh before a camera."""
    return Raster(PosedMesh(mesh), camera, _SUPERSAMPLE).alpha


def seen_beside(mesh: Mesh, other: Mesh, camera: Camera) -> Array:
    """The alpha (H, W) of a mesh before a camera, without what another mesh hides of it."""
    count = len(mesh.topology.faces)
    faces = np.concatenate([mesh.topology.faces, other.topology.faces + len(mesh.vertices)])
    both = Mesh(np.concatenate([mesh.vertices, other.vertices]), Topology(faces))
    raster = Raster(PosedMesh(both), camera, _SUPERSAMPLE)
    alpha: Array = raster.mean((raster.face < count).astype(np.float64)[:, None])[..., 0]
    return alpha
