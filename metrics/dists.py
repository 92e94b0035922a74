"""DISTS, deep image structure and texture similarity (Ding et al., TPAMI 2022), as dists-pytorch 0.1 computes it.

One minus the weighted similarities of means (texture) and of correlations (structure) of each channel of the picture
and of five layers of VGG-16, whose max pooling is replaced by Hanning-weighted L2 pooling. The authors' evaluation
shrinks pictures to 256 pixels first; here they keep their size, as in a table of several metrics they should.
The backbone is that of LPIPS (float16 weights); the learned weights of the channels are in `weights/dists.safetensors`.
"""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from .base import Family
from .networks import batch, features, weights
from .truths import remembered
from .view import View

EPSILON = 1e-6  # c1 and c2 of the paper


def dists(view: View) -> float:
    """The distance: 0 for equal images, about 1 for unrelated ones."""
    alpha, beta = _weights()
    with torch.no_grad():
        truth, prediction = remembered("dists", batch(view.truth), _layers), _layers(batch(view.prediction))
        texture, structure = zip(*map(_similarities, prediction, truth), strict=True)
        return float(alpha @ (1 - torch.cat(texture)) + beta @ (1 - torch.cat(structure)))


def _layers(image: Tensor) -> list[Tensor]:
    """An image (1, 3, H, W) itself and its five layers of features, each (pixels, channels)."""
    return [layer[0].permute(1, 2, 0).flatten(0, 1) for layer in (image, *features("vgg", image, pool=_l2_pool))]


def _similarities(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Of means and of structure (Eq. 3 and 4), each (channels,), of two layers (pixels, channels)."""
    mean_a, mean_b = a.mean(0), b.mean(0)
    texture = (2 * mean_a * mean_b + EPSILON) / (mean_a**2 + mean_b**2 + EPSILON)
    a, b = a - mean_a, b - mean_b
    structure = (2 * (a * b).mean(0) + EPSILON) / ((a * a).mean(0) + (b * b).mean(0) + EPSILON)
    return texture, structure


def _l2_pool(x: Tensor, window: int, stride: int) -> Tensor:
    """Root of the weighted mean square in a Hanning window of 3 pixels: no aliasing, unlike the maximum of 2 x 2."""
    hanning = torch.tensor([0.25, 0.5, 0.25])
    kernel = torch.outer(hanning, hanning).expand(x.shape[1], 1, 3, 3)
    return (conv2d(x.square(), kernel, stride=stride, padding=1, groups=x.shape[1]) + 1e-12).sqrt()


@cache
def _weights() -> tuple[Tensor, Tensor]:
    """alpha and beta, (1475,) each, one a channel; together they sum to 1."""
    stored = weights("dists")
    total = stored["alpha"].sum() + stored["beta"].sum()
    return stored["alpha"] / total, stored["beta"] / total


DISTS = Family(
    "dists",
    "DISTS",
    dists,
    higher_is_better=False,
    decimals=4,
    terms=("resize:none",),
    perfect=0.0,
    regions=("box", "full"),
    spaces=("srgb",),
    least=32,
)
