"""The first layers of AlexNet, trained on ImageNet, as methods look at pictures with them.

A copy of its own: what a method is trained with changes only with the method, never with the metrics that judge it.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor
from torch.nn.functional import conv2d, max_pool2d

from handbench.errors import InputError

_FILE = Path(__file__).parent / "weights" / "alexnet.safetensors"
# mean and standard deviation of ImageNet, moved to images in [-1, 1] (lpips 0.1.4, ScalingLayer)
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
_LAYERS = ((False, 4, 2), (True, 1, 2), (True, 1, 1))  # pooled before, stride, padding


@cache
def _weights() -> tuple[tuple[Tensor, Tensor], ...]:
    """Kernels (O, I, h, w) float32, channels last in memory, and biases (O,) by layer."""
    try:
        stored = load_file(_FILE)
    except Exception as error:  # safetensors raises its own types for a damaged file
        raise InputError(f"weights {_FILE} cannot be read ({error}); install handbench again") from error
    return tuple(
        (
            stored[f"conv{i}.weight"].float().contiguous(memory_format=torch.channels_last),
            stored[f"conv{i}.bias"].float(),
        )
        for i in range(len(_LAYERS))
    )


def features(images: Tensor) -> list[Tensor]:
    """Features (N, C, h, w) after each of the first three layers, of images (N, 3, H, W) in [0, 1].

    Images are at least 32 pixels wide and high. Raises `InputError` if the weights are missing or damaged.
    """
    shift, scale = (images.new_tensor(v).view(1, 3, 1, 1) for v in (_SHIFT, _SCALE))
    x = ((2.0 * images - 1.0 - shift) / scale).contiguous(memory_format=torch.channels_last)
    found = []
    for (pooled, stride, padding), (weight, bias) in zip(_LAYERS, _weights(), strict=True):
        if pooled:
            x = max_pool2d(x, 3, 2)
        x = conv2d(x, weight.to(x.device), bias.to(x.device), stride, padding).relu_()
        found.append(x)
    return found
