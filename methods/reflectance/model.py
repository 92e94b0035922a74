"""Relighting by a reflectance model alone: mean texture times diffuse feature plus specular feature.

C = k_d C^d T / E + k_s C^s   (URHand Eq. 3 with two fitted scales), E the mean diffuse feature of the frames
that gave T, which turns the fully lit texture into an albedo up to scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from handbench.errors import InputError, Unsupported, unknown_name
from handbench.light.lightset import light_samples
from handbench.light.spread import ENVIRONMENT_ERROR
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.recording import Need
from handbench.render.see.raster import rasterise
from handbench.render.shade.shading import Model
from handbench.render.uv.posed import PosedSurface
from handbench.scene import KNOWN_LIGHTS, Array, Baked, Camera, Frame, Light, Prediction, Viewpoint, needed
from handbench.settings import UNCHANGED, Changes, changed
from handbench.skips import skips

from ..kit.picture import prediction
from ..kit.shading import Shading
from ..kit.texture import mean_texture
from ..kit.weights import load_state, save_state


@dataclass(frozen=True)
class ReflectanceConfig:
    """The settings of a reflectance method.

    texture             side of the texture in texels
    roughness           values to choose from
    fit_frames          how many training frames the fit looks at
    environment_error   how far lights of an environment may be moved, see `handbench.light.spread`; 0: each texel of
                        the map at 16 x 32 is a light
    """

    texture: int = 128
    roughness: tuple[float, ...] = (0.25, 0.35, 0.45, 0.55, 0.65, 0.8)
    fit_frames: int = 48
    environment_error: float = ENVIRONMENT_ERROR


FULLY_LIT: frozenset[Need] = frozenset({"image", "alpha", "camera", "mesh", "uv", "light", "full"})
"""For the mean texture over the light that made it."""

PRESETS = {
    "quick": ReflectanceConfig(),
    "standard": ReflectanceConfig(texture=256, fit_frames=96),
    "paper": ReflectanceConfig(texture=1024, fit_frames=96, environment_error=0.0),
}


def full_exposure(enrolment: Recording, size: int) -> float:
    """Mean diffuse feature over the surface in the enrolment's fully lit frames: what the mean texture was lit by."""
    features = []
    poses: set[str] = set()
    for frame in enrolment.of_kind("full").frames:
        if frame.pose_key not in poses:
            poses.add(frame.pose_key)
            surface = PosedSurface(needed(frame.mesh, "mesh"), size)
            lights = light_samples(frame.light)
            shading = Shading(surface, frame.camera.centre)
            diffuse = shading.texture(shading.features(lights, 0.5, "diffuse")[0])
            features.append(float(diffuse[:, torch.from_numpy(surface.atlas.covered)].mean()))
    return float(np.mean(features))


def normalised_texture(enrolment: Recording, size: int) -> Tensor:
    """The mean texture (3, R, R) over the light that made it: an albedo over pi, up to what shading it keeps."""
    return mean_texture(enrolment, size).texture / full_exposure(enrolment, size)


class ReflectanceAvatar(Avatar):
    def __init__(self, texture: Tensor, prior: ReflectancePrior) -> None:
        self._texture, self._prior = texture, prior

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedReflectance(self._texture, self._prior, viewpoint)

    def baked(self, viewpoint: Viewpoint) -> Baked:
        """Raises `Unsupported` for Phong's lobe, which is none of glTF's."""
        prior = self._prior
        if prior.model != "brdf":
            raise Unsupported(f"{prior.name} has a lobe that such textures cannot hold; export another method's avatar")
        albedo = math.pi * prior.diffuse * self._texture.permute(1, 2, 0).clamp_min(0.0)
        roughness = np.full(albedo.shape[:2], prior.roughness)
        return Baked(needed(viewpoint.mesh, "mesh"), albedo.numpy(), roughness, prior.specular)

    def save(self, folder: Path) -> None:
        prior = self._prior
        save_state(folder, prior.name, asdict(prior.config), {"texture": self._texture})


class PosedReflectance(PosedAvatar):
    """The surface, what the camera sees of it, and its shadows so far; `surface` is one that another camera saw."""

    def __init__(
        self, texture: Tensor, prior: ReflectancePrior, viewpoint: Viewpoint, surface: PosedSurface | None = None
    ) -> None:
        self._texture, self._prior, self._viewpoint = texture, prior, viewpoint
        self._surface = surface or PosedSurface(needed(viewpoint.mesh, "mesh"), prior.config.texture)
        self._atlas = self._surface.atlas
        self._raster = rasterise(self._surface.mesh, viewpoint.camera)
        # a fit that gave the specular lobe no share leaves nothing to work out
        self._model: Model = prior.model if prior.specular or not skips().missing_lobes else "diffuse"
        self._shading = Shading(self._surface, viewpoint.camera.centre, self._raster, shared=surface is not None)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedReflectance(self._texture, self._prior, replace(self._viewpoint, camera=camera), self._surface)

    def relight(self, light: Light) -> Prediction:
        prior = self._prior
        lights = light_samples(light, environment_error=prior.config.environment_error)
        features = self._shading.features(lights, prior.roughness, self._model)
        diffuse, specular = map(self._shading.texture, features)
        colour = prior.diffuse * diffuse * self._texture + prior.specular * specular
        return prediction(self._raster, self._atlas.dilate(colour))


