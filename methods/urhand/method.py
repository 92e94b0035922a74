"""URHand behind the one interface: a universal prior, personalised by a mean texture."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from handbench.errors import InputError
from handbench.light.lightset import light_samples
from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, Recording, silent
from handbench.render.posed import PosedSurface, raster
from handbench.render.shading import relight, transfer
from handbench.scene import Camera, Mesh, Prediction, Query

from ..nets.weights import load_state, save_state
from ..picture import prediction
from ..reflectance import normalised_texture
from .config import Config, configuration
from .model import Material, URHandModel
from .training import train

_KEPT_POSES = 8
# A transfer takes 48 MB at 128 texels and 512 lights; below this many lights it would save nothing.
_KEPT_TRANSFERS, _MANY_LIGHTS = 4, 128

INFO = MethodInfo(
    name="urhand",
    title="URHand",
    summary="universal prior: physical branch, neural branch with a linear lighting network",
    universal=True,
    linear=True,
    lights=frozenset({"directional", "point", "environment"}),
    fidelity="faithful reimplementation trained here on open data; image loss without perceptual and adversarial terms",
)


class URHandAvatar(Avatar):
    """A subject: the shared networks and its own mean texture. What the last few poses share is kept."""

    def __init__(self, model: URHandModel, texture: Tensor) -> None:
        self._model, self._texture = model, texture
        self._materials: OrderedDict[Mesh, Material] = OrderedDict()
        self._transfers: OrderedDict[tuple[Mesh, Camera, bytes], Tensor] = OrderedDict()

    @torch.no_grad()  # not inference_mode: caches are shared with training
    def relight(self, query: Query) -> Prediction:
        model, config = self._model, self._model.config
        posed = PosedSurface.of(query.mesh, config.texture)
        material = self._material(query, posed)
        features = self._features(query, posed, material)
        colour, _ = model.colour(features, material, self._texture, posed.atlas)
        return prediction(raster(query.mesh, query.camera), posed.atlas.dilate(posed.atlas.scatter(colour)))

    def _features(self, query: Query, posed: PosedSurface, material: Material) -> Tensor:
        """Shading features (6, N). Many distant lights, as an environment has, go through a kept transfer."""
        lights = light_samples(query.light, self._model.config.environment)
        centre = query.camera.centre
        if len(lights.directions) < _MANY_LIGHTS or len(lights.positions):
            return self._model.features(material, posed, centre, lights, posed.visibility(lights))
        key = (query.mesh, query.camera, lights.directions.tobytes())
        if key not in self._transfers:
            known = (material.normal, posed.position, material.roughness, centre)
            self._transfers[key] = transfer(*known, lights.directions, posed.visibility(lights))
            if len(self._transfers) > _KEPT_TRANSFERS:
                self._transfers.popitem(last=False)
        return torch.cat(relight(self._transfers[key], lights.irradiance))

    def _material(self, query: Query, posed: PosedSurface) -> Material:
        if query.mesh not in self._materials:
            joints = torch.from_numpy(query.pose.joints.copy()).float()
            self._materials[query.mesh] = self._model.material(self._texture, joints, posed)
            if len(self._materials) > _KEPT_POSES:
                self._materials.popitem(last=False)
        return self._materials[query.mesh]


class URHandPrior(Prior):
    def __init__(self, model: URHandModel, joints: int) -> None:
        self.model = model.eval()
        self.joints = joints

    def personalise(self, enrolment: Recording, seed: int = 0) -> Avatar:
        return URHandAvatar(self.model, normalised_texture(enrolment, self.model.config.texture))

    def save(self, folder: Path) -> None:
        state = {**self.model.state_dict(), "joints": torch.tensor(self.joints)}
        save_state(folder, INFO.name, asdict(self.model.config), state)


class URHand(Method):
    info = INFO

    def __init__(self, config: Config) -> None:
        self._config = config

    @property
    def config(self) -> dict[str, Any]:
        return asdict(self._config)

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        if not recording.frames:
            raise InputError("urhand: there are no training frames; check the protocol's [train] selection")
        joints = len(recording.frames[0].pose.joints)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            model = URHandModel(self._config, joints)
        train(model, recording, seed, progress)
        return URHandPrior(model, joints)

    def load(self, folder: Path) -> Prior:
        state = load_state(folder, INFO.name, asdict(self._config))
        joints = int(state.pop("joints"))
        model = URHandModel(self._config, joints)
        model.load_state_dict(state)
        return URHandPrior(model, joints)


def create(preset: str = "quick") -> Method:
    """URHand at a preset."""
    return URHand(configuration(preset))
