"""RelightableHands behind the one interface: nothing is learned from other subjects, everything in `personalise`."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import asdict, replace

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar
from handbench.render.see.raster import rasterise
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Array, Camera, Light, Prediction, Viewpoint, needed
from handbench.settings import UNCHANGED, Changes, changed
from handbench.skips import note, skips

from ..kit.picture import prediction
from ..kit.untaught import Untaught
from .config import RelightableHandsConfig, configuration
from .model import RelightableHandsModel, ViewedTexels, lit
from .training import train

_KEPT_BYTES = 64 << 20  # of responses; one takes 130 kB at 128 texels
_TOGETHER = 8  # lights in one pass of the network: bounds memory
MOST_LIGHTS = 1024
"""Most lights of a picture: at 10 to 20 ms each more would take minutes."""

INFO = MethodInfo(
    name="relightablehands",
    title="RelightableHands",
    summary="one identity's texture decoder on a mesh, one pass a light, summed",
    linear=True,
    needs=frozenset({"image", "alpha", "camera", "mesh", "uv", "pose", "light", "olat or group"}),
    lights=frozenset({"directional", "point", "environment"}),
    fidelity="reimplementation on a mesh, trained here on open data",
)


class RelightableHandsAvatar(Avatar):
    """A subject's trained network."""

    def __init__(self, model: RelightableHandsModel) -> None:
        self._model = model

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedRelightableHands(self._model, viewpoint)


class PosedRelightableHands(PosedAvatar):
    """The surface, what the camera sees of it, and what the hand answered to single lights so far;
    `surface` is one that another camera saw."""

    @torch.no_grad()
    def __init__(self, model: RelightableHandsModel, viewpoint: Viewpoint, surface: PosedSurface | None = None) -> None:
        self._model, self._viewpoint = model, viewpoint
        self._surface = surface or PosedSurface(needed(viewpoint.mesh, "mesh"), model.config.texture, model.device)
        self._raster = rasterise(self._surface.mesh, viewpoint.camera)
        joints = torch.from_numpy(needed(viewpoint.pose, "pose").joints.copy()).float()
        self._seen = ViewedTexels.of(self._surface, viewpoint.camera.centre, joints)
        self._kept: OrderedDict[bytes, Tensor] = OrderedDict()  # by direction or position

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedRelightableHands(self._model, replace(self._viewpoint, camera=camera), self._surface)

    @torch.no_grad()
    def relight(self, light: Light) -> Prediction:
        lights = light_samples(light, environment_lights=self._model.config.environment_lights)
        if len(lights) > MOST_LIGHTS:
            raise Unsupported(
                f"{INFO.title} runs its network once a light: {len(lights)} lights are more than {MOST_LIGHTS}"
            )
        atlas = self._surface.atlas
        colour = torch.zeros(3, atlas.count, device=self._model.device)
        for first in range(0, len(lights), _TOGETHER):
            some = _some(lights, np.arange(first, min(first + _TOGETHER, len(lights))))
            colour += lit(self._responses(some), np.concatenate([some.irradiance, some.intensities]))
        return prediction(self._raster, atlas.dilate(atlas.scatter(colour)))

    def _responses(self, lights: LightSet) -> Tensor:
        """What the hand answers to each of a few lights of unit irradiance or intensity, (L + P, 3, N)."""
        if not skips().known:
            return self._drawn(lights)
        keys = [direction.tobytes() for direction in lights.directions]
        keys += [b"near" + position.tobytes() for position in lights.positions]
        found = {key: self._kept[key] for key in keys if key in self._kept}
        missing = {key: row for row, key in enumerate(keys) if key not in found}
        note("lights known already", len(keys), len(keys) - len(missing))
        if missing:
            rows = np.array([*missing.values()])
            drawn = self._drawn(_some(lights, rows))
            # copies: a view would keep the answers to all of these lights alive
            found |= {key: response.clone() for key, response in zip(missing, drawn, strict=True)}
        for key, response in found.items():
            self._kept[key] = response
            self._kept.move_to_end(key)
        while len(self._kept) * found[keys[0]].nbytes > _KEPT_BYTES:
            self._kept.popitem(last=False)
        return torch.stack([found[key] for key in keys])

    def _drawn(self, lights: LightSet) -> Tensor:
        """The same from the network."""
        visible = self._surface.visibility(lights)
        return self._model.responses(self._seen, lights.directions, visible, lights.positions)[0]


def _some(lights: LightSet, rows: Array) -> LightSet:
    """Some lights, by rows of the distant ones followed by the near ones."""
    distant, near = rows[rows < len(lights.directions)], rows[rows >= len(lights.directions)] - len(lights.directions)
    return LightSet(
        lights.directions[distant], lights.irradiance[distant], lights.positions[near], lights.intensities[near]
    )


class RelightableHands(Untaught):
    def __init__(self, config: RelightableHandsConfig) -> None:
        super().__init__(INFO, asdict(config), lambda *given: RelightableHandsAvatar(train(config, *given)))


def create(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """RelightableHands at a preset with changed settings; `InputError` for unknown ones."""
    return RelightableHands(changed(configuration(preset), changes, INFO.name))
