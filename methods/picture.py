"""From a texture to the picture a query asks for."""

from __future__ import annotations

import torch
from torch import Tensor

from handbench.errors import NonFinite
from handbench.render.raster import Raster
from handbench.scene import Prediction

_KNEE = 0.0031308  # where sRGB turns from a line into a power (IEC 61966-2-1)


def prediction(raster: Raster, texture: Tensor) -> Prediction:
    """The texture (3, R, R) drawn by a raster. Raises `NonFinite` for NaN or infinity."""
    image = raster.sample(texture.detach()).permute(1, 2, 0)
    if not image.isfinite().all():
        bad = int((~image.isfinite()).sum())
        raise NonFinite(f"the method drew {bad} values that are NaN or infinite")
    return Prediction(image.numpy(), raster.alpha)


def display(radiance: Tensor) -> Tensor:
    """sRGB display values of linear radiance, unclipped: losses weigh differences as the eye and the metrics do."""
    low = 12.92 * radiance
    high = 1.055 * radiance.clamp_min(_KNEE) ** (1.0 / 2.4) - 0.055
    return torch.where(radiance <= _KNEE, low, high)
