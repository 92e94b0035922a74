"""HARP (Karunratanakul et al., CVPR 2023) behind the one interface: personalised from pictures in unknown light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch

from handbench.errors import Unsupported
from handbench.hand import hand_model
from handbench.method import Avatar, MethodInfo, PosedAvatar, Progress, Recording
from handbench.render.uv.posed import PosedSurface
from handbench.scene import LIGHT_KINDS, Baked, Camera, Light, Mesh, Pose, Prediction, Unknown, Viewpoint, needed

from ..kit.albedo import Canvas, flat
from ..kit.colourspace import to_linear
from ..kit.enrolled import enrolled
from ..kit.fittedhand import PosedFitted
from ..kit.untaught import Untaught
from ..kit.weights import as_tensor, as_text, check_shapes, load_state, save_state
from .config import HarpConfig
from .fitting import fitted
from .look import Look, shade
from .shadow import visibility
from .surface import HandSurface, mapped

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

    def __init__(self, look: Look, mesh: Mesh | PosedSurface, camera: Camera) -> None:
        self._look = look
        self._canvas = canvas = Canvas(mesh, camera, look.config.texture)
        self._albedo, values = flat(look.albedo, canvas), flat(look.normal_map, canvas)
        self._normal = mapped(canvas.normal.T, self._along(), values.T)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedHarp(self._look, self._canvas.surface, camera)

    def _along(self) -> torch.Tensor | None:
        if self._look.config.tangents == "duff":
            return None
        face = self._canvas.atlas.face[self._canvas.texels]
        vertices = torch.from_numpy(self._canvas.surface.mesh.vertices.copy()).float()
        return self._look.surface.tangents(vertices)[torch.from_numpy(face).long()]

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


_TENSORS = ("offset", "albedo", "normal_map", "light", "ambient")


class HarpAvatar(Avatar):
    """A look; `found` are the poses that its fit began with, none for an avatar that was kept."""

    def __init__(self, look: Look, found: Mapping[str, Pose] = MappingProxyType({})) -> None:
        self.look, self._found = look, found

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        mesh = self.look.mesh(needed(viewpoint.pose, "pose"))
        return PosedFitted(PosedHarp(self.look, mesh, viewpoint.camera), mesh)

    @property
    def found(self) -> Mapping[str, Pose]:
        return self._found

    def baked(self, viewpoint: Viewpoint) -> Baked:
        """Raises `Unsupported` for normals in other frames than the texture's."""
        look, config = self.look, self.look.config
        if config.tangents != "uv":
            raise Unsupported("HARP's normals are in frames of its own here; fit it with tangents along the texture")
        albedo = to_linear(look.albedo, config.space).permute(1, 2, 0).clamp_min(0.0)
        rough = np.full(albedo.shape[:2], 1.0 if config.gloss is None else config.gloss)
        normal = torch.nn.functional.normalize(look.normal_map.permute(1, 2, 0), dim=2)
        mesh = look.mesh(needed(viewpoint.pose, "pose"))
        return Baked(mesh, albedo.numpy(), rough, float(config.gloss is not None), normal.numpy())

    def save(self, folder: Path) -> None:
        """Shape, displacements, textures and light; pictures of the person are not kept."""
        look, surface = self.look, self.look.surface
        state = {"shape": torch.from_numpy(np.array(look.shape, dtype=np.float64))}
        state |= {name: getattr(look, name).detach().contiguous() for name in _TENSORS}
        save_state(folder, INFO.name, asdict(look.config), {**state, "hand": as_tensor(surface.hand.name)})

    @classmethod
    def load(cls, folder: Path, config: HarpConfig) -> HarpAvatar:
        """The avatar that `save` wrote. Raises `InputError` as `load_state` does."""
        state = load_state(folder, INFO.name, asdict(config), {"hand": (None,)})
        model = hand_model(as_text(state["hand"]))
        maps = (3, config.texture, config.texture)
        shapes: dict[str, tuple[int | None, ...]] = {"shape": (model.shape_size,), "ambient": ()}
        surface = HandSurface(model, config.level)
        shapes |= {"offset": (surface.count,), "albedo": maps, "normal_map": maps, "light": (3,)}
        check_shapes(folder, state, shapes)
        return cls(Look(config, surface, state["shape"].numpy(), *(state[name] for name in _TENSORS)))


class Harp(Untaught):
    """There is no prior: all is learned of the enrolled person alone."""

    def __init__(self, config: HarpConfig) -> None:
        super().__init__(INFO, asdict(config), partial(_personalised, config), partial(HarpAvatar.load, config=config))


def _personalised(config: HarpConfig, enrolment: Recording, seed: int, progress: Progress) -> Avatar:
    """Fits the hand model (`hand.fitting`), then HARP's own stages. Raises `Unsupported` with the reason if no hand is
    found: too few key points, an empty mask, a left hand, two hands, another lens …"""
    hand = enrolled(enrolment, config.frames)
    return HarpAvatar(fitted(hand, config, seed, progress), hand.found)
