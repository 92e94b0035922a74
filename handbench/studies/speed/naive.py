"""The shading features as one would first write them from the paper: whole maps, half vectors, L x N buffers.

The competitor that the lighting core is measured against. It keeps every vector of every texel-light pair in
memory, skips nothing, and knows no tile.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from ...light.lightset import LightSet
from ...render.shade.brdf import MIN_ROUGHNESS, SHININESS
from ...render.shade.shading import Model
from ...scene import Array


def naive_features(
    normal: Tensor,
    position: Tensor,
    roughness: Tensor,
    camera_centre: Tensor | Array,
    lights: LightSet,
    visibility: Tensor | Array | None = None,
    model: Model = "brdf",
) -> tuple[Tensor, Tensor]:
    """Diffuse and specular features (3, N) of N texels (URHand supp. Eqs. 1-6): arguments and answer as in
    `handbench.render.shade.shading.light_features`, in the precision of `normal`.

    Takes about 100 bytes a texel-light pair in float32, and two to three times that with gradients.
    """
    n, x = normal.T, position.T
    d = normalize(_like(camera_centre, n) - x, dim=-1)
    omega, irradiance = _incoming(x, lights)
    if visibility is not None:
        irradiance = irradiance * _like(visibility, n)[..., None]
    cosine = (n * omega).sum(dim=-1).clamp_min(0.0)  # (L, N)
    received = irradiance * cosine[..., None]  # (L, N, 3)
    diffuse = received.sum(dim=0)
    if model == "diffuse":
        return diffuse.T, torch.zeros_like(diffuse.T)
    if model == "phong":
        mirrored = 2.0 * cosine[..., None] * n - omega
        lobe = (mirrored * d).sum(dim=-1).clamp(0.0, 1.0) ** SHININESS * (cosine > 0)
        return diffuse.T, (irradiance * lobe[..., None]).sum(dim=0).T
    specular = (received * _brdf(n, d, omega, cosine, roughness)[..., None]).sum(dim=0)
    return diffuse.T, specular.T


def _brdf(n: Tensor, d: Tensor, omega: Tensor, n_omega: Tensor, roughness: Tensor) -> Tensor:
    """D F G of Eqs. 3-6, (L, N); the sine of the half vector's angle, not its cosine, so that it stays finite."""
    beta = roughness.clamp(MIN_ROUGHNESS, 1.0)
    h = normalize(omega + d, dim=-1, eps=1e-6)
    n_d = (n * d).sum(dim=-1).clamp_min(0.0)
    sine2 = torch.linalg.cross(n.expand_as(h), h, dim=-1).square().sum(dim=-1).clamp_max(1.0)
    d_h = (d * h).sum(dim=-1).clamp(0.0, 1.0)
    distribution = (beta**2 / (sine2 + (1.0 - sine2) * beta**4)) ** 2 / math.pi
    fresnel = 0.04 + 0.96 * 2.0 ** ((-5.55473 * d_h - 6.98316) * d_h)
    k = (beta + 1.0) ** 2 / 8.0
    geometry = 1.0 / (4.0 * (n_d * (1.0 - k) + k) * (n_omega * (1.0 - k) + k))
    return torch.where((n_d > 0) & (n_omega > 0), distribution * fresnel * geometry, 0.0)


def _incoming(x: Tensor, lights: LightSet) -> tuple[Tensor, Tensor]:
    """Unit vectors to every light (L + P, N, 3) and what a facing texel receives of it (L + P, N, 3)."""
    count = len(x)
    distant = _like(lights.directions, x)[:, None].expand(-1, count, -1)
    irradiance = _like(lights.irradiance, x)[:, None].expand(-1, count, -1)
    towards = _like(lights.positions, x)[:, None] - x
    distance2 = towards.square().sum(dim=-1, keepdim=True).clamp_min(1e-12)
    near = _like(lights.intensities, x)[:, None] / distance2
    return torch.cat([distant, towards * distance2.rsqrt()]), torch.cat([irradiance, near])


def _like(values: Tensor | Array, other: Tensor) -> Tensor:
    tensor = values if isinstance(values, Tensor) else torch.from_numpy(np.array(values))
    return tensor.to(other.dtype)