class ReflectancePrior(Prior):
    """Two scales and a roughness that serve every subject."""

    def __init__(self, name: str, model: Model, config: ReflectanceConfig, fitted: Sequence[float]) -> None:
        self.name, self.model, self.config = name, model, config
        self.diffuse, self.specular, self.roughness = fitted

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return ReflectanceAvatar(normalised_texture(enrolment, self.config.texture), self)

    def save(self, folder: Path) -> None:
        fitted = torch.tensor([self.diffuse, self.specular, self.roughness], dtype=torch.float64)
        save_state(folder, self.name, asdict(self.config), {"fitted": fitted})

    def restore(self, folder: Path) -> Avatar:
        size = self.config.texture
        state = load_state(folder, self.name, asdict(self.config), {"texture": (3, size, size)})
        return ReflectanceAvatar(state["texture"], self)


class Reflectance(Method):
    """`physical` and `phong`: they differ in the model alone."""

    def __init__(self, info: MethodInfo, model: Model, config: ReflectanceConfig) -> None:
        self.info, self._model, self._config = info, model, config

    @property
    def config(self) -> dict[str, Any]:
        return asdict(self._config)

    def load(self, folder: Path) -> Prior:
        state = load_state(folder, self.info.name, asdict(self._config))
        return ReflectancePrior(self.info.name, self._model, self._config, state["fitted"].tolist())

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        """Scales by least squares over training frames, for each roughness; the roughness that leaves the least."""
        textures = {
            subject: normalised_texture(recording.of_subject(subject), self._config.texture)
            for subject in recording.subjects
        }
        lit = recording.of_kind("olat", "group").frames
        if not lit:
            raise Unsupported(f"{self.info.name} is fitted on frames with few lights, and training has none")
        rng = np.random.default_rng(seed)
        chosen = [lit[i] for i in np.sort(rng.choice(len(lit), min(self._config.fit_frames, len(lit)), replace=False))]
        candidates = self._config.roughness if self._model == "brdf" else self._config.roughness[:1]
        fits = [_Fit() for _ in candidates]
        for step, frame in enumerate(chosen, start=1):
            truth = np.moveaxis(recording.observe(frame).image, -1, 0).ravel()
            for fit, pictures in zip(fits, self._pictures(frame, textures[frame.subject], candidates), strict=True):
                fit.add(pictures, truth)
            progress(step, len(chosen))
        solved = [(*fit.solved(), rough) for fit, rough in zip(fits, candidates, strict=True)]
        _, *fitted = min(solved, key=lambda found: found[0])
        return ReflectancePrior(self.info.name, self._model, self._config, fitted)

    def _pictures(self, frame: Frame, texture: Tensor, candidates: Sequence[float]) -> Iterator[Array]:
        """For each roughness the diffuse and the specular picture of a frame, (pixels, 2)."""
        surface = PosedSurface(needed(frame.mesh, "mesh"), self._config.texture)
        raster = rasterise(surface.mesh, frame.camera)
        shading = Shading(surface, frame.camera.centre, raster)
        lights = light_samples(frame.light)
        for rough in candidates:
            diffuse, specular = map(shading.texture, shading.features(lights, rough, self._model))
            pictures = raster.sample(surface.atlas.dilate(torch.cat([diffuse * texture, specular])))
            yield pictures.reshape(2, -1).T.numpy().astype(np.float64)


class _Fit:
    """Least squares of the recorded pictures by diffuse and specular ones: sums over frames."""

    def __init__(self) -> None:
        self._normal, self._right, self._square, self._count = np.zeros((2, 2)), np.zeros(2), 0.0, 0

    def add(self, pictures: Array, truth: Array) -> None:
        """A frame: its diffuse and specular pictures (pixels, 2), and the recorded one (pixels,)."""
        self._normal += pictures.T @ pictures
        self._right += pictures.T @ truth
        self._square += float(truth.astype(np.float64) @ truth)
        self._count += len(truth)

    def solved(self) -> tuple[float, float, float]:
        """Mean squared error, and the two scales, none negative."""
        normal, right = self._normal, self._right
        if normal[0, 0] <= 0.0:
            raise InputError("the training frames show no lit hand; check lights, cameras and tracked meshes")
        choices = [np.array([right[0] / normal[0, 0], 0.0])]
        if np.linalg.cond(normal) < 1e12:
            choices.append(np.linalg.solve(normal, right))
        scales = min((c for c in choices if (c >= 0).all()), key=lambda c: c @ normal @ c - 2 * c @ right)
        error = (self._square + scales @ normal @ scales - 2 * scales @ right) / self._count
        return float(error), float(scales[0]), float(scales[1])


def described(name: str, title: str, summary: str) -> MethodInfo:
    """What every reflectance method says of itself, with its name."""
    return MethodInfo(
        name=name,
        title=title,
        summary=summary,
        universal=True,
        needs=FULLY_LIT,
        trains_on=FULLY_LIT | {"olat or group"},
        linear=True,
        lights=KNOWN_LIGHTS,
        fidelity="reference: no learned network",
    )


def create(info: MethodInfo, model: Model, preset: str, changes: Changes = UNCHANGED) -> Method:
    """A reflectance method at a preset with changed settings; `InputError` for unknown ones."""
    if preset not in PRESETS:
        raise unknown_name(f"preset of {info.name}", preset, PRESETS)
    return Reflectance(info, model, changed(PRESETS[preset], changes, info.name))
