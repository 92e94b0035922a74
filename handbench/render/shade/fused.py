"""Shading under many distant lights, and its gradient, in one fused loop (XLA).

The formulas are those of `shading`, light by light: no buffer of size lights x texels is ever made. Texels are
taken in blocks that stay in the cache, lights that reach no texel of a block are passed over, and blocks are shared
out among threads. As in `shading`, cosines and tangential parts are taken in float64 and used in float32.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...scene import Array
from ...skips import Skips, note, skips
from .brdf import F0, F1, F2, GRAZING, MIN_ROUGHNESS, SHININESS, SMALL
from .models import RESPONSES

_LIGHTS = 128
"""Lights in a call. Fewer are padded with lights that it is told to leave out, so that one shape is compiled."""

_BLOCK = 2048
"""Texels in a call, filled up with copies of the last one, so that one shape is compiled: every camera sees another
number of texels. The two dozen buffers of the loop take 200 kB."""


@cache
def usable() -> bool:
    """Whether XLA can compile and run here."""
    try:
        import jax

        with jax.default_device(jax.devices("cpu")[0]):
            return float(jax.jit(lambda x: x + 1)(np.float32(1))) == 2.0
    except Exception:  # whatever is wrong with the installation: tiles give the same answer
        return False


def fused_responses(
    model: str,
    normal: Tensor,
    view: Tensor,
    roughness: Tensor,
    directions: Tensor,
    irradiance: Tensor,
    visibility: Tensor | None,
) -> Tensor:
    """The responses of a model (see `shading`) summed over L lights, (K, 3, N) float32.

    normal and view (3, N) unit and directions (L, 3) float64; roughness (N) and irradiance (L, 3) float32;
    visibility (L, N) bool or weights in [0, 1], None: everything is lit. Differentiable once in normal, view and
    roughness. Beside arguments and answer it takes at most 2 MB a thread, for the gradient too: that works the lobes
    out anew.
    """
    return _Fused.apply(normal, view, roughness, model, directions, irradiance, visibility)


@torch.no_grad()
def fused_answers(
    model: str, normal: Tensor, view: Tensor, roughness: Tensor, directions: Tensor, visibility: Tensor | None
) -> Tensor:
    """The responses of a model to each of L lights of unit power, (K, L, N) float32; arguments as above."""
    where, seen = directions.numpy(), None if visibility is None else visibility.numpy()
    maps = [values.numpy() for values in (normal, view, roughness)]
    answer = normal.new_empty(RESPONSES[model], len(where), len(roughness), dtype=torch.float32)
    kernel, rows = _kernel(model, "each"), answer.numpy()

    def block(texels: slice) -> None:
        local = [_filled(values[..., texels]) for values in maps]
        for start in range(0, len(where), _LIGHTS):
            some = slice(start, start + _LIGHTS)
            lamps = _padded(where[some]), _lit(seen, some, texels), len(where[some])
            for row, one in zip(rows, kernel(local, *lamps), strict=True):
                place = row[some, texels]
                place[:] = np.asarray(one)[: place.shape[0], : place.shape[1]]

    _in_blocks(block, len(roughness))
    return answer


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, normal: Tensor, view: Tensor, roughness: Tensor, model: str, *lights: Tensor | None
    ) -> Tensor:
        ctx.model, ctx.maps, ctx.lights = model, (normal, view, roughness), lights
        sums = _over_lights(model, ctx.maps, lights, ())
        return torch.from_numpy(sums).unflatten(0, (-1, 3))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        answer = torch.from_numpy(_over_lights(ctx.model, ctx.maps, ctx.lights, (gradient.flatten(0, 1),)))
        normal, view, roughness = answer.split([3, 3, 1])
        like = [g.to(of.dtype) for g, of in zip((normal, view, roughness[0]), ctx.maps, strict=True)]
        return (*like, None, None, None, None)


def _over_lights(
    model: str, maps: tuple[Tensor, ...], lights: tuple[Tensor | None, ...], gradient: tuple[Tensor, ...]
) -> Array:
    """Sums over lights: the responses (3K, N), or, given a gradient (3K, N) of them, that of the maps (7, N)."""
    directions, irradiance, visibility = lights
    assert directions is not None and irradiance is not None
    where, power = (values.detach().numpy() for values in (directions, irradiance))
    seen = None if visibility is None else visibility.detach().numpy()
    inputs, count = [values.detach().numpy() for values in (*maps, *gradient)], len(maps[2])
    found = np.empty((7 if gradient else 3 * RESPONSES[model], count), dtype=np.float32)
    kernel, chosen = _kernel(model, "gradient" if gradient else "sum"), skips()  # which other threads do not know

    def block(texels: slice) -> int:
        reaching = _reaching(inputs[0][:, texels], where, None if seen is None else seen[:, texels], chosen)
        local = [_filled(values[..., texels]) for values in inputs]
        sums: Any = np.zeros((len(found), _BLOCK), dtype=np.float32)
        for start in range(0, len(reaching), _LIGHTS):
            some = reaching[start : start + _LIGHTS]
            lamps = _padded(where[some]), _padded(power[some]), _lit(seen, some, texels), len(some)
            sums = kernel(local, *lamps, sums)
        place = found[:, texels]
        place[:] = np.asarray(sums)[:, : place.shape[1]]
        return len(reaching) * place.shape[1]

    pairs = sum(_in_blocks(block, count))
    if not gradient:
        note("texel-light pairs", len(where) * count, len(where) * count - pairs)
    return found


def _in_blocks(work: Callable[[slice], Any], count: int) -> list[Any]:
    """What some work answers for each block of texels, shared out among threads."""
    import jax

    def with_doubles(texels: slice) -> Any:
        with jax.enable_x64(True):
            return work(texels)

    each = [slice(start, start + _BLOCK) for start in range(0, count, _BLOCK)]
    workers = min(torch.get_num_threads(), len(each))
    if workers < 2:
        return list(map(with_doubles, each))
    return list(_pool(workers).map(with_doubles, each))


def _reaching(normals: Array, where: Array, seen: Array | None, chosen: Skips) -> Array:
    """Which lights reach any texel of a block, rising.

    Without visibility the normals of a block are known to lie in a cone; a light that is below the horizon of the
    whole cone reaches none.
    """
    if seen is not None and chosen.occluded:
        return np.flatnonzero(seen.any(axis=1))
    if seen is None and chosen.below_horizon:
        axis = normals.mean(axis=1)
        axis /= max(float(np.linalg.norm(axis)), 1e-12)
        tilt = float(np.clip((axis @ normals).min(), -1.0, 1.0))  # cosine of the cone's half angle
        if tilt > 0.0:
            return np.flatnonzero(where @ axis > -np.sqrt(1.0 - tilt * tilt) - 1e-6)
    return np.arange(len(where))


def _filled(values: Array) -> Array:
    """Values (..., n) with copies of the last up to `_BLOCK`."""
    whole = np.empty((*values.shape[:-1], _BLOCK), dtype=values.dtype)
    whole[..., : values.shape[-1]] = values
    whole[..., values.shape[-1] :] = values[..., -1:]
    return whole


def _padded(rows: Array) -> Array:
    """Rows (l, c) with zeros added up to `_LIGHTS`."""
    whole = np.zeros((_LIGHTS, *rows.shape[1:]), dtype=rows.dtype)
    whole[: len(rows)] = rows
    return whole


def _lit(seen: Array | None, lights: slice | Array, texels: slice) -> Array:
    """What of some lights reaches a block, padded both ways; (1, 1) if everything is lit."""
    if seen is None:
        return np.ones((1, 1), dtype=bool)
    whole = np.empty((_LIGHTS, _BLOCK), dtype=seen.dtype)  # what is not filled is not read
    some = seen[lights, texels]
    whole[: some.shape[0], : some.shape[1]] = some
    return whole


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="shading")


@cache
def _kernel(model: str, what: Literal["sum", "gradient", "each"]) -> Any:
    """For the texels of one block and the first `count` lights: their responses added to sums (3K, block), the same
    of the maps' gradient (7, block), or the response (l, block) to each.

    Every map is a list of vectors and every sum its own carry: XLA makes one loop of that, where stacked arrays
    would have each row worked out anew.
    """
    import jax
    import jax.numpy as jnp
    from jax import lax

    single = jnp.float32

    def dot(a: Any, b: Any) -> Any:
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    def prepare(normal: Any, view: Any, roughness: Any) -> Any:
        beta = jnp.clip(roughness, MIN_ROUGHNESS, 1.0)
        alpha2 = (beta * beta) ** 2
        x, y, z = normal
        sign = jnp.where(z < 0, -1.0, 1.0)
        a = -1.0 / (sign + z)
        axes = [
            normal,
            [1.0 + sign * x * x * a, sign * x * y * a, -sign * x],
            [x * y * a, sign + y * y * a, -y],
        ]
        to_view = [dot(axis, view) for axis in axes]
        cosine = jnp.maximum(to_view[0].astype(single), 0.0)
        k = (beta + 1.0) ** 2 * 0.125
        if model == "brdf":
            scale = 0.25 / jnp.pi * alpha2 * (cosine > 0) / (cosine * (1.0 - k) + k)
        else:
            scale = (cosine > 0).astype(single)
        return axes, to_view, view, beta, alpha2, k, cosine, scale

    def respond(texel: Any, where: Any, lit: Any) -> list[Any]:
        axes, to_view, view, beta, alpha2, k, view_cosine, scale = texel
        if model in ("diffuse", "phong"):
            cosine = jnp.maximum(dot(axes[0], where).astype(single), 0.0)
            if model == "diffuse":
                return [cosine * lit]
            mirrored = 2.0 * cosine * to_view[0].astype(single) - dot(view, where).astype(single)
            return [cosine * lit, jnp.clip(mirrored, 0.0, 1.0) ** SHININESS * lit * (cosine > 0)]
        to_light = [dot(axis, where) for axis in axes]
        cosine = jnp.maximum(to_light[0].astype(single), 0.0)
        up, along, across = ((mine + other).astype(single) for mine, other in zip(to_light, to_view, strict=True))
        planar = along * along + across * across
        length2 = jnp.maximum(planar + up * up, SMALL)
        facing = 0.5 * jnp.sqrt(length2)
        received = cosine * lit
        ratio = length2 / (planar + up * up * alpha2)  # D = (α ratio)^2 / π
        if model == "brdf":
            fresnel = F0 + (1.0 - F0) * jnp.exp2((F1 * facing + F2) * facing)
            return [received, ratio * ratio * fresnel * scale * received / (cosine * (1.0 - k) + k)]
        facing = jnp.minimum(facing, 1.0)
        edge = schlick(facing)
        rise = 2.0 * beta * facing * facing - 0.5
        diffuse = (1.0 + rise * schlick(cosine)) * (1.0 + rise * schlick(view_cosine)) / jnp.pi
        smith = 0.5 / jnp.maximum(cosine * slope(view_cosine, alpha2) + view_cosine * slope(cosine, alpha2), GRAZING)
        lobe = ratio * ratio * alpha2 / jnp.pi * smith * scale * received
        return [diffuse * scale * received, lobe * (1.0 - edge), lobe * edge]

    def schlick(cosine: Any) -> Any:
        rest = jnp.maximum(1.0 - cosine, 0.0)
        return rest * (rest * rest) ** 2

    def slope(cosine: Any, alpha2: Any) -> Any:
        return jnp.sqrt((1.0 - alpha2) * cosine * cosine + alpha2)

    def lit(seen: Any, light: Any) -> Any:
        return seen[light].astype(single) if seen.size > 1 else 1.0

    def vectors(maps: Any) -> list[Any]:
        return [values if values.ndim == 1 else [*values] for values in maps]

    def add(  # type: ignore[no-untyped-def]
        maps, directions, power, seen, count, sums
    ):
        normal, view, roughness, *gradient = vectors(maps)

        def responses(i, texel):  # type: ignore[no-untyped-def]
            answers = respond(texel, directions[i], lit(seen, i))
            return [power[i, colour] * answer for answer in answers for colour in range(3)]

        def plus(total, terms):  # type: ignore[no-untyped-def]
            return jax.tree.map(lambda before, term: before + term.astype(single), total, terms)

        if what == "sum":
            texel = prepare(normal, view, roughness)
            return jnp.stack(lax.fori_loop(0, count, lambda i, total: plus(total, responses(i, texel)), [*sums]))
        texel, pull = jax.vjp(prepare, normal, view, roughness)

        def light(i, total):  # type: ignore[no-untyped-def]
            return plus(total, jax.vjp(lambda texel: responses(i, texel), texel)[1](gradient[0])[0])

        zero = jax.tree.map(lambda values: jnp.zeros_like(values, single), texel)
        total = lax.fori_loop(0, count, light, zero)
        of_normal, of_view, of_rough = pull(jax.tree.map(lambda g, of: g.astype(of.dtype), total, texel))
        return sums + jnp.stack([row.astype(single) for row in (*of_normal, *of_view, of_rough)])

    def each(maps, directions, seen, count):  # type: ignore[no-untyped-def]
        texel = prepare(*vectors(maps))

        def light(i, rows):  # type: ignore[no-untyped-def]
            answers = respond(texel, directions[i], lit(seen, i))
            places = zip(rows, answers, strict=True)
            return [lax.dynamic_update_slice(row, one.astype(single)[None], (i, 0)) for row, one in places]

        held = jnp.zeros((len(directions), maps[2].shape[0]), single)
        return lax.fori_loop(0, count, light, [held] * RESPONSES[model])

    return jax.jit(each if what == "each" else add)
