"""PALM-Net's reflectance, its light, and the directions in which light is gathered."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from handbench.errors import InputError
from handbench.light.environment import directions, solid_angles
from handbench.light.gaussians import SphericalGaussians, integrals, lobes
from handbench.methods.palm.directions import Sampling, gather, strata
from handbench.methods.palm.light import ENERGY, LightSampler, MapSampler, StudioLight, frame
from handbench.methods.palm.reflectance import Form, Material, coloured, responses
from handbench.methods.palm.scattering import Scattering
from handbench.methods.palm.shading import dealt, shared
from handbench.methods.palm.visibility import Occluder
from handbench.render.shade.brdf import specular
from handbench.scene import Array, Environment

TOWARDS = torch.from_numpy(directions(80, 160).reshape(-1, 3)).float()
SOLID = torch.from_numpy(solid_angles(80, 160).ravel()).float()


def points(count: int, seed: int = 0) -> tuple[Tensor, Tensor, Material]:
    """Normals, views that see them, and materials."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    view = normal / np.linalg.norm(normal, axis=1, keepdims=True) + 0.6 * rng.normal(size=(count, 3))
    view *= np.sign((normal * view).sum(1))[:, None]
    n, v = (torch.nn.functional.normalize(torch.from_numpy(a).float(), dim=1) for a in (normal, view))
    values = torch.from_numpy(rng.uniform(0.15, 0.9, (count, 5))).float()
    return n, v, Material(values[:, :3], values[:, 3], values[:, 4])


class GaussianSampler:
    """A light without texels: spherical Gaussians, drawn by the power of their brightest channel."""

    def __init__(self, gaussians: SphericalGaussians) -> None:
        self.gaussians = gaussians
        with torch.no_grad():
            power = integrals(gaussians.sharpness) * gaussians.amplitude.amax(dim=1)
            total = power.sum()
            even = torch.full_like(power, 1.0 / len(power))
            self._share = power / total if total > 0 else even

    def radiance(self, towards: Tensor) -> Tensor:
        return self.gaussians.evaluate(towards)

    @torch.no_grad()
    def draw(self, uniform: Array) -> Tensor:
        pick, along, around = torch.from_numpy(np.ascontiguousarray(uniform.T)).to(self._share)
        edges = torch.cumsum(self._share, 0)
        which = torch.searchsorted(edges, pick.contiguous() * edges[-1], right=True).clamp_max(len(edges) - 1)
        axis, sharp = self.gaussians.axes[which], self.gaussians.sharpness[which].clamp_min(1e-4)
        # the cosine's distribution is exponential (von Mises and Fisher on the sphere)
        fall = -torch.expm1(-2.0 * sharp)
        away = -torch.log1p(-along * fall) / sharp
        sine = (away * (2.0 - away)).clamp_min(0.0).sqrt()
        first, second = frame(axis)
        angle = (2.0 * math.pi * around)[:, None]
        across = torch.cos(angle) * first + torch.sin(angle) * second
        return torch.nn.functional.normalize((1.0 - away)[:, None] * axis + sine[:, None] * across, dim=1)

    @torch.no_grad()
    def density(self, towards: Tensor) -> Tensor:
        sharp = self.gaussians.sharpness.clamp_min(1e-4)
        return lobes(self.gaussians.axes, sharp, towards) @ (self._share / integrals(sharp))


