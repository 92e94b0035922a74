"""Errors of tracked geometry, in millimetres."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..scene import Array, Mesh

_MM = 1000.0


def surface_distances(mesh: Mesh, points: Array) -> Array:
    """Distance (N,) of each point (N, 3) of a scan from the nearest point of the mesh."""
    import open3d as o3d

    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(f"surface_distances: points have shape {points.shape}, expected (n, 3) with n > 0")
    scene = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    middle = mesh.vertices.mean(axis=0)  # Embree works in float32
    scene.add_triangles(
        tensor((mesh.vertices - middle).astype(np.float32)), tensor(mesh.topology.faces.astype(np.uint32))
    )
    return _MM * scene.compute_distance(tensor((points - middle).astype(np.float32))).numpy().astype(np.float64)


def surface_errors(mesh: Mesh, points: Array) -> dict[str, float]:
    """Mean and 95th percentile of `surface_distances`."""
    distances = surface_distances(mesh, points)
    return {"surface_mean": float(distances.mean()), "surface_p95": float(np.percentile(distances, 95))}


def point_error(found: Array, true: Array) -> float:
    """Mean distance of corresponding points (N, 3): joints or vertices. Raises `InputError` for unequal shapes."""
    if found.shape != true.shape:
        raise InputError(f"point_error: {found.shape} and {true.shape} do not correspond; give equal shapes")
    return float(_MM * np.linalg.norm(found - true, axis=-1).mean())
