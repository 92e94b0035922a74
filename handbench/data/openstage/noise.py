"""Smooth random fields in object space: the same at every texel of a point, so charts show no seams."""

from __future__ import annotations

import functools

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from ...scene import Array

_SIDE = 48


@functools.cache
def _lattice() -> Array:
    """A periodic lattice of normal numbers, as cubic spline coefficients."""
    values = np.random.default_rng(20240229).standard_normal((_SIDE,) * 3)
    return spline_filter(values, order=2, mode="grid-wrap").astype(np.float32)


class Noise:
    """Independent fields for one seed: each call draws the next one."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def field(self, points: Array, size: float | tuple[float, float, float]) -> Array:
        """Values (N,) at points (N, 3), about normal, mean 0, variance 1; `size` of a blob in metres, or per axis."""
        offset = self._rng.uniform(0, _SIDE, 3)
        turn = np.linalg.qr(self._rng.standard_normal((3, 3)))[0] if np.isscalar(size) else np.eye(3)
        at = np.empty((3, len(points)))
        for row, axis, scale, start in zip(at, turn, np.broadcast_to(size, 3), offset, strict=True):
            axis = axis / scale  # by hand: BLAS threads cost more than they give on tall thin products
            row[:] = points[:, 0] * axis[0] + points[:, 1] * axis[1] + points[:, 2] * axis[2] + start
        return map_coordinates(_lattice(), at, order=2, mode="grid-wrap", prefilter=False) * np.float32(1.35)

    def cloud(self, points: Array, size: float, octaves: int = 3, fall: float = 0.6) -> Array:
        """A sum of fields of halving size, variance 1."""
        weights = fall ** np.arange(octaves)
        total = sum(w * self.field(points, size * 0.5**i) for i, w in enumerate(weights))
        return total / np.sqrt((weights**2).sum())
