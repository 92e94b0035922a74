"""A method in four small classes: the mean texture, relit as if the surface were Lambertian and shadowless."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from handbench.light.lightset import light_samples
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.methods.kit.texture import mean_texture
from handbench.render.see.raster import Raster, rasterise
from handbench.scene import Array, Light, Prediction, Viewpoint

TEXELS = 64


def irradiance(normal: Array, light: Light) -> Array:
    """Irradiance (N, 3) at unit normals (N, 3), shadows left out: sum_i E_i max(0, n . w_i)."""
    lights = light_samples(light)
    return np.maximum(normal @ lights.directions.T, 0.0) @ lights.irradiance


class LambertAvatar(Avatar):
    """`texture` (3, R, R): outgoing radiance for each unit of irradiance."""

    def __init__(self, texture: torch.Tensor) -> None:
        self._texture = texture

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        raster = rasterise(viewpoint.mesh, viewpoint.camera)
        return PosedLambert(raster, raster.sample(self._texture).permute(1, 2, 0).numpy())


class PosedLambert(PosedAvatar):
    """What lights share: which surface each pixel shows, and its premultiplied albedo (H, W, 3)."""

    def __init__(self, raster: Raster, albedo: Array) -> None:
        self._raster, self._albedo = raster, albedo
        self._normal = raster.normal

    def relight(self, light: Light) -> Prediction:
        shading = self._raster.mean(irradiance(self._normal, light))
        alpha = self._raster.alpha  # shading and albedo are both premultiplied: once is enough
        return Prediction(shading * self._albedo / np.maximum(alpha, 1e-6)[..., None], alpha)


class LambertPrior(Prior):
    """Nothing is learned from other subjects."""

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        lit = []
        for frame in enrolment.of_kind("full").frames:
            lit.append(irradiance(rasterise(frame.mesh, frame.camera).normal, frame.light).mean())
        return LambertAvatar(mean_texture(enrolment, TEXELS).texture / float(np.mean(lit)))

    def save(self, folder: Path) -> None:
        """Nothing is learned, so nothing is written."""


class Lambert(Method):
    info = MethodInfo(
        name="example-lambert",
        title="Lambert",
        summary="mean texture on a Lambertian surface without shadows",
        universal=True,
        needs=frozenset({"image", "alpha", "camera", "mesh", "uv", "light", "full"}),
        linear=True,
    )

    @property
    def config(self) -> dict[str, Any]:
        return {"texels": TEXELS}

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        return LambertPrior()

    def load(self, folder: Path) -> Prior:
        return LambertPrior()


def create(preset: str = "quick") -> Method:
    """The method; every preset is the same."""
    return Lambert()
