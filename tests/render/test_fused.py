"""The fused kernel and the kept transfer give what the tiles give."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
import torch

from handbench.light.lightset import LightSet
from handbench.render.shade import fused, switch
from handbench.render.shade.shading import light_features, relight, transfer


@pytest.fixture(autouse=True)
def tiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until a test asks for the fused kernel, tiles shade whatever there is: what they are compared with."""
    for least in ("_FUSE", "_DRAW"):
        monkeypatch.setattr(switch, least, 1 << 60)


@pytest.fixture
def scene():
    """The last block of texels is not full, and the lights need two calls."""
    generator = torch.Generator().manual_seed(0)
    normal, position = torch.randn(2, 3, 600, generator=generator)
    normal = torch.nn.functional.normalize(normal, dim=0)
    directions = torch.nn.functional.normalize(torch.randn(150, 3, generator=generator), dim=1)
    lights = LightSet(directions.numpy(), np.random.default_rng(0).random((150, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    visible = torch.rand(150, 600, generator=generator) > 0.3
    return normal, 0.05 * position, torch.rand(600, generator=generator), np.array([0.0, 0.0, 1.0]), lights, visible


# Visibility is read alike for all models, and each pair is a second of XLA's: every kind and every model comes in both
# tests, and all kinds with the model that most methods use.
@pytest.mark.parametrize(
    ("seen", "model"),
    [("bool", "brdf"), ("weights", "brdf"), ("none", "brdf"), ("weights", "phong"), ("bool", "diffuse")],
)
def test_fused_and_tiled_agree(scene, seen: str, model: str, fuse: Callable[[], None]) -> None:
    *maps, visible = scene
    visibility = {"bool": visible, "weights": 0.5 * visible, "none": None}[seen]
    tiled = light_features(*maps, visibility, model)
    fuse()
    fast = light_features(*maps, visibility, model)
    for one, other in zip(tiled, fast, strict=True):
        assert (one - other).abs().max() <= 3e-6 * one.abs().max()


@pytest.mark.parametrize("model", ["brdf", "phong"])
def test_fused_gradients_are_those_of_the_tiles(scene, model: str, fuse: Callable[[], None]) -> None:
    *maps, visible = scene
    maps[2] = 0.1 + 0.9 * maps[2]

    def gradients(dtype: torch.dtype) -> tuple[torch.Tensor, ...]:
        inputs = [values.to(dtype).requires_grad_() for values in maps[:3]]
        diffuse, specular = light_features(*inputs, *maps[3:], visible, model)
        return torch.autograd.grad((diffuse * diffuse + 2.0 * specular).sum(), inputs, allow_unused=model == "phong")

    exact = gradients(torch.float64)
    fuse()
    for ours, expected in zip(gradients(torch.float32), exact, strict=True):
        if expected is not None:
            assert (ours - expected).abs().max() < 1e-5 * expected.abs().max()


def test_gradients_in_the_light_keep_to_the_tiles(scene, fuse: Callable[[], None]) -> None:
    *maps, lights, visible = scene
    fuse()
    power = torch.tensor(lights.irradiance, requires_grad=True)
    some = LightSet(lights.directions, power, lights.positions, lights.intensities)
    light_features(*maps, some, visible)[1].sum().backward()
    assert power.grad is not None and power.grad.abs().max() > 0


def test_without_xla_the_tiles_answer(scene, fuse: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    *maps, visible = scene
    fuse()
    fast = light_features(*maps, visible)
    monkeypatch.setitem(sys.modules, "jax", None)  # what a broken installation looks like
    fused.usable.cache_clear()
    try:
        assert not fused.usable()
        slow = light_features(*maps, visible)
    finally:
        fused.usable.cache_clear()
    for one, other in zip(fast, slow, strict=True):
        assert (one - other).abs().max() < 1e-6 * one.abs().max()


@pytest.mark.parametrize(("seen", "model"), [("bool", "brdf"), ("none", "phong"), ("weights", "diffuse")])
def test_fused_and_tiled_transfers_agree(scene, seen: str, model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    *maps, lights, visible = scene
    visibility = {"bool": visible, "weights": 0.5 * visible, "none": None}[seen]
    tiled = transfer(*maps, lights.directions, visibility, model)
    monkeypatch.setattr(switch, "_DRAW", 0)
    fast = transfer(*maps, lights.directions, visibility, model)
    assert fast.shape == tiled.shape and (fast - tiled).abs().max() <= 1e-5 * tiled.abs().max()


def test_a_transfer_relights_as_the_tiles_do(scene) -> None:
    *maps, lights, visible = scene
    known = transfer(*maps, lights.directions, visible)
    for irradiance in (lights.irradiance, lights.irradiance[::-1].copy()):
        other = LightSet(lights.directions, irradiance, lights.positions, lights.intensities)
        for one, two in zip(light_features(*maps, other, visible), relight(known, irradiance), strict=True):
            assert (one - two).abs().max() < 1e-5 * one.abs().max()
