"""The surface of HARP in torch: a hand model subdivided and displaced along its normals, and how rough it is."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from handbench.hand import HandModel
from handbench.render.silhouette import EdgeTable
from handbench.scene import Array, Topology

from ..kit.rows import rows_of


class HandSurface:
    """The triangles of a hand model at a level: V vertices, F faces, E edges."""

    def __init__(self, hand: HandModel, level: int) -> None:
        self.hand, self.level = hand, min(level, hand.levels)
        self.topology: Topology = hand.topology(self.level)
        self.edges = EdgeTable(self.topology.faces)
        self.faces = torch.from_numpy(self.topology.faces.astype(np.int64))
        self.pairs = torch.from_numpy(self.edges.pairs)
        self.count = int(self.topology.faces.max()) + 1
        self._beside = torch.from_numpy(_beside(self.topology.faces))
        self._degree = torch.bincount(self.pairs.flatten(), minlength=self.count).clamp_min(1)[:, None]
        self._along = torch.from_numpy(_along(self.topology)).float()

    def posed(self, shape: Tensor, joints: Tensor, rotation: Tensor, translation: Tensor, offset: Tensor) -> Tensor:
        """Vertices (V, 3) in the world, displaced by offsets (V,) in metres; differentiable in everything."""
        coarse = self.hand.skin(shape, joints, rotation) + translation
        smooth = self.hand.subdivide(coarse, self.level)
        return smooth + offset[:, None] * self.normals(smooth)

    def normals(self, vertices: Tensor) -> Tensor:
        """Unit normals (V, 3): of the faces around, by their area."""
        normal = torch.zeros_like(vertices)
        across = self._across(vertices)
        for corner in range(3):
            normal = normal.index_add(0, self.faces[:, corner], across)
        return torch.nn.functional.normalize(normal, dim=1, eps=1e-20)

    def tangents(self, vertices: Tensor) -> Tensor:
        """Directions (F, 3) on the faces in which u grows."""
        corners = rows_of(vertices, self.faces)
        return (self._along[:, :1] * (corners[:, 1] - corners[:, 0])) + self._along[:, 1:] * (
            corners[:, 2] - corners[:, 0]
        )

    def roughness(self, vertices: Tensor) -> Tensor:
        """Mean distance in metres of vertices from the middle of their neighbours (uniform Laplacian)."""
        first, second = self.pairs.T
        total = torch.zeros_like(vertices).index_add(0, first, rows_of(vertices, second))
        total = total.index_add(0, second, rows_of(vertices, first))
        return (total / self._degree - vertices).norm(dim=1).mean()

    def creases(self, vertices: Tensor) -> Tensor:
        """Mean of 1 - cosine between the normals of faces that share an edge."""
        normal = torch.nn.functional.normalize(self._across(vertices), dim=1, eps=1e-20)
        first, second = self._beside.T
        return (1.0 - (rows_of(normal, first) * rows_of(normal, second)).sum(dim=1)).mean()

    def lengths(self, vertices: Tensor) -> Tensor:
        """Lengths (E,) of the edges in millimetres."""
        first, second = self.pairs.T
        return 1000.0 * (rows_of(vertices, first) - rows_of(vertices, second)).norm(dim=1)

    def _across(self, vertices: Tensor) -> Tensor:
        """Normals (F, 3) of the faces, as long as twice their area."""
        corners = rows_of(vertices, self.faces)
        return torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def mapped(normal: Tensor, along: Tensor | None, values: Tensor) -> Tensor:
    """Unit normals (N, 3) that a normal map's values (N, 3) turn: x along a tangent, y across it, z the normal (N, 3).

    along (N, 3) are tangents before they are made unit and square to the normal; None: those of Duff et al. 2017, which
    the normal alone decides ("Building an orthonormal basis, revisited").
    """
    if along is None:
        x, y, z = normal.unbind(1)
        sign = torch.where(z >= 0, 1.0, -1.0)
        a = -1.0 / (sign + z)
        first = torch.stack([1.0 + sign * x * x * a, sign * x * y * a, -sign * x], dim=1)
    else:
        first = along - (along * normal).sum(dim=1, keepdim=True) * normal
        first = torch.nn.functional.normalize(first, dim=1, eps=1e-20)
    second = torch.linalg.cross(normal, first)
    turned = values[:, :1] * first + values[:, 1:2] * second + values[:, 2:] * normal
    return torch.nn.functional.normalize(turned, dim=1, eps=1e-20)


def _beside(faces: Array) -> Array:
    """Pairs (n, 2) of faces that share an edge."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    face = np.arange(len(faces)).repeat(3)
    order = np.lexsort(ends.T)
    same = (ends[order][1:] == ends[order][:-1]).all(axis=1)
    return np.stack([face[order][:-1][same], face[order][1:][same]], axis=1)


def _along(topology: Topology) -> Array:
    """What of a face's two edges from its first corner makes u grow by one, (F, 2)."""
    uvs, uv_faces = topology.unwrapped
    corners = uvs[uv_faces]
    (a, b), (c, d) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    area = a * d - b * c
    return np.stack([d, -b], axis=1) / np.where(np.abs(area) > 1e-14, area, 1.0)[:, None]