def sky(kind: str) -> LightSampler:
    rng = np.random.default_rng(3)
    if kind == "map":
        radiance = rng.uniform(0.0, 0.3, (16, 32, 3))
        radiance[3, 7] = 40.0
        return MapSampler(Environment("a lamp in a room", radiance))
    axes = rng.normal(size=(5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    parts = (axes, rng.uniform(0.5, 40.0, 5), rng.uniform(0.1, 2.0, (5, 3)))
    return GaussianSampler(SphericalGaussians(*(torch.from_numpy(part).float() for part in parts)))


def brute_force(light: LightSampler, normal: Tensor, view: Tensor, material: Material, form: Form) -> Tensor:
    power = light.radiance(TOWARDS).float() * SOLID[:, None]
    return coloured(material, responses(normal, view, material.roughness, TOWARDS, form), power)


def written_out(normal, view, light, albedo, roughness, metallic, form):  # type: ignore[no-untyped-def]
    """f cos (L, 3) of one point as the module prints it, in numpy's float64."""
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    nl, nv, nh, c = light @ normal, view @ normal, half @ normal, (half * light).sum(1)
    alpha2 = roughness**2 if form == "released" else roughness**4
    d = alpha2 / (np.pi * (nh**2 * (alpha2 - 1) + 1) ** 2)
    k = (roughness + 1) ** 2 / 8
    g = nl / (nl * (1 - k) + k) * nv / (nv * (1 - k) + k)
    f0 = 0.04 * (1 - metallic) + albedo * metallic
    f = f0 + (1 - f0) * 2 ** ((-5.55473 * c - 6.98316) * c)[:, None]
    whole = (1 - metallic) * albedo * nl[:, None] / np.pi + (d * g / (4 * nv))[:, None] * f
    return np.where((nl > 0)[:, None], whole, 0.0)


@pytest.mark.parametrize("form", ["released", "squared"])
def test_reflectance_is_the_formula(form: Form) -> None:
    normal, view, material = points(5)
    answers = responses(normal, view, material.roughness, TOWARDS[::149], form)
    for i in range(5):
        own = [values[i].double().numpy() for values in (material.albedo, material.roughness, material.metallic)]
        expected = written_out(
            normal[i].double().numpy(), view[i].double().numpy(), TOWARDS[::149].double().numpy(), *own, form
        )
        one = tuple(a[i : i + 1] for a in answers)
        drawn = torch.stack([coloured(material.of(slice(i, i + 1)), one, p) for p in _single(len(expected))], 1)
        # below the horizon rounding decides
        assert np.allclose(drawn[0].numpy(), expected, rtol=3e-3, atol=1e-4)


def _single(count: int) -> list[Tensor]:
    """Power from one direction at a time."""
    return list(torch.eye(count)[:, :, None].expand(-1, -1, 3))


def test_squared_form_without_metal_has_the_lobe_of_urhand() -> None:
    normal, view, material = points(8)
    bare = Material(torch.zeros(8, 3), material.roughness, torch.zeros(8))
    light = TOWARDS[::101]
    _, head_on, edge = responses(normal, view, bare.roughness, light, "squared")
    lobe = specular(normal[:, None], view[:, None], light, bare.roughness[:, None])
    cosine = (normal @ light.T).clamp_min(0.0)
    assert torch.allclose(0.04 * head_on + edge, lobe * cosine, rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("roughness", [0.09, 0.3, 0.8])
@pytest.mark.parametrize("angle", [0.0, 30.0, 60.0])
def test_white_furnace_is_the_models_own_value(roughness: float, angle: float) -> None:
    """The diffuse part is not lessened: a white surface sends back 1 and what the lobe adds, 1.02 to 1.05."""
    turn = math.radians(angle)
    normal, view = torch.tensor([[0.0, 1.0, 0.0]]), torch.tensor([[math.sin(turn), math.cos(turn), 0.0]])
    white = Material(torch.ones(1, 3), torch.tensor([roughness]), torch.zeros(1))
    fine = directions(256, 512).reshape(-1, 3)
    one = written_out(
        normal[0].double().numpy(), view[0].double().numpy(), fine, np.ones(3), roughness, 0.0, "released"
    )
    expected = solid_angles(256, 512).ravel() @ one
    room = MapSampler(Environment("white", np.ones((4, 8, 3))))
    found = brute_force(room, normal, view, white, "released")
    assert found[0].numpy() == pytest.approx(expected, rel=3e-3)
    assert 1.015 < float(found[0, 0]) < 1.055


@pytest.mark.parametrize("kind", ["map", "gaussians"])
@pytest.mark.parametrize("how", ["strata", "light", "combined"])
def test_sampling_is_unbiased(kind: str, how: Sampling) -> None:
    """The mean of many estimates is within four of its standard errors of the sum over 12,800 texels."""
    light, where = sky(kind), points(6)
    expected = brute_force(light, *where, "released")
    runs = []
    for seed in range(24):
        samples = gather(how, light, 128, where, "released", np.random.default_rng(seed), fresh=True)
        runs.append(
            coloured(where[2], responses(where[0], where[1], where[2].roughness, samples.directions), samples.power)
        )
    found = torch.stack(runs)
    error = found.std(dim=0) / math.sqrt(len(runs))
    assert ((found.mean(dim=0) - expected).abs() <= 4.5 * error + 0.015 * expected).all()


def test_the_light_is_found_by_its_importance_and_a_narrow_lobe_by_the_skins() -> None:
    """A lamp of one texel: strata miss it, the light's own density does not; on a mirror both need the combination."""
    where = points(6)
    errors = {how: _error(how, sky("map"), where) for how in ("strata", "light", "combined")}
    assert errors["light"] < 0.5 * errors["strata"]
    shiny = (where[0], where[1], Material(torch.full((6, 3), 0.9), torch.full((6,), 0.1), torch.ones(6)))
    wide = GaussianSampler(SphericalGaussians(torch.tensor([[0.0, 1.0, 0.0]]), torch.tensor([0.3]), torch.ones(1, 3)))
    assert _error("combined", wide, shiny) < 0.5 * _error("light", wide, shiny)


def _error(how: Sampling, light: LightSampler, where: tuple[Tensor, Tensor, Material]) -> float:
    expected = brute_force(light, *where, "released")
    found = []
    for seed in range(12):
        samples = gather(how, light, 128, where, "released", np.random.default_rng(seed), fresh=True)
        answers = responses(where[0], where[1], where[2].roughness, samples.directions)
        found.append(coloured(where[2], answers, samples.power) - expected)
    return float(torch.stack(found).square().mean().sqrt() / expected.mean())


@pytest.mark.parametrize("kind", ["map", "gaussians"])
def test_draws_follow_their_density(kind: str) -> None:
    light = sky(kind)
    drawn = light.draw(np.random.default_rng(0).random((8000, 3))).float()
    assert torch.allclose(drawn.norm(dim=1), torch.ones(len(drawn)), atol=1e-5)
    assert float(light.density(TOWARDS).float() @ SOLID) == pytest.approx(1.0, rel=2e-3)
    expected = TOWARDS.T @ (light.density(TOWARDS).float() * SOLID)
    assert torch.allclose(drawn.mean(dim=0), expected, atol=0.03)


def test_strata_cover_the_sphere() -> None:
    assert np.abs(strata(128)[0].mean(axis=0)).max() < 1e-12
    rows = np.floor((1.0 - strata(128, np.random.default_rng(0), 3)[..., 1]) / 2.0 * 8).astype(int)
    assert all((np.bincount(one) == 16).all() for one in rows)


def test_studio_light_starts_with_the_released_energy() -> None:
    light = StudioLight(8).gaussians()
    assert light.integral().detach().numpy() == pytest.approx(np.full(3, ENERGY), rel=1e-5)
    assert (light.sharpness >= 10.0).all()


def test_gradients_reach_the_light_and_the_material() -> None:
    learned, (normal, view, material) = StudioLight(4), points(5)
    albedo = material.albedo.clone().requires_grad_()
    own = Material(albedo, material.roughness, material.metallic)
    samples = gather(
        "strata", GaussianSampler(learned.gaussians()), 32, (normal, view, own), "released", np.random.default_rng(0)
    )
    coloured(own, responses(normal, view, own.roughness, samples.directions), samples.power).sum().backward()
    assert albedo.grad is not None and albedo.grad.abs().sum() > 0
    for parameter in learned.parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all() and parameter.grad.abs().sum() > 0


def test_a_single_direction_is_refused() -> None:
    with pytest.raises(InputError, match="at least 2"):
        gather("strata", sky("map"), 1, points(1), "released", np.random.default_rng(0))


def places(rays: int, each: int) -> Scattering:
    """Rays with `each` places of random weights; every other ray meets nothing."""
    rng = np.random.default_rng(8)
    normal, view, material = points(rays * each, 5)
    ray = torch.arange(rays).repeat_interleave(each) * 2
    weight = torch.from_numpy(rng.dirichlet(np.ones(each), rays) * rng.uniform(0.3, 1.0, (rays, 1))).float().flatten()
    return Scattering(2 * rays, ray, weight, torch.zeros_like(normal), normal, view, material)


def test_draws_keep_each_rays_alpha_and_fall_where_the_weight_is() -> None:
    whole = places(7, 5)
    drawn = whole.drawn(400)
    assert torch.allclose(
        drawn.total(torch.ones(len(drawn.ray), 1)), whole.total(torch.ones(len(whole.ray), 1)), atol=1e-6
    )
    assert torch.allclose(drawn.total(drawn.normal), whole.total(whole.normal), atol=4e-3)


def test_gradients_of_draws_are_those_of_the_sum() -> None:
    whole = places(4, 5)
    weight = whole.weight.clone().requires_grad_()
    own = replace(whole, weight=weight)
    values = torch.arange(20.0)[:, None]
    (exact,) = torch.autograd.grad(own.total(values).sum(), weight)
    parts = replace(own, normal=values.expand(-1, 3)).drawn(4000)
    (found,) = torch.autograd.grad(parts.total(parts.normal)[:, 0].sum(), weight)
    assert torch.allclose(found, exact, rtol=0.02, atol=0.03)


class Wall(Occluder):
    """Hides all that comes from x > 0."""

    def __call__(self, points: Tensor, towards: Tensor) -> Tensor:
        return (towards[:, 0] <= 0).float()

    def of_all(self, points: Tensor, normal: Tensor, towards: Tensor) -> Tensor:
        return self(points, towards).expand(len(points), -1)


@pytest.mark.parametrize("way", ["dealt", "shared"])
def test_colour_of_rays_is_unbiased_with_shadows(way: str) -> None:
    """Against every place under every direction."""
    whole, light = places(4, 3), sky("gaussians")
    assert isinstance(light, GaussianSampler)
    answers = responses(whole.normal, whole.view, whole.material.roughness, TOWARDS)
    power = light.radiance(TOWARDS) * (SOLID * (TOWARDS[:, 0] <= 0))[:, None]
    expected = whole.total(coloured(whole.material, answers, power))
    found = []
    for seed in range(80):
        first, second = np.random.default_rng(seed), np.random.default_rng([1, seed])
        if way == "dealt":
            found.append(dealt(whole.drawn(64, first), light.gaussians, Wall(), 64, second))
        else:
            found.append(shared(whole.drawn(2, first), light.gaussians, Wall(), 64, second))
    drawn = torch.stack(found)
    error = drawn.std(dim=0) / math.sqrt(len(drawn))
    assert ((drawn.mean(dim=0) - expected).abs() <= 4.5 * error + 0.015 * expected).all()
