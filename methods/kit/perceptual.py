"""A perceptual image loss: distances between the features of a network that ships with the package."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .alexnet import features

WEIGHTS = (0.8, 0.1, 0.1)
"""Of AlexNet's first three layers. URHand's released code weighs three layers of an EfficientNet-B0 so; its weights
are not shipped here, and AlexNet's are, in a copy of the methods' own. LPIPS-Alex looks at pictures with the same
weights: read that metric with this loss in mind."""

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
    with torch.no_grad():
        wanted = _features(truth if truth.ndim == 4 else truth[None])
    total = pictures.new_zeros(len(pictures))
    for weight, drawn, true in zip(WEIGHTS, _features(pictures), wanted, strict=True):
        total = total + weight * (drawn - true).abs().mean(dim=(1, 2, 3))
    return total


def _features(pictures: Tensor) -> list[Tensor]:
    """The features of (B, 3, H, W) by layer."""
    clipped = pictures.clamp(0.0, 1.0)
    height, width = clipped.shape[-2:]
    if min(height, width) < _LEAST:
        clipped = torch.nn.functional.pad(clipped, (0, max(0, _LEAST - width), 0, max(0, _LEAST - height)))
    return features(clipped)
