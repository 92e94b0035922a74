from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from handbench.errors import InputError
from handbench.light.environment import directions, solid_angles
from handbench.light.gaussians import SphericalGaussians, fit, integrals
from handbench.light.skybox import skybox
from handbench.light.stage import stage_directions
from handbench.scene import Environment

EXTREMES = [0.0, 1e-12, 1e-6, 0.0199, 0.0201, 1.0, 50.0, 1e3, 1e6]


def random_lobes(count: int, seed: int = 0) -> SphericalGaussians:
    """Lobes that stand apart: no fit tells many that lie on each other."""
    random = np.random.default_rng(seed)
    axes = stage_directions(count) + 0.1 * random.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    values = (axes, np.exp(random.uniform(0, 4, count)), random.uniform(0.2, 3, (count, 3)))
    return SphericalGaussians(*map(torch.from_numpy, values))


def miss(lobes: SphericalGaussians, environment: Environment) -> float:
    """Relative RMS error of the radiance over the sphere."""
    size = environment.radiance.shape[:2]
    weights = solid_angles(*size)[..., None]
    error = (lobes.to_environment(*size).radiance - environment.radiance.astype(float)) ** 2
    return float(np.sqrt((weights * error).sum() / (weights * environment.radiance.astype(float) ** 2).sum()))


@pytest.mark.parametrize("sharpness", EXTREMES)
@pytest.mark.parametrize(("dtype", "rtol"), [(torch.float64, 1e-12), (torch.float32, 1e-6)])
def test_integral_is_the_quadrature(sharpness: float, dtype: torch.dtype, rtol: float) -> None:
    # 2 pi times the integral over the height c, with t = 1 - c so that a sharp lobe is not lost
    edge = min(2.0, 40.0 / max(sharpness, 1e-9))
    expected = 2 * np.pi * quad(lambda t: np.exp(-sharpness * t), 0.0, edge, epsabs=0, epsrel=1e-13)[0]
    assert integrals(torch.tensor([sharpness], dtype=dtype)).item() == pytest.approx(expected, rel=rtol)


def test_radiance_is_the_formula_also_for_sharp_lobes_in_float32() -> None:
    lobes = random_lobes(5)
    towards = torch.from_numpy(directions(6, 12).reshape(-1, 3))
    cosines = towards @ lobes.axes.T
    expected = torch.exp(lobes.sharpness * (cosines - 1)) @ lobes.amplitude
    assert torch.allclose(lobes.evaluate(towards), expected, rtol=1e-12)
    # a hundredth of a degree off the axis of the sharpest lobe; m.v - 1 in float32 knows it to two digits only
    angle = 1e-3
    near = torch.tensor([[np.sin(angle), 0, np.cos(angle)]], dtype=torch.float32)
    sharp = SphericalGaussians(torch.tensor([[0.0, 0, 1]]), torch.tensor([1e6]), torch.ones(1, 3))
    assert sharp.evaluate(near)[0, 0].item() == pytest.approx(np.exp(1e6 * (np.cos(angle) - 1)), rel=2e-4)


def test_the_integral_is_the_sum_of_the_map() -> None:
    lobes = random_lobes(6)
    radiance = lobes.evaluate(torch.from_numpy(directions(200, 400).reshape(-1, 3))).numpy()
    assert np.allclose(solid_angles(200, 400).ravel() @ radiance, lobes.integral().numpy(), rtol=1e-4)


@pytest.mark.parametrize("sharpness", EXTREMES)
def test_a_map_keeps_the_power_of_each_lobe(sharpness: float) -> None:
    axis = torch.tensor([[0.6, 0.64, 0.48]])
    lobes = SphericalGaussians(axis, torch.tensor([sharpness]), torch.tensor([[1.0, 2.0, 0.5]]))
    environment = lobes.to_environment(9, 17)
    power = (environment.radiance * solid_angles(9, 17)[..., None]).sum(axis=(0, 1))
    assert np.allclose(power, lobes.integral().numpy(), rtol=1e-5)
    if sharpness >= 1e3:
        brightest = environment.radiance[..., 0].argmax()
        assert brightest == (directions(9, 17).reshape(-1, 3) @ axis[0].numpy()).argmax()


