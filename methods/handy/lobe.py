"""The specular parts that an albedo is drawn with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never

import torch

from handbench.render.shade.brdf import specular
from handbench.render.shade.shading import Model

from .config import Reflectance


@dataclass(frozen=True)
class Lobe:
    """A model of `render.shade` with its roughness, and the share of its specular feature that is added."""

    model: Model
    roughness: float
    strength: float


def lobe(reflectance: Reflectance, roughness: float) -> Lobe:
    """GGX of a roughness, or Phong's lobe, whose highlight is as bright as that of GGX where light and camera are
    straight above. Phong told no amount, and URHand's authors tell none."""
    match reflectance:
        case "ggx":
            return Lobe("brdf", roughness, 1.0)
        case "phong":
            up = torch.tensor([0.0, 0.0, 1.0])
            return Lobe("phong", roughness, float(specular(up, up, up, torch.tensor(roughness))))
        case _:
            assert_never(reflectance)
