"""The reflectance of PALM-Net's skin: a diffuse part and one glossy lobe, told by albedo, roughness and metallic.

The seed says "Disney BRDF"; what the released code computes, and what is computed here, is

    f cos = (1 - m) a cos / pi  +  D G F cos / (4 n.w n.d)
    D     GGX of width alpha;  G: Schlick's product with k = (r + 1)^2 / 8 (Karis 2013)
    F     F0 + (1 - F0) 2^((-5.55473 c - 6.98316) c), F0 = 0.04 (1 - m) + a m, c = w.h

which has neither Burley's diffuse term nor his masking. In the released form alpha is the roughness r itself. In the
"squared" one alpha is r^2, as Disney's artists have it; then a surface without metal has the lobe of URHand (supp. Eqs.
3-6). The diffuse part is not lessened by what the lobe reflects: a white surface sends back 2 to 5 % more than it gets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import torch
from torch import Tensor

from handbench.render.shade.brdf import F1, F2, SMALL, base_reflectance, clamp_roughness, distribution, masking

Form: TypeAlias = Literal["released", "squared"]
"""How wide a lobe a roughness means, see the module."""

Responses: TypeAlias = tuple[Tensor, Tensor, Tensor]
"""What points answer to directions, without colour, (P, D) each: see `responses`."""


@dataclass(frozen=True, eq=False)
class Material:
    """What P points are made of: albedo (P, 3), roughness (P) and metallic (P), all in [0, 1]."""

    albedo: Tensor
    roughness: Tensor
    metallic: Tensor

    def of(self, points: Tensor | slice) -> Material:
        """That of some of the points."""
        return Material(self.albedo[points], self.roughness[points], self.metallic[points])


def responses(normal: Tensor, view: Tensor, roughness: Tensor, light: Tensor, form: Form = "released") -> Responses:
    """What P points answer to D directions, without colour: the cosine, and the lobe's two parts, (P, D) each.

    normal and view (P, 3) unit, roughness (P), light (D, 3) for all points or (P, D, 3), unit, towards the light. The
    lobe is D G cos / (4 n.w n.d) times 1 - S and times S, S the power of two in F. Zero where light or viewer is not
    above the surface. Differentiable in all of them.
    """
    to_light, across = _dots(light, normal), _dots(light, view)
    to_view = (normal * view).sum(-1)[:, None]
    above = (to_light > 0) & (to_view > 0)
    length2 = (2.0 + 2.0 * across).clamp_min(SMALL)  # |w + d|^2
    sine2 = (1.0 - (to_light + to_view).square() / length2).clamp(0.0, 1.0)
    facing = 0.5 * length2.sqrt()
    cosine, rough = to_light.clamp_min(0.0) * above, clamp_roughness(roughness)[:, None]
    peak = distribution(sine2, rough.sqrt() if form == "released" else rough)  # which takes the root of its width
    lobe = 0.25 * cosine * peak * masking(cosine, rough) * masking(to_view.clamp_min(0.0), rough)
    edge = torch.exp2((F1 * facing + F2) * facing)
    return cosine, lobe * (1.0 - edge), lobe * edge


def coloured(material: Material, answers: Responses, power: Tensor) -> Tensor:
    """Radiance (P, 3) that points send back: their `responses` to directions, from which comes `power`.

    power (D, 3), or (P, D, 3) if every point has its own directions or shadows: radiance times solid angle for
    samples of a sphere, irradiance on a facing surface for distant lights.
    """
    pattern = "pd,dc->pc" if power.ndim == 2 else "pd,pdc->pc"
    diffuse, head_on, edge = (torch.einsum(pattern, answer, power) for answer in answers)
    metallic = material.metallic[:, None]
    return (
        (1.0 - metallic) * material.albedo * diffuse / math.pi
        + base_reflectance(material.albedo, metallic) * head_on
        + edge
    )


def seen_through(answers: Responses, seen: Tensor) -> Responses:
    """The responses (P, D) to light of which points see so much, (P, D) in [0, 1]."""
    diffuse, head_on, edge = answers
    return diffuse * seen, head_on * seen, edge * seen


def width(roughness: Tensor, form: Form) -> Tensor:
    """The width alpha of GGX that a roughness means."""
    rough = clamp_roughness(roughness)
    return rough if form == "released" else rough.square()


def _dots(light: Tensor, vector: Tensor) -> Tensor:
    """Cosines (P, D) of directions (D, 3) or (P, D, 3) with one vector (P, 3) each."""
    return vector @ light.T if light.ndim == 2 else (light @ vector[:, :, None])[..., 0]
