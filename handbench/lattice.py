"""Values at the nodes of a regular lattice, and what lies between them: trilinear interpolation and its slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .errors import InputError
from .scene import Array


@dataclass(frozen=True, eq=False)
class Lattice:
    """Nodes on a box: `low` and `high` (3,) are its first and last node in metres, `counts` how many along x, y, z.

    Values are kept node by node, (G, C) with x running fastest, so that what a point needs lies together in memory.
    """

    low: Tensor
    high: Tensor
    counts: tuple[int, int, int]

    def __post_init__(self) -> None:
        if min(self.counts) < 2:
            raise InputError(f"lattice: {self.counts} nodes; give at least 2 along each axis")

    @staticmethod
    def around(points: Array, margin: float, spacing: float) -> Lattice:
        """Nodes `spacing` apart (or a little less) on the box of points (N, 3), `margin` wider on all sides."""
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        counts = np.maximum(2, np.ceil((high - low) / spacing).astype(int) + 1)
        first, last = (torch.from_numpy(np.asarray(end, dtype=np.float32)) for end in (low, high))
        return Lattice(first, last, (int(counts[0]), int(counts[1]), int(counts[2])))

    @property
    def size(self) -> int:
        """G."""
        x, y, z = self.counts
        return x * y * z

    @property
    def step(self) -> Tensor:
        """Metres from node to node along each axis, (3,)."""
        return (self.high - self.low) / torch.tensor([n - 1.0 for n in self.counts])

    def nodes(self) -> Tensor:
        """Where they are, (G, 3)."""
        x, y, z = (
            torch.linspace(float(a), float(b), n) for a, b, n in zip(self.low, self.high, self.counts, strict=True)
        )
        grid = torch.meshgrid(z, y, x, indexing="ij")
        return torch.stack(grid[::-1], dim=-1).reshape(-1, 3)

    def inside(self, points: Tensor) -> Tensor:
        """Whether points (N, 3) lie in the box, (N,)."""
        return ((points >= self.low) & (points <= self.high)).all(dim=1)

    def nearest(self, points: Tensor) -> Tensor:
        """The node (N,) next to each point (N, 3); one outside the box has that of the box's nearest place."""
        at = ((points - self.low) / self.step).round().long()
        at = torch.minimum(at.clamp_min(0), torch.tensor(self.counts) - 1)
        nx, ny, _ = self.counts
        return at[:, 0] + nx * (at[:, 1] + ny * at[:, 2])

    def corners(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """The eight nodes (N, 8) around points (N, 3), and the place (N, 3) in [0, 1] between them.

        Outside the box values go on as they are on its sides.
        """
        at = (points - self.low) / self.step
        first = torch.minimum(at.long().clamp_min(0), torch.tensor(self.counts) - 2)
        place = (at - first).clamp(0.0, 1.0)
        nx, ny, _ = self.counts
        base = first[:, 0] + nx * (first[:, 1] + ny * first[:, 2])
        return base[:, None] + torch.tensor([x + nx * (y + ny * z) for z, y, x in _CORNERS]), place

    def values(self, table: Tensor, points: Tensor) -> Tensor:
        """What a table (G, C) holds at points (N, 3): (N, C), differentiable in the table."""
        nodes, place = self.corners(points)
        return interpolated(table, nodes, trilinear(place)[:, None])[:, 0]

    def slopes(self, table: Tensor, points: Tensor) -> Tensor:
        """How that changes along x, y and z, per metre: (N, 3, C), differentiable in the table."""
        nodes, place = self.corners(points)
        return interpolated(table, nodes, trilinear_slopes(place)) / self.step[:, None]


_CORNERS = [(z, y, x) for z in (0, 1) for y in (0, 1) for x in (0, 1)]


def trilinear(place: Tensor) -> Tensor:
    """Weights (N, 8) of the corners, x fastest, of places (N, 3) in a cell."""
    (x, y, z), (u, v, w) = (1.0 - place).unbind(1), place.unbind(1)
    floor = torch.stack([x * y, u * y, x * v, u * v], dim=1)
    return torch.cat([floor * z[:, None], floor * w[:, None]], dim=1)


def trilinear_slopes(place: Tensor) -> Tensor:
    """Derivatives (N, 3, 8) of those weights by the place."""
    (x, y, z), (u, v, w) = (1.0 - place).unbind(1), place.unbind(1)
    along_x = torch.stack([-y, y, -v, v], dim=1)
    along_y = torch.stack([-x, -u, x, u], dim=1)
    floor = torch.stack([x * y, u * y, x * v, u * v], dim=1)
    sides = [torch.cat([side * z[:, None], side * w[:, None]], dim=1) for side in (along_x, along_y)]
    return torch.stack([*sides, torch.cat([-floor, floor], dim=1)], dim=1)


class _Interpolation(torch.autograd.Function):
    """Weighted sums of rows of a table. torch's own gathers keep every row that they read, eight a point."""

    @staticmethod
    def forward(ctx: torch.autograd.function.FunctionCtx, table: Tensor, nodes: Tensor, weights: Tensor) -> Tensor:
        ctx.save_for_backward(nodes, weights)
        ctx.rows = len(table)  # type: ignore[attr-defined]
        if weights.shape[1] == 1:
            bag = torch.nn.functional.embedding_bag(nodes, table, per_sample_weights=weights[:, 0], mode="sum")
            return bag[:, None]
        return weights @ table[nodes]

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, None, None]:  # type: ignore[no-untyped-def]
        nodes, weights = ctx.saved_tensors
        share = weights.transpose(1, 2) @ gradient
        total = gradient.new_zeros(ctx.rows, gradient.shape[2])
        return total.index_add_(0, nodes.reshape(-1), share.reshape(-1, gradient.shape[2])), None, None


def interpolated(table: Tensor, nodes: Tensor, weights: Tensor) -> Tensor:
    """Sums (N, K, C) of the rows `nodes` (N, M) of a table (G, C), each weighted in K ways (N, K, M).

    Differentiable in the table alone; slopes by the place are such a sum too.
    """
    found: Tensor = _Interpolation.apply(table, nodes, weights)
    return found
