"""Shading features: the light that texels reflect, summed over lights in tiles that fit the cache."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np
import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from ..light.lightset import LightSet, light_samples
from ..scene import Array
from .brdf import SHININESS, clamp_roughness, distribution, fresnel, masking
from .fused import fused_features
from .surface import unit

__all__ = ["LightSet", "Model", "light_features", "light_samples"]

Model: TypeAlias = Literal["brdf", "phong", "diffuse"]
Dots: TypeAlias = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor | None]]

_PAIRS = 1 << 16
"""Texel-light pairs in a tile: 256 kB for each of the dozen buffers of the kernel."""

_LIGHTS = 32
"""Lights in a tile."""

_KEEP = 1 << 22
"""Above this many pairs the backward pass recomputes tiles instead of keeping their buffers (60 bytes a pair)."""

_FUSE = 1 << 20
"""From this many pairs on the fused kernel, compiled once a shape, beats tiles where no gradient is needed."""


def light_features(
    normal: Tensor,
    position: Tensor,
    roughness: Tensor,
    camera_centre: Tensor | Array,
    lights: LightSet,
    visibility: Tensor | Array | None = None,
    model: Model = "brdf",
) -> tuple[Tensor, Tensor]:
    """Diffuse and specular features (3, N) each of N texels (URHand supp. Eqs. 1-2), linear in the lights.

    normal (3, N) unit, position (3, N) and camera_centre (3,) in metres, roughness (N); visibility (L + P, N)
    bool or weights in [0, 1], rows as in `lights`; None: everything is lit. The diffuse feature is the
    irradiance; it has no 1/pi and no albedo. `model` "brdf" gives the specular feature of Eqs. 3-6, "phong" that
    of Phong (no cosine), "diffuse" zeros. Differentiable in normal, position, roughness and, if `lights` holds
    tensors, in their irradiance and intensities. Lights without power are skipped unless they need a gradient.
    """
    centre = _tensor(camera_centre).to(normal.dtype)
    view = unit(centre[:, None] - position)
    maps = (normal, view, position, roughness)
    split = len(lights.directions)
    kinds: tuple[tuple[Tensor | Array, Tensor | Array, Dots, slice], ...] = (
        (lights.directions, lights.irradiance, _distant, slice(0, split)),
        (lights.positions, lights.intensities, _near, slice(split, None)),
    )
    features = normal.new_zeros(2, *normal.shape)
    for places, powers, dots, rows in kinds:
        where, power = (_tensor(values).to(normal.dtype) for values in (places, powers))
        seen = None if visibility is None else _tensor(visibility[rows])
        if not power.requires_grad:
            lit = power.any(dim=1)
            if not lit.all():
                where, power = where[lit], power[lit]
                seen = None if seen is None else seen[lit]
        if len(where):
            features = features + _sum(dots, where, power, seen, maps, model)
    return features[0], features[1]


@torch.no_grad()
def transfer(
    normal: Tensor,
    position: Tensor,
    roughness: Tensor,
    camera_centre: Tensor | Array,
    directions: Array,
    visibility: Tensor,
) -> Tensor:
    """What N texels answer to L distant lights of unit irradiance, (2, L, N): diffuse and specular (Eqs. 1-6).

    For relighting a known pose and camera: the features are irradiance^T @ transfer, see `relight`. Takes 8 L N
    bytes (48 MB for a 16 x 32 environment at 128 texels); arguments as in `light_features`.
    """
    view = unit(_tensor(camera_centre).to(normal.dtype)[:, None] - position)
    where = _tensor(directions).to(normal.dtype)
    answer = normal.new_empty(2, len(where), normal.shape[1])
    step = max(1, _PAIRS // min(_LIGHTS, len(where)))
    for first in range(0, normal.shape[1], step):
        texels = slice(first, first + step)
        local = tuple(values[..., texels] for values in (normal, view, position, roughness))
        for start in range(0, len(where), _LIGHTS):
            some = slice(start, start + _LIGHTS)
            diffuse, lobe = _response(_distant, where[some], visibility[some, texels], local, "brdf")
            answer[0, some, texels] = diffuse
            answer[1, some, texels] = lobe  # type: ignore[assignment]
    return answer


def relight(known: Tensor, irradiance: Array) -> tuple[Tensor, Tensor]:
    """Diffuse and specular features (3, N) of a `transfer` (2, L, N) under irradiance (L, 3)."""
    power = _tensor(irradiance).to(known.dtype).T
    return power @ known[0], power @ known[1]


def _tensor(values: Tensor | Array) -> Tensor:
    """The values as a tensor; read-only arrays are copied, which torch cannot share."""
    return values if isinstance(values, Tensor) else torch.from_numpy(np.require(values, requirements="W"))


def _sum(
    dots: Dots, where: Tensor, power: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: Model
) -> Tensor:
    """Both features (2, 3, N) under lights of one kind, tile by tile."""
    count = maps[0].shape[1]
    tracked = torch.is_grad_enabled() and any(values.requires_grad for values in (where, power, *maps))
    if (
        dots is _distant
        and model == "brdf"
        and not tracked
        and len(where) * count >= _FUSE
        and power.dtype == torch.float32
    ):
        normal, view, _, roughness = maps
        return fused_features((normal, *_tangents(normal)), view, roughness, where, power, seen)
    step = max(1, _PAIRS // min(_LIGHTS, len(where)))
    keep = not torch.is_grad_enabled() or len(where) * count <= _KEEP
    tiles = []
    for first in range(0, count, step):
        texels = slice(first, first + step)
        local = tuple(values[..., texels] for values in maps)
        parts = []
        for start in range(0, len(where), _LIGHTS):
            some = slice(start, start + _LIGHTS)
            inputs = (dots, where[some], power[some], None if seen is None else seen[some, texels], local, model)
            parts.append(_tile(*inputs) if keep else checkpoint(_tile, *inputs, use_reentrant=False))
        tiles.append(sum(parts[1:], start=parts[0]))
    return torch.cat(tiles, dim=2)


def _tile(
    dots: Dots, where: Tensor, power: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: Model
) -> Tensor:
    """Both features (2, 3, T) of T texels under L lights."""
    diffuse, lobe = _response(dots, where, seen, maps, model)
    specular = torch.zeros_like(maps[0]) if lobe is None else power.T @ lobe
    return torch.stack([power.T @ diffuse, specular])


def _response(
    dots: Dots, where: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: Model
) -> tuple[Tensor, Tensor | None]:
    """Diffuse and, where the model has one, specular response (L, T) of T texels to L lights of unit power."""
    normal, view, position, roughness = maps
    if model == "brdf":
        axes = torch.stack([normal, *_tangents(normal)], dim=1)
    elif model == "phong":
        axes = torch.stack([normal, view], dim=1)
    else:
        axes = normal[:, None]
    to_light, falloff = dots(where, position, axes)
    cosine = to_light[:, 0].clamp_min(0.0)
    received = torch.ones_like(cosine) if seen is None else seen.to(cosine.dtype)
    if falloff is not None:
        received = received * falloff
    diffuse = cosine * received
    to_view = (axes * view[:, None]).sum(dim=0)
    if model == "brdf":
        return diffuse, _specular(to_light, to_view, cosine, clamp_roughness(roughness)) * diffuse
    if model == "phong":
        mirrored = 2.0 * cosine * to_view[0] - to_light[:, 1]
        return diffuse, mirrored.clamp(0.0, 1.0).pow(SHININESS) * received * (cosine > 0)
    return diffuse, None


def _specular(to_light: Tensor, to_view: Tensor, cosine: Tensor, roughness: Tensor) -> Tensor:
    """D F G (L, T) from ω (L, 3, T) and d (3, T) in the frame (n, t, b) of each texel.

    There |ω + d|^2 sin^2(n, h) is the sum of two squares and |ω + d| = 2 d.h, so that no L x T buffer holds
    vectors and nothing cancels.
    """
    total = to_light + to_view
    planar = total[:, 1].square() + total[:, 2].square()
    length2 = torch.addcmul(planar, total[:, 0], total[:, 0]).clamp_min(1e-8)
    lobe = distribution(planar / length2, roughness) * fresnel(0.5 * length2.sqrt())
    above = masking(to_view[0].clamp_min(0.0), roughness) * (0.25 * (to_view[0] > 0))
    return lobe * (masking(cosine, roughness) * above)


def _tangents(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors that complete unit normals (3, T) to a frame (Duff et al. 2017, JCGT 6(1))."""
    x, y, z = normal
    sign = torch.where(z < 0, -1.0, 1.0).to(z.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    return torch.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), torch.stack([b, sign + y * y * a, -y])


def _distant(where: Tensor, position: Tensor, axes: Tensor) -> tuple[Tensor, Tensor | None]:
    """Components (L, K, T) of directions (L, 3) along axes (3, K, T); no falloff."""
    return (where @ axes.flatten(1)).unflatten(1, axes.shape[1:]), None


def _near(where: Tensor, position: Tensor, axes: Tensor) -> tuple[Tensor, Tensor | None]:
    """Components (P, K, T) along axes of the unit vectors to positions (P, 3), and 1 / r^2 (P, T)."""
    towards = where[:, :, None] - position
    falloff = 1.0 / towards.square().sum(dim=1).clamp_min(1e-12)
    return torch.einsum("pct,ckt->pkt", towards * falloff.sqrt()[:, None], axes), falloff
