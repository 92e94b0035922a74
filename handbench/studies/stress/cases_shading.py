"""Shading features over texels and lights, at the borders of what is lit, seen and near."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError, NonFinite
from ...light.lightset import LightSet
from ...render.shade import reference
from ...render.shade.shading import Model, light_features, relight, transfer
from ...scene import Array
from .case import Case
from .judgement import TruthPair, accurate, equal, finite, finite_or
from .scenes import NONE, distant, exact, near, sphere_directions, tensor, unit

FAMILY = "shading"
TEXELS = 128
JAX = "jax float64"

_features: Callable[..., tuple[Tensor, Tensor]] = light_features  # called with unpacked maps
_transfer_of: Callable[..., Tensor] = transfer


@dataclass(frozen=True)
class ShadedTexels:
    """Texels in float64 as float32 holds them: normal, position and roughness, the camera's centre, the lights."""

    normal: Array
    position: Array
    roughness: Array
    centre: Array
    lights: LightSet
    visible: Array | None = None

    def features(self, model: Model = "brdf", dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
        maps = [tensor(values, dtype) for values in (self.normal.T, self.position.T, self.roughness)]
        return _features(*maps, self.centre, self.lights, self.visible, model)

    def truth(self) -> tuple[Array, Array]:
        """Features (3, N) by the independent reference; a near light is one distant light a texel."""
        view = unit(self.centre - self.position)
        count = len(self.normal)
        visible = np.ones((len(self.lights), count)) if self.visible is None else self.visible
        split = len(self.lights.directions)
        rough = self.roughness.clip(0.02, 1.0)
        parts = [(self.lights.directions, self.lights.irradiance, visible[:split])] if split else []
        for place, power, seen in zip(self.lights.positions, self.lights.intensities, visible[split:], strict=True):
            towards = place - self.position
            falloff = seen / (towards**2).sum(1)
            parts.append((unit(towards), np.tile(power, (count, 1)), np.diag(falloff)))
        total = np.zeros((2, count, 3))
        for directions, power, seen in parts:
            total += reference.shading_features(unit(self.normal), view, rough, *_padded(directions, power, seen))
        return total[0].T, total[1].T


def _padded(directions: Array, power: Array, seen: Array) -> tuple[Array, Array, Array]:
    """With dark lights added up to one count, so that the reference is compiled for few shapes."""
    lack = max(TEXELS - len(directions), 0)
    up = np.tile([0.0, 0.0, 1.0], (lack, 1))
    dark = np.zeros((lack, 3))
    return np.concatenate([directions, up]), np.concatenate([power, dark]), np.pad(seen, ((0, lack), (0, 0)))


@cache
def setting(count: int = 32, roughness: float = 0.3) -> ShadedTexels:
    """Texels on a unit sphere seen from 3 m, under `count` distant lights."""
    normal = exact(sphere_directions(TEXELS, 3))
    rng = np.random.default_rng(4)
    position = normal.astype(np.float32).astype(np.float64)
    power = rng.uniform(0.1, 1.0, (count, 3))
    lights = distant(sphere_directions(count, 5), power)
    return ShadedTexels(normal, position, np.full(TEXELS, roughness), np.array([0.0, 0.5, 3.0]), lights)


def cases() -> Iterator[Case]:
    for beta in (0.0, 0.02, 0.1, 0.3, 1.0, 3.0):
        yield _accurate(f"roughness {beta:g}", setting(roughness=beta))
    for count in (1, 33, 10_000):  # one, one more than a tile, and enough for the fused path
        yield _accurate(f"{count} lights", setting(count))
    for power in (1e-8, 1e-4, 1e4, 1e8):
        yield _accurate(f"radiance {power:g}", _powered(np.full((32, 3), power)))
    yield _accurate("one hot light of 1e8", _powered(np.concatenate([np.full((1, 3), 1e8), np.full((31, 3), 1e-4)])))
    yield _accurate("a light of one channel", _powered(np.eye(32, 3)))
    for name, where in _places().items():
        yield _accurate(name, where)
        yield Case(FAMILY, f"gradient, {name}", finite(), partial(_gradients, where))
    for name, lights in {
        "no lights": distant(NONE, NONE),
        "only dark lights": _powered(np.zeros((32, 3))).lights,
    }.items():
        where = replace(setting(), lights=lights)
        yield Case(FAMILY, f"{name} give black", equal(), partial(_black, where), "zero")
    yield Case(FAMILY, "everything in shadow is black", equal(), partial(_black, _shadowed(0.0)), "zero")
    yield _accurate("half of the light in shadow", _shadowed(0.5))
    for name, where in _near().items():
        yield _accurate(name, where)
        yield Case(FAMILY, f"gradient, {name}", finite(), partial(_gradients, where))
    touching = replace(setting(), lights=near(setting().position[:1], np.ones((1, 3))))
    yield Case(FAMILY, "light exactly on a texel", finite(), touching.features)
    yield Case(FAMILY, "gradient, light exactly on a texel", finite(), partial(_gradients, touching))
    inside = replace(setting(), centre=setting().position[0])
    yield Case(FAMILY, "camera exactly on a texel", finite(), inside.features)
    yield Case(FAMILY, "gradient, camera exactly on a texel", finite(), partial(_gradients, inside))
    for beta in (0.0, 0.02, 1.0, 3.0):
        rough = setting(roughness=beta)
        yield Case(FAMILY, f"gradient, roughness {beta:g}", finite(), partial(_gradients, rough))
    yield Case(FAMILY, "gradient in the roughness", accurate(1e-4), _roughness_gradient, JAX)
    yield Case(FAMILY, "gradient under 10000 lights", finite(), partial(_gradients, setting(10_000)))
    for dtype in (torch.float16, torch.bfloat16):
        name = str(dtype).removeprefix("torch.")
        for beta in (0.02, 0.5):
            low = partial(setting(roughness=beta).features, dtype=dtype)
            yield Case(FAMILY, f"{name}, roughness {beta:g}", finite_or(InputError), low)
        bright = partial(_powered(np.full((32, 3), 1e8)).features, dtype=dtype)
        yield Case(FAMILY, f"{name}, radiance 1e8", finite_or(InputError), bright)
    float64 = partial(_compare, setting(), torch.float64)
    yield Case(FAMILY, "float64", accurate(1e-12), float64, JAX)
    yield Case(FAMILY, "phong under 10000 lights", finite(), partial(setting(10_000).features, "phong"))
    yield Case(FAMILY, "diffuse under 10000 lights", accurate(1e-5), _diffuse, JAX)
    yield Case(FAMILY, "order of the lights", equal(1e-5), _permuted, "the lights in another order")
    yield Case(FAMILY, "one light as a thousand", equal(1e-5), _split, "one light of their sum")
    yield Case(FAMILY, "kept transfer, 1000 lights", equal(1e-5), _transfer, "light_features")
    yield Case(FAMILY, "NaN roughness", finite_or(NonFinite), setting(roughness=float("nan")).features)


def _accurate(name: str, where: ShadedTexels) -> Case:
    return Case(FAMILY, name, accurate(1e-5), partial(_compare, where), JAX)


def _compare(where: ShadedTexels, dtype: torch.dtype = torch.float32) -> TruthPair:
    return TruthPair(where.features(dtype=dtype), where.truth())


def _black(where: ShadedTexels) -> TruthPair:
    return TruthPair(where.features(), (np.zeros((3, TEXELS)),) * 2)


def _powered(power: Array) -> ShadedTexels:
    return replace(setting(), lights=distant(setting().lights.directions, power))


def _shadowed(share: float) -> ShadedTexels:
    return replace(setting(), visible=np.full((32, TEXELS), share, dtype=np.float32))


def _places() -> dict[str, ShadedTexels]:
    """Directions where something vanishes, on texels that face +z, so that float32 holds them exactly."""
    turn = np.linspace(0, 2 * np.pi, TEXELS, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(TEXELS)], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (TEXELS, 1))
    base = replace(setting(), normal=up, position=0.01 * ring.astype(np.float32).astype(np.float64))

    def lit_from(directions: Array, centre: Array) -> ShadedTexels:
        return replace(base, lights=distant(unit(directions), np.ones((len(directions), 3))), centre=centre)

    rise = np.array([0.0, 0.0, 1.0])
    above, behind = np.array([0.0, 0, 2]), np.array([0.0, 0, -2])
    return {
        "lights exactly at the horizon": lit_from(ring[::4], above),
        "lights grazing by 1e-6": lit_from(ring[::4] + 1e-6 * rise, above),
        "lights behind the surface": lit_from(ring[::4] - 0.5 * rise, above),
        "view from behind": lit_from(ring[::4] + 0.5 * rise, behind),
        "d = -ω": lit_from(-behind[None], behind),
        "d = ω = n": lit_from(above[None], above),
        "grazing view": lit_from(ring[::4] + 0.5 * rise, np.array([3.0, 0, 1e-3])),
    }


