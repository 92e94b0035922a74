"""The convolutions of AlexNet and VGG-16, as feature extractors, with the weights in `weights/` (see NOTICE there)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import prod
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch import Tensor
from torch.nn.functional import conv2d, max_pool2d

from handbench.errors import InputError

from . import winograd

FOLDER = Path(__file__).parent / "weights"
# mean and standard deviation of ImageNet, moved to images in [-1, 1] (lpips 0.1.4, ScalingLayer)
SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)


class ConvStage(NamedTuple):
    """Max pooling (window, stride; none if the window is 1), then convolutions (stride, padding) with ReLU."""

    pool: tuple[int, int]
    convolutions: tuple[tuple[int, int], ...]


# features are taken after every stage: relu1 … relu5 of AlexNet, relu1_2, 2_2, 3_3, 4_3, 5_3 of VGG-16
STAGES = {
    "alex": (
        ConvStage((1, 1), ((4, 2),)),
        ConvStage((3, 2), ((1, 2),)),
        ConvStage((3, 2), ((1, 1),)),
        ConvStage((1, 1), ((1, 1),)),
        ConvStage((1, 1), ((1, 1),)),
    ),
    "vgg": (
        ConvStage((1, 1), ((1, 1),) * 2),
        ConvStage((2, 2), ((1, 1),) * 2),
        ConvStage((2, 2), ((1, 1),) * 3),
        ConvStage((2, 2), ((1, 1),) * 3),
        ConvStage((2, 2), ((1, 1),) * 3),
    ),
}


def strides(network: str) -> list[int]:
    """Pixels from one feature to the next after every stage."""
    found, stride = [], 1
    for stage in STAGES[network]:
        stride *= stage.pool[1] * prod(step for step, _ in stage.convolutions)
        found.append(stride)
    return found


@cache
def network_weights(name: str) -> dict[str, Tensor]:
    """The float32 tensors of a file in `weights/`: "lpips_alex", "lpips_vgg" or "dists".

    Of a network conv{i}.weight (channels last), conv{i}.bias, and head{i}.weight of LPIPS v0.1.
    """
    file = FOLDER / f"{name}.safetensors"
    try:
        stored = load_file(file)
    except Exception as error:  # safetensors raises its own types for a damaged file
        raise InputError(f"metric weights {file} cannot be read ({error}); install handbench again") from error
    named = {name: value.float() for name, value in stored.items()}
    return {n: v.contiguous(memory_format=torch.channels_last) if v.ndim == 4 else v for n, v in named.items()}


def batch(image: NDArray[np.float64]) -> Tensor:
    """A picture (H, W, 3) as the networks take it: (1, 3, H, W) float32, channels last in memory."""
    return torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None]


def features(
    network: str,
    images: Tensor,
    stages: int | None = None,
    pool: Callable[[Tensor, int, int], Tensor] = max_pool2d,
) -> list[Tensor]:
    """Features (N, C, h, w) after the first `stages` stages, or all of them, of images (N, 3, H, W) in [0, 1].

    Images are at least 32 pixels wide and high. `pool(x, window, stride)` makes maps smaller between stages.
    """
    named = network_weights(f"lpips_{network}")
    shift, scale = (torch.tensor(v).view(1, 3, 1, 1) for v in (SHIFT, SCALE))
    x = ((2.0 * images - 1.0 - shift) / scale).contiguous(memory_format=torch.channels_last)
    taps, index = [], 0
    for stage in STAGES[network][:stages]:
        if stage.pool != (1, 1):
            x = pool(x, *stage.pool)
        for stride, padding in stage.convolutions:
            weight, bias = named[f"conv{index}.weight"], named[f"conv{index}.bias"]
            if _worth_winograd(x, weight, stride):
                x = winograd.convolve(x, _transformed(network, index), bias).relu_()
            else:
                x = conv2d(x, weight, bias, stride, padding).relu_()
            index += 1
        taps.append(x)
    return taps


def _worth_winograd(x: Tensor, weight: Tensor, stride: int) -> bool:
    """Whether Winograd's way is the faster one for maps x: measured. It is not meant for gradients."""
    suits = weight.shape[2:] == (3, 3) and stride == 1 and not torch.is_grad_enabled()
    return suits and weight.shape[1] >= 128 and x.shape[2] * x.shape[3] >= 320


@cache
def _transformed(network: str, index: int) -> Tensor:
    return winograd.transformed(network_weights(f"lpips_{network}")[f"conv{index}.weight"])
