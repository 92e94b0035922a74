"""Distant light that PALM-Net looks up and samples, a map; and what it learns, spherical Gaussians."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from handbench.light.environment import solid_angles, texels
from handbench.light.gaussians import SphericalGaussians, integrals
from handbench.light.stage import stage_directions
from handbench.scene import Array, Environment

ENERGY = 0.8 * 2.0 * math.pi
"""Of the light that training starts from, summed over the sphere: the released code's."""


class LightSampler(Protocol):
    """Light from all around, and how to draw directions where it is bright."""

    def radiance(self, towards: Tensor) -> Tensor:
        """From unit directions (N, 3), (N, 3)."""
        ...

    def draw(self, uniform: Array) -> Tensor:
        """Directions (N, 3) from numbers (N, 3) in [0, 1)."""
        ...

    def density(self, towards: Tensor) -> Tensor:
        """How likely `draw` gives directions, (N) per steradian."""
        ...


class MapSampler:
    """An environment map; texels are drawn by the power of their brightest channel, evenly within."""

    def __init__(self, environment: Environment) -> None:
        self._radiance = torch.from_numpy(np.array(environment.radiance)).reshape(-1, 3)
        self._size = environment.radiance.shape[:2]
        solid = solid_angles(*self._size).ravel()
        power = environment.radiance.reshape(-1, 3).max(axis=1) * solid
        total = power.sum()
        share = power / total if total > 0 else solid / solid.sum()
        self._edges = np.cumsum(share)
        self._density = torch.from_numpy(share / solid).float()

    def radiance(self, towards: Tensor) -> Tensor:
        return self._radiance[self._texel(towards)]

    def draw(self, uniform: Array) -> Tensor:
        height, width = self._size
        which = np.searchsorted(self._edges, uniform[:, 0] * self._edges[-1], side="right").clip(0, height * width - 1)
        row, column = np.divmod(which, width)
        top, bottom = np.cos(row * np.pi / height), np.cos((row + 1) * np.pi / height)
        up = top + (bottom - top) * uniform[:, 1]
        phi = (column + uniform[:, 2]) * (2.0 * np.pi / width)
        ring = np.sqrt(np.maximum(0.0, 1.0 - up * up))
        towards = np.stack([ring * np.sin(phi), up, -ring * np.cos(phi)], axis=1)
        return torch.from_numpy(towards).float()

    def density(self, towards: Tensor) -> Tensor:
        return self._density[self._texel(towards)]

    def _texel(self, towards: Tensor) -> Tensor:
        row, column = texels(towards.detach().numpy(), *self._size)
        return torch.from_numpy(row * self._size[1] + column)


class StudioLight(nn.Module):
    """Spherical Gaussians as training changes them: L(w) = sum |mu| exp(|lambda| (w.xi - 1)).

    They start grey on `count` well-spread axes, sharpness 10 + |20 N(0, 1)|, with `ENERGY` in all (the released code:
    64; the seed: 8).
    """

    def __init__(self, count: int) -> None:
        super().__init__()
        rng = np.random.default_rng([41, 0])
        sharpness = torch.from_numpy(10.0 + np.abs(20.0 * rng.standard_normal(count))).float()
        power = ENERGY / float(integrals(sharpness).sum())
        self.axes = nn.Parameter(torch.from_numpy(stage_directions(count)).float())
        self.sharpness = nn.Parameter(sharpness)
        self.amplitude = nn.Parameter(torch.full((count, 3), power))

    def gaussians(self) -> SphericalGaussians:
        """The lobes; differentiable."""
        axes = torch.nn.functional.normalize(self.axes, dim=1)
        return SphericalGaussians(axes, self.sharpness.abs(), self.amplitude.abs())


def frame(axis: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors (N, 3) across each unit axis (N, 3) and each other (Duff et al. 2017)."""
    x, y, z = axis.unbind(1)
    sign = torch.where(z >= 0, 1.0, -1.0).to(z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = torch.stack([1.0 + sign * x * x * a, sign * b, -sign * x], dim=1)
    second = torch.stack([b, sign + y * y * a, -y], dim=1)
    return first, second