def _near() -> dict[str, ShadedTexels]:
    """Near lights outside and inside the sphere of texels."""
    places = {
        "near light 1 m off": [0.0, 0, 2],
        "near light 1 mm off": list(1.001 * setting().normal[0]),
        "near light 1 km off": [0.0, 0, 1000],
        "near light inside the mesh": [0.1, 0.2, 0.3],
    }
    return {
        name: replace(setting(), lights=near(np.array([place], dtype=np.float32), np.ones((1, 3))))
        for name, place in places.items()
    }


def _gradients(where: ShadedTexels) -> tuple[Any, ...]:
    """Of the sum of both features in everything that light_features is differentiable in."""
    maps = [tensor(values).requires_grad_() for values in (where.normal.T, where.position.T, where.roughness)]
    powers = [tensor(values).requires_grad_() for values in (where.lights.irradiance, where.lights.intensities)]
    lights = LightSet(where.lights.directions, powers[0], where.lights.positions, powers[1])  # type: ignore[arg-type]
    diffuse, specular = _features(*maps, where.centre, lights, where.visible)
    (diffuse + specular).sum().backward()
    return tuple(value.grad for value in (*maps, *powers) if value.grad is not None)


def _roughness_gradient() -> TruthPair:
    where = setting()
    rough = tensor(np.linspace(0.1, 0.9, TEXELS)).requires_grad_()
    light_features(tensor(where.normal.T), tensor(where.position.T), rough, where.centre, where.lights)[
        1
    ].sum().backward()
    step = 1e-5
    ends = [rough.detach().double().numpy() + side * step for side in (1, -1)]
    up, down = (replace(where, roughness=end).truth()[1].sum(axis=0) for end in ends)
    return TruthPair(rough.grad, (up - down) / (2 * step))


def _diffuse() -> TruthPair:
    where = setting(10_000)
    return TruthPair(where.features("diffuse"), (where.truth()[0], np.zeros((3, TEXELS))))


def _permuted() -> TruthPair:
    where = setting(10_000)
    order = np.random.default_rng(0).permutation(10_000)
    other = distant(where.lights.directions[order], where.lights.irradiance[order])
    return TruthPair(replace(where, lights=other).features(), where.features())


def _split() -> TruthPair:
    one = setting(1)
    thousand = distant(np.repeat(one.lights.directions, 1000, 0), np.repeat(one.lights.irradiance / 1000, 1000, 0))
    return TruthPair(replace(one, lights=thousand).features(), one.features())


def _transfer() -> TruthPair:
    where = setting(1000)
    maps = [tensor(values) for values in (where.normal.T, where.position.T, where.roughness)]
    lights = where.lights
    seen = torch.from_numpy(np.random.default_rng(0).random((1000, TEXELS)) < 0.7)
    known = _transfer_of(*maps, where.centre, lights.directions, seen)
    return TruthPair(relight(known, lights.irradiance), _features(*maps, where.centre, lights, seen))
