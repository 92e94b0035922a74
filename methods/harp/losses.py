"""The losses of HARP's textures (`loss/texture_reg.py`), each a mean over the texels that the surface uses."""

from __future__ import annotations

import torch
from torch import Tensor

ALBEDO_REACH, NORMAL_REACH = 1.0, 2.0
"""Standard deviations in texels of the random steps; cut to whole numbers, almost half of the albedo's are none."""

UPRIGHT = 0.2
"""Weight of a normal map's distance from (0, 0, 1) beside its smoothness."""


def jitter(texture: Tensor, used: Tensor, reach: float, generator: torch.Generator) -> Tensor:
    """Mean absolute difference of a map (C, R, R) to itself at a random step of each texel; used (R, R) bool."""
    size = texture.shape[-1]
    row, column = torch.nonzero(used, as_tuple=True)
    steps = torch.normal(0.0, reach, (2, len(row)), generator=generator).trunc().long()
    flat = texture.flatten(1)
    other = (row + steps[0]).clamp(0, size - 1) * size + (column + steps[1]).clamp(0, size - 1)
    # not by brackets: several threads sum their gradient in any order
    return (flat.index_select(1, row * size + column) - flat.index_select(1, other)).abs().mean()


def upright(normal_map: Tensor, used: Tensor) -> Tensor:
    """Mean distance of normals (3, R, R) from (0, 0, 1), a third of it as in the code."""
    straight = torch.tensor([0.0, 0.0, 1.0])[:, None]
    return (normal_map[:, used] - straight).norm(dim=0).mean() / 3.0


def normal_regulariser(normal_map: Tensor, used: Tensor, generator: torch.Generator) -> Tensor:
    """Of a normal map: close to upright, and smooth."""
    return UPRIGHT * upright(normal_map, used) + jitter(normal_map, used, NORMAL_REACH, generator)
