"""The texture decoder of RelightableHands: a U-Net over UV maps with the pose at its bottleneck.

It sees no texture of the subject, so what makes one identity differ from texel to texel can only be in its weights:
every layer has a bias of its own at every texel ("untied"), as in the released code.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..kit.layers import Down, Keep, Up, activate, concat, initialise, tile_pose

INPUTS = 7  # view direction, light direction, visibility
OUTPUTS = 4  # texture, shadow
HALVINGS = 5  # the released code has five layers each way, all of 64 channels
CHANNELS = 64
FINEST = 32  # of the map that is doubled to full size

_VISIBLE = 4.0  # how much larger the shadow map starts where a texel sees the light


class Untied(nn.Module):
    """A layer, plus a bias (side, side, C) for every texel and channel of its answer."""

    def __init__(self, layer: nn.Module, channels: int, side: int) -> None:
        super().__init__()
        self.layer = layer
        self.bias = nn.Parameter(torch.zeros(side, side, channels))

    def forward(self, x: Tensor) -> Tensor:
        # Flat, as the maps lie in memory: torch sums the gradients of a batch 30 times faster so.
        flat = self.layer(x).permute(0, 2, 3, 1).flatten(1) + self.bias.flatten()
        return flat.unflatten(1, self.bias.shape).permute(0, 3, 1, 2)


class TextureDecoder(nn.Module):
    """Inputs (B, 7, R, R) and pose (1, P) -> raw texture T (B, 3, R, R) and shadow S (B, 1, R, R) of Eq. 7."""

    def __init__(self, pose_size: int, size: int) -> None:
        super().__init__()
        sides = [size >> j for j in range(HALVINGS + 1)]
        self.encoder = nn.ModuleList(
            Untied(Down(INPUTS if j == 0 else CHANNELS, CHANNELS, bias=False), CHANNELS, sides[j + 1])
            for j in range(HALVINGS)
        )
        self.pose = nn.Linear(pose_size, CHANNELS)
        widths = [FINEST if j == 0 else CHANNELS for j in reversed(range(HALVINGS))]
        # beside what comes from below, the first layer sees the pose and every later one its skip connection
        self.decoder = nn.ModuleList(
            Untied(Up(2 * CHANNELS, width, bias=False), width, side)
            for width, side in zip(widths, sides[-2::-1], strict=True)
        )
        last = Keep(FINEST + INPUTS, OUTPUTS, bias=False)
        self.last = Untied(last, OUTPUTS, size)
        initialise(self, activated=True)
        with torch.no_grad():
            # Start with the visibility for shadow, which the released code uses for its first 1,000 steps, and with
            # a texture that is above zero, where the ReLU of Eq. 7 has a gradient.
            last.weight.mul_(0.1)
            last.weight[3, -1, 1, 1] = _VISIBLE
            self.last.bias[..., 3] = -_VISIBLE / 2.0
            self.last.bias[..., :3] = 1.0

    def forward(self, inputs: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        skips, x = [], inputs
        for layer in self.encoder:
            x = activate(layer(x))
            skips.append(x)
        code = activate(self.pose(pose)).expand(len(inputs), -1)
        x = concat(x, tile_pose(code, x))
        for layer, beside in zip(self.decoder, [*skips[-2::-1], inputs], strict=True):
            x = concat(activate(layer(x)), beside)
        maps = self.last(x)
        return maps[:, :3], maps[:, 3:]
