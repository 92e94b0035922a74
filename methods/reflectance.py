"""Relighting by a reflectance model alone: mean texture times diffuse feature plus specular feature.

C = k_d C^d T / E + k_s C^s   (URHand Eq. 3 with two fitted scales), E the mean diffuse feature of the frames
that gave T, which turns the fully lit texture into an albedo up to scale.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from handbench.data.texture import mean_texture
from handbench.errors import InputError, Unsupported, unknown_name
from handbench.light.lightset import light_samples
from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, Recording, silent
from handbench.render.posed import PosedSurface, raster
from handbench.render.raster import Raster
from handbench.render.shading import Model, light_features
from handbench.scene import Frame, Prediction, Query
from handbench.skips import note, skips

from .nets.weights import load_state, save_state
from .picture import prediction


@dataclass(frozen=True)
class ReflectanceConfig:
    """Texture size in texels; roughness values to choose from; how many training frames the fit looks at."""

    texture: int = 128
    roughness: tuple[float, ...] = (0.25, 0.35, 0.45, 0.55, 0.65, 0.8)
    fit_frames: int = 48


PRESETS = {
    "quick": ReflectanceConfig(),
    "standard": ReflectanceConfig(texture=256, fit_frames=96),
    "paper": ReflectanceConfig(texture=1024, fit_frames=96),
}


def full_exposure(enrolment: Recording, size: int) -> float:
    """Mean diffuse feature over the surface in the enrolment's fully lit frames: what the mean texture was lit by."""
    features = []
    seen = set()
    for frame in enrolment.of_kind("full").frames:
        if id(frame.mesh) not in seen:
            seen.add(id(frame.mesh))
            posed = PosedSurface.of(frame.mesh, size)
            diffuse, _ = shade(posed, frame, 0.5, "diffuse")
            features.append(float(diffuse[:, torch.from_numpy(posed.atlas.covered)].mean()))
    return float(np.mean(features))


def normalised_texture(enrolment: Recording, size: int) -> Tensor:
    """The mean texture (3, R, R) over the light that made it: an albedo over pi, up to what shading it keeps."""
    return mean_texture(enrolment, size).texture / full_exposure(enrolment, size)


def shade(
    posed: PosedSurface, query: Query, roughness: float, model: Model, picture: Raster | None = None
) -> tuple[Tensor, Tensor]:
    """Diffuse and specular feature textures (3, R, R) of a query on the coarse surface, with shadows.

    If they are made for one picture, texels that it does not look up are left at zero (`Skips.unseen`).
    """
    atlas = posed.atlas
    lights = light_samples(query.light)
    normal, position, texels = posed.normal, posed.position, None
    note("texels outside charts", atlas.size**2, atlas.size**2 - atlas.count)
    if picture is not None and skips().unseen:
        texels = np.flatnonzero(atlas.needed(picture.texels(atlas.size)))
        note("texels out of sight", atlas.count, atlas.count - len(texels))
        normal, position = normal[:, texels], position[:, texels]
    visible = posed.visibility(lights, texels=texels)
    rough = torch.full((normal.shape[1],), roughness)
    diffuse, specular = light_features(normal, position, rough, query.camera.centre, lights, visible, model)
    if texels is not None:
        where = torch.from_numpy(texels)
        diffuse, specular = (f.new_zeros(3, atlas.count).index_copy(1, where, f) for f in (diffuse, specular))
    return atlas.scatter(diffuse), atlas.scatter(specular)


class ReflectanceAvatar(Avatar):
    def __init__(self, texture: Tensor, prior: ReflectancePrior) -> None:
        self._texture = texture
        self._prior = prior

    def relight(self, query: Query) -> Prediction:
        prior = self._prior
        posed = PosedSurface.of(query.mesh, prior.config.texture)
        picture = raster(query.mesh, query.camera)
        # a fit that gave the specular lobe no share leaves nothing to work out
        model: Model = prior.model if prior.specular or not skips().missing_lobes else "diffuse"
        diffuse, specular = shade(posed, query, prior.roughness, model, picture)
        colour = prior.diffuse * diffuse * self._texture + prior.specular * specular
        return prediction(picture, posed.atlas.dilate(colour))


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
        best = (np.inf, (1.0, 0.0, candidates[0]))
        for step, rough in enumerate(candidates, start=1):
            error, scales = _fit(self._samples(recording, chosen, textures, rough))
            best = min(best, (error, (*scales, rough)), key=lambda pair: pair[0])
            progress(step, len(candidates), loss=error)
        return ReflectancePrior(self.info.name, self._model, self._config, best[1])

    def _samples(
        self, recording: Recording, frames: list[Frame], textures: dict[str, Tensor], rough: float
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """For each frame the two shaded pictures (pixels, 2) and the recorded one (pixels,)."""
        for frame in frames:
            posed = PosedSurface.of(frame.mesh, self._config.texture)
            picture = raster(frame.mesh, frame.camera)
            diffuse, specular = shade(posed, frame, rough, self._model, picture)
            maps = torch.cat([diffuse * textures[frame.subject], specular])
            pictures = picture.sample(posed.atlas.dilate(maps))
            truth = recording.observe(frame).image
            yield pictures.reshape(2, -1).T.numpy().astype(np.float64), np.moveaxis(truth, -1, 0).ravel()


def _fit(samples: Iterator[tuple[np.ndarray, np.ndarray]]) -> tuple[float, tuple[float, float]]:
    """Mean squared error and the two non-negative scales of the least squares fit."""
    normal, right, square, count = np.zeros((2, 2)), np.zeros(2), 0.0, 0
    for pictures, truth in samples:
        normal += pictures.T @ pictures
        right += pictures.T @ truth
        square += float(truth.astype(np.float64) @ truth)
        count += len(truth)
    if normal[0, 0] <= 0.0:
        raise InputError("the training frames show no lit hand; check lights, cameras and tracked meshes")
    choices = [np.array([right[0] / normal[0, 0], 0.0])]
    if np.linalg.cond(normal) < 1e12:
        choices.append(np.linalg.solve(normal, right))
    scales = min((c for c in choices if (c >= 0).all()), key=lambda c: c @ normal @ c - 2 * c @ right)
    return (square + scales @ normal @ scales - 2 * scales @ right) / count, (float(scales[0]), float(scales[1]))


def create(info: MethodInfo, model: Model, preset: str) -> Method:
    """A reflectance method at a preset; `InputError` for an unknown one."""
    if preset not in PRESETS:
        raise unknown_name(f"preset of {info.name}", preset, PRESETS)
    return Reflectance(info, model, PRESETS[preset])
