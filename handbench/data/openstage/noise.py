"""Smooth random fields in object space: the same at every texel of a point, so charts show no seams."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from ...scene import Array

_BLOBS, _SAMPLES, _CHANNELS = 32, 3, 4


@functools.cache
def _lattice() -> Tensor:
    """Four periodic fields of `_BLOBS` blobs a side, variance 1, sampled finely enough to be read linearly."""
    values = np.random.default_rng(20240229).standard_normal((_CHANNELS, *(_BLOBS,) * 3))
    away = np.arange(_BLOBS * _SAMPLES + 1)[:, None] / _SAMPLES - np.arange(_BLOBS)
    away = np.abs((away + _BLOBS / 2) % _BLOBS - _BLOBS / 2)
    spline = np.where(away < 1, 2 / 3 - away**2 * (1 - away / 2), np.clip(2 - away, 0, None) ** 3 / 6)
    for axis in (1, 2, 3):
        values = np.moveaxis(np.tensordot(spline, values, (1, axis)), 0, axis)
    values -= values.mean(axis=(1, 2, 3), keepdims=True)
    return torch.from_numpy((values / values.std(axis=(1, 2, 3), keepdims=True)).astype(np.float32))[None]


class NoiseFields:
    """Independent fields for one seed: each call draws the next ones."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def fields(self, points: Array, size: float, count: int = _CHANNELS) -> Array:
        """Up to four fields (count, N) at points (N, 3), about normal, variance 1; `size` of a blob in metres."""
        offset = self._rng.uniform(0, _BLOBS, 3)
        turn = np.linalg.qr(self._rng.standard_normal((3, 3)))[0] / size
        at = torch.from_numpy(np.ascontiguousarray(points, np.float32)) @ torch.from_numpy(turn.T.astype(np.float32))
        at = (at + torch.from_numpy(offset.astype(np.float32))).remainder_(_BLOBS).mul_(2 / _BLOBS).sub_(1)
        return grid_sample(_lattice()[:, :count], at[None, :, None, None], align_corners=True)[0, :, :, 0, 0].numpy()

    def field(self, points: Array, size: float) -> Array:
        """One field (N,)."""
        found: Array = self.fields(points, size, 1)[0]
        return found


@dataclass(frozen=True, eq=False)
class Bands:
    """One person's fields at all texels, (4, N) of each size: blobs of 26 mm to 0.9 mm. Read once, used all over."""

    mm26: Array
    mm11: Array
    mm6: Array
    mm3: Array
    mm1: Array
    fine: Array

    @staticmethod
    def of(points: Array, noise: NoiseFields) -> Bands:
        return Bands(*(noise.fields(points, size) for size in (26e-3, 11e-3, 5.5e-3, 3e-3, 1.4e-3, 0.9e-3)))
