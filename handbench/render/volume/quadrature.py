"""How much of what lies along a ray reaches the eye: the volume rendering integral as a sum."""

from __future__ import annotations

import torch
from torch import Tensor


def laplace_density(distance: Tensor, beta: Tensor | float) -> Tensor:
    """Density (1/m) at signed distances in metres, positive outside (Yariv et al. 2021, VolSDF).

    1/β times the Laplace distribution's share: 1/β deep inside, 1/(2β) on the surface, 0 far outside. β in metres is
    how soft the surface is.
    """
    tail = torch.expm1(-distance.abs() / beta)
    return (0.5 + 0.5 * distance.sign() * tail) / beta


def transmittance(density: Tensor, length: Tensor) -> Tensor:
    """What of the light from each interval's far end reaches the ray's start, (R, S).

    density (R, S) of the intervals, front to back, constant in each; length (R, S) in metres.
    """
    return torch.exp(-(density * length).cumsum(dim=1))


def weights(density: Tensor, length: Tensor) -> Tensor:
    """Share (R, S) of each interval in the ray's colour: T_i (1 - exp(-density_i length_i)), front to back.

    Exact where density and colour are constant in each interval (Max 1995; the seed's Sec. 4.1). What a ray's weights
    leave of one is the background's.
    """
    passed = transmittance(density, length)
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    return before * -torch.expm1(-density * length)
