"""A method in three small classes: the mean texture, relit as if the surface were Lambertian and shadowless."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from handbench.data.texture import mean_texture
from handbench.light.lightset import light_samples
from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, Recording, silent
from handbench.render.posed import raster
from handbench.scene import Array, Light, Prediction, Query

TEXELS = 64


def irradiance(normal: Array, light: Light) -> Array:
    """Irradiance (N, 3) at unit normals (N, 3), shadows left out: sum_i E_i max(0, n . w_i)."""
    lights = light_samples(light)
    return np.maximum(normal @ lights.directions.T, 0.0) @ lights.irradiance


class LambertAvatar(Avatar):
    """`texture` (3, R, R): outgoing radiance for each unit of irradiance."""

    def __init__(self, texture: torch.Tensor) -> None:
        self._texture = texture

    def relight(self, query: Query) -> Prediction:
        picture = raster(query.mesh, query.camera)
        shading = picture.mean(irradiance(picture.normal, query.light))
        albedo = picture.sample(self._texture).permute(1, 2, 0).numpy()
        alpha = picture.alpha  # both are premultiplied: once is enough
        return Prediction(shading * albedo / np.maximum(alpha, 1e-6)[..., None], alpha)


class LambertPrior(Prior):
    """Nothing is learned from other subjects."""

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        lit = []
        for frame in enrolment.of_kind("full").frames:
            normal = raster(frame.mesh, frame.camera).normal
            lit.append(irradiance(normal, frame.light).mean())
        return LambertAvatar(mean_texture(enrolment, TEXELS).texture / float(np.mean(lit)))

    def save(self, folder: Path) -> None:
        """Nothing is learned, so nothing is written."""


class Lambert(Method):
    info = MethodInfo(
        name="example-lambert",
        title="Lambert",
        summary="mean texture on a Lambertian surface without shadows",
        universal=True,
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
