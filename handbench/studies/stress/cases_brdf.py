"""Reflectance models, elementwise, at the borders of their domain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...render.shade import brdf, reference
from ...scene import Array
from .case import Case
from .judgement import TruthPair, accurate, equal, finite, finite_or
from .scenes import around, exact, sphere_directions, tangent, tensor, unit

FAMILY = "brdf"
ANGLES = 512
JAX = "jax float64, as printed"

_specular_of: Callable[..., Tensor] = brdf.specular  # called with unpacked directions
_phong_of: Callable[..., Tensor] = brdf.phong

Directions = tuple[Array, Array, Array]


def cases() -> Iterator[Case]:
    for beta in (0.02, 0.05, 0.1, 0.3, 0.6, 1.0):
        yield _specular(f"roughness {beta:g}", anywhere(), beta)
        yield _specular(f"roughness {beta:g}, mirror direction", mirror(), beta)
        yield _specular(f"roughness {beta:g}, across the lobe", across(), beta)
        yield _gradient(f"gradient, roughness {beta:g}", anywhere(), beta)
    for beta in (0.0, 1e-3, -0.5, 1.5, 1e6):  # documented: clamped
        yield _specular(f"roughness {beta:g}, out of range", anywhere(), beta)
        yield _gradient(f"gradient, roughness {beta:g}, out of range", anywhere(), beta, accurate_to=None)
    for name, make in PLACES.items():
        yield _specular(name, make(), 0.3)
        yield _gradient(f"gradient, {name}", make(), 0.3, accurate_to=None)
    for name, make in DARK.items():
        yield Case(FAMILY, f"{name} is black", equal(), partial(_dark, make()), "zero")
    for dtype in (torch.float16, torch.bfloat16):
        for beta in (0.02, 0.3, 1.0):
            name = f"{str(dtype).removeprefix('torch.')}, roughness {beta:g}"
            yield Case(FAMILY, name, finite_or(InputError), partial(_low_precision, mirror(), beta, dtype))
    yield Case(FAMILY, "reciprocity", equal(1e-5), _reciprocity, "light and viewer exchanged")
    for name, make in {"anywhere": anywhere, "mirror direction": mirror, **PLACES}.items():
        yield Case(FAMILY, f"phong, {name}", accurate(3e-5), partial(_phong, make()), "numpy float64")
        yield Case(FAMILY, f"phong gradient, {name}", finite(), partial(_phong_gradient, make()))


def anywhere() -> Directions:
    """Normal, view and light (`ANGLES`, 3), both above the horizon."""
    normal = exact(sphere_directions(ANGLES))
    return normal, exact(around(normal, 1)), exact(around(normal, 2))


def mirror() -> Directions:
    """The view is the mirrored light, so that the half vector is the normal: the peak of the lobe."""
    normal, _, light = anywhere()
    return normal, exact(2.0 * (normal * light).sum(1, keepdims=True) * normal - light), light


def across() -> Directions:
    """The half vector goes through the lobe of roughness 0.02, from its peak to ten times its half width."""
    normal, _, light = anywhere()
    away = np.linspace(0.0, 10 * 0.02**2, ANGLES)[:, None]
    half = unit(normal + away * tangent(normal))
    return normal, exact(2.0 * (half * light).sum(1, keepdims=True) * half - light), light


def _grazing(view: float, light: float) -> Directions:
    """View and light at these sines above the horizon of +z, which float32 holds exactly."""
    turn = np.linspace(0.0, 2 * np.pi, ANGLES, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(ANGLES)], axis=1)
    normal = np.tile([0.0, 0.0, 1.0], (ANGLES, 1))
    other = np.roll(ring, ANGLES // 3, axis=0)
    return normal, exact(unit(ring + view * normal)), exact(unit(other + light * normal))


def _opposite(light_above: float) -> Directions:
    """View and light on one line through the surface, so that the half vector vanishes."""
    normal, _, light = _grazing(0.0, light_above)
    return normal, -light, light


PLACES: dict[str, Callable[[], Directions]] = {
    "view grazing by 1e-3": lambda: _grazing(1e-3, 0.5),
    "view grazing by 1e-6": lambda: _grazing(1e-6, 0.5),
    "light grazing by 1e-3": lambda: _grazing(0.5, 1e-3),
    "light grazing by 1e-6": lambda: _grazing(0.5, 1e-6),
    "both grazing by 1e-3": lambda: _grazing(1e-3, 1e-3),
    "light at the horizon": lambda: _grazing(0.5, 0.0),
    "view at the horizon": lambda: _grazing(0.0, 0.5),
    "d = -ω at the horizon": lambda: _opposite(0.0),
    "d = -ω": lambda: _opposite(0.3),
    "d = ω = n": lambda: (anywhere()[0],) * 3,
}

DARK: dict[str, Callable[[], Directions]] = {
    "light below the horizon": lambda: (anywhere()[0], anywhere()[1], -anywhere()[2]),
    "view below the horizon": lambda: (anywhere()[0], -anywhere()[1], anywhere()[2]),
    "both below the horizon": lambda: (-anywhere()[0], anywhere()[1], anywhere()[2]),
}


def _specular(name: str, where: Directions, beta: float) -> Case:
    def run() -> TruthPair:
        got = _specular_of(*map(tensor, where), torch.full((len(where[0]),), beta))
        return TruthPair(got * cosine(where), _truth(where, beta) * cosine(where).numpy())

    return Case(FAMILY, name, accurate(1e-5), run, JAX)


def cosine(where: Directions) -> Tensor:
    """n.ω, by which a feature is multiplied: at the horizon itself the lobe jumps, the feature does not."""
    return torch.from_numpy((unit(where[0]) * where[2]).sum(1).clip(min=0.0))


def _truth(where: Directions, beta: float) -> Array:
    """D F G in float64 at the clamped roughness, zero where light or view is below the horizon.

    Eq. 3 asks for a normal that is unit to float64; light and view are taken as float32 has them.
    """
    return np.asarray(_jax(lambda b: _printed(where, b), beta))


def _jax(function: Callable[[Any], Any], beta: float) -> Any:
    import jax
    import jax.numpy as jnp

    with jax.enable_x64(True):
        return function(jnp.full(ANGLES, np.clip(beta, brdf.MIN_ROUGHNESS, 1.0), jnp.float64))


def _printed(where: Directions, beta: Any) -> Any:
    import jax.numpy as jnp

    normal, view, light = (jnp.asarray(values, jnp.float64) for values in (unit(where[0]), *where[1:]))
    to_light, to_view = (normal * light).sum(1), (normal * view).sum(1)
    above = (to_light > 0) & (to_view > 0)
    total = jnp.where(above[:, None], light + view, normal)
    half = total / jnp.linalg.norm(total, axis=1, keepdims=True)
    d, f = reference.distribution((half * normal).sum(1), beta), reference.fresnel((view * half).sum(1))
    g = reference.geometry(jnp.maximum(to_view, 0), jnp.maximum(to_light, 0), beta)
    return jnp.where(above, d * f * g, 0.0)


def _gradient(name: str, where: Directions, beta: float, accurate_to: float | None = 1e-4) -> Case:
    """The derivative in roughness against jax; where the clamp or an edge makes it one-sided, only finite."""

    def run() -> Any:
        inputs = [tensor(values).requires_grad_() for values in where]
        rough = torch.full((len(where[0]),), beta, requires_grad=True)
        _specular_of(*inputs, rough).sum().backward()
        grads = tuple(value.grad for value in (*inputs, rough))
        if accurate_to is None:
            return grads
        import jax

        truth = _jax(jax.grad(lambda b: _printed(where, b).sum()), beta)
        return grads[:3], TruthPair(rough.grad, np.asarray(truth))

    if accurate_to is None:
        return Case(FAMILY, name, finite(), run)
    return Case(FAMILY, name, accurate(accurate_to), lambda: run()[1], JAX)


def _dark(where: Directions) -> TruthPair:
    got = _specular_of(*map(tensor, where), torch.full((len(where[0]),), 0.3))
    return TruthPair(got, torch.zeros(len(where[0])))


def _low_precision(where: Directions, beta: float, dtype: torch.dtype) -> Tensor:
    inputs = [tensor(values, dtype) for values in where]
    return _specular_of(*inputs, torch.full((len(where[0]),), beta, dtype=dtype))


def _reciprocity() -> TruthPair:
    normal, view, light = map(tensor, anywhere())
    rough = torch.linspace(0.02, 1.0, len(normal))
    return TruthPair(brdf.specular(normal, view, light, rough), brdf.specular(normal, light, view, rough))


def _phong(where: Directions) -> TruthPair:
    normal, view, light = unit(where[0]), *where[1:]
    to_light = (normal * light).sum(1, keepdims=True)
    lobe = ((2.0 * to_light * normal - light) * view).sum(1).clip(0.0, 1.0) ** brdf.SHININESS
    got = _phong_of(*map(tensor, where)) * cosine(where)
    return TruthPair(got, lobe * cosine(where).numpy())


def _phong_gradient(where: Directions) -> tuple[Any, ...]:
    inputs = [tensor(values).requires_grad_() for values in where]
    _phong_of(*inputs).sum().backward()
    return tuple(value.grad for value in inputs)
