from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest
import torch
from torch import Tensor

from handbench.render.shade import brdf, reference


def unit(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(*shape, 3, generator=generator, dtype=dtype), dim=-1)


@pytest.mark.parametrize("roughness", [0.3, 0.5, 1.0])
def test_stable_distribution_is_the_printed_one(roughness: float) -> None:
    cosine = torch.linspace(0, 1, 1001, dtype=torch.float64)
    ours = brdf.distribution(1 - cosine**2, torch.tensor(roughness, dtype=torch.float64)).numpy()
    beta, c = roughness, cosine.numpy()
    printed = beta**4 / (np.pi * (c**2 * (beta**4 - 1) + 1) ** 2)
    assert np.allclose(ours, printed, rtol=1e-11)


@pytest.mark.parametrize("roughness", [0.02, 0.05, 0.1, 0.3, 1.0])
def test_float32_keeps_five_digits_at_all_angles(roughness: float) -> None:
    # angles down to a hundredth of the lobe's width; n and h are exact in float32, so only the formula is judged
    angle = np.concatenate([[0.0], np.geomspace(1e-2 * roughness**2, np.pi / 2, 400)])
    half = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1).astype(np.float32)
    n = np.array([0, 0, 1], dtype=np.float32)
    # the lit half vector of view = light = h: specular = D F(1) G
    lobe = brdf.specular(torch.tensor(n), torch.tensor(half), torch.tensor(half), torch.tensor(np.float32(roughness)))
    h = half.astype(np.float64)
    sine2 = (h[:, 0] ** 2) / (h**2).sum(-1)
    c = h[:, 2]
    b2 = float(np.float32(roughness)) ** 2
    d = (b2 / (sine2 + (1 - sine2) * b2**2)) ** 2 / np.pi
    k = (float(np.float32(roughness)) + 1) ** 2 / 8
    f = 0.04 + 0.96 * 2.0 ** (-5.55473 - 6.98316)
    above = c > 1e-3
    expected = (d * f / (4 * (c * (1 - k) + k) ** 2))[above]
    assert np.allclose(lobe.numpy()[above], expected, rtol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_specular_is_the_reference(seed: int) -> None:
    normal, view, light = (unit(500, seed=3 * seed + k) for k in range(3))
    roughness = torch.linspace(0.3, 1, 500, dtype=torch.float64)
    ours = brdf.specular(normal, view, light, roughness).numpy()
    half = (view + light) / (view + light).norm(dim=-1, keepdim=True)
    dot = lambda a, b: (a * b).sum(-1).numpy()  # noqa: E731
    with np.errstate(all="ignore"):
        printed = (
            reference.distribution(dot(half, normal), roughness.numpy())
            * reference.fresnel(dot(view, half))
            * reference.geometry(dot(normal, view), dot(normal, light), roughness.numpy())
        )
    above = (dot(normal, view) > 0) & (dot(normal, light) > 0)
    assert 50 < above.sum() < 250
    assert np.allclose(ours[above], np.asarray(printed, dtype=np.float64)[above], rtol=1e-9)
    assert not ours[~above].any()


def albedo(roughness: float, cosine: float) -> float:
    """The integral of D G (n.ω) over all lights: what a white furnace returns if F were 1."""
    view = torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine], dtype=torch.float64)
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    beta = torch.tensor(roughness, dtype=torch.float64)
    # over half vectors, dω = 4 (d.h) dh; cells of equal weight under D cos(theta) dh
    share = (torch.arange(1000, dtype=torch.float64) + 0.5) / 1000
    tangent2 = beta**4 * share / (1 - share)
    cos_h = (1 / (1 + tangent2)).sqrt()[:, None]
    phi = ((torch.arange(360, dtype=torch.float64) + 0.5) / 360 * 2 * math.pi)[None]
    sin_h = (1 - cos_h**2).clamp_min(0).sqrt()
    half = torch.stack([sin_h * phi.cos(), sin_h * phi.sin(), cos_h.expand(-1, 360)], dim=-1)
    d_h = (half * view).sum(-1)
    light = 2 * d_h[..., None] * half - view
    value = brdf.specular(normal, view, light, beta) / brdf.fresnel(d_h.clamp_min(0)) * light[..., 2].clamp_min(0)
    density = brdf.distribution((1 - cos_h**2), beta) * cos_h
    return float((value * 4 * d_h.clamp_min(0) / density).mean())


@pytest.mark.parametrize(
    ("roughness", "cosine", "expected"),
    [
        (1.0, 1.0, 1 - math.log(2)),  # D = 1/pi and K = 1/2 leave the integral of c / (1 + c)
        (0.05, 1.0, 1.0),  # a mirror head-on loses nothing
        (0.05, 0.1, 0.20),
    ],
)
def test_white_furnace_has_the_printed_losses(roughness: float, cosine: float, expected: float) -> None:
    # the printed G is no masking of the printed D, so the furnace is not white: these are its true values
    assert albedo(roughness, cosine) == pytest.approx(expected, abs=0.005)


