"""LPIPS by other people's code, so that handbench's networks are not compared with themselves."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.resources import files

import pytest
import torch
import torchmetrics.functional.image.lpips as theirs
from safetensors.torch import load_file
from torch import Tensor, nn

Lpips = Callable[..., Tensor]

# `features` of torchvision's AlexNet and VGG-16: convolutions (channels, kernel, stride, padding), or pooling
ALEXNET = [(64, 11, 4, 2), "pool", (192, 5, 1, 2), "pool", (384, 3, 1, 1), (256, 3, 1, 1), (256, 3, 1, 1)]
VGG16 = [
    *[(64, 3, 1, 1)] * 2, "pool", *[(128, 3, 1, 1)] * 2, "pool", *[(256, 3, 1, 1)] * 3, "pool",
    *[(512, 3, 1, 1)] * 3, "pool", *[(512, 3, 1, 1)] * 3,
]  # fmt: skip
RECIPES = {"alexnet": ("alex", ALEXNET, (3, 2)), "vgg16": ("vgg", VGG16, (2, 2))}


def _torchvisions(name: str, pretrained: bool = True) -> nn.Sequential:
    """What torchvision would build, with the convolutions of our file: rounded to float16, as the originals are not
    at hand in a test. What rounding does is held by the pinned values of `test_lpips`."""
    network, recipe, pool = RECIPES[name]
    stored = load_file(str(files("handbench.metrics") / "weights" / f"lpips_{network}.safetensors"))
    layers: list[nn.Module] = []
    channels, index = 3, 0
    for step in recipe:
        if isinstance(step, str):
            layers.append(nn.MaxPool2d(*pool))
            continue
        layer = nn.Conv2d(channels, step[0], *step[1:])
        layer.load_state_dict({key: stored[f"conv{index}.{key}"].float() for key in ("weight", "bias")})
        layers += [layer, nn.ReLU()]
        channels, index = step[0], index + 1
    return nn.Sequential(*layers)


@pytest.fixture(scope="session")
def official_lpips() -> Lpips:
    """LPIPS of images (1, 3, H, W) in the networks' range, [-1, 1]: a value, or the map (H, W) if `spatial`.

    The code and the heads are the lpips package's, as torchmetrics carries them; computed in float64.
    """

    @cache
    def network(name: str, spatial: bool) -> nn.Module:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(theirs, "_get_tv_model_features", _torchvisions)
            return theirs._LPIPS(net=name, spatial=spatial).double()

    def distance(name: str, a: Tensor, b: Tensor, spatial: bool = False) -> Tensor:
        with torch.no_grad():
            return network(name, spatial)(a.double(), b.double()).squeeze()

    return distance
