"""LPIPS v0.1 (Zhang et al., CVPR 2018), AlexNet and VGG-16, as lpips 0.1.4 computes it.

Unit-normalised features of both images, squared differences, weighted by the learned heads, averaged over each
layer and summed over layers. Images are mapped from [0, 1] to the networks' range here, never by the caller.
Weights are stored as float16. Against the original float32 ones, over 46 pairs from slight noise to flat colours, that
moves a value by 5e-5 (AlexNet) or 2e-5 (VGG) in the median and by 4e-4 or 1.3e-4 at most; most between dark or flat
pictures, where it was up to 1.3 % of a small distance.
"""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from .base import Family
from .networks import STAGES, batch, features, network_weights, strides
from .tiles import Tile, tiles
from .truths import remembered
from .view import View


def lpips(network: str, view: View) -> float:
    """The distance, 0 for equal images, of "alex" or "vgg". Images go one by one: batches are no faster on a CPU."""
    heads = [network_weights(f"lpips_{network}")[f"head{layer}.weight"] for layer in range(len(STAGES[network]))]
    found: list[list[tuple[float, int]]] = [[] for _ in heads]  # mean and number of features, by layer and tile
    with torch.no_grad():  # not inference_mode: the weights that it loads may be trained through later
        for tile in tiles(*view.support.shape):
            directions = partial(_directions, network, tile)
            truth, prediction = batch(view.truth[tile.cut]), batch(view.prediction[tile.cut])
            whole = tile.own == tile.cut
            of_truth = remembered(f"lpips-{network}", truth, directions) if whole else directions(truth)
            for layer, a, b, head in zip(found, directions(prediction), of_truth, heads, strict=True):
                if len(a):
                    layer.append((float((a - b).square_().mean(0) @ head), len(a)))
    total = 0.0
    for layer in found:
        count = sum(n for _, n in layer)
        total += sum(value * (n / count) for value, n in layer)
    return total


def _directions(network: str, tile: Tile, image: Tensor) -> list[Tensor]:
    """Own features of a tile's image (1, 3, H, W), of each layer (pixels, channels), each divided by its length."""
    maps = zip(features(network, image), strides(network), strict=True)
    layers = [layer[0][:, *tile.features(stride)].permute(1, 2, 0).flatten(0, 1) for layer, stride in maps]
    return [layer.div_(torch.linalg.vector_norm(layer, dim=1, keepdim=True) + 1e-10) for layer in layers]


def _family(network: str, title: str) -> Family:
    return Family(
        f"lpips-{network}",
        f"LPIPS ({title})",
        partial(lpips, network),
        higher_is_better=False,
        decimals=4,
        regions=("box", "full"),
        spaces=("srgb",),
        terms=("heads:0.1",),
        perfect=0.0,
        least=32,
    )


ALEX = _family("alex", "Alex")
VGG = _family("vgg", "VGG")
