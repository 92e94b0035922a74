"""The mean predictor: the mean texture under the mean light, whatever light is asked for. The floor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from handbench.errors import Unsupported
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.scene import LIGHT_KINDS, Camera, Light, Prediction, Viewpoint, needed

from .kit.picture import prediction
from .kit.texture import mean_texture
from .kit.weights import load_state, save_state

TEXTURE = 128


class MeanAvatar(Avatar):
    def __init__(self, texture: torch.Tensor) -> None:
        self._texture = texture

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedMean(PosedMesh.of(needed(viewpoint.mesh, "mesh")), viewpoint.camera, self._texture)

    def save(self, folder: Path) -> None:
        save_state(folder, "mean", {}, {"texture": self._texture})

    @classmethod
    def load(cls, folder: Path) -> MeanAvatar:
        """The avatar that `save` wrote."""
        return cls(load_state(folder, "mean", {}, {"texture": (3, TEXTURE, TEXTURE)})["texture"])


class PosedMean(PosedAvatar):
    """One picture for every light."""

    def __init__(self, mesh: PosedMesh, camera: Camera, texture: torch.Tensor) -> None:
        self._mesh, self._texture = mesh, texture
        self._picture = prediction(rasterise(mesh, camera), texture)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedMean(self._mesh, camera, self._texture)

    def relight(self, light: Light) -> Prediction:
        return self._picture


class MeanPrior(Prior):
    """`exposure`: how bright the training frames are beside the fully lit ones."""

    def __init__(self, exposure: float) -> None:
        self.exposure = exposure

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return MeanAvatar(self.exposure * mean_texture(enrolment, TEXTURE).texture)

    def save(self, folder: Path) -> None:
        save_state(folder, "mean", {}, {"exposure": torch.tensor(self.exposure, dtype=torch.float64)})

    def restore(self, folder: Path) -> Avatar:
        return MeanAvatar.load(folder)


class Mean(Method):
    info = MethodInfo(
        name="mean",
        title="Mean predictor",
        summary="mean texture under the mean light",
        universal=True,
        needs=frozenset({"image", "alpha", "camera", "mesh", "uv", "full"}),
        trains_on=frozenset({"image", "alpha", "full", "olat or group"}),
        role="calibration",
        lights=LIGHT_KINDS,
        fidelity="calibration: the floor",
    )

    @property
    def config(self) -> dict[str, Any]:
        return {"texture": TEXTURE}

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        """The mean radiance of the hand in relit frames over that in fully lit frames."""
        relit = _mean_radiance(recording.of_kind("olat", "group"))
        full = _mean_radiance(recording.of_kind("full"))
        return MeanPrior(relit / full)

    def load(self, folder: Path) -> Prior:
        return MeanPrior(float(load_state(folder, "mean", {})["exposure"]))


def _mean_radiance(recording: Recording) -> float:
    if not recording.frames:
        raise Unsupported("the mean predictor needs fully lit frames and frames with few lights to train on")
    total = coverage = 0.0
    for frame in recording.frames:
        observation = recording.observe(frame)
        total += float(observation.image.sum(dtype="float64"))
        coverage += 3.0 * float(needed(observation.alpha, "alpha").sum(dtype="float64"))
    return total / coverage


def create(preset: str = "quick") -> Method:
    """The mean predictor; every preset is the same."""
    return Mean()
