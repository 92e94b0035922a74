"""A posed surface with an albedo texture under any known light: how avatars without a light of their own are relit."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from handbench.light.lightset import light_samples
from handbench.light.spread import ENVIRONMENT_ERROR
from handbench.render.see.raster import rasterise
from handbench.render.shade.shading import Model, light_features
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Camera, Light, Mesh, Prediction
from handbench.skips import skips

from .picture import prediction


class Canvas:
    """What a camera sees of a posed surface with R x R textures: what is drawn at its `texels` (n,), and only there.

    position and normal (3, n) of the surface at those texels, float32.
    """

    def __init__(self, mesh: Mesh, camera: Camera, size: int) -> None:
        self.surface = PosedSurface(mesh, size)
        self.atlas = self.surface.atlas
        self._raster = rasterise(self.surface.mesh, camera)
        self._camera = camera
        seen = self.atlas.needed(self._raster.texels(size)) if skips().unseen else np.ones(self.atlas.count, dtype=bool)
        self.texels = np.flatnonzero(seen)
        self.position, self.normal = (part[:, self.texels] for part in (self.surface.position, self.surface.normal))

    def drawn(self, colour: Tensor) -> Prediction:
        """The picture of linear colours (3, n) at the texels."""
        whole = colour.new_zeros(3, self.atlas.count).index_copy(1, torch.from_numpy(self.texels), colour)
        return prediction(self._raster, self.atlas.dilate(self.atlas.scatter(whole)))

    def lit(
        self,
        light: Light,
        albedo: Tensor,
        normal: Tensor | None = None,
        gloss: float | None = None,
        environment_error: float = ENVIRONMENT_ERROR,
    ) -> Prediction:
        """The picture under a known light: C = albedo / pi C^d + C^s with hard shadows.

        albedo (3, n) linear; normal (3, n) unit in place of the surface's. C^d and C^s are the features of URHand supp.
        Eqs. 1-6, the latter for roughness `gloss`; without it the surface is Lambert's. Linear in the light. Raises
        `Unsupported` for an unknown light.
        """
        lights = light_samples(light, environment_error=environment_error)
        visible = self.surface.visibility(lights, texels=self.texels)
        facing = self.normal if normal is None else normal
        roughness = torch.full((facing.shape[1],), gloss or 1.0)
        model: Model = "diffuse" if gloss is None else "brdf"
        args = (facing, self.position, roughness, self._camera.centre, lights, visible)
        diffuse, specular = light_features(*args, model)
        return self.drawn(albedo * diffuse / math.pi + specular)


def flat(texture: Tensor, canvas: Canvas) -> Tensor:
    """The values (C, n) of a map (C, R, R) at the texels of a canvas."""
    return canvas.atlas.gather(texture)[:, torch.from_numpy(canvas.texels)]
