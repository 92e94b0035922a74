"""The sRGB transfer curve (IEC 61966-2-1), there and back; everything else in the scene is linear."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .arrays import Array

if TYPE_CHECKING:
    from torch import Tensor

_KNEE, _SHOWN_KNEE = 0.0031308, 0.04045  # where the curve turns from a line into a power: linear, and shown


def srgb(linear: Array) -> Array:
    """Linear Rec. 709 values, any shape, clipped to [0, 1] and encoded for display."""
    x = np.clip(linear, 0.0, 1.0)
    bright = x > _KNEE
    shown = 12.92 * x
    np.power(x, 1 / 2.4, out=shown, where=bright)
    np.multiply(shown, 1.055, out=shown, where=bright)
    np.subtract(shown, 0.055, out=shown, where=bright)
    return shown


def linear(shown: Array) -> Array:
    """Display values in [0, 1], any shape, as linear Rec. 709: undoes `srgb`."""
    return np.where(shown <= _SHOWN_KNEE, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def eight_bit(image: Array) -> Array:
    """Linear values, any shape, as the 8-bit sRGB codes of a picture file or screen."""
    return (srgb(image) * 255.0 + 0.5).astype(np.uint8)


def unclipped_srgb(linear: Tensor) -> Tensor:
    """The curve beyond white too, differentiable: losses weigh differences as the eye and the metrics do."""
    import torch

    low = 12.92 * linear
    high = 1.055 * linear.clamp_min(_KNEE) ** (1.0 / 2.4) - 0.055
    return torch.where(linear <= _KNEE, low, high)


def unclipped_linear(shown: Tensor) -> Tensor:
    """Display values, any shape, as linear ones, none negative; beyond white the curve goes on. Differentiable."""
    import torch

    bright = shown > _SHOWN_KNEE
    high = ((torch.where(bright, shown, 1.0) + 0.055) / 1.055) ** 2.4
    return torch.where(bright, high, shown.clamp_min(0.0) / 12.92)
