"""Where a surface may be: signed distances to a mesh that is close to it, at the nodes of a lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...lattice import Lattice
from ...lean import open3d
from ...scene import Array

REACH = 8e-3
"""Metres on both sides of the mesh in which the surface is looked for."""

_CELL = 4e-3


@dataclass(frozen=True, eq=False)
class Shell:
    """The space within `reach` metres of a closed mesh; distance (G, 1) to it at the nodes, negative inside.

    Of nodes that no place within reach lies beside it is rough: beyond reach, and of the right sign.
    """

    lattice: Lattice
    distance: Tensor
    reach: float

    @staticmethod
    def around(vertices: Array, faces: Array, reach: float = REACH, cell: float = _CELL) -> Shell:
        """The shell of a closed mesh, vertices (V, 3) and faces (F, 3), with nodes about `cell` metres apart."""
        lattice = Lattice.around(np.asarray(vertices), reach + cell, cell)
        o3d = open3d()
        scene, tensor = o3d.t.geometry.RaycastingScene(), o3d.core.Tensor
        scene.add_triangles(
            tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32)),
            tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32)),
        )

        def exact(nodes: Array) -> Array:
            return scene.compute_signed_distance(tensor.from_numpy(np.ascontiguousarray(nodes))).numpy()

        # distances of places far away take longest and are not needed: there the nearest of some coarser nodes does
        x, y, z = lattice.counts
        nodes = lattice.nodes().numpy().reshape(z, y, x, 3)
        coarse = [np.minimum(np.arange(1, n + 1) // 3 * 3, n - 1) for n in (z, y, x)]
        axes, back = zip(*(np.unique(rows, return_inverse=True) for rows in coarse), strict=True)
        some = exact(nodes[np.ix_(*axes)].reshape(-1, 3)).reshape([len(rows) for rows in axes])
        distance = some[np.ix_(*back)]
        step = float(lattice.step.norm())
        near = np.abs(distance) < reach + 2.0 * step  # a node is at most a cell's diagonal from a coarse one
        distance[near] = exact(nodes[near])
        return Shell(lattice, torch.from_numpy(distance.reshape(-1, 1)), reach)

    @property
    def box(self) -> Tensor:
        """Its corners (2, 3): outside there is nothing."""
        return torch.stack([self.lattice.low, self.lattice.high])

    def at(self, points: Tensor) -> Tensor:
        """The distance (N,) of points (N, 3) to the mesh, trilinear between nodes; far outside of the box."""
        found = self.lattice.values(self.distance, points)[:, 0]
        return found.where(self.lattice.inside(points), torch.inf)
