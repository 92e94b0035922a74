"""URHand: from a mean texture, a pose and light to the texture that is drawn."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from handbench.light.lightset import LightSet
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.posed import PosedSurface

from ..kit.layers import channels_last
from . import lighting
from .config import UrhandConfig
from .networks import HALVINGS, EnvironmentEncoder, FeatureEncoder, NeuralBranch, PhysicalBranch


@dataclass(frozen=True)
class RefinedMaps:
    """What the networks make of a pose alone: refined unit normal (3, N), roughness (N), and the maps that modulate
    the layers of the neural branch's decoder, none without that branch."""

    normal: Tensor
    roughness: Tensor
    modulation: list[Tensor]


class URHandModel(nn.Module):
    """Both branches. Maps are at the covered texels, (C, N), between the networks and (1, C, R, R) inside them.

    Networks run in bfloat16 if the configuration says so; everything that comes in or goes out is float32. All of it
    is on the `device` of the parameters.
    """

    def __init__(self, config: UrhandConfig, joints: int) -> None:
        super().__init__()
        self.config = config
        self.physical = PhysicalBranch(3 * joints)
        if config.neural:
            activated = config.network == "non-linear"
            encoder = (
                FeatureEncoder(activated=activated)
                if config.encoder == "features"
                else EnvironmentEncoder(config.texture >> HALVINGS, config.environment)
            )
            self.neural = NeuralBranch(encoder, activated, config.bias_scale)
        channels_last(self)

    def material(self, texture: Tensor, joints: Tensor, posed: PosedSurface) -> RefinedMaps:
        """Refined normal and roughness of a posed surface from the normalised mean texture (3, R, R), pose (J, 3)."""
        with self._precision():
            raw_displacement, raw_roughness, joint = self.physical(
                self._batch(texture[None]), self._batch(joints.reshape(1, -1))
            )
            modulation = self.neural.nonlinear(joint) if self.config.neural else []
        config, atlas = self.config, posed.atlas
        low, high = config.roughness
        roughness = low + (high - low) * torch.sigmoid(atlas.gather(raw_roughness.float()[0, 0]))
        if not config.refiner:
            return RefinedMaps(posed.normal, roughness, modulation)
        # the paper's sigmoid, centred: a constant displacement only thickens the hand
        sigmoid = torch.sigmoid(atlas.gather(raw_displacement.float()[0]))
        return RefinedMaps(posed.relief.refined(config.displacement * (2.0 * sigmoid - 1.0)), roughness, modulation)

    def physical_colour(self, features: Tensor, texture: Tensor, atlas: Atlas) -> Tensor:
        """The physical branch's own picture (3, N): C^d T + C^s (Eq. 3)."""
        return features[:3] * atlas.gather(texture) + features[3:]

    def colour(
        self, features: Tensor, lights: LightSet, material: RefinedMaps, texture: Tensor, atlas: Atlas
    ) -> tuple[Tensor, list[Tensor]]:
        """The final picture's texture (3, N), g T + b sigma_T (Eq. 6), and the encoder's maps (for Eq. 9)."""
        if not self.config.neural:
            return self.physical_colour(features, texture, atlas), []
        scale = lighting.power(lights).clamp_min(1e-12) if self.config.exposure else 1.0
        gain, bias, encoded = self.response(features / scale, lights, material, atlas)
        return scale * (gain * atlas.gather(texture) + bias * self.config.bias_scale), encoded

    def response(
        self, features: Tensor, lights: LightSet, material: RefinedMaps, atlas: Atlas
    ) -> tuple[Tensor, Tensor, list[Tensor]]:
        """Gain and bias at the texels, (3, N) each, and the encoder's maps.

        The network sees the features of a light's intensity, one diffuse and one specular value a texel (supp.
        Eqs. 1-2 have a scalar L_i). Coloured light is three lights, one a colour channel, each of which answers
        for its own channel of the picture; for white light the three are one. An environment map is seen whole.
        """
        if self.config.encoder == "environment":
            inputs = lighting.environment_map(lights, self.config.environment)[None].to(self.device)
            count = 1
        else:
            coloured = features.reshape(2, 3, -1).transpose(0, 1)  # colour channel, (diffuse, specular), texel
            count = 1 if torch.equal(coloured[0], coloured[1]) and torch.equal(coloured[0], coloured[2]) else 3
            inputs = atlas.dilate(atlas.scatter(coloured[:count]))
        with self._precision():
            gain, bias, encoded = self.neural(self._batch(inputs), material.modulation)
        bias = atlas.gather(bias.float())[:, 0]
        if count == 3:  # of each light's answer its own channel
            return atlas.gather(gain.diagonal().movedim(-1, 0).float()), bias, encoded
        return atlas.gather(gain.float())[0], bias.expand(3, -1), encoded

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.physical.pose.weight.device

    def _batch(self, values: Tensor) -> Tensor:
        """Maps with the channels last."""
        return values.contiguous(memory_format=torch.channels_last) if values.ndim == 4 else values

    def _precision(self) -> AbstractContextManager[object]:
        return torch.autocast(self.device.type, torch.bfloat16) if self.config.bfloat16 else nullcontext()
