"""URHand: from a mean texture, a pose and light to the texture that is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from handbench.light.lightset import LightSet
from handbench.render.atlas import Atlas
from handbench.render.posed import PosedSurface
from handbench.render.shading import light_features
from handbench.render.surface import refine
from handbench.scene import Array

from ..nets.layers import channels_last
from .config import Config
from .networks import NeuralBranch, PhysicalBranch


@dataclass(frozen=True)
class Material:
    """What the physical branch makes of a pose: refined unit normal (3, N), roughness (N), joint feature."""

    normal: Tensor
    roughness: Tensor
    joint: Tensor


class URHandModel(nn.Module):
    """Both branches. Maps are at the covered texels, (C, N), between the networks and (1, C, R, R) inside them."""

    def __init__(self, config: Config, joints: int) -> None:
        super().__init__()
        self.config = config
        self.physical = PhysicalBranch(3 * joints)
        self.neural = NeuralBranch(config.bias_scale)
        channels_last(self)

    def material(self, texture: Tensor, joints: Tensor, posed: PosedSurface) -> Material:
        """Refined normal and roughness of a posed surface from the normalised mean texture (3, R, R), pose (J, 3)."""
        raw_displacement, raw_roughness, joint = self.physical(_batch(texture), joints.reshape(1, -1))
        config, atlas = self.config, posed.atlas
        # the paper's sigmoid, centred: a constant displacement only thickens the hand
        displacement = config.displacement * (2.0 * torch.sigmoid(raw_displacement[0]) - 1.0)
        low, high = config.roughness
        roughness = low + (high - low) * torch.sigmoid(atlas.gather(raw_roughness[0, 0]))
        refined = refine(atlas.scatter(posed.position), atlas.scatter(posed.normal), displacement, atlas)
        return Material(atlas.gather(refined), roughness, joint)

    def features(
        self, material: Material, posed: PosedSurface, camera_centre: Array, lights: LightSet, visible: Tensor
    ) -> Tensor:
        """Diffuse and specular shading features, (6, N) (supp. Eqs. 1-2)."""
        return torch.cat(
            light_features(material.normal, posed.position, material.roughness, camera_centre, lights, visible)
        )

    def physical_colour(self, features: Tensor, texture: Tensor, atlas: Atlas) -> Tensor:
        """The physical branch's own picture (3, N): C^d T + C^s (Eq. 3)."""
        return features[:3] * atlas.gather(texture) + features[3:]

    def colour(
        self, features: Tensor, material: Material, texture: Tensor, atlas: Atlas
    ) -> tuple[Tensor, list[Tensor]]:
        """The final picture's texture (3, N), g T + b sigma_T (Eq. 6), and the encoder's maps.

        The network sees the features of a light's intensity, one diffuse and one specular value a texel (supp.
        Eqs. 1-2 have a scalar L_i). Coloured light is three lights, one a colour channel, each of which answers
        for its own channel of the picture; for white light the three are one.
        """
        lights = features.reshape(2, 3, -1).transpose(0, 1)  # colour channel, (diffuse, specular), texel
        if torch.equal(lights[0], lights[1]) and torch.equal(lights[0], lights[2]):
            lights = lights[:1]
        maps = atlas.dilate(atlas.scatter(lights)).contiguous(memory_format=torch.channels_last)
        gain, bias, encoded = self.neural(maps, material.joint)
        own = torch.arange(3) if len(lights) == 3 else torch.zeros(3, dtype=torch.long)
        gain, bias = atlas.gather(gain)[own, torch.arange(3)], atlas.gather(bias)[own, 0]
        return gain * atlas.gather(texture) + bias * self.config.bias_scale, encoded


def _batch(maps: Tensor) -> Tensor:
    return maps[None].contiguous(memory_format=torch.channels_last)
