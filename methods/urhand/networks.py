"""The networks of URHand with the channel sizes of its supplementary material, for any texture size 64 k.

PhysicalBranch     mean texture and pose -> displacement, roughness, joint feature   (Sec. 4.2)
NeuralBranch       joint feature and shading features -> gain and bias maps          (Sec. 4.3)
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from ..kit.layers import Down, Keep, Up, activate, concat, initialise, tile_pose

# Sec. 4.2: six layers each way, all inner channels 64; six halvings take 1024 texels to the 16 of Sec. 5.2.
UNET_CHANNELS = (3, 64, 64, 64, 64, 64, 64)
# Sec. 4.3: the non-linear network and the linear decoder; six doublings and a last layer at full size.
BRANCH_CHANNELS = (128, 256, 128, 128, 64, 32, 16, 4)
HALVINGS = len(UNET_CHANNELS) - 1
POSE_CHANNELS = BRANCH_CHANNELS[0] - UNET_CHANNELS[-1]


class PhysicalBranch(nn.Module):
    """U-Net from the mean texture (B, 3, R, R) and pose (B, P) to displacement, roughness and joint feature.

    Both outputs are raw maps (B, 1, R, R): `model.py` turns them into metres and into a roughness.
    """

    def __init__(self, pose_size: int) -> None:
        super().__init__()
        pairs = list(pairwise(UNET_CHANNELS))
        self.encoder = nn.ModuleList(Down(i, o) for i, o in pairs)
        self.pose = nn.Linear(pose_size, POSE_CHANNELS)
        widths = [BRANCH_CHANNELS[0], *[64 + 64] * (HALVINGS - 1)]  # every later layer also sees its skip connection
        self.decoder = nn.ModuleList(Up(i, o) for i, o in zip(widths, [64] * (HALVINGS - 1) + [2], strict=True))
        initialise(self, activated=True)
        last = self.decoder[-1]
        assert isinstance(last, Up)
        nn.init.normal_(last.conv.weight, std=1e-3)  # start at the coarse surface with the middle roughness

    def forward(self, texture: Tensor, pose: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        skips, x = [], texture
        for layer in self.encoder:
            x = activate(layer(x))
            skips.append(x)
        joint = concat(x, tile_pose(activate(self.pose(pose)), x))
        x = joint
        for j, layer in enumerate(self.decoder):
            x = layer(x)
            if j < HALVINGS - 1:
                x = concat(activate(x), skips[HALVINGS - 2 - j])
        return x[:, :1], x[:, 1:], joint


class NonLinearNetwork(nn.Module):
    """Joint feature (B, 128, R/64, R/64) -> one modulation map per layer of the linear decoder."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = _upward(bias=True)
        initialise(self, activated=True)

    @property
    def convolutions(self) -> list[Keep]:
        return _convolutions(self.layers)

    def forward(self, joint: Tensor) -> list[Tensor]:
        maps, x = [], joint
        for layer in self.layers:
            x = activate(layer(x))
            maps.append(x)
        return maps


class FeatureEncoder(nn.Module):
    """Shading features (B, C, R, R) -> one map per layer of the decoder, coarse to fine; no bias.

    No activation either, unless `activated`: the non-linear model of supp. Sec. 5.2.
    """

    def __init__(self, inputs: int = 2, activated: bool = False) -> None:
        super().__init__()
        self._activated = activated
        fine_to_coarse = BRANCH_CHANNELS[-2::-1]  # 16 32 64 128 128 256 128
        self.first = Keep(inputs, fine_to_coarse[0], bias=False)
        self.layers = nn.ModuleList(Down(i, o, bias=False) for i, o in pairwise(fine_to_coarse))
        initialise(self, activated)

    def forward(self, features: Tensor) -> list[Tensor | None]:
        maps, x = [], features
        for layer in (self.first, *self.layers):
            x = activate(layer(x)) if self._activated else layer(x)
            maps.append(x)
        return maps[::-1]


class EnvironmentEncoder(nn.Module):
    """An environment map (B, 3, 16, 32) -> the decoder's first map: one layer without bias (supp. Sec. 5.2).

    The seed's map is 128 x 16 x 16, at 1024 texels; it has the side of the decoder's first layer at any texture size.
    """

    def __init__(self, side: int, environment: tuple[int, int]) -> None:
        super().__init__()
        self.side = side
        inputs = 3 * environment[0] * environment[1]
        self.layer = nn.Linear(inputs, BRANCH_CHANNELS[0] * side * side, bias=False)
        nn.init.normal_(self.layer.weight, std=inputs**-0.5)

    def forward(self, environment: Tensor) -> list[Tensor | None]:
        coarse = self.layer(environment.flatten(1)).unflatten(1, (BRANCH_CHANNELS[0], self.side, self.side))
        return [coarse, *[None] * (len(BRANCH_CHANNELS) - 2)]


