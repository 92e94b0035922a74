"""Shading features under many distant lights in one fused loop (XLA): for evaluation, where no gradient is needed.

The formulas are those of `shading`, light by light: nothing of size lights x texels is ever made.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .brdf import F0, F1, F2, MIN_ROUGHNESS

_BLOCK = 64
"""Lights are padded to a multiple of this with dark ones, so that few shapes are compiled."""


def fused_features(
    frame: tuple[Tensor, Tensor, Tensor],
    view: Tensor,
    roughness: Tensor,
    directions: Tensor,
    irradiance: Tensor,
    visibility: Tensor | None,
) -> Tensor:
    """Diffuse and specular features (2, 3, N) of the BRDF (URHand supp. Eqs. 1-6), float32, without gradient.

    frame: unit normal and two tangents, each (3, N); view (3, N) unit; roughness (N); directions and irradiance
    (L, 3); visibility (L, N) bool or weights in [0, 1], None: everything is lit.
    """
    pad = -len(directions) % _BLOCK
    seen = torch.ones(len(directions), len(roughness), dtype=torch.bool) if visibility is None else visibility
    per_texel = (np.ascontiguousarray(values.detach().numpy()) for values in (*frame, view, roughness))
    per_light = (np.pad(values.detach().numpy(), ((0, pad), (0, 0))) for values in (directions, irradiance, seen))
    return torch.from_numpy(np.array(_kernel()(*per_texel, *per_light)))


@cache
def _kernel() -> Any:
    import jax
    import jax.numpy as jnp

    def features(normal, tangent, bitangent, view, roughness, directions, irradiance, seen):  # type: ignore[no-untyped-def]
        beta = jnp.clip(roughness, MIN_ROUGHNESS, 1.0)
        alpha = beta * beta
        k = (beta + 1.0) ** 2 * 0.125
        view_n, view_t, view_b = ((axis * view).sum(0) for axis in (normal, tangent, bitangent))
        masked_view = 0.25 * (view_n > 0) / (jnp.maximum(view_n, 0.0) * (1.0 - k) + k)

        def add(sums, light):  # type: ignore[no-untyped-def]
            where, power, lit = light
            light_n, light_t, light_b = (
                axis[0] * where[0] + axis[1] * where[1] + axis[2] * where[2] for axis in (normal, tangent, bitangent)
            )
            planar = (light_t + view_t) ** 2 + (light_b + view_b) ** 2
            length2 = jnp.maximum(planar + (light_n + view_n) ** 2, 1e-8)
            sine2 = planar / length2
            root = alpha / (sine2 + (1.0 - sine2) * (alpha * alpha))
            facing = 0.5 * jnp.sqrt(length2)
            fresnel = F0 + (1.0 - F0) * jnp.exp2((F1 * facing + F2) * facing)
            cosine = jnp.maximum(light_n, 0.0)
            received = cosine * lit
            lobe = root * root * (1.0 / jnp.pi) * fresnel * masked_view / (cosine * (1.0 - k) + k)
            diffuse, specular = sums
            return (diffuse + power[:, None] * received, specular + power[:, None] * (lobe * received)), None

        zero = jnp.zeros_like(normal)
        sums, _ = jax.lax.scan(add, (zero, zero), (directions, irradiance, seen))
        return jnp.stack(sums)

    return jax.jit(features)
