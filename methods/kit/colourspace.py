"""The colours in which a method multiplies albedo and light: linear, or display values as many codes do."""

from __future__ import annotations

from typing import Literal, TypeAlias

import torch
from torch import Tensor

from handbench.scene import Array
from handbench.scene.colour import linear, srgb, unclipped_srgb

Space: TypeAlias = Literal["linear", "display"]


def to_model(image: Array, space: Space) -> Array:
    """Linear colours in those of a space: "display" ones are clipped to [0, 1], as a photograph is."""
    return srgb(image) if space == "display" else image


def to_display(colour: Tensor, space: Space) -> Tensor:
    """Colours of a space as losses compare them; differentiable."""
    return colour if space == "display" else unclipped_srgb(colour)


def to_linear(colour: Tensor, space: Space) -> Tensor:
    """Colours of a space as light, none negative."""
    if space == "linear":
        return colour.clamp_min(0.0)
    return torch.from_numpy(linear(colour.clamp(0.0, 1.0).numpy())).to(colour)
