"""The shadow of a pose that no picture showed: what UHM asks its ShadowNet for."""

from __future__ import annotations

import torch
from torch import Tensor

from handbench.light.environment import directions

_ALIKE = 12.0
"""How fast surfaces whose normals differ stop telling of each other's shadow: half at 19 degrees."""

_USUAL = 0.01
"""What the mean shadow weighs, of all that is seen: where no picture showed a normal, it decides."""


class Shadowing:
    """Shadows by normal, from the shadows (T, N) that texels had under their normals (T, N, 3) in T pictures.

    A texel's shadow is that of all texels that faced the same way, by a kernel over normals, and what it alone had
    beside that in the picture in which it faced most alike: what fingers hide does not turn with the normal. So an
    enrolled pose gets its own shadows back. `seen` (T, N) tells which texels each picture shows.
    """

    def __init__(self, shadows: Tensor, normals: Tensor, seen: Tensor) -> None:
        self._normals, self._seen = normals, seen.float() + 1e-3
        self._towards = torch.from_numpy(directions(16, 32).reshape(-1, 3)).float()
        near = (normals.reshape(-1, 3) @ self._towards.T).argmax(dim=1)
        weight = seen.reshape(-1).float()
        empty = torch.zeros(len(self._towards))
        self._weight = empty.index_add(0, near, weight)
        self._total = empty.index_add(0, near, weight * shadows.reshape(-1))
        self._usual = _USUAL * weight.sum().clamp_min(1.0)
        self._mean = self._total.sum() / weight.sum().clamp_min(1.0)
        self._own = shadows - torch.stack([self._by_normal(each) for each in normals])

    def _by_normal(self, normal: Tensor) -> Tensor:
        alike = torch.exp(_ALIKE * (normal @ self._towards.T - 1.0))
        return (alike @ self._total + self._usual * self._mean) / (alike @ self._weight + self._usual)

    def at(self, normal: Tensor, texels: Tensor) -> Tensor:
        """The shadows (n,) in [0, 1] of texels (n,) whose normals (n, 3) a new pose turned."""
        cosine = (self._normals[:, texels] * normal).sum(dim=2)
        weight = torch.exp(_ALIKE * (cosine - 1.0)) * self._seen[:, texels]
        own = (weight * self._own[:, texels]).sum(dim=0) / weight.sum(dim=0)
        return (self._by_normal(normal) + own).clamp(0.0, 1.0)
