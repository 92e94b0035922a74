"""What the networks are told of the light: shading features, its power, or an environment map."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.light.environment import solid_angles, texels
from handbench.light.lightset import LightSet
from handbench.render.shade.shading import Model, light_features
from handbench.scene import Array

from .config import UrhandConfig
from .released import released_features


def features(
    config: UrhandConfig,
    normal: Tensor,
    roughness: Tensor,
    position: Tensor,
    centre: Array,
    lights: LightSet,
    visible: Tensor | None,
) -> Tensor:
    """Diffuse and specular shading features, (6, N) (supp. Eqs. 1-2 or what an ablation puts in their place)."""
    if config.shading == "released":
        return torch.cat(released_features(normal, position, roughness, centre, lights, visible))
    return torch.cat(light_features(normal, position, roughness, centre, lights, visible, model(config)))


def model(config: UrhandConfig) -> Model:
    """The reflectance model of the features, unless they are the released code's."""
    if config.shading == "released" or not config.specular:
        return "diffuse"
    return config.shading


def power(lights: LightSet, visible: Tensor | None = None) -> Tensor:
    """Mean power of the distant lights over the colours: a number, or (N) what of it reaches each texel."""
    mean = torch.as_tensor(np.asarray(lights.irradiance).mean(axis=1), dtype=torch.float32)
    if visible is None:
        return mean.sum()
    mean = mean.to(visible.device)
    return mean @ visible[: len(mean)].to(mean.dtype)


def environment_map(lights: LightSet, size: tuple[int, int]) -> Tensor:
    """Distant lights as an environment map (3, H, W) of mean radiance: each falls into the texel it lies in.

    Raises `Unsupported` for near lights, which no map holds.
    """
    if len(lights.positions):
        raise Unsupported("an environment map cannot hold near lights")
    height, width = size
    row, column = texels(np.asarray(lights.directions), height, width)
    radiance = np.zeros((height, width, 3))
    np.add.at(radiance, (row, column), np.asarray(lights.irradiance) / solid_angles(height, width)[row, column, None])
    return torch.from_numpy(radiance.transpose(2, 0, 1)).float()
