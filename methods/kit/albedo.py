"""A posed surface with an albedo texture under any known light: how avatars without a light of their own are relit."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from handbench.light.lightset import light_samples
from handbench.light.spread import ENVIRONMENT_ERROR
from handbench.render.see.raster import rasterise
from handbench.render.shade.shading import Model
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Camera, Light, Mesh, Prediction

from .picture import prediction
from .shading import Shading


class Canvas:
    """What a camera sees of a posed surface with R x R textures: what is drawn at its `texels` (n,), and only there.

    position and normal (3, n) of the surface at those texels, float32. A canvas of a surface that another one has
    shares what that knows of shadows.
    """

    def __init__(self, mesh: Mesh | PosedSurface, camera: Camera, size: int) -> None:
        shared = isinstance(mesh, PosedSurface)  # with another camera
        self.surface = mesh if isinstance(mesh, PosedSurface) else PosedSurface(mesh, size)
        self.atlas = self.surface.atlas
        self._raster = rasterise(self.surface.mesh, camera)
        self._shading = Shading(self.surface, camera.centre, self._raster, shared)
        self.texels = self._shading.texels
        self.position, self.normal = self._shading.position, self._shading.normal

    def drawn(self, colour: Tensor) -> Prediction:
        """The picture of linear colours (3, n) at the texels."""
        return prediction(self._raster, self.atlas.dilate(self._shading.texture(colour)))

    def lit(
        self,
        light: Light,
        albedo: Tensor,
        normal: Tensor | None = None,
        gloss: float | None = None,
        environment_error: float = ENVIRONMENT_ERROR,
        lobe: Model = "brdf",
        strength: float = 1.0,
    ) -> Prediction:
        """The picture under a known light: C = albedo / pi C^d + strength C^s with hard shadows.

        albedo (3, n) linear; normal (3, n) unit in place of the surface's. C^d and C^s are the features of URHand supp.
        Eqs. 1-6, the latter of a `lobe` for roughness `gloss`; without it the surface is Lambert's. Linear in the
        light. Raises `Unsupported` for an unknown light.
        """
        lights = light_samples(light, environment_error=environment_error)
        model: Model = "diffuse" if gloss is None else lobe
        diffuse, specular = self._shading.features(lights, gloss or 1.0, model, normal)
        return self.drawn(albedo * diffuse / math.pi + strength * specular)


def flat(texture: Tensor, canvas: Canvas) -> Tensor:
    """The values (C, n) of a map (C, R, R) at the texels of a canvas."""
    return canvas.atlas.gather(texture)[:, torch.from_numpy(canvas.texels)]
