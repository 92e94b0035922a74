"""Hard shadows: which lights each texel sees."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..scene import Array, Mesh
from .atlas import Atlas
from .rays import RayScene
from .surface import face_normals, mesh_normals

HORIZON = 0.1
"""Pairs with n.ω below minus this are not traced: normals refined by millimetre displacements tilt a little."""

_RAYS = 1 << 19
"""Rays traced at once: 12 MB."""


def visibility(
    mesh: Mesh, atlas: Atlas, directions: Array, positions: Array | None = None, horizon: float = HORIZON
) -> Array:
    """Whether covered texels see distant lights (L, 3) and near ones at positions (P, 3): bool (L + P, N).

    `directions` are unit vectors to the distant lights. Pairs more than `horizon` (a sine) below the horizon of the
    smooth normal are not traced and count as unseen.
    """
    origins, normals = _shadow_origins(mesh, atlas)
    scene = RayScene.of(mesh)
    near = np.zeros((0, 3)) if positions is None else np.asarray(positions, dtype=np.float32)
    seen = np.zeros((len(directions) + len(near), atlas.count), dtype=bool)
    step = max(1, _RAYS // atlas.count)
    for start in range(0, len(directions), step):
        some = np.asarray(directions[start : start + step], dtype=np.float32)
        facing = some @ normals.T > -horizon
        unblocked = ~scene.blocked(_shadow_rays(origins, some, facing))
        seen[start : start + len(some)][facing] = unblocked
    for row, position in enumerate(near, start=len(directions)):
        towards = position - origins
        facing = np.einsum("nc,nc->n", towards, normals) > -horizon * np.linalg.norm(towards, axis=1)
        # rays run from the texel (0) to the light (1)
        seen[row, facing] = ~scene.occluded(origins[facing], towards[facing], far=1.0)
    return seen


def _shadow_rays(origins: Array, directions: Array, facing: Array) -> Array:
    """Rays (M, 6) from origins (N, 3) along directions (L, 3) for the M true pairs of facing (L, N), in its order."""
    padded = np.concatenate([origins, np.zeros_like(origins)], axis=1)
    rays = np.empty((np.count_nonzero(facing), 6), dtype=np.float32)
    end = 0
    for direction, row in zip(directions, facing, strict=True):
        texels = np.flatnonzero(row)
        start, end = end, end + len(texels)
        # take() into place is four times faster than indexing, which would copy twice
        np.take(padded, texels, axis=0, out=rays[start:end], mode="clip")
        rays[start:end, 3:] = direction
    return rays


@lru_cache(maxsize=4)
def _shadow_origins(mesh: Mesh, atlas: Atlas) -> tuple[Array, Array]:
    """Where shadow rays start, and the smooth normals there, both (N, 3) float32.

    A point on a flat triangle is hidden by its neighbours from lights that the smooth surface sees, which
    draws the triangles along the terminator. So a start is lifted to the planes tangent at the triangle's
    vertices (Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II, ch. 4), then off the triangle
    by the scene's epsilon.
    """
    vertices, faces = mesh.vertices, mesh.topology.faces
    corners = faces[atlas.face]
    vertex_normal = mesh_normals(mesh)[corners]
    point = atlas.interpolate(vertices)
    height = np.einsum("nkc,nkc->nk", point[:, None] - vertices[corners], vertex_normal)
    lift = -np.minimum(height, 0.0) * atlas.barycentric
    smooth = np.einsum("nk,nkc->nc", atlas.barycentric, vertex_normal)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
    start = point + np.einsum("nk,nkc->nc", lift, vertex_normal)
    start += RayScene.of(mesh).epsilon * face_normals(vertices, faces)[atlas.face]
    return start.astype(np.float32), smooth.astype(np.float32)
