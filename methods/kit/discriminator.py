"""The adversary of a relighting network: patches of pictures, real or drawn, at several scales, with a condition.

URHand Eq. 8, hinge form, multi-scale. "Light-aware" means that the discriminator also sees the diffuse and specular
Phong shading of the light: it then judges whether a picture fits its light, not only whether it looks like a hand.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from .layers import Down, Keep, activate, channels_last, initialise

CHANNELS = (32, 64, 128)
SCALES = 2


class Discriminator(nn.Module):
    """Patch scores of pictures (B, 3, H, W) beside conditions (B, C, H, W), one map a scale."""

    def __init__(self, conditions: int) -> None:
        super().__init__()
        self.scales = nn.ModuleList(_patches(3 + conditions) for _ in range(SCALES))
        initialise(self, activated=True)
        channels_last(self)

    def forward(self, pictures: Tensor, condition: Tensor | None) -> list[Tensor]:
        x = pictures if condition is None else torch.cat([pictures, condition.expand(len(pictures), -1, -1, -1)], dim=1)
        x = x.contiguous(memory_format=torch.channels_last)
        scores = []
        for i, layers in enumerate(self.scales):
            y = nn.functional.avg_pool2d(x, 2**i) if i else x
            for layer in layers[:-1]:  # type: ignore[index]
                y = activate(layer(y))
            scores.append(layers[-1](y))  # type: ignore[index]
        return scores


def _patches(inputs: int) -> nn.ModuleList:
    sizes = pairwise((inputs, *CHANNELS))
    return nn.ModuleList([*(Down(i, o) for i, o in sizes), Keep(CHANNELS[-1], 1)])


def generator_loss(fake: list[Tensor]) -> Tensor:
    """What the generator minimises: minus the mean patch score, averaged over the scales."""
    return -torch.stack([scores.mean() for scores in fake]).mean()


def discriminator_loss(real: list[Tensor], fake: list[Tensor]) -> Tensor:
    """The hinge loss of the discriminator, averaged over the scales."""
    margins = [(1.0 - r).relu().mean() + (1.0 + f).relu().mean() for r, f in zip(real, fake, strict=True)]
    return torch.stack(margins).mean()
