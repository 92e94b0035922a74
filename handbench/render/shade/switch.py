"""Tiles or the fused kernel: the one place that chooses between the readable form and the fast one."""

from __future__ import annotations

import torch
from torch import Tensor

from .fused import fused_answers, fused_responses, usable
from .models import RESPONSES
from .tiles import LIGHTS, Dots, blocks, distant, responses, tiles

_FUSE = 1 << 20
"""From this many pairs on the fused kernel, which takes a second or two to compile, beats tiles in a training."""

_DRAW = 1 << 16
"""The same where nothing is differentiated: 8 lights at 7,388 texels take 3.0 ms, by tiles 4.2; 5 lights 2.5
and 2.1."""


def summed(
    dots: Dots, where: Tensor, power: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: str
) -> Tensor:
    """The responses (K, 3, N) under lights of one kind, tile by tile or fused."""
    by_light, by_texel = (
        torch.is_grad_enabled() and any(values is not None and values.requires_grad for values in some)
        for some in ((power, seen), maps)
    )
    large = len(where) * maps[0].shape[1] >= (_FUSE if by_light or by_texel else min(_FUSE, _DRAW))
    on_cpu = power.device.type == "cpu"
    if dots is distant and large and on_cpu and power.dtype == torch.float32 and not by_light and usable():
        normal, view, _, roughness = maps
        return fused_responses(model, normal, view, roughness, where, power, seen)
    return tiles(dots, where, power, seen, maps, model)


def answers(where: Tensor, seen: Tensor | None, maps: tuple[Tensor, ...], model: str, dtype: torch.dtype) -> Tensor:
    """The responses (K, L, N) to each of L distant lights of unit power, tile by tile or fused; without gradients."""
    normal, view, _, roughness = maps
    large = len(where) * len(roughness) >= min(_FUSE, _DRAW)
    if large and roughness.device.type == "cpu" and dtype == torch.float32 and usable():
        return fused_answers(model, normal, view, roughness, where, seen)
    answer = normal.new_empty(RESPONSES[model], len(where), len(roughness), dtype=dtype)
    for texels in blocks(len(where), len(roughness)):
        local = tuple(values[..., texels] for values in maps)
        for start in range(0, len(where), LIGHTS):
            some = slice(start, start + LIGHTS)
            part = None if seen is None else seen[some, texels]
            for row, one in zip(answer, responses(distant, where[some], part, local, model, dtype), strict=True):
                row[some, texels] = one
    return answer
