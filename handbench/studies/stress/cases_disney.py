"""The Disney BRDF, elementwise and as radiance, at the borders of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...render.shade import brdf, reference
from ...render.shade.shading import disney_radiance
from ...scene import Array
from .case import Case
from .cases_brdf import ANGLES, DARK, PLACES, Directions, across, anywhere, cosine, mirror
from .cases_shading import TEXELS, setting
from .judgement import TruthPair, accurate, equal, finite, finite_or
from .scenes import tensor, unit

FAMILY = "disney"
JAX = "jax float64, as printed"

_disney: Callable[..., Tensor] = brdf.disney  # called with unpacked maps
_radiance_of: Callable[..., Tensor] = disney_radiance


@dataclass(frozen=True)
class DisneyParameters:
    """The three parameters, the same for all texels."""

    albedo: float = 0.6
    roughness: float = 0.4
    metallic: float = 0.0

    def tensors(self, count: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor, Tensor]:
        albedo = torch.full((count, 3), self.albedo, dtype=dtype)
        rough, metallic = (torch.full((count,), v, dtype=dtype) for v in (self.roughness, self.metallic))
        return albedo, rough, metallic

    def evaluate(self, where: Directions, dtype: torch.dtype = torch.float32) -> Tensor:
        return _disney(*(tensor(values, dtype) for values in where), *self.tensors(len(where[0]), dtype))


def cases() -> Iterator[Case]:
    for beta in (0.0, 0.02, 0.1, 0.5, 1.0, 2.0):
        for metallic in (0.0, 1.0):
            name = f"roughness {beta:g}, metallic {metallic:g}"
            yield _accurate(name, anywhere(), DisneyParameters(0.6, beta, metallic))
            yield Case(
                FAMILY,
                f"gradient, {name}",
                finite(),
                partial(_gradient, mirror(), DisneyParameters(0.6, beta, metallic)),
            )
    for beta in (0.02, 0.1, 0.5):
        yield _accurate(f"roughness {beta:g}, across the lobe", across(), DisneyParameters(0.6, beta, 0.5))
    for name, make in PLACES.items():
        yield _accurate(name, make(), DisneyParameters())
        yield Case(FAMILY, f"gradient, {name}", finite(), partial(_gradient, make(), DisneyParameters()))
    for name, make in DARK.items():
        yield Case(FAMILY, f"{name} is black", equal(), partial(_dark, make()), "zero")
    for name, skin in {
        "black": DisneyParameters(albedo=0.0),
        "white metal": DisneyParameters(1.0, 0.4, 1.0),
        "albedo and metallic above 1": DisneyParameters(2.0, 0.4, 3.0),
        "albedo and metallic below 0": DisneyParameters(-1.0, 0.4, -1.0),
    }.items():
        yield _accurate(name, anywhere(), skin)
        yield Case(FAMILY, f"gradient, {name}", finite(), partial(_gradient, anywhere(), skin))
    for dtype in (torch.float16, torch.bfloat16):
        for beta in (0.02, 0.5):
            name = f"{str(dtype).removeprefix('torch.')}, roughness {beta:g}"
            low = partial(DisneyParameters(0.6, beta).evaluate, mirror(), dtype)
            yield Case(FAMILY, name, finite_or(InputError), low)
    for count in (1, 32):
        sums = partial(_radiance, count)
        yield Case(FAMILY, f"radiance of {count} lights", accurate(1e-5), sums, "brdf.disney in float64")
    yield Case(FAMILY, "gradient, radiance of 32 lights", finite(), _radiance_gradient)


def _accurate(name: str, where: Directions, skin: DisneyParameters) -> Case:
    def run() -> TruthPair:
        weight = cosine(where)[:, None]
        return TruthPair(skin.evaluate(where) * weight, _truth(where, skin) * weight.numpy())

    return Case(FAMILY, name, accurate(1e-5), run, JAX)


def _truth(where: Directions, skin: DisneyParameters) -> Array:
    """The reference at the clamped parameters, zero where light or view is not above the surface."""
    import jax
    import jax.numpy as jnp

    above = ((where[0] * where[1]).sum(1) > 0) & ((where[0] * where[2]).sum(1) > 0)
    up = np.array([0.0, 0.0, 1.0])
    inputs = [np.where(above[:, None], values, up) for values in (unit(where[0]), *where[1:])]
    parameters = (
        np.clip(skin.albedo, 0, 1) * np.ones(3),
        np.clip(skin.roughness, 0.02, 1),
        np.clip(skin.metallic, 0, 1),
    )
    with jax.enable_x64(True):
        over = jax.vmap(reference.disney_brdf, in_axes=(0, 0, 0, None, None, None))
        values = over(*(jnp.asarray(v, jnp.float64) for v in (*inputs, *parameters)))
        return np.where(above[:, None], np.asarray(values), 0.0)


def _gradient(where: Directions, skin: DisneyParameters) -> tuple[Any, ...]:
    inputs = [tensor(values) for values in where] + list(skin.tensors(len(where[0])))
    for value in inputs:
        value.requires_grad_()
    _disney(*inputs).sum().backward()
    return tuple(value.grad for value in inputs)


def _dark(where: Directions) -> TruthPair:
    return TruthPair(DisneyParameters().evaluate(where), torch.zeros(ANGLES, 3))


def _radiance(count: int) -> TruthPair:
    where = setting(count)
    skin = DisneyParameters(0.6, 0.4, 0.3)
    position = tensor(where.position.T)
    albedo, rough, metallic = skin.tensors(TEXELS)
    got = disney_radiance(tensor(where.normal.T), position, albedo.T, rough, metallic, where.centre, where.lights)
    normal, view = unit(where.normal), unit(where.centre - where.position)
    total = torch.zeros(TEXELS, 3, dtype=torch.float64)
    for direction, power in zip(where.lights.directions, where.lights.irradiance, strict=True):
        place = (normal, view, np.broadcast_to(direction, normal.shape))
        total += skin.evaluate(place, torch.float64) * cosine(place)[:, None] * torch.from_numpy(power)
    return TruthPair(got, total.T)


def _radiance_gradient() -> tuple[Any, ...]:
    where = setting()
    albedo, rough, metallic = DisneyParameters(0.6, 0.4, 0.3).tensors(TEXELS)
    inputs = [tensor(where.normal.T), tensor(where.position.T), albedo.T.contiguous(), rough, metallic]
    for value in inputs:
        value.requires_grad_()
    _radiance_of(*inputs, where.centre, where.lights).sum().backward()
    return tuple(value.grad for value in inputs)
