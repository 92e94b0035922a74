"""Catmull–Clark subdivision of a closed quad mesh as a sparse matrix (Catmull and Clark, 1978)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Step:
    """One step: matrix (V', V) takes coarse to fine vertices; quads (4 Q, 4) are the fine faces.

    Fine vertices are the coarse ones, then one a face, then one an edge. Corner k of coarse face f becomes fine
    face 4 f + k, which starts at that corner, so faces of two meshes with equal coarse order stay in step.
    """

    matrix: sp.csr_array
    quads: NDArray[Any]


def _split(quads: NDArray[Any], count: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Fine quads, the coarse edges (E, 2), and for each face its four edges, edge k from corner k to k + 1."""
    faces = len(quads)
    both = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], -1), -1).reshape(-1, 2)
    edges, inverse = np.unique(both, axis=0, return_inverse=True)
    face_edges = inverse.reshape(faces, 4)
    on_edge = count + faces + face_edges
    centre = np.broadcast_to(count + np.arange(faces)[:, None], (faces, 4))
    fine = np.stack([quads, on_edge, centre, np.roll(on_edge, 1, axis=1)], -1).reshape(-1, 4)
    return fine, edges, face_edges


def _incidence(rows: NDArray[Any], columns: NDArray[Any], shape: tuple[int, int]) -> sp.csr_array:
    values = np.ones(rows.size)
    return sp.csr_array((values, (rows.ravel(), columns.ravel())), shape=shape)


def catmull_clark(quads: NDArray[Any], count: int) -> Step:
    """Smooth subdivision of a closed mesh of `count` vertices and quads (Q, 4)."""
    fine, edges, face_edges = _split(quads, count)
    face_of = np.broadcast_to(np.arange(len(quads))[:, None], quads.shape)
    face_points = _incidence(face_of, quads, (len(quads), count)) / 4
    edge_ends = _incidence(np.broadcast_to(np.arange(len(edges))[:, None], edges.shape), edges, (len(edges), count))
    edge_faces = _incidence(face_edges, face_of, (len(edges), len(quads)))
    edge_points = (edge_ends + edge_faces @ face_points) / 4
    vertex_faces = _incidence(quads, face_of, (count, len(quads)))
    valence = vertex_faces.sum(axis=1)
    # (F + 2 R + (n - 3) P) / n with F the mean of face points and R the mean of edge midpoints
    inverse = sp.diags_array(1 / valence)
    mean_faces = inverse @ vertex_faces @ face_points
    mean_middles = inverse @ (edge_ends.T @ (edge_ends / 2))
    vertex_points = inverse @ (mean_faces + 2 * mean_middles + sp.diags_array(valence - 3.0))
    return Step(sp.csr_array(sp.vstack([vertex_points, face_points, edge_points])), fine)


def linear_step(quads: NDArray[Any], count: int) -> Step:
    """Subdivision that moves nothing, for UVs: new points are the means of their corners; borders are allowed."""
    fine, edges, _ = _split(quads, count)
    face_of = np.broadcast_to(np.arange(len(quads))[:, None], quads.shape)
    face_points = _incidence(face_of, quads, (len(quads), count)) / 4
    edge_of = np.broadcast_to(np.arange(len(edges))[:, None], edges.shape)
    edge_points = _incidence(edge_of, edges, (len(edges), count)) / 2
    return Step(sp.csr_array(sp.vstack([sp.eye_array(count), face_points, edge_points])), fine)


def triangles(quads: NDArray[Any]) -> NDArray[Any]:
    """(2 Q, 3): every quad cut along its first diagonal; triangles 2 q and 2 q + 1 come from quad q."""
    return np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], 1).reshape(-1, 3)
