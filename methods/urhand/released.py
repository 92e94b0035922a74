"""The shading features of URHand's released code, which are not those of its paper.

The specular feature is a GGX lobe at three roughnesses β, β^16, β^32, each clamped to at most 1, summed, times 10,
without the cosine n.ω (only n.ω > 0 counts).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from handbench.errors import Unsupported
from handbench.light.lightset import LightSet
from handbench.render.shade.brdf import specular
from handbench.render.uv.surface import unit
from handbench.scene import Array

POWERS = (1, 16, 32)
SCALE = 10.0


def released_features(
    normal: Tensor, position: Tensor, roughness: Tensor, centre: Array, lights: LightSet, visible: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Diffuse and specular features (3, N), arguments as in `handbench.render.shade.shading.light_features`.

    Light by light, so that no buffer grows with their number. Raises `Unsupported` for near lights.
    """
    if len(lights.positions):
        raise Unsupported("the released form of URHand's shading features has no near lights")
    seen_from, directions, irradiance = (
        torch.as_tensor(values, dtype=normal.dtype, device=normal.device)
        for values in (centre, lights.directions, lights.irradiance)
    )
    view = unit(seen_from[:, None] - position)
    diffuse, lobes = torch.zeros_like(normal), torch.zeros_like(normal)
    for i in range(len(directions)):
        seen = torch.ones_like(roughness) if visible is None else visible[i].to(normal.dtype)
        one = checkpoint(_one_light, normal, view, roughness, directions[i], seen, use_reentrant=False)
        diffuse = diffuse + irradiance[i, :, None] * one[0]
        lobes = lobes + irradiance[i, :, None] * one[1]
    return diffuse, lobes


def _one_light(normal: Tensor, view: Tensor, roughness: Tensor, direction: Tensor, seen: Tensor) -> Tensor:
    """Diffuse and specular response (2, N) to one light of unit power."""
    cosine = direction @ normal
    lobe = sum(specular(normal.T, view.T, direction, roughness**power).clamp(max=1.0) for power in POWERS)
    return torch.stack([cosine.clamp_min(0.0) * seen, SCALE * lobe * (cosine > 0) * seen])
