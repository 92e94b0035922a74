"""Rays against a triangle mesh: Embree, through open3d."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lean import open3d
from ...scene import Array


@dataclass(frozen=True)
class Hits:
    """First hits of N rays. Where `hit` is false the other fields are meaningless.

    distance (N,) in units of the ray's direction, face (N,) int32, barycentric (N, 3) float32 in the
    order of the face's vertices, hit (N,) bool.
    """

    distance: Array
    face: Array
    barycentric: Array
    hit: Array


class RayScene:
    """A mesh that answers ray queries: vertices (V, 3), faces (F, 3).

    Embree works in float32. So the scene lies about the middle of the mesh's box, `centre` (3,) float64, and all
    rays are moved there in float64 first: a mesh 10 km from the origin loses nothing. All of it lies
    within `radius` of the centre; `epsilon` is how far off a surface a ray must start.
    """

    def __init__(self, vertices: Array, faces: Array) -> None:
        o3d = open3d()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        vertices = np.asarray(vertices, dtype=np.float64)
        low, high = (vertices.min(axis=0), vertices.max(axis=0)) if len(vertices) else (np.zeros(3), np.zeros(3))
        self.centre: Array = (low + high) / 2
        if len(faces):  # Embree's scene of nothing is a scene without geometry
            self._scene.add_triangles(
                self._tensor.from_numpy((vertices - self.centre).astype(np.float32)),
                self._tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32)),
            )
        self.radius = float(np.linalg.norm(high - low)) / 2
        extent = float((high - low).max())
        # float32 positions carry errors of extent * 6e-8; 1e-5 clears them and is 2 micrometres on a hand
        self.epsilon = 1e-5 * extent

    def cast(self, origins: Array, directions: Array) -> Hits:
        """First hits of rays with origins and directions that broadcast to (N, 3); directions of any length."""
        answer = self._scene.cast_rays(self._tensor.from_numpy(self._rays(origins, directions)))
        distance = answer["t_hit"].numpy()
        uv = answer["primitive_uvs"].numpy()
        barycentric = np.empty((len(uv), 3), dtype=uv.dtype)
        barycentric[:, 1:] = uv
        barycentric[:, 0] = 1.0 - (uv[:, 0] + uv[:, 1])  # a sum along rows of two is ten times slower
        face = answer["primitive_ids"].numpy().astype(np.int32)
        return Hits(distance, face, barycentric, np.isfinite(distance))

    def occluded(self, origins: Array, directions: Array, far: float = np.inf) -> Array:
        """Whether anything lies on a ray before `far` (in units of its direction), (N,) bool."""
        return self.blocked(self._rays(origins, directions), far)

    def blocked(self, rays: Array, far: float = np.inf) -> Array:
        """`occluded` for rays (N, 6) float32 that are packed already: origin from `centre`, direction."""
        return self._scene.test_occlusions(self._tensor.from_numpy(rays), tfar=far).numpy()

    def distances(self, rays: Array) -> Array:
        """Distance (N,) float32 of the first hits of packed rays, in units of their directions; inf without a hit."""
        return self._scene.cast_rays(self._tensor.from_numpy(rays))["t_hit"].numpy()

    def _rays(self, origins: Array, directions: Array) -> Array:
        count = max(len(origins), len(directions)) if len(origins) and len(directions) else 0
        rays = np.empty((count, 6), dtype=np.float32)
        if count:
            rays[:, :3] = origins - self.centre
            rays[:, 3:] = directions
        return rays
