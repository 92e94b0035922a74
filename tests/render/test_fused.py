"""The fused kernel and the kept transfer give what the tiles give."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.light.lightset import LightSet
from handbench.render import shading
from handbench.render.shading import light_features, relight, transfer


@pytest.fixture
def scene():
    generator = torch.Generator().manual_seed(0)
    normal, position = torch.randn(2, 3, 500, generator=generator)
    normal = torch.nn.functional.normalize(normal, dim=0)
    directions = torch.nn.functional.normalize(torch.randn(70, 3, generator=generator), dim=1)
    lights = LightSet(directions.numpy(), np.random.default_rng(0).random((70, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    visible = torch.rand(70, 500, generator=generator) > 0.3
    return normal, 0.05 * position, torch.rand(500, generator=generator), np.array([0.0, 0.0, 1.0]), lights, visible


@pytest.mark.parametrize("seen", ["bool", "weights", "none"])
def test_fused_and_tiled_agree(scene, seen: str, monkeypatch: pytest.MonkeyPatch) -> None:
    *maps, visible = scene
    visibility = {"bool": visible, "weights": 0.5 * visible, "none": None}[seen]
    tiled = light_features(*maps, visibility)
    monkeypatch.setattr(shading, "_FUSE", 0)
    fused = light_features(*maps, visibility)
    for one, other in zip(tiled, fused, strict=True):
        assert (one - other).abs().max() < 1e-5 * one.abs().max()


def test_gradients_keep_to_the_tiles(scene, monkeypatch: pytest.MonkeyPatch) -> None:
    normal, position, roughness, centre, lights, visible = scene
    monkeypatch.setattr(shading, "_FUSE", 0)
    roughness = roughness.requires_grad_()
    light_features(normal, position, roughness, centre, lights, visible)[1].sum().backward()
    assert roughness.grad is not None and roughness.grad.abs().max() > 0


def test_a_transfer_relights_as_the_tiles_do(scene) -> None:
    *maps, lights, visible = scene
    known = transfer(*maps, lights.directions, visible)
    for irradiance in (lights.irradiance, lights.irradiance[::-1].copy()):
        other = LightSet(lights.directions, irradiance, lights.positions, lights.intensities)
        for one, two in zip(light_features(*maps, other, visible), relight(known, irradiance), strict=True):
            assert (one - two).abs().max() < 1e-5 * one.abs().max()
