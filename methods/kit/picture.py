"""From a texture to the picture a query asks for."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from handbench.errors import NonFinite
from handbench.render.see.raster import Raster
from handbench.scene import Array, Prediction

from .host import on_host


def prediction(raster: Raster, texture: Tensor) -> Prediction:
    """The texture (3, R, R) drawn by a raster, see `pictured`."""
    return pictured(raster, raster.sample(texture.detach()).permute(1, 2, 0))


def pictured(raster: Raster, image: Tensor) -> Prediction:
    """An image (H, W, 3) of what a raster sees, with the raster's depth and normals. Raises `NonFinite` for NaN."""
    drawn = on_host(image)
    if not np.isfinite(drawn).all():
        bad = int((~np.isfinite(drawn)).sum())
        raise NonFinite(f"the method drew {bad} values that are NaN or infinite")
    alpha = raster.alpha
    depth, normal = _Drawn(alpha.shape, "depth_map", raster), _Drawn((*alpha.shape, 3), "normal_map", raster)
    return Prediction(drawn, alpha, depth=depth, normal=normal)


class _Drawn:
    """A map of a raster that is drawn when numpy asks for it: no relighting waits for geometry that nothing scores."""

    def __init__(self, shape: tuple[int, ...], name: str, raster: Raster) -> None:
        self.shape, self._name, self._raster = shape, name, raster

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> Array:
        return np.array(getattr(self._raster, self._name), dtype=dtype, copy=copy)