def test_values_and_gradients_are_finite_everywhere() -> None:
    normal = torch.tensor([0.0, 0.0, 1.0])
    angles = torch.tensor([0.0, 1e-6, 1e-3, 0.5, 1.5, math.pi / 2, 1.6, math.pi - 1e-4, math.pi])
    ring = torch.stack([angles.sin(), torch.zeros_like(angles), angles.cos()], dim=-1)
    ring = torch.cat([ring, -ring])
    for roughness in (0.0, 1e-3, 0.02, 0.3, 1.0, 2.0):
        inputs = [normal.expand(18, 18, 3).clone(), ring[:, None].repeat(1, 18, 1), ring[None].repeat(18, 1, 1)]
        inputs.append(torch.full((18, 18), roughness))
        for value in inputs:
            value.requires_grad_()
        for lobe in (brdf.specular(*inputs), brdf.phong(*inputs[:3])):
            assert lobe.isfinite().all() and (lobe >= 0).all()
            for gradient in torch.autograd.grad(lobe.sum(), inputs, allow_unused=True):
                assert gradient is None or gradient.isfinite().all()


def test_gradients_are_those_of_finite_differences() -> None:
    # directions are parametrised through their normalisation, as networks do
    generator = torch.Generator().manual_seed(4)
    near = lambda: torch.randn(8, 3, generator=generator, dtype=torch.float64) * 0.4 + torch.tensor([0.0, 0.0, 1.0])  # noqa: E731
    inputs = [near().requires_grad_() for _ in range(3)]
    inputs.append(torch.linspace(0.15, 0.95, 8, dtype=torch.float64).requires_grad_())

    def lobe(n: Tensor, d: Tensor, w: Tensor, roughness: Tensor) -> Tensor:
        return brdf.specular(*(torch.nn.functional.normalize(v, dim=-1) for v in (n, d, w)), roughness)

    assert torch.autograd.gradcheck(lobe, inputs)


def test_specular_is_reciprocal() -> None:
    normal, view, light = (unit(200, seed=k) for k in range(3))
    roughness = torch.full((200,), 0.3, dtype=torch.float64)
    assert torch.allclose(
        brdf.specular(normal, view, light, roughness), brdf.specular(normal, light, view, roughness), rtol=1e-12
    )


def test_phong_mirrors_about_the_normal() -> None:
    normal = torch.tensor([0.0, 0.0, 1.0])
    light = torch.tensor([0.6, 0.0, 0.8])
    assert brdf.phong(normal, torch.tensor([-0.6, 0.0, 0.8]), light) == pytest.approx(1, abs=1e-5)
    tilted = torch.tensor([-0.6 * math.cos(0.2) - 0.8 * math.sin(0.2), 0.0, 0.8 * math.cos(0.2) - 0.6 * math.sin(0.2)])
    assert brdf.phong(normal, tilted, light, 20.0) == pytest.approx(math.cos(0.2) ** 20, rel=1e-4)
    assert brdf.phong(normal, normal, torch.tensor([0.6, 0.0, -0.8])) == 0


