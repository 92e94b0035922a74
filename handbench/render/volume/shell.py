"""Where a surface may be: signed distances to a mesh that is close to it, at the nodes of a lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...lattice import Lattice
from ...scene import Array

REACH = 8e-3
"""Metres on both sides of the mesh in which the surface is looked for."""

_CELL = 4e-3


@dataclass(frozen=True, eq=False)
class Shell:
    """The space within `reach` metres of a closed mesh; distance (G, 1) to it at the nodes, negative inside."""

    lattice: Lattice
    distance: Tensor
    reach: float

    @staticmethod
    def around(vertices: Array, faces: Array, reach: float = REACH, cell: float = _CELL) -> Shell:
        """The shell of a closed mesh, vertices (V, 3) and faces (F, 3), with nodes about `cell` metres apart."""
        import open3d.core
        from open3d.t.geometry import RaycastingScene

        lattice = Lattice.around(np.asarray(vertices), reach + cell, cell)
        scene, tensor = RaycastingScene(), open3d.core.Tensor
        scene.add_triangles(
            tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32)),
            tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32)),
        )
        distance = scene.compute_signed_distance(tensor.from_numpy(lattice.nodes().numpy()))
        return Shell(lattice, torch.from_numpy(distance.numpy().copy())[:, None], reach)

    @property
    def box(self) -> Tensor:
        """Its corners (2, 3): outside there is nothing."""
        return torch.stack([self.lattice.low, self.lattice.high])

    def at(self, points: Tensor) -> Tensor:
        """The distance (N,) of points (N, 3) to the mesh, trilinear between nodes; far outside of the box."""
        found = self.lattice.values(self.distance, points)[:, 0]
        return found.where(self.lattice.inside(points), torch.inf)