def test_gradients_are_finite_at_the_extremes_and_right_between() -> None:
    towards = torch.from_numpy(np.concatenate([directions(4, 8).reshape(-1, 3), np.eye(3), -np.eye(3)]))
    for dtype in (torch.float32, torch.float64):
        axes = torch.eye(3, dtype=dtype).repeat(3, 1).requires_grad_()
        sharpness = torch.tensor(EXTREMES, dtype=dtype, requires_grad=True)
        amplitude = torch.zeros(9, 3, dtype=dtype).requires_grad_()
        lobes = SphericalGaussians(axes, sharpness, amplitude + 1)
        total = lobes.evaluate(towards.to(dtype)).sum() + lobes.integral().sum()
        for gradient in torch.autograd.grad(total, (axes, sharpness, amplitude)):
            assert torch.isfinite(gradient).all()
    some = torch.tensor([0.0, 1e-3, 0.02, 3.0, 40.0], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(integrals(some).sum(), some)
    assert slope[0].item() == pytest.approx(-4 * np.pi)
    for value, found in zip(some.tolist()[1:], slope.tolist()[1:], strict=True):
        exact = quad(lambda t, s=value: -t * np.exp(-s * t), 0, 2, epsrel=1e-12)[0] * 2 * np.pi
        assert found == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("count", [1, 3, 8])
def test_lobes_are_recovered_from_their_map(count: int) -> None:
    true = random_lobes(count)
    found = fit(true.to_environment(32, 64), count)
    order = (true.axes @ found.axes.T).argmax(dim=1)
    assert order.unique().numel() == count
    assert torch.allclose(found.axes[order], true.axes, atol=1e-5)
    assert torch.allclose(found.sharpness[order], true.sharpness, rtol=1e-4)
    assert torch.allclose(found.amplitude[order], true.amplitude, rtol=1e-4)


@pytest.mark.parametrize("name", ["brightday", "default", "nightlights"])
def test_more_lobes_are_closer_to_real_light(name: str) -> None:
    environment = skybox(name, 12, 24)
    few, many = fit(environment, 8), fit(environment, 24)
    assert len(few) == 8 and len(many) == 24 and (many.amplitude >= 0).all() and (few.amplitude >= 0).all()
    assert miss(many, environment) < min(0.1, 0.5 * miss(few, environment))
    power = (environment.radiance * solid_angles(12, 24)[..., None]).sum(axis=(0, 1))
    assert np.allclose(many.integral().numpy(), power, rtol=1e-9)


def test_a_fit_repeats_and_scales_with_the_light() -> None:
    environment = skybox("hall", 8, 16)
    first, again = fit(environment, 5), fit(environment, 5)
    assert torch.equal(first.axes, again.axes) and torch.equal(first.amplitude, again.amplitude)
    for factor in (2.0**-90, 2.0**90):
        scaled = fit(environment.scaled(factor), 5)
        assert torch.allclose(scaled.amplitude / factor, first.amplitude, rtol=1e-9)


@pytest.mark.parametrize("radiance", [np.zeros((4, 8, 3)), np.ones((1, 1, 3)), np.ones((1, 2, 3)), np.ones((6, 12, 3))])
def test_plain_maps_are_fitted(radiance: np.ndarray) -> None:
    found = fit(Environment("plain", radiance), 8)
    drawn = found.to_environment(*radiance.shape[:2]).radiance
    assert np.allclose(drawn, radiance, atol=2e-3) and torch.isfinite(found.axes).all()


def test_bad_lobes_are_named() -> None:
    one, unit = torch.ones(1, 3), torch.tensor([[0.0, 1.0, 0.0]])
    with pytest.raises(InputError, match=r"\(1, 3\), \(2,\), \(1, 3\)"):
        SphericalGaussians(unit, torch.ones(2), one)
    with pytest.raises(InputError, match="unit"):
        SphericalGaussians(one, torch.ones(1), one)
    for bad in (-1.0, float("nan")):
        with pytest.raises(InputError, match="sharpness"):
            SphericalGaussians(unit, torch.tensor([bad]), one)
    with pytest.raises(InputError, match="0 spherical Gaussians"):
        fit(Environment("grey", np.ones((2, 4, 3))), 0)
