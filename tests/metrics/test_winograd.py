"""Winograd convolutions against plain ones in float64."""

from __future__ import annotations

import importlib

import pytest
import torch
from torch.nn.functional import conv2d

networks = importlib.import_module("handbench.metrics.networks")
winograd = importlib.import_module("handbench.metrics.winograd")


@pytest.mark.parametrize("size", [(1, 1), (4, 4), (5, 9), (41, 83)])
@pytest.mark.parametrize("count", [1, 2])
def test_it_is_a_convolution(size: tuple[int, int], count: int) -> None:
    random = torch.Generator().manual_seed(0)
    maps = torch.rand(count, 130, *size, generator=random).to(memory_format=torch.channels_last)
    weight, bias = torch.randn(70, 130, 3, 3, generator=random), torch.randn(70, generator=random)
    expected = conv2d(maps.double(), weight.double(), bias.double(), padding=1)
    found = winograd.convolve(maps, winograd.transformed(weight), bias)
    assert found.shape == expected.shape
    assert (found - expected).abs().max() < 1e-5 * expected.abs().max()


@pytest.mark.parametrize(("network", "height", "width"), [("alex", 320, 300), ("vgg", 160, 150)])
def test_networks_use_it_and_plain_convolutions_for_gradients(
    network: str, height: int, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = []

    def convolve(x: torch.Tensor, *rest: torch.Tensor) -> torch.Tensor:
        sizes.append(x.shape[2:])
        return winograd.convolve(x, *rest)

    monkeypatch.setattr(
        networks, "winograd", type("Counted", (), {"convolve": convolve, "transformed": winograd.transformed})
    )
    images = torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(2))
    plain = networks.features(network, images)
    assert not sizes
    with torch.no_grad():
        fast = networks.features(network, images)
    assert sizes and min(rows * columns for rows, columns in sizes) >= 320
    for a, b in zip(fast, plain, strict=True):
        assert (a - b).abs().max() < 1e-5 * b.abs().max()
