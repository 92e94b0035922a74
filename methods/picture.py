"""From a texture to the picture a query asks for."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from handbench.errors import NonFinite
from handbench.render.raster import Raster
from handbench.scene import Array, Prediction

_KNEE = 0.0031308  # where sRGB turns from a line into a power (IEC 61966-2-1)


def prediction(raster: Raster, texture: Tensor) -> Prediction:
    """The texture (3, R, R) drawn by a raster, with the raster's depth and normals. Raises `NonFinite` for NaN."""
    image = raster.sample(texture.detach()).permute(1, 2, 0)
    if not image.isfinite().all():
        bad = int((~image.isfinite()).sum())
        raise NonFinite(f"the method drew {bad} values that are NaN or infinite")
    alpha = raster.alpha
    depth, normal = _Drawn(alpha.shape, _depth, raster), _Drawn((*alpha.shape, 3), _normal, raster)
    return Prediction(image.numpy(), alpha, depth=depth, normal=normal)


class _Drawn:
    """A map that is drawn when numpy asks for it: no relighting waits for geometry that nothing scores."""

    def __init__(self, shape: tuple[int, ...], draw: Callable[[Raster], Array], raster: Raster) -> None:
        self.shape, self._draw, self._raster = shape, draw, raster

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> Array:
        return np.array(self._draw(self._raster), dtype=dtype, copy=copy)


@lru_cache(maxsize=2)  # scoring asks light by light, and the lights of a view share a raster
def _depth(raster: Raster) -> Array:
    return raster.depth_map()


@lru_cache(maxsize=2)
def _normal(raster: Raster) -> Array:
    return raster.normal_map()


def display(radiance: Tensor) -> Tensor:
    """sRGB display values of linear radiance, unclipped: losses weigh differences as the eye and the metrics do."""
    low = 12.92 * radiance
    high = 1.055 * radiance.clamp_min(_KNEE) ** (1.0 / 2.4) - 0.055
    return torch.where(radiance <= _KNEE, low, high)
