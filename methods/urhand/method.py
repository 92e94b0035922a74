"""URHand behind the one interface: a universal prior, personalised by a mean texture."""

from __future__ import annotations

from copy import copy
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from handbench.device import device
from handbench.errors import InputError
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.render.see.raster import rasterise
from handbench.render.shade.cells import CellAnswers
from handbench.render.uv.posed import PosedSurface
from handbench.scene import KNOWN_LIGHTS, Array, Camera, Light, Prediction, Viewpoint, needed
from handbench.settings import UNCHANGED, Changes, changed
from handbench.skips import note, skips

from ..ablations import ABLATIONS
from ..kit.picture import prediction
from ..kit.sampling import Sampling
from ..kit.views import visibility
from ..kit.weights import load_state, save_state
from ..reflectance.model import FULLY_LIT, normalised_texture
from . import lighting
from .config import UrhandConfig, configuration
from .model import URHandModel
from .training import train

INFO = MethodInfo(
    name="urhand",
    title="URHand",
    summary="universal prior: physical branch, neural branch with a linear lighting network",
    universal=True,
    needs=FULLY_LIT | {"pose"},
    trains_on=FULLY_LIT | {"pose", "olat or group"},
    linear=True,
    lights=KNOWN_LIGHTS,
    fidelity="faithful reimplementation trained here on open data",
)


class URHandAvatar(Avatar):
    """A subject: the shared networks and its own mean texture."""

    def __init__(self, model: URHandModel, texture: Tensor) -> None:
        self._model, self._texture = model, texture

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedURHand(self._model, self._texture, viewpoint)

    def save(self, folder: Path) -> None:
        save_state(folder, INFO.name, asdict(self._model.config), {"texture": self._texture})


class PosedURHand(PosedAvatar):
    """The surface as the physical branch refines it, what the camera sees of it, and its shadows and answers so far."""

    @torch.no_grad()  # not inference_mode: the atlas is shared with training
    def __init__(self, model: URHandModel, texture: Tensor, viewpoint: Viewpoint) -> None:
        self._model, self._texture = model, texture.to(model.device)
        self._surface = PosedSurface(needed(viewpoint.mesh, "mesh"), model.config.texture, model.device)
        self._raster = rasterise(self._surface.mesh, viewpoint.camera)
        joints = torch.from_numpy(needed(viewpoint.pose, "pose").joints.copy()).float().to(model.device)
        self._material = model.material(self._texture, joints, self._surface)
        self._centre = viewpoint.camera.centre
        # exposure is worked out texel by texel
        self._sampling = None if model.config.exposure else Sampling.of(self._surface.atlas, self._raster)
        self._sampled: CellAnswers | None = None
        if self._sampling is not None and model.config.shading != "released":
            maps = self._maps(self._sampling.texels)
            self._sampled = CellAnswers(*maps, self._centre, lighting.model(model.config))

    def seen_by(self, camera: Camera) -> PosedAvatar:
        other = copy(self)
        other._raster, other._centre = rasterise(self._surface.mesh, camera), camera.centre
        other._sampling = other._sampled = None  # shadows at all texels serve every camera
        return other

    @torch.no_grad()
    def relight(self, light: Light) -> Prediction:
        model, config, atlas = self._model, self._model.config, self._surface.atlas
        # an encoder of environment maps sees the map itself
        error = config.environment_error if config.encoder == "features" else 0.0
        lights = light_samples(light, config.environment, environment_error=error)
        features, visible = self._features(lights)
        colour, _ = model.colour(features, lights, self._material, self._texture, atlas)
        if config.exposure and visible is not None:
            colour = colour * (lighting.power(lights, visible) / lighting.power(lights).clamp_min(1e-12))
        return prediction(self._raster, atlas.dilate(atlas.scatter(colour)))

    def _features(self, lights: LightSet) -> tuple[Tensor, Tensor | None]:
        """Shading features (6, N), and what of each light reaches the texels, (L + P, N) or None without shadows.

        The network looks at texels that no picture shows. Under the few lights of an environment most of those have
        the features of one near them (`Sampling`, `Skips.unseen`), and no row of visibility is given. Which lights
        these are does not depend on the others, so answers stay linear in light.
        """
        sampling, of_map = self._sampling, lights.of_map
        if sampling is None or of_map is None or not of_map.any() or not skips().unseen:
            visible = self._visible(lights)
            return self._shaded(lights, visible), visible
        texels, count = sampling.texels, self._surface.atlas.count
        note("texels out of sight", count, count - len(texels))
        around = lights.only(of_map, np.zeros(len(lights.positions), dtype=bool))
        if self._sampled is None:
            found = self._shaded(around, self._visible(around, texels), texels)
        else:
            found = torch.cat(self._sampled.features(around, partial(self._visible, texels=texels)))
        found = found.index_select(1, sampling.source.to(found.device))
        others = lights.only(~of_map)
        if len(others):
            found = found + self._shaded(others, self._visible(others))
        return found, None

    def _visible(self, lights: LightSet, texels: Array | None = None) -> Tensor | None:
        return visibility(self._surface, lights, self._model.config.shadows, texels)

    def _shaded(self, lights: LightSet, visible: Tensor | None, texels: Array | None = None) -> Tensor:
        """The features (6, N) of all covered texels or some."""
        normal, position, roughness = self._maps(texels)
        return lighting.features(self._model.config, normal, roughness, position, self._centre, lights, visible)

    def _maps(self, texels: Array | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Normal and position (3, N) and roughness (N) of all covered texels or some."""
        maps = self._material.normal, self._surface.position, self._material.roughness
        if texels is None:
            return maps
        normal, position, roughness = (values[..., torch.from_numpy(texels).to(values.device)] for values in maps)
        return normal, position, roughness


class URHandPrior(Prior):
    def __init__(self, model: URHandModel, joints: int) -> None:
        self.model = model.eval()
        self.joints = joints

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return URHandAvatar(self.model, normalised_texture(enrolment, self.model.config.texture))

    def save(self, folder: Path) -> None:
        state = {**self.model.state_dict(), "joints": torch.tensor(self.joints)}
        save_state(folder, INFO.name, asdict(self.model.config), state)

    def restore(self, folder: Path) -> Avatar:
        config = self.model.config
        state = load_state(folder, INFO.name, asdict(config), {"texture": (3, config.texture, config.texture)})
        return URHandAvatar(self.model, state["texture"])


class URHand(Method):
    def __init__(self, config: UrhandConfig, info: MethodInfo = INFO) -> None:
        self.info = info
        self._config = config

    @property
    def config(self) -> dict[str, Any]:
        return asdict(self._config)

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        if not recording.frames:
            raise InputError("urhand: there are no training frames; check the protocol's [train] selection")
        joints = len(needed(recording.frames[0].pose, "pose").joints)
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


def create(preset: str = "quick", ablation: str | None = None, changes: Changes = UNCHANGED) -> Method:
    """URHand at a preset, or one of its `ABLATIONS` at it, with changed settings; `InputError` for unknown ones."""
    config, named = configuration(preset), INFO
    if ablation is not None:
        variant = ABLATIONS[ablation]
        config = replace(config, **variant.overrides)
        named = replace(INFO, name=f"urhand-{ablation}", title=variant.title, summary=variant.summary)
    config = changed(config, changes, named.name)
    lights = INFO.lights if config.near_lights else INFO.lights - {"point"}
    return URHand(config, replace(named, linear=config.linear, lights=lights))
