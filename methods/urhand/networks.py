"""The networks of URHand with the channel sizes of its supplementary material, for any texture size 64 k.

PhysicalBranch     mean texture and pose -> displacement, roughness, joint feature   (Sec. 4.2)
NeuralBranch       joint feature and shading features -> gain and bias maps          (Sec. 4.3)
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from ..nets.layers import Down, Keep, Up, activate, concat, initialise, tile_pose

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


class LinearEncoder(nn.Module):
    """Shading features (B, C, R, R) -> one map per layer of the decoder, coarse to fine; no bias, no activation."""

    def __init__(self, inputs: int = 2) -> None:
        super().__init__()
        fine_to_coarse = BRANCH_CHANNELS[-2::-1]  # 16 32 64 128 128 256 128
        self.first = Keep(inputs, fine_to_coarse[0], bias=False)
        self.layers = nn.ModuleList(Down(i, o, bias=False) for i, o in pairwise(fine_to_coarse))
        initialise(self, activated=False)

    def forward(self, features: Tensor) -> list[Tensor]:
        maps = [self.first(features)]
        for layer in self.layers:
            maps.append(layer(maps[-1]))
        return maps[::-1]


class LinearDecoder(nn.Module):
    """F_dec^{j+1} = ConvT(F_enc^j + F_dec^j) / sqrt(2) * F_nl^j (URHand Eq. 5); no bias, no activation."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = _upward(bias=False)
        initialise(self, activated=False)

    @property
    def convolutions(self) -> list[Keep]:
        return _convolutions(self.layers)

    def forward(self, encoded: list[Tensor], modulation: list[Tensor]) -> Tensor:
        x: Tensor | None = None
        for layer, code, factor in zip(self.layers, encoded, modulation, strict=True):
            x = layer(code if x is None else code + x) * factor * 2**-0.5
        assert x is not None
        return x


class NeuralBranch(nn.Module):
    """Gain (B, 3, R, R) and bias (B, 1, R, R) maps, linear in the shading features (B, 2, R, R) by construction.

    It starts as the physical branch, gain = C^d and bias = C^s: the finest layer passes both features through and
    everything else begins small. Training then only has to learn what the physics lacks.
    """

    def __init__(self, bias_scale: float) -> None:
        super().__init__()
        self.nonlinear = NonLinearNetwork()
        self.encoder = LinearEncoder()
        self.decoder = LinearDecoder()
        self._start_as_physics(bias_scale)

    @torch.no_grad()
    def _start_as_physics(self, bias_scale: float) -> None:
        for layer in self.nonlinear.convolutions:  # modulation near one
            layer.weight.mul_(0.3)
            layer.bias.fill_(1.0)  # type: ignore[union-attr]
        self.nonlinear.convolutions[-1].weight.mul_(0.3)
        first, last = self.encoder.first.weight, self.decoder.convolutions[-1].weight
        self.decoder.convolutions[-2].weight.mul_(0.1)
        last.mul_(0.1)
        first[:2] = 0.0
        last[:, :2] = 0.0
        for feature in range(2):
            first[feature, feature, 1, 1] = 1.0
        last[:3, 0, 1, 1] = 2**0.5
        last[3, 1, 1, 1] = 2**0.5 / bias_scale

    def forward(self, features: Tensor, joint: Tensor) -> tuple[Tensor, Tensor, list[Tensor]]:
        """Gain, bias and the encoder's maps (for the L1 regularisation, Eq. 9)."""
        encoded = self.encoder(features)
        maps = self.decoder(encoded, self.nonlinear(joint))
        return maps[:, :3], maps[:, 3:], encoded


def _upward(bias: bool) -> nn.ModuleList:
    """The seven layers of `BRANCH_CHANNELS`: six that double, one that keeps the size."""
    pairs = list(pairwise(BRANCH_CHANNELS))
    return nn.ModuleList([*(Up(i, o, bias) for i, o in pairs[:HALVINGS]), Keep(*pairs[-1], bias)])


def _convolutions(layers: nn.ModuleList) -> list[Keep]:
    return [layer.conv if isinstance(layer, Up) else layer for layer in layers]  # type: ignore[misc]
