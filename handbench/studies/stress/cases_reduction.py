"""Environments as a few lights and as spherical Gaussians: dark, hot, tiny and asked for too many."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import torch

from ...errors import InputError
from ...light import environment as env
from ...light.gaussians import SphericalGaussians, fit
from ...light.reduction import reduced, reduced_to
from ...scene import Array, Environment
from .case import Case
from .cases_light import irradiance, maps
from .judgement import TruthPair, accurate, equal, finite, refused
from .scenes import sphere_directions

FAMILY = "reduction"
BLACK = Environment("black", np.zeros((16, 32, 3)))


def cases() -> Iterator[Case]:
    for name, environment in maps().items():
        for count in (1, 16, 10_000):
            label = f"{name}, {count} lights keep the power"
            yield Case(FAMILY, label, accurate(1e-6), partial(_power, environment, count), "numpy float64")
        exact = partial(_exact, environment)
        yield Case(FAMILY, f"{name}, all lights are the texels", equal(1e-12), exact, "to_directional")
        lobes = partial(_fitted, environment)
        yield Case(FAMILY, f"{name}, 8 Gaussians", finite(), lobes)
    yield Case(FAMILY, "all-zero map has no lights", equal(), lambda: TruthPair(len(reduced(BLACK, 8)[0]), 0), "zero")
    yield Case(
        FAMILY, "all-zero map, an error bound", equal(), lambda: TruthPair(len(reduced_to(BLACK, 0.1)), 0), "zero"
    )
    yield Case(FAMILY, "all-zero map, 8 Gaussians are black", equal(), _dark_lobes, "zero")
    yield Case(FAMILY, "an error bound of 1 % is kept", equal(), _bounded, "the bound")
    for sharpness in (0.0, 1e-12, 1e-2, 1.0, 1e6):
        name = f"Gaussian of sharpness {sharpness:g}"
        yield Case(FAMILY, f"{name}, integral", accurate(1e-5), partial(_integral, sharpness), "numpy float64")
        yield Case(FAMILY, f"gradient, {name}", finite(), partial(_gradient, sharpness))
    wide = partial(_to_map, 1e6)
    yield Case(FAMILY, "Gaussian narrower than a texel keeps its power", accurate(1e-5), wide, "its integral")
    for name, run in _broken().items():
        yield Case(FAMILY, name, refused(InputError), run)


def _power(environment: Environment, count: int) -> TruthPair:
    towards, power = reduced(environment, count)
    length = np.linalg.norm(towards, axis=1)
    return TruthPair((power.sum(axis=0), length), (irradiance(environment), np.ones(len(length))))


def _exact(environment: Environment) -> TruthPair:
    size = environment.radiance.shape[:2]
    return TruthPair(reduced(environment, size[0] * size[1]), env.to_directional(environment, *size))


def _fitted(environment: Environment) -> tuple[Any, ...]:
    height, width = environment.radiance.shape[:2]
    lobes = fit(env.resize(environment, min(height, 16), min(width, 32)), 8)
    return lobes.axes, lobes.sharpness, lobes.amplitude, lobes.evaluate(torch.from_numpy(sphere_directions(50)))


def _dark_lobes() -> TruthPair:
    lobes = fit(BLACK, 8)
    return TruthPair(lobes.evaluate(torch.from_numpy(sphere_directions(50))), np.zeros((50, 3)))


def _bounded() -> TruthPair:
    found = reduced_to(maps()["radiance 1e8"], 0.01)
    return TruthPair(max(found.error, 0.01), 0.01)


def _lobe(sharpness: float, dtype: torch.dtype = torch.float32) -> SphericalGaussians:
    axes = torch.tensor([[0.6, 0.0, 0.8]], dtype=dtype)
    return SphericalGaussians(axes, torch.tensor([sharpness], dtype=dtype), torch.ones(1, 3, dtype=dtype))


def _integral(sharpness: float) -> TruthPair:
    truth = 4 * np.pi if sharpness == 0 else -2 * np.pi * np.expm1(-2 * sharpness) / sharpness
    return TruthPair(_lobe(sharpness).integral(), np.full(3, truth))


def _gradient(sharpness: float) -> tuple[Any, ...]:
    lobe = _lobe(sharpness)
    parts = (lobe.axes, lobe.sharpness, lobe.amplitude)
    for part in parts:
        part.requires_grad_()
    towards = torch.tensor([[0.6, 0.0, 0.8], [-0.6, 0.0, -0.8], [0.0, 1.0, 0.0]])
    (lobe.evaluate(towards).sum() + lobe.integral().sum()).backward()
    return tuple(part.grad for part in parts)


def _to_map(sharpness: float) -> TruthPair:
    lobe = _lobe(sharpness, torch.float64)
    return TruthPair(irradiance(lobe.to_environment(16, 32)), lobe.integral())


def _broken() -> dict[str, Callable[[], Any]]:
    one: Array = np.ones((4, 8, 3))
    plain = Environment("plain", one)
    axes = torch.ones(2, 3)
    return {
        "0 lights": lambda: reduced(plain, 0),
        "-1 lights": lambda: reduced(plain, -1),
        "an error bound of NaN": lambda: reduced_to(plain, float("nan")),
        "an error bound below 0": lambda: reduced_to(plain, -0.1),
        "0 Gaussians": lambda: fit(plain, 0),
        "Gaussians of other shapes": lambda: SphericalGaussians(axes, torch.ones(3), torch.ones(2, 3)),
    }
