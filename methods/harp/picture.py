"""What HARP compares itself with: crops of a hand, their unknown poses, and the surface points seen in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.scene import Array

from ..kit.colourspace import to_display, to_model
from ..kit.crop import Crop
from .config import HarpConfig

EATEN = 2
"""Times the mask's edge is eaten by 3 x 3 before colours are compared."""


@dataclass(eq=False)
class PixelSamples:
    """Pixels (P,) inside a crop's mask that the surface covers, some several times, and where on it they are."""

    pixel: Tensor
    face: Tensor
    barycentric: Tensor
    uv: Tensor
    age: int = 0
    visible: Tensor | None = None


class FittedCrop:
    """A crop, its colours (3, h, w) in the model's space and as display values, and the unknown pose."""

    def __init__(self, crop: Crop, pose: tuple[Array, Array, Array], config: HarpConfig) -> None:
        self.crop = crop
        self.start = torch.tensor(pose[0]).float()
        self.joints = torch.zeros_like(self.start, requires_grad=True)
        self.rotation, self.translation = (torch.tensor(part).float().requires_grad_() for part in pose[1:])
        self.model = to_model(crop.image, config.space)
        self.colour = torch.from_numpy(np.moveaxis(self.model, -1, 0).copy())
        self.image = to_display(self.colour, config.space)
        self.alpha = torch.from_numpy(crop.alpha)
        self.inner = crop.inner(EATEN)
        self.points: Tensor | None = None
        self.samples: PixelSamples | None = None

    @property
    def unknowns(self) -> list[Tensor]:
        return [self.joints, self.rotation, self.translation]
