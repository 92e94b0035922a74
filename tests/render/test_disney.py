"""The Disney BRDF: values, gradients, furnace, reciprocity, and its sum over lights."""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import numpy as np
import pytest
import torch
from torch import Tensor

from handbench.light.lightset import LightSet
from handbench.render.shade import brdf, reference
from handbench.render.shade.shading import disney_radiance


def scene(count: int, seed: int = 0) -> list[np.ndarray]:
    """normal, view, light (n, 3) with light and view above the horizon; albedo (n, 3), roughness, metallic (n)."""
    random = np.random.default_rng(seed)
    normal, view, light = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in random.normal(size=(3, count, 3)))
    view, light = (v * np.where((v * normal).sum(1, keepdims=True) < 0, -1.0, 1.0) for v in (view, light))
    return [normal, view, light, random.random((count, 3)), 0.05 + 0.95 * random.random(count), random.random(count)]


def test_values_and_gradients_are_those_of_the_reference() -> None:
    arrays = scene(300)
    with jax.enable_x64(True):
        value = np.asarray(jax.jit(jax.vmap(reference.disney_brdf))(*arrays))
        summed = jax.grad(lambda *a: jax.vmap(reference.disney_brdf)(*a).sum(), argnums=tuple(range(6)))
        expected = [np.asarray(g) for g in jax.jit(summed)(*arrays)]
    inputs = [torch.tensor(v, requires_grad=True) for v in arrays]
    ours = brdf.disney(*inputs)
    assert np.allclose(ours.detach().numpy(), value, rtol=1e-8)
    for k, (g, e) in enumerate(zip(torch.autograd.grad(ours.sum(), inputs), expected, strict=True)):
        g = g.numpy()
        if k < 3:  # only turning a unit vector means anything
            g, e = (v - (v * arrays[k]).sum(1, keepdims=True) * arrays[k] for v in (g, e))
        assert np.allclose(g, e, rtol=1e-6, atol=1e-7 * np.abs(e).max()), k


def test_gradients_are_those_of_finite_differences() -> None:
    normal, view, light, albedo, roughness, metallic = (torch.tensor(v) for v in scene(6, seed=1))
    inputs = [v.requires_grad_() for v in (normal, view, light, 0.1 + 0.8 * albedo, roughness, 0.1 + 0.8 * metallic)]

    def value(n: Tensor, d: Tensor, w: Tensor, *rest: Tensor) -> Tensor:
        return brdf.disney(*(torch.nn.functional.normalize(v, dim=-1) for v in (n, d, w)), *rest)

    assert torch.autograd.gradcheck(value, inputs)


def test_it_is_reciprocal_and_dark_below_the_horizon() -> None:
    normal, view, light, *rest = (torch.tensor(v) for v in scene(200, seed=2))
    assert torch.allclose(brdf.disney(normal, view, light, *rest), brdf.disney(normal, light, view, *rest), rtol=1e-10)
    for pair in ((-view, light), (view, -light)):
        assert not brdf.disney(normal, *pair, *rest).any()


def furnace(view: Tensor, albedo: float, roughness: float, metallic: float, nodes: int = 240) -> float:
    x, weight = np.polynomial.legendre.leggauss(nodes)
    height, weight = (x + 1) / 2, weight / 2
    azimuth = (np.arange(2 * nodes) + 0.5) * math.pi / nodes
    flat = np.sqrt(1 - height**2)[:, None]
    up = np.broadcast_to(height[:, None], (nodes, 2 * nodes))
    light = torch.tensor(np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], -1))
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    one = lambda value: torch.tensor(value, dtype=torch.float64)  # noqa: E731
    value = brdf.disney(normal, view, light, one([albedo] * 3), one(roughness), one(metallic))[..., 0].numpy()
    return float((value * (height * weight)[:, None]).sum() * math.pi / nodes)


HEAD_ON = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def test_furnace_of_the_metal() -> None:
    # F = 1; D = 1/pi and G / 4 n.d n.w = 1 / (2 (1 + c)) leave the integral of c / (1 + c)
    assert furnace(HEAD_ON, 1.0, 1.0, 1.0) == pytest.approx(1 - math.log(2), abs=1e-9)
    for cosine in (0.2, 0.6, 1.0):  # a single bounce never gives energy, and a smoother metal loses less
        view = torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine], dtype=torch.float64)
        shares = [furnace(view, 1.0, roughness, 1.0) for roughness in (1.0, 0.7, 0.4)]
        assert shares[0] < shares[1] < shares[2] < 1.0


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_furnace_of_the_diffuse_part(roughness: float) -> None:
    # head-on d.h^2 = (1 + c) / 2 and the viewer's factor is 1: 1 + (b - 1/2) / 21 + b / 84, which may exceed 1
    flat = furnace(HEAD_ON, 1.0, roughness, 0.0) - furnace(HEAD_ON, 0.0, roughness, 0.0)
    assert flat == pytest.approx(1 + (roughness - 0.5) / 21 + roughness / 84, rel=1e-9)


@pytest.fixture
def lit():
    random = np.random.default_rng(3)
    normal, position = (torch.tensor(v) for v in random.normal(size=(2, 3, 600)))
    normal = torch.nn.functional.normalize(normal, dim=0)
    albedo, roughness, metallic = (torch.tensor(v) for v in (random.random((3, 600)), *random.random((2, 600))))
    towards = random.normal(size=(40, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    lights = LightSet(towards, random.random((40, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    return [normal, 0.05 * position, albedo, roughness, metallic], np.array([0.1, 0.0, 1.0]), lights


def test_radiance_is_the_sum_of_the_brdf(lit) -> None:
    maps, centre, lights = lit
    normal, position, albedo, roughness, metallic = maps
    seen = np.random.default_rng(4).random((40, 600)) < 0.7
    view = torch.nn.functional.normalize(torch.tensor(centre)[:, None] - position, dim=0)
    expected = torch.zeros(3, 600, dtype=torch.float64)
    for towards, power, row in zip(
        *(torch.tensor(v) for v in (lights.directions, lights.irradiance, seen)), strict=True
    ):
        value = brdf.disney(normal.T, view.T, towards, albedo.T, roughness, metallic)
        expected += value.T * (towards @ normal).clamp_min(0) * row * power[:, None]
    assert torch.allclose(disney_radiance(*maps, centre, lights, seen), expected, rtol=1e-9, atol=1e-14)


def test_fused_radiance_and_gradient_are_the_tiles(lit, fuse: Callable[[], None]) -> None:
    maps, centre, lights = lit

    def answer(dtype: torch.dtype) -> list[Tensor]:
        inputs = [v.to(dtype).requires_grad_() for v in maps]
        radiance = disney_radiance(*inputs, centre, lights)
        return [radiance.detach(), *torch.autograd.grad(radiance.sum(), inputs)]

    tiled = answer(torch.float64)
    fuse()
    for ours, expected in zip(answer(torch.float32), tiled, strict=True):
        assert torch.allclose(ours.double(), expected, rtol=1e-4, atol=1e-5 * float(expected.abs().max()))
