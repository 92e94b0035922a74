"""What the parsers share: polygons into triangles, and repeated vertices into one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import InputError
from ...scene import Array, Mesh, Topology


def triangles(polygons: Sequence[Sequence[int]]) -> Array:
    """Polygons, each three corners or more, as fans of triangles (F, 3)."""
    if {*map(len, polygons)} <= {3}:
        return np.array(polygons, dtype=np.int64).reshape(-1, 3)
    return np.array(
        [(polygon[0], polygon[k], polygon[k + 1]) for polygon in polygons for k in range(1, len(polygon) - 1)],
        dtype=np.int64,
    ).reshape(-1, 3)


def surface(vertices: Array, faces: Array, uvs: Array | None, uv_faces: Array | None) -> Mesh:
    """A checked mesh. Raises `InputError` for one without faces or whose faces point outside its vertices."""
    if not len(faces):
        raise InputError("it has no faces; export a surface, not points")
    for name, corners, count in (("faces", faces, len(vertices)), ("UVs", uv_faces, 0 if uvs is None else len(uvs))):
        if corners is not None and (corners.min() < 0 or corners.max() >= count):
            raise InputError(f"its {name} point outside the {count} that it holds; it is damaged, export it anew")
    return Mesh(vertices, Topology(faces, uvs, uv_faces))


def welded(vertices: Array, faces: Array, uvs: Array | None) -> Mesh:
    """A mesh from vertices that are repeated wherever UVs (V, 2) have a seam: those of equal position become one."""
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InputError(f"its faces point outside the {len(vertices)} vertices; it is damaged, export it anew")
    _, first, place = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # keep the file's order
    rank = np.empty(len(first), np.int64)
    rank[order] = np.arange(len(first))
    return surface(vertices[first[order]], rank[place.ravel()][faces], uvs, None if uvs is None else faces)
