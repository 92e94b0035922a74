"""Convolution blocks of the hand models: halve, double, keep; with or without bias and activation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

LEAK = 0.2


class Down(nn.Conv2d):
    """Halves the side of a map: 4x4 convolution with stride 2."""

    def __init__(self, inputs: int, outputs: int, bias: bool = True) -> None:
        super().__init__(inputs, outputs, 4, stride=2, padding=1, bias=bias)


class Keep(nn.Conv2d):
    """Keeps the side of a map: 3x3 convolution."""

    def __init__(self, inputs: int, outputs: int, bias: bool = True) -> None:
        super().__init__(inputs, outputs, 3, padding=1, bias=bias)

    def forward(self, x: Tensor) -> Tensor:
        if x.shape[-2:] == (1, 1):  # the kernel's centre does it all; oneDNN's gradient of this varies from run to run
            return nn.functional.linear(x[:, :, 0, 0], self.weight[:, :, 1, 1], self.bias)[:, :, None, None]
        return super().forward(x)


class Up(nn.Module):
    """Doubles the side of a map: a transposed convolution, then bilinear interpolation (URHand supp. Sec. 4.2).

    At stride 1 a transposed convolution is a convolution with its kernel turned, which runs faster.
    """

    def __init__(self, inputs: int, outputs: int, bias: bool = True) -> None:
        super().__init__()
        self.conv = Keep(inputs, outputs, bias)

    def forward(self, x: Tensor) -> Tensor:
        return nn.functional.interpolate(self.conv(x), scale_factor=2, mode="bilinear", align_corners=False)


def initialise(module: nn.Module, activated: bool) -> None:
    """Weights that keep the second moment of a unit-variance input, with or without a leaky ReLU behind; zero bias."""
    gain = nn.init.calculate_gain("leaky_relu", LEAK) if activated else 1.0
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d):
            inputs = layer.in_channels * layer.kernel_size[0] * layer.kernel_size[1]
            nn.init.normal_(layer.weight, std=gain / inputs**0.5)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)


def activate(x: Tensor) -> Tensor:
    """Leaky ReLU with slope 0.2 below zero."""
    return nn.functional.leaky_relu(x, LEAK)


def tile_pose(pose: Tensor, like: Tensor) -> Tensor:
    """A pose code (B, C) as a map (B, C, h, w) of the size of `like`."""
    return pose[:, :, None, None].expand(-1, -1, *like.shape[-2:])


def concat(*maps: Tensor) -> Tensor:
    """Maps side by side along their channels."""
    return torch.cat(maps, dim=1)


def channels_last(module: nn.Module) -> None:
    """Lay out convolution weights with the channels last: 2 to 4 times faster on CPUs, the same values."""
    for parameter in module.parameters():
        if parameter.ndim == 4:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
