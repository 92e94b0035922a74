"""The reflectance models of the shading features, elementwise.

    specular    the parametric BRDF of URHand, supplement Sec. 4.2 (Eqs. 3-6)
    phong       Phong's lobe; lambert is its diffuse part and everyone's
    disney      Burley's diffuse, GGX and Smith: albedo, roughness, metallic

The equations are rearranged so that float32 keeps its digits. With s = |n x h|^2 instead of (n.h)^2, Eq. 3 reads
D = [b^2 / (s + (1 - s) b^4)]^2 / pi. A lobe of roughness b turns an error e of a direction into 2 e / b^2 of its
value (e / 2e-4 at b = 0.02), so cosines and s are taken in float64 and only then rounded to the inputs' precision,
which for halves is raised to float32.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

MIN_ROUGHNESS = 0.02
"""Roughness is raised to at least this: a lobe of b = 0.02 is 4e-4 rad wide, far below a texel's own spread."""

F0, F1, F2 = 0.04, -5.55473, -6.98316

SHININESS = 32
"""Phong exponent: the lobe is about as wide as that of roughness 0.5."""

GRAZING = 1e-12
"""Least denominator of Smith's masking; its square must not overflow in a gradient."""

SMALL = 1e-16
"""Least |ω + d|^2: below it, at d = -ω to 1e-8 rad, the half vector has no direction."""


def distribution(sine2: Tensor, roughness: Tensor) -> Tensor:
    """D (URHand supp. Eq. 3) from s = sin^2 of the angle between n and h, and roughness β in [MIN_ROUGHNESS, 1].

    It is GGX with α = β^2 (Walter et al. 2007, Eq. 33).
    """
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
    beta = clamp_roughness(_single(roughness))
    to_light, to_view, sine2, facing = _angles(normal, view, light)
    above = (to_light > 0) & (to_view > 0)
    lobe = distribution(sine2, beta) * fresnel(facing)
    return above * lobe * masking(to_light.clamp_min(0), beta) * masking(to_view.clamp_min(0), beta) * 0.25


def phong(normal: Tensor, view: Tensor, light: Tensor, shininess: float = SHININESS) -> Tensor:
    """Phong's lobe (r.d)^shininess of unit vectors (..., 3) that broadcast, r the mirrored light: (...).

    Zero where the light is below the surface. It has no cosine and no normalisation, as Phong had none
    ("Illumination for computer generated pictures", 1975); its diffuse part is Lambert's 1 / pi.
    """
    to_light, to_view, across = (_dot(a, b) for a, b in ((normal, light), (normal, view), (light, view)))
    mirrored = (2.0 * to_light * to_view - across).to(torch.result_type(normal, light))
    return (to_light > 0) * mirrored.clamp(0.0, 1.0).pow(shininess)


def disney(normal: Tensor, view: Tensor, light: Tensor, albedo: Tensor, roughness: Tensor, metallic: Tensor) -> Tensor:
    """The Disney BRDF with three parameters, (..., 3), of unit vectors (..., 3) that broadcast.

    albedo (..., 3), roughness and metallic (...); clamped to [0, 1], roughness to [MIN_ROUGHNESS, 1]. The sum of
        (1 - metallic) albedo `burley`       diffuse with retro-reflection
        D F G / (4 n.ω n.d)                  D: GGX with α = roughness^2; F: Schlick with F0 = lerp(0.04, albedo,
                                             metallic); G: height-correlated Smith (`smith`)
    Burley, "Physically Based Shading at Disney" (2012) names the parameters, the diffuse term, α and Schlick. His
    separable G with remapped roughness is replaced by the height-correlated one of Heitz (2014), which belongs to
    this D. Zero where light or viewer is not above the surface; no cosine.
    """
    albedo, metallic = _single(albedo).clamp(0.0, 1.0), _single(metallic).clamp(0.0, 1.0)[..., None]
    beta = clamp_roughness(_single(roughness))
    to_light, to_view, sine2, facing = _angles(normal, view, light)
    above = (to_light > 0) & (to_view > 0)
    to_light, to_view = to_light.clamp_min(0), to_view.clamp_min(0)
    diffuse = above * burley(to_light, to_view, facing, beta)
    lobe = above * distribution(sine2, beta) * smith(to_light, to_view, beta)
    edge = schlick(facing)[..., None]
    f0 = base_reflectance(albedo, metallic)
    return (1.0 - metallic) * albedo * diffuse[..., None] + lobe[..., None] * (f0 + (1.0 - f0) * edge)


def base_reflectance(albedo: Tensor, metallic: Tensor) -> Tensor:
    """Reflectance head-on, F0 = lerp(0.04, albedo, metallic) (Burley 2012, Sec. 5.2)."""
    return F0 + metallic * (albedo - F0)


def schlick(facing: Tensor) -> Tensor:
    """(1 - ω.h)^5 for ω.h in [0, 1] (Schlick 1994)."""
    rest = (1.0 - facing).clamp_min(0.0)
    return rest * rest.square().square()


def burley(to_light: Tensor, to_view: Tensor, facing: Tensor, roughness: Tensor) -> Tensor:
    """Diffuse reflectance of albedo 1 from n.ω, n.d, ω.h in [0, 1]: Burley 2012, Sec. 5.3."""
    rise = 2.0 * roughness * facing.square() - 0.5  # F_D90 - 1
    return (1.0 + rise * schlick(to_light)) * (1.0 + rise * schlick(to_view)) * (1.0 / math.pi)


def smith(to_light: Tensor, to_view: Tensor, roughness: Tensor) -> Tensor:
    """G / (4 n.ω n.d) from cosines in [0, 1]: height-correlated Smith for GGX with α = β^2 (Heitz 2014, Eq. 99)."""
    alpha2 = roughness.square().square()

    def slope(cosine: Tensor) -> Tensor:
        return ((1.0 - alpha2) * cosine.square() + alpha2).sqrt()

    return 0.5 / (to_light * slope(to_view) + to_view * slope(to_light)).clamp_min(GRAZING)


def _angles(normal: Tensor, view: Tensor, light: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """n.ω, n.d, sin^2(n, h) and d.h, taken in float64 and given in the inputs' precision, at least float32."""
    dtype = torch.promote_types(torch.result_type(normal, light), torch.float32)
    n, d, w = (v.double() for v in (normal, view, light))
    total, n = torch.broadcast_tensors(w + d, n)
    length2 = total.square().sum(-1).clamp_min(SMALL)
    sine2 = torch.linalg.cross(n, total, dim=-1).square().sum(-1) / length2
    facing = 0.5 * length2.sqrt()  # |ω + d| = 2 d.h
    angles = (_dot(n, w), _dot(n, d), sine2.clamp_max(1.0), facing.clamp_max(1.0))
    return tuple(angle.to(dtype) for angle in angles)  # type: ignore[return-value]


def _single(values: Tensor) -> Tensor:
    """At least float32: the peak of a narrow lobe is beyond what float16 holds."""
    return values.to(torch.promote_types(values.dtype, torch.float32))


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a.double() * b.double()).sum(-1)
