"""The surface of a posed hand as a mesh: marching cubes at rest, moved as the pose moves it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from handbench.errors import NonFinite
from handbench.lattice import Lattice
from handbench.scene import Mesh, Topology

if TYPE_CHECKING:
    from .posed import PosedHand


@dataclass(frozen=True, eq=False)
class FieldSurface:
    """A mesh in the world, and where its vertices are in canonical space, (V, 3)."""

    mesh: Mesh
    canonical: Tensor


@torch.no_grad()
def extracted(posed: PosedHand, spacing: float) -> FieldSurface:
    """The zero level of f_g in a pose, from nodes `spacing` metres apart that are within reach of the skin at rest.

    Nodes that are farther are taken to be inside or outside as the skin at rest has them. Faces turn outwards; sheets
    of a fold are all there. Raises `NonFinite` where f_g has no surface there.
    """
    from skimage.measure import marching_cubes

    model, field = posed.model, posed.deformation.field
    reach = model.config.reach
    shell = model.rest_shell(field)
    lattice = Lattice.around(field.rest.numpy(), reach, spacing)
    nodes = lattice.nodes()
    values = shell.at(nodes).clamp(-reach, reach)
    near = values.abs() < reach
    values[near] = model.geometry(nodes[near], posed.conditions).sdf
    nx, ny, nz = lattice.counts
    grid = values.view(nz, ny, nx).permute(2, 1, 0).numpy()
    try:
        found, faces, _, _ = marching_cubes(grid, 0.0, gradient_direction="descent")
    except (ValueError, RuntimeError) as error:
        raise NonFinite(f"palm: the geometry field has no surface near the hand ({error}); train longer") from error
    canonical = lattice.low + torch.from_numpy(found.copy()).float() * lattice.step
    world = posed.placed(posed.deformation.forward(canonical))
    return FieldSurface(Mesh(world.double().numpy(), Topology(faces.astype(np.int32))), canonical)
