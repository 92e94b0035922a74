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
from .networks import batch, features, weights
from .truths import remembered
from .view import View


def lpips(network: str, view: View) -> float:
    """The distance, 0 for equal images, of "alex" or "vgg". Images go one by one: batches are no faster on a CPU."""
    with torch.no_grad():  # not inference_mode: the weights that it loads may be trained through later
        truth = remembered(f"lpips-{network}", batch(view.truth), partial(_directions, network))
        prediction = _directions(network, batch(view.prediction))
        total = 0.0
        for layer, (a, b) in enumerate(zip(prediction, truth, strict=True)):
            head = weights(f"lpips_{network}")[f"head{layer}.weight"]
            total += float((a - b).square_().mean(0) @ head)
    return total


def _directions(network: str, image: Tensor) -> list[Tensor]:
    """Features of an image (1, 3, H, W) of each layer (pixels, channels), each pixel's divided by its length."""
    layers = [layer[0].permute(1, 2, 0).flatten(0, 1) for layer in features(network, image)]
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
