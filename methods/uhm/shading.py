"""The shadow of a pose that no picture showed: what UHM asks its ShadowNet for."""

from __future__ import annotations

import torch
from torch import Tensor

from handbench.light.environment import directions, places_of, texels

_ALIKE = 12.0
"""How fast surfaces whose normals differ stop telling of each other's shadow: half at 19 degrees."""

_USUAL = 0.01
"""What the mean shadow weighs, of all that is seen: where no picture showed a normal, it decides."""

_SIZE = (32, 64)
"""Rows and columns of the table of shadows by normal: cells of 6 degrees, a third of what the kernel blurs."""


class Shadowing:
    """Shadows by normal, from the shadows (T, N) that texels had under their normals (T, N, 3) in T pictures.

    A texel's shadow is that of all texels that faced the same way, by a kernel over normals, and what it alone had
    beside that in the picture in which it faced most alike: what fingers hide does not turn with the normal. So an
    enrolled pose gets its own shadows back. `seen` (T, N) tells which texels each picture shows.
    """

    def __init__(self, shadows: Tensor, normals: Tensor, seen: Tensor) -> None:
        self._normals, self._seen = normals, seen.float() + 1e-3
        towards = torch.from_numpy(directions(*_SIZE).reshape(-1, 3)).float()
        row, column = texels(normals.reshape(-1, 3).numpy(), *_SIZE)
        near, weight = torch.from_numpy(row * _SIZE[1] + column), seen.reshape(-1).float()
        empty = torch.zeros(len(towards))
        weights = empty.index_add(0, near, weight)
        total = empty.index_add(0, near, weight * shadows.reshape(-1))
        everything = weight.sum().clamp_min(1.0)
        usual, mean = _USUAL * everything, total.sum() / everything
        alike = torch.exp(_ALIKE * (towards @ towards.T - 1.0))
        table = ((alike @ total + usual * mean) / (alike @ weights + usual)).reshape(_SIZE)
        self._table = torch.cat([table[:, -1:], table, table[:, :1]], dim=1)  # columns go around
        self._own = shadows - self._by_normal(normals)

    def _by_normal(self, normal: Tensor) -> Tensor:
        """The table's values (...) at unit normals (..., 3), between its cells."""
        row, column = places_of(normal, *_SIZE)
        across, down = 2.0 * (column + 1.0) / (_SIZE[1] + 2.0) - 1.0, 2.0 * row / _SIZE[0] - 1.0
        place = torch.stack([across, down], dim=-1).reshape(1, 1, -1, 2)
        found = torch.nn.functional.grid_sample(
            self._table[None, None], place, padding_mode="border", align_corners=False
        )
        return found.reshape(normal.shape[:-1])

    def at(self, normal: Tensor, texels: Tensor) -> Tensor:
        """The shadows (n,) in [0, 1] of texels (n,) whose normals (n, 3) a new pose turned."""
        cosine = (self._normals[:, texels] * normal).sum(dim=2)
        weight = torch.exp(_ALIKE * (cosine - 1.0)) * self._seen[:, texels]
        own = (weight * self._own[:, texels]).sum(dim=0) / weight.sum(dim=0)
        return (self._by_normal(normal) + own).clamp(0.0, 1.0)
