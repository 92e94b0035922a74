"""DISTS, deep image structure and texture similarity (Ding et al., TPAMI 2022), as dists-pytorch 0.1 computes it.

One minus the weighted similarities of means (texture) and of correlations (structure) of each channel of the picture
and of five layers of VGG-16, whose max pooling is replaced by Hanning-weighted L2 pooling. The authors' evaluation
shrinks pictures to 256 pixels first; here they keep their size, as in a table of several metrics they should.
The backbone is that of LPIPS (float16 weights); the learned weights of the channels are in `weights/dists.safetensors`.
"""

from __future__ import annotations

from functools import cache, partial

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from .base import Family
from .networks import batch, features, network_weights, strides
from .tiles import Tile, tiles
from .truths import remembered
from .view import View

EPSILON = 1e-6  # c1 and c2 of the paper


def dists(view: View) -> float:
    """The distance: 0 for equal images, about 1 for unrelated ones."""
    parts = list(tiles(*view.support.shape))
    with torch.no_grad():
        if len(parts) == 1:
            layers = partial(_layers, parts[0])
            truth, prediction = remembered("dists", batch(view.truth), layers), layers(batch(view.prediction))
            moments = [_moments(a, b) for a, b in zip(prediction, truth, strict=True)]
        else:
            moments = _in_tiles(view, parts)
        texture, structure = zip(*(_similarities(*of_layer) for of_layer in moments), strict=True)
        alpha, beta = _weights()
        return float(alpha @ (1 - torch.cat(texture)) + beta @ (1 - torch.cat(structure)))


def _layers(tile: Tile, image: Tensor) -> list[Tensor]:
    """A tile's image (1, 3, H, W) itself and its five layers of features, what is its own, each (pixels, channels)."""
    maps = zip((image, *features("vgg", image, pool=_l2_pool)), (1, *strides("vgg")), strict=True)
    return [layer[0][:, *tile.features(stride)].permute(1, 2, 0).flatten(0, 1) for layer, stride in maps]


def _moments(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
    """Means, variances and covariance of the channels of two layers (pixels, channels)."""
    mean_a, mean_b = a.mean(0), b.mean(0)
    a, b = a - mean_a, b - mean_b
    return mean_a, mean_b, (a * a).mean(0), (b * b).mean(0), (a * b).mean(0)


def _in_tiles(view: View, parts: list[Tile]) -> list[tuple[Tensor, ...]]:
    """`_moments` of all layers of a large picture: float64 sums over its tiles, of values and of their products."""
    sums: list[Tensor] = []
    counts: list[int] = []
    for tile in parts:
        pair = [_layers(tile, batch(image[tile.cut])) for image in (view.prediction, view.truth)]
        for layer, (a, b) in enumerate(zip(*pair, strict=True)):
            if layer == len(sums):
                sums.append(torch.zeros(5, a.shape[1], dtype=torch.float64))
                counts.append(0)
            counts[layer] += len(a)
            for row, values in enumerate((a, b, a * a, b * b, a * b)):
                sums[layer][row] += values.sum(0, dtype=torch.float64)
    moments = []
    for total, count in zip(sums, counts, strict=True):
        mean_a, mean_b, aa, bb, ab = total / count
        found = (mean_a, mean_b, aa - mean_a**2, bb - mean_b**2, ab - mean_a * mean_b)
        moments.append(tuple(moment.float() for moment in found))
    return moments


def _similarities(mean_a: Tensor, mean_b: Tensor, aa: Tensor, bb: Tensor, ab: Tensor) -> tuple[Tensor, Tensor]:
    """Of means and of structure (Eq. 3 and 4), each (channels,), of two layers with these `_moments`."""
    texture = (2 * mean_a * mean_b + EPSILON) / (mean_a**2 + mean_b**2 + EPSILON)
    structure = (2 * ab + EPSILON) / (aa + bb + EPSILON)
    return texture, structure


def _l2_pool(x: Tensor, window: int, stride: int) -> Tensor:
    """Root of the weighted mean square in a Hanning window of 3 pixels: no aliasing, unlike the maximum of 2 x 2."""
    hanning = torch.tensor([0.25, 0.5, 0.25])
    kernel = torch.outer(hanning, hanning).expand(x.shape[1], 1, 3, 3)
    return (conv2d(x.square(), kernel, stride=stride, padding=1, groups=x.shape[1]) + 1e-12).sqrt()


@cache
def _weights() -> tuple[Tensor, Tensor]:
    """alpha and beta, (1475,) each, one a channel; together they sum to 1."""
    stored = network_weights("dists")
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
