"""What a place is to a network: features looked up in tables, all behind one interface.

HashGrid    levels of grids from coarse to fine; fine ones share a table by a hash (Müller et al. 2022), as the seed
TriPlane    a few dense grids and three planes: half the time of the hash grid on a CPU, and no collisions
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from handbench.errors import InputError
from handbench.lattice import interpolated, trilinear, trilinear_slopes

_PRIMES = (1, 2654435761, 805459861)
_START = 1e-4  # greatest value in a table at first (Müller et al. 2022)


class Encoding(nn.Module, ABC):
    """Features (N, size) of places x (N, 3) in [-1, 1] along each axis of a box; differentiable in the tables.

    Slopes take three times as long as values and are taken by formula: what is differentiated is the table only, once.
    The released code switches fine levels of f_rf on bit by bit; here all are there from the start.
    """

    size: int

    @abstractmethod
    def _tables(self, x: Tensor, slopes: bool) -> list[Tensor]:
        """Of each table, coarse first: its features and, if asked for, their slopes, (N, 1 or 4, F)."""

    def forward(self, x: Tensor) -> Tensor:
        return torch.cat(self._tables(x, slopes=False), dim=2)[:, 0]

    def with_slopes(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """The features and their derivatives by x, (N, 3, size)."""
        found = torch.cat(self._tables(x, slopes=True), dim=2)
        return found[:, 0], found[:, 1:]


def _table(rows: int, features: int) -> nn.Parameter:
    return nn.Parameter(torch.empty(rows, features).uniform_(-_START, _START))


def _counts(nodes: int, aspect: Sequence[float]) -> list[int]:
    """Nodes along each axis of a box so that cells are cubes: `nodes` along an axis of aspect 1."""
    return [max(2, round(nodes * side)) for side in aspect]


def _cells(x: Tensor, counts: Sequence[int]) -> tuple[Tensor, Tensor]:
    """First corner (N, D) of the cell of each x (N, D) in [-1, 1], and the place in it in [0, 1]."""
    last = torch.tensor(counts) - 1
    at = (0.5 * x + 0.5) * last
    first = torch.minimum(at.long().clamp_min(0), last - 1)
    return first, (at - first).clamp(0.0, 1.0)


def _weighted(place: Tensor, counts: Sequence[int], slopes: bool) -> Tensor:
    """Weights (N, 1, 8) of a cell's corners, and with slopes (N, 4, 8) their derivatives by x too."""
    weights = trilinear(place)[:, None]
    if not slopes:
        return weights
    scale = 0.5 * (torch.tensor(counts) - 1.0)
    return torch.cat([weights, trilinear_slopes(place) * scale[:, None]], dim=1)


class HashGrid(Encoding):
    """`levels` grids with `features` each, from `base` to `finest` nodes along the box's longest side.

    A grid of up to 2^table nodes is kept whole, a finer one in a table of that size by a hash of the node. The released
    code has 32 levels of 2 features, growing by 1.447, in 2^19 rows, from 16 on: from about the thirteenth level on
    its cells are below a tenth of a millimetre, and hold what collides there.
    """

    def __init__(self, levels: int, features: int, table: int, base: int, finest: float, aspect: Sequence[float]):
        super().__init__()
        if levels < 1 or not 2 <= base <= finest:
            raise InputError(f"hash grid: {levels} levels from {base} to {finest} nodes; give 1 or more, and rising")
        growth = (finest / base) ** (1.0 / max(1, levels - 1))
        # powers of roots are a little off: without the least bit more the finest level could be a node short
        sides = [math.floor(base * growth**level * (1.0 + 1e-9)) for level in range(levels)]
        self.counts = [_counts(nodes, aspect) for nodes in sides]
        self.rows = [min(int(np.prod([float(n) for n in counts])), 2**table) for counts in self.counts]
        self.size = levels * features
        self.tables = nn.ParameterList(_table(rows, features) for rows in self.rows)

    def _tables(self, x: Tensor, slopes: bool) -> list[Tensor]:
        found = []
        for table, counts, rows in zip(self.tables, self.counts, self.rows, strict=True):
            first, place = _cells(x, counts)
            found.append(interpolated(table, _hashed(first, counts, rows), _weighted(place, counts, slopes)))
        return found


_CORNERS = torch.tensor([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])


def _whole(first: Tensor, counts: Sequence[int]) -> Tensor:
    """Rows (N, 8), in a table of all nodes, of the corners of cells whose first corner is (N, 3)."""
    strides = torch.tensor([1, counts[0], counts[0] * counts[1]])
    return (first * strides).sum(dim=1, keepdim=True) + (_CORNERS * strides).sum(dim=1)


def _hashed(first: Tensor, counts: Sequence[int], rows: int) -> Tensor:
    """The same in a table of so many rows: by a hash if it has no row for each node."""
    nx, ny, nz = counts
    if nx * ny * nz <= rows:
        return _whole(first, counts)
    corners = first[:, None] + _CORNERS
    mixed = corners[..., 0] * _PRIMES[0] ^ corners[..., 1] * _PRIMES[1] ^ corners[..., 2] * _PRIMES[2]
    return mixed % rows


class TriPlane(Encoding):
    """Dense grids of `grids` nodes along the longest side, then three planes of `plane` nodes, `features` each.

    A plane's features are looked up by two of the three coordinates.
    """

    def __init__(self, grids: Sequence[int], plane: int, features: int, aspect: Sequence[float]) -> None:
        super().__init__()
        if min([*grids, plane]) < 2:
            raise InputError(f"tri-plane: grids {tuple(grids)} and planes of {plane} nodes; give at least 2 nodes")
        self.counts = [_counts(nodes, aspect) for nodes in grids]
        self.sides = _counts(plane, aspect)
        self.size = features * (len(self.counts) + 3)
        rows = [int(np.prod(counts)) for counts in self.counts]
        self.tables = nn.ParameterList(_table(count, features) for count in rows)
        self.planes = nn.ParameterList(_table(self.sides[a] * self.sides[b], features) for a, b in _PLANES)

    def _tables(self, x: Tensor, slopes: bool) -> list[Tensor]:
        found = []
        for table, counts in zip(self.tables, self.counts, strict=True):
            first, place = _cells(x, counts)
            found.append(interpolated(table, _whole(first, counts), _weighted(place, counts, slopes)))
        first, place = _cells(x, self.sides)
        for table, axes in zip(self.planes, _PLANES, strict=True):
            found.append(self._plane(table, first, place, axes, slopes))
        return found

    def _plane(self, table: Tensor, first: Tensor, place: Tensor, axes: tuple[int, int], slopes: bool) -> Tensor:
        a, b = axes
        row = self.sides[a]
        nodes = (first[:, a] + row * first[:, b])[:, None] + torch.tensor([0, 1, row, row + 1])
        u, v = place[:, a], place[:, b]
        weights = torch.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], dim=1)[:, None]
        if slopes:
            along_u = torch.stack([v - 1, 1 - v, -v, v], dim=1) * (0.5 * (self.sides[a] - 1))
            along_v = torch.stack([u - 1, -u, 1 - u, u], dim=1) * (0.5 * (self.sides[b] - 1))
            none = torch.zeros_like(along_u)
            columns = [along_u if k == a else along_v if k == b else none for k in range(3)]
            weights = torch.cat([weights, torch.stack(columns, dim=1)], dim=1)
        return interpolated(table, nodes, weights)


_PLANES = ((0, 1), (0, 2), (1, 2))
