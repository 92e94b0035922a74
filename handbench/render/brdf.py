"""The reflectance models of the shading features, elementwise.

Equations are those of URHand, supplement Sec. 4.2, rearranged so that float32 keeps its digits:
with s = |n x h|^2 instead of (n.h)^2, Eq. 3 reads D = [b^2 / (s + (1 - s) b^4)]^2 / pi.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

MIN_ROUGHNESS = 0.02
"""Roughness is raised to at least this: below, a lobe is narrower (b^2 = 4e-4 rad) than float32 directions resolve."""

F0, F1, F2 = 0.04, -5.55473, -6.98316

SHININESS = 32.0
"""Phong exponent: the lobe is about as wide as that of roughness 0.5."""

_SMALL = 1e-8


def distribution(sine2: Tensor, roughness: Tensor) -> Tensor:
    """D (URHand supp. Eq. 3) from s = sin^2 of the angle between n and h, and roughness β in [MIN_ROUGHNESS, 1]."""
    alpha = roughness * roughness
    root = alpha / (sine2 + (1.0 - sine2) * (alpha * alpha))
    return root * root * (1.0 / math.pi)


def fresnel(cosine: Tensor) -> Tensor:
    """F (URHand supp. Eq. 4) from d.h in [0, 1]."""
    return F0 + (1.0 - F0) * torch.exp2((F1 * cosine + F2) * cosine)


def masking(cosine: Tensor, roughness: Tensor) -> Tensor:
    """One factor of G: 1 / (c (1 - K) + K), K = (β + 1)^2 / 8, for c >= 0.

    G (URHand supp. Eqs. 5-6) is masking(n.d) masking(n.ω) / 4.
    """
    k = (roughness + 1.0).square() * 0.125
    return 1.0 / (cosine * (1.0 - k) + k)


def clamp_roughness(roughness: Tensor) -> Tensor:
    return roughness.clamp(MIN_ROUGHNESS, 1.0)


def specular(normal: Tensor, view: Tensor, light: Tensor, roughness: Tensor) -> Tensor:
    """D F G (URHand supp. Eqs. 3-6) of unit vectors (..., 3) that broadcast, roughness (...): (...).

    Zero where the light or the viewer is not above the surface, so the half vector's pole at d = -ω is
    never reached. Roughness is clamped to [MIN_ROUGHNESS, 1]. The cosine n.ω of Eq. 2 is not included.
    """
    beta = clamp_roughness(roughness)
    to_light, to_view = (normal * light).sum(-1), (normal * view).sum(-1)
    total = light + view
    length2 = total.square().sum(-1).clamp_min(_SMALL)
    total, normal = torch.broadcast_tensors(total, normal)
    sine2 = torch.linalg.cross(normal, total, dim=-1).square().sum(-1) / length2
    above = (to_light > 0) & (to_view > 0)
    lobe = distribution(sine2.clamp_max(1.0), beta) * fresnel(0.5 * length2.sqrt())  # |ω + d| = 2 d.h
    return above * lobe * masking(to_light.clamp_min(0), beta) * masking(to_view.clamp_min(0), beta) * 0.25


def phong(normal: Tensor, view: Tensor, light: Tensor, shininess: float = SHININESS) -> Tensor:
    """Phong's lobe (r.d)^shininess of unit vectors (..., 3) that broadcast, r the mirrored light: (...).

    Zero where the light is below the surface. It has no cosine and no normalisation, as Phong had none.
    """
    to_light, to_view = (normal * light).sum(-1), (normal * view).sum(-1)
    mirrored = 2.0 * to_light * to_view - (light * view).sum(-1)
    return (to_light > 0) * mirrored.clamp(0.0, 1.0).pow(shininess)