class Decoder(nn.Module):
    """F_dec^{j+1} = ConvT(F_enc^j + F_dec^j) / sqrt(2) * F_nl^j (URHand Eq. 5); no bias.

    No activation either, unless `activated`.
    """

    def __init__(self, activated: bool = False) -> None:
        super().__init__()
        self._activated = activated
        self.layers = _upward(bias=False)
        initialise(self, activated)

    @property
    def convolutions(self) -> list[Keep]:
        return _convolutions(self.layers)

    def forward(self, encoded: list[Tensor | None], modulation: list[Tensor]) -> Tensor:
        """Gain and bias maps, (B, 4, R, R). Without gradients the encoder's maps are overwritten."""
        if not (self._activated or torch.is_grad_enabled()):
            return self._in_place(encoded, modulation)
        x: Tensor | None = None
        for layer, code, factor in zip(self.layers, encoded, modulation, strict=True):
            inputs = code if x is None else x if code is None else code + x
            x = layer(inputs) * (factor * 2**-0.5)  # one map for all colours: the pictures' are many times larger
            if self._activated:
                x = activate(x)
        assert x is not None
        return x

    def _in_place(self, encoded: list[Tensor | None], modulation: list[Tensor]) -> Tensor:
        """The same in fewer passes over maps and without new ones: the finest are larger than a cache."""
        x = encoded[0]
        for layer, code, factor in zip(self.layers, [*encoded[1:], None], modulation, strict=True):
            answer = layer(x)
            x = answer.mul_(factor * 2**-0.5) if code is None else code.addcmul_(answer, factor, value=2**-0.5)
        assert x is not None
        return x


class NeuralBranch(nn.Module):
    """Gain (B, 3, R, R) and bias (B, 1, R, R) maps from an encoding of the light, linear in it by construction.

    With shading features it starts as the physical branch, gain = C^d and bias sigma_T = C^s: the finest layer passes
    both features through and everything else adds nothing yet. Training then only has to learn what the physics lacks.
    """

    def __init__(self, encoder: FeatureEncoder | EnvironmentEncoder, activated: bool, bias_scale: float) -> None:
        super().__init__()
        self.nonlinear = NonLinearNetwork()
        self.encoder = encoder
        self.decoder = Decoder(activated)
        self._modulate_near_one()
        if isinstance(encoder, FeatureEncoder):
            self._start_as_physics(encoder, bias_scale)

    @torch.no_grad()
    def _modulate_near_one(self) -> None:
        for layer in self.nonlinear.convolutions:
            layer.weight.mul_(0.3)
            layer.bias.fill_(1.0)  # type: ignore[union-attr]

    @torch.no_grad()
    def _start_as_physics(self, encoder: FeatureEncoder, bias_scale: float) -> None:
        # Exactly, whatever the seed: seven layers multiply, so small random weights can still give a far-off start.
        self.nonlinear.convolutions[-1].weight.zero_()
        before, last = (layer.weight for layer in self.decoder.convolutions[-2:])
        before.mul_(0.1)
        before[:2] = 0.0
        encoder.first.weight[:2] = 0.0
        last.zero_()
        for feature in range(2):
            encoder.first.weight[feature, feature, 1, 1] = 1.0
        last[:3, 0, 1, 1] = 2**0.5
        last[3, 1, 1, 1] = 2**0.5 / bias_scale

    def forward(self, light: Tensor, modulation: list[Tensor]) -> tuple[Tensor, Tensor, list[Tensor]]:
        """Gain, bias and the encoder's maps (for the L1 regularisation, Eq. 9); no maps without gradients.

        `modulation` is what `nonlinear` answers to the joint feature: the same under every light.
        """
        encoded = self.encoder(light)
        maps = self.decoder(encoded, modulation)
        kept = [code for code in encoded if code is not None] if torch.is_grad_enabled() else []
        return maps[:, :3], maps[:, 3:], kept


def _upward(bias: bool) -> nn.ModuleList:
    """The seven layers of `BRANCH_CHANNELS`: six that double, one that keeps the size."""
    pairs = list(pairwise(BRANCH_CHANNELS))
    return nn.ModuleList([*(Up(i, o, bias) for i, o in pairs[:HALVINGS]), Keep(*pairs[-1], bias)])


def _convolutions(layers: nn.ModuleList) -> list[Keep]:
    return [layer.conv if isinstance(layer, Up) else layer for layer in layers]  # type: ignore[misc]
