"""Rays against a triangle mesh: Embree, through open3d."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..scene import Array, Mesh


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
    """A mesh that answers ray queries: vertices (V, 3), faces (F, 3)."""

    def __init__(self, vertices: Array, faces: Array) -> None:
        import open3d.core
        from open3d.t.geometry import RaycastingScene

        self._tensor = open3d.core.Tensor
        self._scene = RaycastingScene()
        vertices = np.ascontiguousarray(vertices, dtype=np.float32)
        if len(faces):  # Embree's scene of nothing is a scene without geometry
            self._scene.add_triangles(
                self._tensor.from_numpy(vertices), self._tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32))
            )
        extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
        # float32 positions carry errors of extent * 6e-8; 1e-5 clears them and is 2 micrometres on a hand
        self.epsilon = 1e-5 * extent

    @staticmethod
    def of(mesh: Mesh) -> RayScene:
        """The scene of a mesh; the last few are kept."""
        return _scene_of(mesh)

    def cast(self, origins: Array, directions: Array) -> Hits:
        """First hits of rays with origins and directions that broadcast to (N, 3); directions of any length."""
        answer = self._scene.cast_rays(self._tensor.from_numpy(_rays(origins, directions)))
        distance = answer["t_hit"].numpy()
        uv = answer["primitive_uvs"].numpy()
        barycentric = np.concatenate([1.0 - uv.sum(axis=1, keepdims=True), uv], axis=1)
        face = answer["primitive_ids"].numpy().astype(np.int32)
        return Hits(distance, face, barycentric, np.isfinite(distance))

    def occluded(self, origins: Array, directions: Array, far: float = np.inf) -> Array:
        """Whether anything lies on a ray before `far` (in units of its direction), (N,) bool."""
        return self.blocked(_rays(origins, directions), far)

    def blocked(self, rays: Array, far: float = np.inf) -> Array:
        """`occluded` for rays (N, 6) float32 that are packed already: origin, direction."""
        return self._scene.test_occlusions(self._tensor.from_numpy(rays), tfar=far).numpy()


def _rays(origins: Array, directions: Array) -> Array:
    count = max(len(origins), len(directions))
    rays = np.empty((count, 6), dtype=np.float32)
    rays[:, :3] = origins
    rays[:, 3:] = directions
    return rays


@lru_cache(maxsize=4)
def _scene_of(mesh: Mesh) -> RayScene:
    return RayScene(mesh.vertices, mesh.topology.faces)
