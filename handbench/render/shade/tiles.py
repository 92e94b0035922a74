"""Responses of texels to lights, summed tile by tile: tiles fit the cache, and no buffer is lights x texels.

The readable form of `fused`, and what serves small work and gradients in the lights; see `shading` for the models.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...skips import note, skips
from .brdf import SHININESS, SMALL, burley, clamp_roughness, distribution, fresnel, masking, schlick, smith
from .models import RESPONSES

Dots: TypeAlias = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor | None]]

_PAIRS = 1 << 16
"""Texel-light pairs in a tile: 256 kB for each of the dozen buffers of the kernel."""

LIGHTS = 32
"""Lights in a tile."""

_KEEP = 1 << 20
"""Above this many pairs the backward pass recomputes tiles instead of keeping their buffers (100 bytes a pair)."""


def tiles(
    dots: Dots, where: Tensor, power: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: str
) -> Tensor:
    """The responses (K, 3, N) under lights of one kind, tile by tile."""
    gradients = torch.is_grad_enabled()
    by_light = gradients and (power.requires_grad or (seen is not None and seen.requires_grad))
    tracked = by_light or (gradients and any(values.requires_grad for values in (where, *maps)))
    large = len(where) * maps[0].shape[1] > _KEEP
    if tracked and large and not (seen is not None and seen.requires_grad):
        return _Recomputed.apply(dots, model, seen, where, power, *maps)
    return _tiles(dots, model, seen, where, power, *maps)


def _tiles(dots: Dots, model: str, seen: Tensor | None, where: Tensor, power: Tensor, *maps: Tensor) -> Tensor:
    """The responses (K, 3, N), tile by tile."""
    count, answers, pairs = maps[0].shape[1], [], 0
    if not count:
        return power.new_zeros(RESPONSES[model], 3, 0)
    for texels in blocks(len(where), count):
        local = tuple(values[..., texels] for values in maps)
        parts: list[Tensor] = []
        for start in range(0, len(where), LIGHTS):
            inputs = _reaching(where, power, seen, slice(start, start + LIGHTS), texels)
            if len(inputs[0]) or not (parts or start + LIGHTS < len(where)):  # one part keeps the tile in the graph
                parts.append(_tile(dots, *inputs, local, model))
            pairs += len(inputs[0]) * local[0].shape[1]
        answers.append(sum(parts[1:], start=parts[0]))
    note("texel-light pairs", len(where) * count, len(where) * count - pairs)
    return torch.cat(answers, dim=2)


def blocks(lights: int, count: int) -> Iterator[slice]:
    step = max(1, _PAIRS // min(LIGHTS, lights))
    return (slice(first, first + step) for first in range(0, count, step))


class _Recomputed(torch.autograd.Function):
    """`_tiles` whose backward pass works each tile out again, one after the other: it keeps none of them."""

    @staticmethod
    def forward(ctx: Any, dots: Dots, model: str, seen: Tensor | None, *tensors: Tensor) -> Tensor:
        ctx.how = dots, model, seen
        ctx.save_for_backward(*tensors)
        return _tiles(dots, model, seen, *tensors)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        dots, model, seen = ctx.how
        tensors, wanted = ctx.saved_tensors, ctx.needs_input_grad[3:]
        found = [torch.zeros_like(t) if want else None for t, want in zip(tensors, wanted, strict=True)]
        for texels in blocks(len(tensors[0]), tensors[2].shape[1]):
            for start in range(0, len(tensors[0]), LIGHTS):
                lights = slice(start, start + LIGHTS)
                places: list[Any] = [lights, lights, *[(..., texels)] * 4]  # of where, power and the four maps
                with torch.enable_grad():
                    parts = [
                        t[place].detach().requires_grad_(want)
                        for t, place, want in zip(tensors, places, wanted, strict=True)
                    ]
                    rows = None if seen is None else seen[lights]
                    inputs = _reaching(parts[0], parts[1], rows, slice(None), texels)
                    if not len(inputs[0]):
                        continue
                    answer = _tile(dots, *inputs, tuple(parts[2:]), model)
                asked = [part for part in parts if part.requires_grad]
                slopes = iter(torch.autograd.grad(answer, asked, gradient[..., texels], allow_unused=True))
                for total, place in zip(found, places, strict=True):
                    if total is not None and (slope := next(slopes)) is not None:
                        total[place] += slope
        return (None, None, None, *found)


def _reaching(
    where: Tensor, power: Tensor, seen: Tensor | None, lights: slice, texels: slice
) -> tuple[Tensor, Tensor, Tensor | None]:
    """The lights of a tile that any of its texels sees: place, power, visibility."""
    where, power = where[lights], power[lights]
    if seen is None:
        return where, power, None
    seen = seen[lights, texels]
    if skips().occluded and not seen.requires_grad:
        reached = (seen if seen.dtype == torch.bool else seen != 0).any(dim=1)
        if not reached.all():
            return where[reached], power[reached], seen[reached]
    return where, power, seen


def _tile(
    dots: Dots, where: Tensor, power: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: str
) -> Tensor:
    """The responses (K, 3, T) of T texels under L lights."""
    return torch.stack([power.T @ one for one in responses(dots, where, seen, maps, model, power.dtype)])


def responses(
    dots: Dots, where: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: str, dtype: torch.dtype
) -> tuple[Tensor, ...]:
    """The responses of a model, each (L, T), of T texels to L lights of unit power.

    Cosines and tangential parts are taken in float64, see `brdf`; what follows keeps its digits in `dtype`.
    """
    normal, view, position, roughness = maps
    if model == "diffuse":
        axes = normal[:, None]
    elif model == "phong":
        axes = torch.stack([normal, view], dim=1)
    else:
        axes = torch.stack([normal, *_tangents(normal)], dim=1)
    to_light, falloff = dots(where, position, axes)
    cosine = to_light[:, 0].to(dtype).clamp_min(0.0)
    received = torch.ones_like(cosine) if seen is None else seen.to(dtype)
    if falloff is not None:
        received = received * falloff.to(dtype)
    diffuse = cosine * received
    if model == "diffuse":
        return (diffuse,)
    to_view = (axes * view[:, None]).sum(dim=0)
    if model == "phong":
        mirrored = (2.0 * to_light[:, 0] * to_view[0] - to_light[:, 1]).to(dtype)
        return diffuse, mirrored.clamp(0.0, 1.0).pow(SHININESS) * received * (cosine > 0)
    beta = clamp_roughness(roughness)
    sine2, facing = _half(to_light, to_view, dtype)
    view_cosine = to_view[0].to(dtype).clamp_min(0.0)
    if model == "brdf":
        above = masking(view_cosine, beta) * (0.25 * (view_cosine > 0))
        lobe = distribution(sine2, beta) * fresnel(facing) * (masking(cosine, beta) * above)
        return diffuse, lobe * diffuse
    above, edge = diffuse * (view_cosine > 0), schlick(facing)
    lobe = distribution(sine2, beta) * smith(cosine, view_cosine, beta) * above
    return burley(cosine, view_cosine, facing, beta) * above, lobe * (1.0 - edge), lobe * edge


def _half(to_light: Tensor, to_view: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """sin^2(n, h) and d.h (L, T) from ω (L, 3, T) and d (3, T) in the frame (n, t, b) of each texel.

    There |ω + d|^2 sin^2(n, h) is the sum of two squares and |ω + d| = 2 d.h, so that no L x T buffer holds
    vectors and nothing cancels but in the sums ω + d, which are float64.
    """
    total = (to_light + to_view).to(dtype)
    planar = total[:, 1].square() + total[:, 2].square()
    length2 = torch.addcmul(planar, total[:, 0], total[:, 0]).clamp_min(SMALL)
    return planar / length2, (0.5 * length2.sqrt()).clamp_max(1.0)


def _tangents(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors that complete unit normals (3, T) to a frame (Duff et al. 2017, JCGT 6(1))."""
    x, y, z = normal
    sign = torch.where(z < 0, -1.0, 1.0).to(z.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    return torch.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), torch.stack([b, sign + y * y * a, -y])


def distant(where: Tensor, position: Tensor, axes: Tensor) -> tuple[Tensor, Tensor | None]:
    """Components (L, K, T) of directions (L, 3) along axes (3, K, T); no falloff."""
    return (where @ axes.flatten(1)).unflatten(1, axes.shape[1:]), None


def near(where: Tensor, position: Tensor, axes: Tensor) -> tuple[Tensor, Tensor | None]:
    """Components (P, K, T) along axes of the unit vectors to positions (P, 3), and 1 / r^2 (P, T)."""
    towards = where[:, :, None] - position
    falloff = 1.0 / towards.square().sum(dim=1).clamp_min(1e-12)
    return torch.einsum("pct,ckt->pkt", towards * falloff.sqrt()[:, None], axes), falloff
