"""A perceptual image loss: distances between the features of a network that ships with the package."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from handbench.metrics.networks import features

WEIGHTS = (0.8, 0.1, 0.1)
"""Of AlexNet's first three layers. URHand's released code weighs three layers of an EfficientNet-B0 so; its weights
are not shipped here, and AlexNet's are, as those of LPIPS-Alex: read that metric with this loss in mind."""

PATCH = 64
"""Pixels along a patch: a random one a step costs a quarter of the whole picture and has its gradient on average."""

_LEAST = 32  # pixels: the smallest side that AlexNet's layers take


def patch(height: int, width: int, rng: np.random.Generator) -> tuple[slice, slice]:
    """Rows and columns of a random patch of a picture, or all of them where it is smaller."""
    top, left = (int(rng.integers(max(1, side - PATCH + 1))) for side in (height, width))
    return slice(top, top + PATCH), slice(left, left + PATCH)


def perceptual_loss(pictures: Tensor, truth: Tensor) -> Tensor:
    """Weighted mean absolute difference of features, one value for each of B pictures (B, 3, H, W) of display values.

    truth (3, H, W) or (B, 3, H, W). Values are clipped to [0, 1], as the networks know no others; sides below 32
    pixels are padded with black.
    """
    count = len(pictures)
    both = torch.cat([pictures, truth.expand(count, -1, -1, -1) if truth.ndim == 4 else truth[None]]).clamp(0.0, 1.0)
    height, width = both.shape[-2:]
    if min(height, width) < _LEAST:
        both = torch.nn.functional.pad(both, (0, max(0, _LEAST - width), 0, max(0, _LEAST - height)))
    total = both.new_zeros(count)
    for weight, layer in zip(WEIGHTS, features("alex", both, len(WEIGHTS)), strict=True):
        total = total + weight * (layer[:count] - layer[count:]).abs().mean(dim=(1, 2, 3))
    return total
