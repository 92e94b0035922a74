"""Where a pose takes the space around a hand at rest."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ...lattice import Lattice
from ..handmodel import vector
from ..skinning import joint_transforms
from .weightfield import WeightField

_REACH = 0.022  # metres from the posed skin: the middle of a palm is closer
_CELL = 4e-3  # metres between the places whose nearest bones are known
MOST = 4  # nearest bones that are known of a place
_AROUND = 16  # coarse vertices among which the nearest bones are looked for


class Deformation:
    """A shape (S,) in a pose (J, 3): x -> A(x) x + b(x), the blend of all bones' transforms by the field's weights.

    Points come from the field's canonical space and go to the *hand frame*: the world before `Pose.rotation` and
    `Pose.translation`. Between nodes A and b are trilinear. Where the shape is not the field's, the nodes' growth
    is in b. Pose blend shapes are left out, as in SNARF. Differentiable in shape and joints.
    """

    def __init__(self, field: WeightField, shape: Tensor, joints: Tensor) -> None:
        hand = field.hand
        self.field = field
        joints = vector("joints", joints, (len(hand.parents), 3), torch.float32)
        _, points = hand.rest_points(shape, torch.float32)
        frames = torch.tensor(hand.frames, dtype=torch.float32)
        turn, offset = joint_transforms(points[: len(joints)], hand.parents, frames, joints)
        bones = torch.cat([turn.flatten(1), offset], dim=1)
        self.turn, self.offset = turn, offset
        blended = field.weights @ bones
        moved = (blended[:, :9].unflatten(1, (3, 3)) @ field.growth(shape)[..., None]).squeeze(2)
        self.table = torch.cat([blended[:, :9], blended[:, 9:] + moved], dim=1)
        """(G, 12): A row by row, then b."""

    def forward(self, x: Tensor) -> Tensor:
        """Canonical points (N, 3) in the hand frame, (N, 3). Differentiable in shape and joints, not in x."""
        return _applied(self.field.lattice.values(self.table, x), x)

    def blend(self, x: Tensor) -> Tensor:
        """A (N, 3, 3) at canonical points (N, 3): the blended rotations (and not quite one itself)."""
        return self.field.lattice.values(self.table, x)[:, :9].unflatten(1, (3, 3))

    def jacobian(self, x: Tensor) -> Tensor:
        """d forward / dx at canonical points (N, 3): (N, 3, 3), rows are the hand frame's axes."""
        lattice = self.field.lattice
        slope = lattice.slopes(self.table, x)  # of each entry of A and b along each canonical axis
        along = (slope[..., :9].unflatten(2, (3, 3)) @ x[:, None, :, None]).squeeze(3) + slope[..., 9:]
        return self.blend(x) + along.transpose(1, 2)

    @cached_property
    def nearest(self) -> Nearest:
        """The bones that are nearest to each place around the posed hand."""
        return Nearest(self)


def _applied(values: Tensor, x: Tensor) -> Tensor:
    return (values[:, :9].unflatten(1, (3, 3)) @ x[..., None]).squeeze(2) + values[:, 9:]


class Nearest:
    """Of each node of a lattice around the posed hand, its nearest coarse vertices, no two of one bone.

    vertices (G, `MOST`), -1 where there are no more bones among the nearest vertices or the skin is out of reach.
    """

    def __init__(self, deformation: Deformation) -> None:
        field = deformation.field
        with torch.no_grad():
            self.posed = deformation.forward(field.coarse)
            self.back = torch.linalg.inv(deformation.blend(field.coarse))
        self.lattice = Lattice.around(self.posed.numpy(), _REACH, _CELL)
        tree, nodes = cKDTree(self.posed.numpy()), self.lattice.nodes().numpy()
        near = np.flatnonzero(tree.query(nodes, distance_upper_bound=_REACH)[0] < _REACH)
        distance, found = tree.query(nodes[near], _AROUND, distance_upper_bound=_REACH)
        there = torch.from_numpy(distance < _REACH)
        vertices = torch.from_numpy(found).where(there, 0)
        owner = field.bone[vertices].where(there, -1)
        chosen = torch.full((len(near), MOST), -1)
        taken = torch.full_like(chosen, -1)
        count = torch.zeros(len(near), dtype=torch.long)
        for column, own in zip(vertices.T, owner.T, strict=True):
            rows = ((own >= 0) & (taken != own[:, None]).all(dim=1) & (count < MOST)).nonzero()[:, 0]
            chosen[rows, count[rows]] = column[rows]
            taken[rows, count[rows]] = own[rows]
            count[rows] += 1
        self.vertices = torch.full((len(nodes), MOST), -1).index_copy(0, torch.from_numpy(near), chosen)
