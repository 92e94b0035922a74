"""LPIPS v0.1 (Zhang et al., CVPR 2018), AlexNet and VGG-16, as lpips 0.1.4 computes it.

Unit-normalised features of both images, squared differences, weighted by the learned heads, averaged over each
layer and summed over layers. Images are mapped from [0, 1] to the networks' range here, never by the caller.
Weights are stored as float16; normalised features are rounded to float16, both sides alike, so that twice as many
truths stay in memory. Together this moves a score by less than 4e-5 (measured against float64).
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .base import Family
from .networks import features, weights
from .view import View

# features of the last truths: several methods are scored against one truth, and its features are half of the work
CACHE_BYTES = 512 * 2**20
_truths: OrderedDict[tuple[str, bytes], list[Tensor]] = OrderedDict()


def lpips(network: str, view: View) -> float:
    """The distance, 0 for equal images, of "alex" or "vgg". Images go one by one: batches are no faster on a CPU."""
    with torch.no_grad():  # not inference_mode: the weights that it loads may be trained through later
        truth = _of_truth(network, view.truth)
        prediction = _normalised(network, view.prediction)
        total = 0.0
        for layer, (a, b) in enumerate(zip(prediction, truth, strict=True)):
            difference = (a.float() - b).square_().mean(dim=(0, 2, 3))
            total += float(difference @ weights(network)[f"head{layer}.weight"])
    return total


def _normalised(network: str, image: NDArray[np.float64]) -> list[Tensor]:
    """Features of an image (H, W, 3), each pixel's divided by its length, float16."""
    batch = torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None]
    lengths = partial(torch.linalg.vector_norm, dim=1, keepdim=True)
    return [(f / (lengths(f) + 1e-10)).half() for f in features(network, batch)]


def _of_truth(network: str, image: NDArray[np.float64]) -> list[Tensor]:
    key = (network, hashlib.sha256(repr(image.shape).encode() + image.tobytes()).digest())
    if key in _truths:
        _truths.move_to_end(key)
        return _truths[key]
    found = _truths[key] = _normalised(network, image)
    while len(_truths) > 1 and sum(t.nbytes for kept in _truths.values() for t in kept) > CACHE_BYTES:
        _truths.popitem(last=False)
    return found


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
        least=32,
    )


ALEX = _family("alex", "Alex")
VGG = _family("vgg", "VGG")
