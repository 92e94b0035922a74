"""Shading under many distant lights, and its gradient, in one fused loop (XLA).

The formulas are those of `shading`, light by light: no buffer of size lights x texels is ever made. Texels are
taken in blocks that stay in the cache, lights that reach no texel of a block are passed over, and blocks are shared
out among threads. As in `shading`, cosines and tangential parts are taken in float64 and used in float32.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...scene import Array
from ...skips import note, skips
from ..uv.surface import unit
from .brdf import F0, F1, F2, GRAZING, MIN_ROUGHNESS, SHININESS, SMALL
from .models import RESPONSES

_LIGHTS = 128
"""Lights in a call. Fewer are padded with lights that no block is told to take, so that one shape is compiled."""

_BLOCK = 2048
"""Texels in a block: the two dozen buffers of the loop take 200 kB. Blocks are filled up with copies of the last texel,
and their number to a power of two, so that few shapes are compiled: every camera sees another number of texels. What
is filled up is not worked out."""


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
    roughness. Beside its arguments it takes 110 N bytes a thread and up to `_LIGHTS` rows of visibility, for
    the gradient too: that works the lobes out anew.
    """
    return _Fused.apply(normal, view, roughness, model, directions, irradiance, visibility)


@torch.no_grad()
def fused_answers(
    model: str, normal: Tensor, view: Tensor, roughness: Tensor, directions: Tensor, visibility: Tensor | None
) -> Tensor:
    """The responses of a model to each of L lights of unit power, (K, L, N) float32; arguments as above."""
    import jax

    where = directions.numpy()
    seen = np.ones((len(where), len(roughness)), dtype=bool) if visibility is None else visibility.numpy()
    answer = normal.new_empty(RESPONSES[model], len(where), len(roughness), dtype=torch.float32)
    kernel = _kernel(model, _BLOCK, "each")

    def block(start: int) -> None:
        some = slice(start, start + _BLOCK)
        spare = max(0, start + _BLOCK - len(roughness))
        texels = [_wide(values[..., some].numpy(), spare) for values in (normal, view, roughness)]
        with jax.enable_x64(True):
            for first in range(0, len(where), _LIGHTS):
                lights = slice(first, first + _LIGHTS)
                lamps = [_padded(where[lights]), _padded(_wide(seen[lights, some], spare)), len(where[lights])]
                found = kernel(*jax.device_put([texels, *lamps]))
                for rows, one in zip(answer, found, strict=True):
                    rows.numpy()[lights, some] = np.asarray(one)[: lamps[2], : _BLOCK - spare]

    starts = range(0, len(roughness), _BLOCK)
    workers = min(torch.get_num_threads(), len(starts))

    def share(worker: int) -> None:
        for start in starts[worker::workers]:
            block(start)

    list(_pool().map(share, range(workers)) if workers > 1 else map(share, range(workers)))
    return answer


def _wide(values: Array, spare: int) -> Array:
    """Values (..., n) with `spare` copies of the last."""
    return np.ascontiguousarray(
        np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, spare)], "edge") if spare else values
    )


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
    import jax
    import jax.numpy as jnp

    directions, irradiance, visibility = lights
    assert directions is not None and irradiance is not None
    where, power = (values.detach().numpy() for values in (directions, irradiance))
    seen = None if visibility is None else visibility.detach().numpy()
    count, block = len(maps[2]), _BLOCK
    blocks = -(-count // block)
    held = 1 << (blocks - 1).bit_length()
    spare = held * block - count
    workers = min(torch.get_num_threads(), blocks)
    edges = [blocks * worker // workers for worker in range(workers + 1)]
    kernel = _kernel(model, block, "gradient" if gradient else "sum")
    reaches = _reaches(maps[0].detach(), where, seen, block, blocks)
    rows = ((0, held - blocks), (0, 0))

    def filled(values: Array, mode: Any = "edge") -> Array:
        return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, spare)], mode) if spare else values

    with jax.enable_x64(True):
        # arrays are handed over together: one by one takes as long as the loop over few lights
        texels = jax.device_put(
            [np.ascontiguousarray(filled(values.detach().numpy())) for values in (*maps, *gradient)]
        )
        parts = [jnp.zeros((7 if gradient else 3 * RESPONSES[model], count + spare), jnp.float32)] * workers
        for start in range(0, len(where), _LIGHTS):
            some = slice(start, start + _LIGHTS)
            order = np.argsort(~reaches[:, some], axis=1, kind="stable")  # those that reach the block first, in order
            lit = np.ones((1, 1), dtype=bool) if seen is None else filled(_padded(seen[some]), "constant")
            reached = np.pad(reaches[:, some].sum(axis=1), rows[0])
            lamps = [_padded(where[some]), _padded(power[some]), lit, np.pad(_padded(order.T).T, rows), reached]
            given = jax.device_put(lamps)

            def share(worker: int, before: Any, given: list[Any] = given) -> Any:
                with jax.enable_x64(True):
                    return kernel(texels, *given, before, edges[worker], edges[worker + 1]).block_until_ready()

            each = range(workers), parts
            parts = list(_pool().map(share, *each)) if workers > 1 else list(map(share, *each))
    if not gradient:
        note("texel-light pairs", len(where) * count, (reaches.size - int(reaches.sum())) * count // blocks)
    total = np.array(parts[0])  # in numpy: XLA would compile a slice for each number of texels
    for part in parts[1:]:
        total += np.asarray(part)
    return np.ascontiguousarray(total[:, :count])


def _reaches(normal: Tensor, where: Array, seen: Array | None, block: int, blocks: int) -> Array:
    """Which lights reach any texel of a block, (blocks, L) bool.

    Without visibility the normals of a block are known to lie in a cone; a light that is below the horizon of the
    whole cone reaches none.
    """
    reaches = np.ones((blocks, len(where)), dtype=bool)
    starts = np.arange(blocks) * block
    if seen is not None and skips().occluded:
        for index, start in enumerate(starts):
            reaches[index] = seen[:, start : start + block].any(axis=1)
    elif seen is None and skips().below_horizon:
        for index, start in enumerate(starts):
            normals = normal[:, start : start + block]
            axis = unit(normals.mean(dim=1, keepdim=True))
            tilt = float((axis.T @ normals).min().clamp(-1.0, 1.0))  # cosine of the cone's half angle
            if tilt > 0.0:
                reaches[index] = where @ axis[:, 0].numpy() > -np.sqrt(1.0 - tilt * tilt) - 1e-6
    return reaches


def _padded(rows: Array) -> Array:
    """Rows (l, ...) with zeros added up to `_LIGHTS`."""
    missing = _LIGHTS - len(rows)
    return np.pad(rows, ((0, missing), (0, 0))) if missing else rows


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="shading")