def above_ground(count: int, seed: int, least: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (count, 3): normals, and views and lights above their horizon by a cosine of at least `least`."""
    random = np.random.default_rng(seed)
    normal, *others = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in random.normal(size=(3, count, 3)))
    flipped = (v * np.where((v * normal).sum(1, keepdims=True) < 0, -1.0, 1.0) for v in others)
    lifted = (v + least * normal for v in flipped)
    view, light = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in lifted)
    return normal, view, light


def tilted(normal: np.ndarray, angle: float, azimuth: float) -> np.ndarray:
    """Unit vectors at an angle to normals (n, 3)."""
    across = np.cross(normal, [0.3, -0.5, 0.8])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normal, across)
    return np.cos(angle) * normal + np.sin(angle) * (np.cos(azimuth) * across + np.sin(azimuth) * along)


# (angle of the viewer, angle and azimuth of the light, roughness): plain, grazing, mirror, nearly d = -ω, clamps
AWKWARD = [
    (0.3, 0.7, 1.0, 0.4),
    (1.5, 1.2, 2.0, 0.3),
    (1.57, 1.57, 3.0, 0.8),
    (0.6, 0.6, math.pi, 0.05),
    (1.569, 1.569, math.pi, 0.5),
    (0.4, 0.41, math.pi, 0.021),
    (0.2, 1.0, 0.0, 0.999),
]


@pytest.fixture(scope="module")
def printed() -> Any:
    """The printed model's values and gradients in all its arguments, each compiled once."""
    inputs = (0, 1, 2, 3)
    return jax.jit(jax.vmap(reference.seed_brdf)), jax.jit(jax.vmap(jax.grad(reference.seed_brdf, argnums=inputs)))


@pytest.mark.parametrize("case", AWKWARD)
def test_gradients_are_those_of_the_other_backend(case: tuple[float, float, float, float], printed: Any) -> None:
    theta, phi, azimuth, roughness = case
    normal, _, _ = above_ground(5, seed=1)
    view, light = tilted(normal, theta, 0.0), tilted(normal, phi, azimuth)
    rough = np.full(5, roughness)
    with jax.enable_x64(True):
        value, expected = (jax.tree.map(np.asarray, one(normal, view, light, rough)) for one in printed)
    inputs = [torch.tensor(v, requires_grad=True) for v in (normal, view, light, rough)]
    ours = brdf.specular(*inputs)
    assert np.allclose(ours.detach().numpy(), value, rtol=1e-6)
    found = torch.autograd.grad(ours.sum(), inputs)
    # the printed D knows the length of n, the stable one does not: along n they may differ, see `tangential`
    steepest = float(ours.detach().max()) / roughness**2  # what a lobe's value changes by over its width
    for g, e, at in zip(found[:3], expected[:3], inputs[:3], strict=True):
        g, e = (tangential(v, at.detach().numpy()) for v in (g.numpy(), e))
        assert np.allclose(g, e, rtol=1e-5, atol=1e-6 * steepest)
    assert np.allclose(found[3].numpy(), expected[3], rtol=1e-5)


def tangential(gradient: np.ndarray, at: np.ndarray) -> np.ndarray:
    """What a gradient says about turning a unit vector."""
    return gradient - (gradient * at).sum(1, keepdims=True) * at


def test_gradients_stop_at_the_clamp_of_roughness() -> None:
    normal, view, light = (torch.tensor(v) for v in above_ground(20, seed=2))
    for roughness, moves in ((0.0199, False), (0.0201, True), (0.999, True), (1.001, False)):
        rough = torch.full((20,), roughness, dtype=torch.float64, requires_grad=True)
        (gradient,) = torch.autograd.grad(brdf.specular(normal, view, light, rough).sum(), rough)
        assert bool((gradient != 0).all()) is moves and bool(gradient.any()) is moves


def furnace(model, nodes: int = 120) -> float:
    """The integral of a model (light (..., 3)) -> (...) times n.ω over all lights, by Gauss and the trapezoid."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    height, weight = (x + 1) / 2, weight / 2
    azimuth = (np.arange(2 * nodes) + 0.5) * math.pi / nodes
    flat = np.sqrt(1 - height**2)[:, None]
    light = np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.broadcast_to(height[:, None], (nodes, 2 * nodes))], -1
    )
    value = model(torch.tensor(light)).numpy()
    return float((value * (height * weight)[:, None]).sum() * math.pi / nodes)


NORMAL = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def leaning(cosine: float) -> Tensor:
    return torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine], dtype=torch.float64)


def test_phong_has_the_furnace_of_its_formula() -> None:
    # head-on r.d = n.ω, so the integral of c^n c over the hemisphere is 2 pi / (n + 2)
    assert furnace(lambda light: brdf.phong(NORMAL, NORMAL, light, 32.0)) == pytest.approx(2 * math.pi / 34, rel=1e-9)


@pytest.mark.parametrize(("roughness", "cosine"), [(1.0, 0.5), (0.7, 0.9), (0.6, 0.3)])
def test_two_quadratures_agree_on_the_furnace(roughness: float, cosine: float) -> None:
    view, beta = leaning(cosine), torch.tensor(roughness, dtype=torch.float64)

    def without_fresnel(light: Tensor) -> Tensor:
        facing = 0.5 * (light + view).norm(dim=-1)
        return brdf.specular(NORMAL, view, light, beta) / brdf.fresnel(facing)

    assert furnace(without_fresnel) == pytest.approx(albedo(roughness, cosine), abs=1e-3)


def test_lobes_are_reciprocal() -> None:
    normal, view, light = (torch.tensor(v) for v in above_ground(200, seed=5))
    assert torch.allclose(brdf.phong(normal, view, light), brdf.phong(normal, light, view), rtol=1e-9, atol=1e-15)


def test_phong_is_the_reference() -> None:
    normal, view, light = above_ground(100, seed=6)
    with jax.enable_x64(True):
        expected = np.asarray(jax.vmap(lambda n, d, w: reference.phong_brdf(n, d, w, 32.0))(normal, view, light))
    single = [torch.tensor(v.astype(np.float32)) for v in (normal, view, light)]
    assert np.allclose(brdf.phong(*single).numpy(), expected, rtol=1e-4, atol=1e-6)
