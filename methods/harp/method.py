"""HARP (Karunratanakul et al., CVPR 2023) behind the one interface: personalised from pictures in unknown light."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

import torch

from handbench.method import Avatar, MethodInfo, PosedAvatar, Progress, Recording
from handbench.scene import LIGHT_KINDS, Light, Mesh, Prediction, Unknown, Viewpoint, needed

from ..kit.albedo import Canvas, flat
from ..kit.colourspace import to_linear
from ..kit.enrolled import enrolled
from ..kit.untaught import Untaught
from .config import HarpConfig
from .fitting import fitted
from .look import Look, shade
from .shadow import visibility
from .surface import mapped

INFO = MethodInfo(
    name="harp",
    title="HARP",
    summary="displaced parametric mesh, albedo and normal map, one point light with a shadow map, fitted to pictures",
    universal=True,
    linear=True,
    needs=frozenset({"image", "alpha", "camera", "keypoints"}),
    lights=LIGHT_KINDS,
    fidelity="reimplementation from paper and code on another hand model; no prior, nothing of the authors' fits",
)


class PosedHarp(PosedAvatar):
    """The displaced surface in a pose, and what a camera sees of it."""

    def __init__(self, look: Look, viewpoint: Viewpoint) -> None:
        self._look = look
        mesh = look.mesh(needed(viewpoint.pose, "pose"))
        self._canvas = canvas = Canvas(mesh, viewpoint.camera, look.config.texture)
        self._albedo, values = flat(look.albedo, canvas), flat(look.normal_map, canvas)
        self._normal = mapped(canvas.normal.T, self._along(mesh), values.T)

    def _along(self, mesh: Mesh) -> torch.Tensor | None:
        if self._look.config.tangents == "duff":
            return None
        face = self._canvas.atlas.face[self._canvas.texels]
        return self._look.surface.tangents(torch.from_numpy(mesh.vertices.copy()).float())[
            torch.from_numpy(face).long()
        ]

    @torch.no_grad()
    def relight(self, light: Light) -> Prediction:
        """Under a known light by albedo and normals; under an unknown one as it was enrolled, by its own estimate."""
        if isinstance(light, Unknown):
            return self._as_enrolled()
        config = self._look.config
        albedo = to_linear(self._albedo, config.space)
        return self._canvas.lit(light, albedo, self._normal.T, config.gloss, config.environment_error)

    def _as_enrolled(self) -> Prediction:
        look, canvas = self._look, self._canvas
        position = canvas.position.T
        seen = visibility(canvas.surface.mesh, look.light.numpy(), position.double().numpy(), look.config.shadow_size)
        shading = shade(position, self._normal, torch.from_numpy(seen).float(), look.light, look.ambient)
        return canvas.drawn(to_linear(self._albedo * shading, look.config.space))


class HarpAvatar(Avatar):
    def __init__(self, look: Look) -> None:
        self.look = look

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedHarp(self.look, viewpoint)


class Harp(Untaught):
    """There is no prior: all is learned of the enrolled person alone."""

    def __init__(self, config: HarpConfig) -> None:
        super().__init__(INFO, asdict(config), partial(_personalised, config))


def _personalised(config: HarpConfig, enrolment: Recording, seed: int, progress: Progress) -> Avatar:
    """Fits the hand model (`hand.fitting`), then HARP's own stages. Raises `Unsupported` with the reason if no hand is
    found: too few key points, an empty mask, a left hand, two hands, another lens …"""
    return HarpAvatar(fitted(enrolled(enrolment, config.frames), config, seed, progress))
