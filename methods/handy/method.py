"""Handy-style texture inversion behind the one interface: the rows `handy-phong` and `handy-ggx` of URHand's Table 1.

A texture is sought in the space of a generator, as URHand's authors did with Handy's (Potamias et al., CVPR 2023), and
taken as the albedo of a fixed reflectance. The generator is one of our own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from handbench.hand import hand_model
from handbench.hand.known import SHIPPED
from handbench.method import Avatar, MethodInfo, PosedAvatar, Progress, Recording
from handbench.recording import Need
from handbench.render.uv.posed import PosedSurface
from handbench.scene import LIGHT_KINDS, Baked, Camera, Light, Mesh, Pose, Prediction, Unknown, Viewpoint, needed

from ..kit.albedo import Canvas, flat
from ..kit.enrolled import Enrolled
from ..kit.fittedhand import PosedFitted
from ..kit.untaught import Untaught
from ..kit.weights import load_state, save_state
from .config import HandyConfig, Reflectance
from .generator import SIZE, shipped
from .inversion import inverted
from .lobe import lobe
from .pictures import sitting

_NEEDS: frozenset[Need] = frozenset({"image", "alpha", "camera"})
_FIDELITY = "Handy-style: inversion as the paper tells, in a generator trained on procedural skins, not in Handy's"


def _described(name: str, title: str, lobe: str) -> MethodInfo:
    return MethodInfo(
        name=name,
        title=title,
        summary=f"a texture found in a generator's space, taken as the albedo under {lobe}",
        universal=True,
        linear=True,
        needs=_NEEDS,
        lights=LIGHT_KINDS,
        fidelity=_FIDELITY,
    )


INFOS: dict[Reflectance, MethodInfo] = {
    "phong": _described("handy-phong", "Handy-style + Phong", "Phong's lobe"),
    "ggx": _described("handy-ggx", "Handy-style + GGX", "GGX"),
}


class PosedHandy(PosedAvatar):
    """The textured hand in a pose, and what a camera sees of it."""

    def __init__(self, avatar: HandyAvatar, mesh: Mesh | PosedSurface, camera: Camera) -> None:
        self._avatar = avatar
        self._canvas = Canvas(mesh, camera, SIZE)
        self._albedo = flat(avatar.albedo, self._canvas)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedHandy(self._avatar, self._canvas.surface, camera)

    def relight(self, light: Light) -> Prediction:
        """Under a known light by albedo and lobe; under an unknown one the texture as the enrolled pictures show it."""
        avatar = self._avatar
        if isinstance(light, Unknown):
            return self._canvas.drawn(self._albedo * avatar.exposure[:, None])
        config = avatar.config
        drawn = lobe(avatar.reflectance, config.gloss)
        return self._canvas.lit(
            light, self._albedo, None, drawn.roughness, config.environment_error, drawn.model, drawn.strength
        )


class HandyAvatar(Avatar):
    """A person: an albedo (3, SIZE, SIZE), linear; the exposure (1,) or (3,) of pictures drawn without their light; its
    fitted hand, or None where meshes are given."""

    def __init__(
        self, reflectance: Reflectance, config: HandyConfig, albedo: Tensor, exposure: Tensor, hand: Enrolled | None
    ) -> None:
        self.reflectance, self.config = reflectance, config
        self.albedo, self.exposure, self.hand = albedo, exposure, hand

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        mesh = self._mesh(viewpoint)
        posed = PosedHandy(self, mesh, viewpoint.camera)
        return posed if self.hand is None else PosedFitted(posed, mesh)

    def _mesh(self, viewpoint: Viewpoint) -> Mesh:
        if self.hand is None:
            return needed(viewpoint.mesh, "mesh")
        level = min(self.config.level, self.hand.hand.levels)
        return self.hand.mesh(needed(viewpoint.pose, "pose"), level)

    @property
    def found(self) -> Mapping[str, Pose]:
        return {} if self.hand is None else self.hand.found

    def baked(self, viewpoint: Viewpoint) -> Baked:
        """Raises `Unsupported` for Phong's lobe, which such textures cannot hold."""
        drawn = lobe(self.reflectance, self.config.gloss)
        if drawn.model != "brdf":
            return super().baked(viewpoint)
        albedo = self.albedo.permute(1, 2, 0).numpy()
        return Baked(self._mesh(viewpoint), albedo, np.full((SIZE, SIZE), drawn.roughness), drawn.strength)

    def save(self, folder: Path) -> None:
        """Albedo, exposure and, if it was fitted, the hand; pictures of the person are not kept."""
        shape = np.zeros(0) if self.hand is None else np.array(self.hand.shape, dtype=np.float64)
        state = {"shape": torch.from_numpy(shape), "albedo": self.albedo.contiguous(), "exposure": self.exposure}
        save_state(folder, INFOS[self.reflectance].name, _told(self.config), state)

    @classmethod
    def load(cls, folder: Path, reflectance: Reflectance, config: HandyConfig) -> HandyAvatar:
        """The avatar that `save` wrote. Raises `InputError` as `load_state` does."""
        shapes = {"shape": (None,), "albedo": (3, SIZE, SIZE), "exposure": (None,)}
        state = load_state(folder, INFOS[reflectance].name, _told(config), shapes)
        hand = Enrolled(hand_model(), state["shape"].numpy(), ()) if len(state["shape"]) else None
        return cls(reflectance, config, state["albedo"], state["exposure"], hand)


def _told(config: HandyConfig) -> dict[str, Any]:
    return {**asdict(config), "hand": SHIPPED}


class Handy(Untaught):
    """Nothing is learned of the training frames: the generator is the prior."""

    def __init__(self, reflectance: Reflectance, config: HandyConfig) -> None:
        personalise = partial(personalised, reflectance, config)
        restore = partial(HandyAvatar.load, reflectance=reflectance, config=config)
        super().__init__(INFOS[reflectance], asdict(config), personalise, restore)


def personalised(
    reflectance: Reflectance, config: HandyConfig, enrolment: Recording, seed: int, progress: Progress
) -> HandyAvatar:
    """Fits the hand where no mesh is given, then seeks its texture; `Unsupported` with the reason if it cannot."""
    seen = sitting(enrolment, config, lobe(reflectance, config.gloss), progress)
    albedo, exposure = inverted(shipped(), seen.shots, config, seed, progress)
    return HandyAvatar(reflectance, config, albedo, exposure, seen.hand)
