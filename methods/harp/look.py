"""What HARP knows of a person: shape, displacements, albedo, normals, and the light in which they were seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.scene import Array, Mesh, Pose

from .config import HarpConfig
from .surface import HandSurface

SKIN = (232 / 255, 190 / 255, 172 / 255)
"""The albedo that the authors' code begins with, a display colour."""

LIGHT = (-0.5, -0.5, -0.5)
"""Metres from the hand, right, down and away from the camera, where their light begins: upper left, in front."""

AMBIENT = 0.4
"""Before the sigmoid: their ambient light begins with 0.6 of the whole."""


@dataclass(frozen=True, eq=False)
class Look:
    """A person as HARP sees them.

    shape (S,) of the hand; offset (V,) metres along the normals; albedo (3, R, R) in the colours of `config.space`;
    normal_map (3, R, R); light (3,), its position in the world; ambient, a number before the sigmoid.
    """

    config: HarpConfig
    surface: HandSurface
    shape: Array
    offset: Tensor
    albedo: Tensor
    normal_map: Tensor
    light: Tensor
    ambient: Tensor

    def mesh(self, pose: Pose) -> Mesh:
        """The surface in a pose, float64."""
        told = (self.shape, pose.joints, pose.rotation, pose.translation)
        shape, joints, rotation, translation = (torch.tensor(np.asarray(part), dtype=torch.float64) for part in told)
        vertices = self.surface.posed(shape, joints, rotation, translation, self.offset.double())
        return Mesh(vertices.numpy(), self.surface.topology)


def shade(position: Tensor, normal: Tensor, visible: Tensor, light: Tensor, ambient: Tensor) -> Tensor:
    """What of a surface's albedo is seen in HARP's light, (N,): a + (1 - a) max(0, n.l) V, a = sigmoid(ambient).

    One white light at a position, as bright at every distance, and light from everywhere; no specular part. What faces
    the light and sees it shows its albedo, so a diffuse surface has the irradiance pi there.
    """
    towards = torch.nn.functional.normalize(light - position, dim=1)
    share = torch.sigmoid(ambient)
    return share + (1.0 - share) * (normal * towards).sum(dim=1).clamp_min(0.0) * visible