@cache
def _kernel(model: str, block: int, what: Literal["sum", "gradient", "each"]) -> Any:
    """Adds lights to sums for the blocks from `first` to before `last`: responses, or the gradient of the maps. Or, for
    one block, the responses (l, block) to each of the first `count` lights.

    order (blocks, l) lists the lights of a block, of which the first `reached` (blocks,) are taken.
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

    def add(  # type: ignore[no-untyped-def]
        maps, directions, power, seen, order, reached, sums, first, last
    ):
        def one(index, sums):  # type: ignore[no-untyped-def]
            at = index * block

            def local(values):  # type: ignore[no-untyped-def]
                if values.ndim == 1:
                    return lax.dynamic_slice(values, (at,), (block,))
                return [lax.dynamic_slice(row, (at,), (block,)) for row in values]

            normal, view, roughness, *gradient = map(local, maps)

            def responses(step, texel):  # type: ignore[no-untyped-def]
                i = order[index, step]
                lit = lax.dynamic_slice(seen, (i, at), (1, block))[0].astype(single) if seen.size > 1 else 1.0
                answers = respond(texel, directions[i], lit)
                return [power[i, colour] * answer for answer in answers for colour in range(3)]

            def plus(total, terms):  # type: ignore[no-untyped-def]
                return jax.tree.map(lambda before, term: before + term.astype(single), total, terms)

            if what == "gradient":
                texel, pull = jax.vjp(prepare, normal, view, roughness)

                def light(step, total):  # type: ignore[no-untyped-def]
                    return plus(total, jax.vjp(lambda texel: responses(step, texel), texel)[1](gradient[0])[0])

                zero = jax.tree.map(lambda values: jnp.zeros(block, single), texel)
                total = lax.fori_loop(0, reached[index], light, zero)
                of_normal, of_view, of_rough = pull(jax.tree.map(lambda g, of: g.astype(of.dtype), total, texel))
                found = jnp.stack([row.astype(single) for row in (*of_normal, *of_view, of_rough)])
            else:
                texel = prepare(normal, view, roughness)
                zero = [jnp.zeros(block, single)] * sums.shape[0]
                found = jnp.stack(lax.fori_loop(0, reached[index], lambda i, s: plus(s, responses(i, texel)), zero))
            before = lax.dynamic_slice(sums, (0, at), (sums.shape[0], block))
            return lax.dynamic_update_slice(sums, before + found, (0, at))

        return lax.fori_loop(first, last, one, sums)

    def each(maps, directions, seen, count):  # type: ignore[no-untyped-def]
        normal, view, roughness = maps
        texel = prepare([*normal], [*view], roughness)

        def light(i, rows):  # type: ignore[no-untyped-def]
            answers = respond(texel, directions[i], seen[i].astype(single))
            places = zip(rows, answers, strict=True)
            return [lax.dynamic_update_slice(row, one.astype(single)[None], (i, 0)) for row, one in places]

        return lax.fori_loop(0, count, light, [jnp.zeros(seen.shape, single)] * RESPONSES[model])

    return jax.jit(each if what == "each" else add)
