"""URHand behind the one interface: a universal prior, personalised by a mean texture."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from handbench.device import device
from handbench.errors import InputError
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, Recording, silent
from handbench.render.posed import PosedSurface, raster
from handbench.render.shading import relight, transfer
from handbench.scene import KNOWN_LIGHTS, Camera, Prediction, Query
from handbench.skips import skips

from ..ablations import ABLATIONS
from ..nets.weights import load_state, save_state
from ..picture import prediction
from ..reflectance import normalised_texture
from ..views import visibility
from . import lighting
from .config import Config, configuration
from .model import Material, URHandModel
from .training import train

_KEPT_POSES = 8
# A transfer takes 8 bytes a texel and light: 48 MB at 128 texels and 512 lights. It saves nothing for few lights and
# is not kept for more pairs than these.
_KEPT_TRANSFERS, _MANY_LIGHTS, _MOST_PAIRS = 4, 128, 1 << 23

INFO = MethodInfo(
    name="urhand",
    title="URHand",
    summary="universal prior: physical branch, neural branch with a linear lighting network",
    universal=True,
    linear=True,
    lights=KNOWN_LIGHTS,
    fidelity="faithful reimplementation trained here on open data",
)


class URHandAvatar(Avatar):
    """A subject: the shared networks and its own mean texture. What the last few poses share is kept."""

    def __init__(self, model: URHandModel, texture: Tensor) -> None:
        self._model, self._texture = model, texture
        self._materials: OrderedDict[PosedSurface, Material] = OrderedDict()
        self._transfers: OrderedDict[tuple[PosedSurface, Camera, bytes], Tensor] = OrderedDict()

    @torch.no_grad()  # not inference_mode: caches are shared with training
    def relight(self, query: Query) -> Prediction:
        model, config = self._model, self._model.config
        posed = PosedSurface.of(query.mesh, config.texture)
        material = self._material(query, posed)
        lights = light_samples(query.light, config.environment)
        visible = visibility(posed, lights, config.shadows)
        features = self._features(query, posed, material, lights, visible)
        colour, _ = model.colour(features, lights, material, self._texture, posed.atlas)
        if config.exposure and visible is not None:
            colour = colour * (lighting.power(lights, visible) / lighting.power(lights).clamp_min(1e-12))
        return prediction(raster(query.mesh, query.camera), posed.atlas.dilate(posed.atlas.scatter(colour)))

    def _features(
        self, query: Query, posed: PosedSurface, material: Material, lights: LightSet, visible: Tensor | None
    ) -> Tensor:
        """Shading features (6, N). Many distant lights, as an environment has, go through a kept transfer."""
        config, centre = self._model.config, query.camera.centre
        keeps = config.shading == "brdf" and config.specular and skips().repeated and not len(lights.positions)
        few = len(lights.directions) < _MANY_LIGHTS
        if not keeps or few or visible is None or visible.numel() > _MOST_PAIRS:
            return lighting.features(config, material.normal, material.roughness, posed, centre, lights, visible)
        key = (posed, query.camera, lights.directions.tobytes())
        if key not in self._transfers:
            surface = (material.normal, posed.position, material.roughness, centre)
            self._transfers[key] = transfer(*surface, lights.directions, visible)
            if len(self._transfers) > _KEPT_TRANSFERS:
                self._transfers.popitem(last=False)
        return torch.cat(relight(self._transfers[key], lights.irradiance))

    def _material(self, query: Query, posed: PosedSurface) -> Material:
        if posed not in self._materials:  # with `Skips.repeated` off every call has a surface of its own
            joints = torch.from_numpy(query.pose.joints.copy()).float()
            self._materials[posed] = self._model.material(self._texture, joints, posed)
            if len(self._materials) > _KEPT_POSES:
                self._materials.popitem(last=False)
        return self._materials[posed]


class URHandPrior(Prior):
    def __init__(self, model: URHandModel, joints: int) -> None:
        self.model = model.eval()
        self.joints = joints

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return URHandAvatar(self.model, normalised_texture(enrolment, self.model.config.texture))

    def save(self, folder: Path) -> None:
        state = {**self.model.state_dict(), "joints": torch.tensor(self.joints)}
        save_state(folder, INFO.name, asdict(self.model.config), state)


class URHand(Method):
    def __init__(self, config: Config, info: MethodInfo = INFO) -> None:
        self.info = info
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
            model = URHandModel(self._config, joints).to(device())
        train(model, recording, seed, progress)
        return URHandPrior(model, joints)

    def load(self, folder: Path) -> Prior:
        state = load_state(folder, INFO.name, asdict(self._config))
        joints = int(state.pop("joints"))
        model = URHandModel(self._config, joints)
        model.load_state_dict(state)
        return URHandPrior(model.to(device()), joints)


def create(preset: str = "quick", ablation: str | None = None) -> Method:
    """URHand at a preset, or one of its `ABLATIONS` at it."""
    config, named = configuration(preset), INFO
    if ablation is not None:
        variant = ABLATIONS[ablation]
        config = replace(config, **variant.overrides)
        named = replace(INFO, name=f"urhand-{ablation}", title=variant.title, summary=variant.summary)
    lights = INFO.lights if config.near_lights else INFO.lights - {"point"}
    return URHand(config, replace(named, linear=config.linear, lights=lights))
