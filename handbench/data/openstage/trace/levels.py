"""Fewer points that stand for a surface's vertices: what changes slowly over it is worked out there.

Vertices of one cell of space that face alike form a cluster, so the two sides of a thin gap never share one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, dia_array
from scipy.spatial import cKDTree

from ....render.uv.surface import unit_rows
from ....scene import Array

_NEAR = 8


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a surface: positions, unit normals (N, 3), areas (N,) in square metres, mean spacing in metres."""

    positions: Array
    normals: Array
    areas: Array

    @property
    def spacing(self) -> float:
        return float(np.sqrt(self.areas.sum() / max(len(self.areas), 1)))


@dataclass(frozen=True, eq=False)
class Level:
    """M clusters of V vertices: their points, the vertex (M,) in the middle of each, and the ways between.

    gather (M, V) means over the vertices of clusters; spread (V, M) interpolates between clusters.
    """

    points: Points
    middle: Array
    gather: csr_array
    spread: csr_array


def vertex_points(vertices: Array, normals: Array, faces: Array) -> Points:
    """The vertices as points; each owns a third of the faces around it."""
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    shares = np.bincount(faces.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))
    return Points(np.asarray(vertices, np.float64), normals, shares)


def level(points: Points, spacing: float) -> Level:
    """Clusters about `spacing` metres apart; the points themselves for a spacing of 0."""
    count = len(points.areas)
    if spacing == 0:
        every = dia_array((np.ones((1, count), np.float32), [0]), shape=(count, count)).tocsr()
        return Level(points, np.arange(count), every, every)
    cell = np.floor((points.positions - points.positions.min(axis=0)) / (1.1 * spacing)).astype(np.int64)
    axis = np.abs(points.normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(points.normals, axis[:, None], axis=1)[:, 0] > 0)
    size = cell.max(axis=0) + 1
    key = ((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]) * 6 + side
    _, cluster = np.unique(key, return_inverse=True)
    clusters = int(cluster.max()) + 1
    weights = np.maximum(points.areas, 1e-12 * points.areas.max())
    areas = np.bincount(cluster, weights, minlength=clusters)
    share = (weights / areas[cluster]).astype(np.float32)
    order = np.argsort(cluster, kind="stable").astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(np.bincount(cluster, minlength=clusters))]).astype(np.int32)
    gather = csr_array((share[order], order, starts), shape=(clusters, count))
    middle = Points(gather @ points.positions, unit_rows(gather @ points.normals), areas)
    off = np.linalg.norm(points.positions - middle.positions[cluster], axis=1)
    nearest = np.lexsort((off, cluster))[starts[:-1]]
    return Level(middle, nearest, gather, _spread(points, middle, cluster))


def _spread(points: Points, clusters: Points, own: Array) -> csr_array:
    """Smooth weights (V, M) of the clusters near each point that face its way."""
    near = min(_NEAR, len(clusters.areas))
    distance, index = cKDTree(clusters.positions).query(points.positions, k=near)
    distance, index = distance.reshape(-1, near), index.reshape(-1, near)
    alike = np.maximum(np.einsum("vc,vkc->vk", points.normals, clusters.normals[index]), 0) ** 2
    weights = np.exp(-((distance / (0.7 * clusters.spacing)) ** 2)) * alike
    lost = weights.sum(axis=1) < 1e-6
    index[lost, 0], weights[lost] = own[lost], 0
    weights[lost, 0] = 1
    weights /= weights.sum(axis=1, keepdims=True)
    starts = np.arange(0, weights.size + 1, near, dtype=np.int32)
    return csr_array(
        (weights.ravel().astype(np.float32), index.ravel().astype(np.int32), starts),
        shape=(len(index), len(clusters.areas)),
    )
