"""Large pictures go through the networks in tiles, which changes nothing but the order of sums."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
import torch

from handbench.metrics import Pair, metric

networks = importlib.import_module("handbench.metrics.networks")
tiles = importlib.import_module("handbench.metrics.tiles")


def noise(height: int, width: int) -> Pair:
    """Noise sees every pixel that a feature depends on."""
    rng = np.random.default_rng(0)
    return Pair(rng.random((height, width, 3)) ** 2, rng.random((height, width, 3)), np.ones((height, width)))


@pytest.mark.parametrize(
    ("spec", "height", "width"),
    [
        ("lpips-alex", 401, 40),
        ("lpips-vgg", 40, 401),
        ("dists", 401, 40),
        ("objects-with-lighting-lpips", 40, 401),
    ],
)
def test_tiles_score_as_the_whole_picture(spec: str, height: int, width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    pair, chosen = noise(height, width), metric(spec + ("" if "-lpips" in spec else ":region=full"))
    whole = chosen([pair])[0].value
    monkeypatch.setattr(tiles, "LARGEST", 1000)
    monkeypatch.setattr(tiles, "SIDE", 128)
    assert len(list(tiles.tiles(height, width))) == 3
    assert chosen([pair])[0].value == pytest.approx(whole, abs=2e-7)
    monkeypatch.setattr(tiles, "MARGIN", 32)
    assert chosen([pair])[0].value != pytest.approx(whole, abs=2e-7), "the test would see too small a margin"


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_every_feature_belongs_to_one_tile(network: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "LARGEST", 1000)
    monkeypatch.setattr(tiles, "SIDE", 64)
    height, width = 150, 97
    image = torch.rand(1, 3, height, width)
    maps = networks.features(network, image)
    parts = [(tile, networks.features(network, image[:, :, *tile.cut])) for tile in tiles.tiles(height, width)]
    for layer, stride in enumerate(networks.strides(network)):
        counted = torch.zeros(maps[layer].shape[2:])
        for tile, inside in parts:
            rows, columns = (slice(cut.start // stride, None) for cut in tile.cut)
            inner = inside[layer].shape[2:]
            view = counted[rows, columns][: inner[0], : inner[1]]
            view[tile.features(stride)] += 1
        assert (counted == 1).all()


def test_a_picture_of_ordinary_size_is_one_piece() -> None:
    (tile,) = tiles.tiles(1024, 1024)
    assert tile.cut == tile.own == (slice(0, 1024), slice(0, 1024))
    assert {t.cut[0].start % 16 for t in tiles.tiles(2668, 4096)} == {0}
