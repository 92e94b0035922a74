"""UHM-style adaptation (Moon et al., CVPR 2024) behind the one interface, without UHM's own hand model."""

from __future__ import annotations

from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch

from handbench.hand import hand_model
from handbench.method import Avatar, MethodInfo, PosedAvatar, Progress, Recording
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.posed import PosedSurface
from handbench.scene import LIGHT_KINDS, Baked, Camera, Light, Mesh, Pose, Prediction, Unknown, Viewpoint, needed

from ..kit.albedo import Canvas
from ..kit.colourspace import to_linear
from ..kit.enrolled import Enrolled, enrolled
from ..kit.fittedhand import PosedFitted
from ..kit.untaught import Untaught
from ..kit.weights import as_tensor, as_text, check_shapes, load_state, save_state
from .adaptation import Adapted, adapted
from .config import UhmConfig
from .shading import Shadowing

INFO = MethodInfo(
    name="uhm",
    title="UHM-style",
    summary="fitted hand, shadow maps of every picture, a texture without them, refined; relit as an albedo",
    universal=True,
    linear=True,
    needs=frozenset({"image", "alpha", "camera", "keypoints"}),
    lights=LIGHT_KINDS,
    fidelity="reimplementation in the style of UHM's adaptation on another hand model; no prior, no network of theirs",
)


class PosedUhm(PosedAvatar):
    """The textured hand in a pose, and what a camera sees of it."""

    def __init__(self, avatar: UhmAvatar, mesh: Mesh | PosedSurface, camera: Camera) -> None:
        self._avatar, person = avatar, avatar.person
        self._canvas = Canvas(mesh, camera, person.config.texture)
        self._texels = torch.from_numpy(self._canvas.texels)
        self._texture = person.texture[:, self._texels]

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedUhm(self._avatar, self._canvas.surface, camera)

    @torch.no_grad()
    def relight(self, light: Light) -> Prediction:
        """Under a known light the texture is an albedo; under an unknown one it has the shadow of its pose.

        UHM has no reflectance and tells no way to relight it. Assumed here: its texture, which is what a picture would
        be without shadow, is pi times what a diffuse surface of that albedo sends back under unit irradiance.
        """
        config = self._avatar.person.config
        if isinstance(light, Unknown):
            shadow = self._avatar.shadowing.at(self._canvas.normal.T, self._texels)
            return self._canvas.drawn(to_linear(self._texture * shadow, config.space))
        albedo = to_linear(self._texture, config.space)
        return self._canvas.lit(light, albedo, None, config.gloss, config.environment_error)


class UhmAvatar(Avatar):
    def __init__(self, person: Adapted) -> None:
        self.person = person

    @cached_property
    def shadowing(self) -> Shadowing:
        """The shadows of poses under the light as enrolled."""
        return Shadowing(self.person.shadows, self.person.normals, self.person.seen)

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        mesh = self.person.mesh(needed(viewpoint.pose, "pose"))
        return PosedFitted(PosedUhm(self, mesh, viewpoint.camera), mesh)

    @property
    def found(self) -> dict[str, Pose]:
        return self.person.hand.found

    def baked(self, viewpoint: Viewpoint) -> Baked:
        config, mesh = self.person.config, self.person.mesh(needed(viewpoint.pose, "pose"))
        atlas = Atlas.of(mesh.topology, config.texture)
        albedo = atlas.dilate(atlas.scatter(to_linear(self.person.texture, config.space))).permute(1, 2, 0)
        rough = np.full(albedo.shape[:2], 1.0 if config.gloss is None else config.gloss)
        return Baked(mesh, albedo.clamp_min(0.0).numpy(), rough, float(config.gloss is not None))

    def save(self, folder: Path) -> None:
        """The hand and its textures; pictures of the person are not kept."""
        person, hand = self.person, self.person.hand
        state = {"shape": torch.from_numpy(np.array(hand.shape, dtype=np.float64))}
        state |= {name: getattr(person, name).contiguous() for name in ("texture", "shadows", "normals", "seen")}
        save_state(folder, INFO.name, asdict(person.config), {**state, "hand": as_tensor(hand.hand.name)})

    @classmethod
    def load(cls, folder: Path, config: UhmConfig) -> UhmAvatar:
        """The avatar that `save` wrote. Raises `InputError` as `load_state` does."""
        state = load_state(folder, INFO.name, asdict(config), {"hand": (None,)})
        model = hand_model(as_text(state["hand"]))
        texels = Atlas.of(model.topology(min(config.level, model.levels)), config.texture).count
        shapes = {"shape": (model.shape_size,), "texture": (3, texels), "shadows": (None, texels)}
        shapes |= {"normals": (None, texels, 3), "seen": (None, texels)}
        check_shapes(folder, state, shapes)
        hand = Enrolled(model, state["shape"].numpy(), ())
        return cls(Adapted(config, hand, *(state[name] for name in ("texture", "shadows", "normals", "seen"))))


class Uhm(Untaught):
    """There is no prior: the hand model brings the shapes, the rest is of the enrolled person alone."""

    def __init__(self, config: UhmConfig) -> None:
        super().__init__(INFO, asdict(config), partial(_personalised, config), partial(UhmAvatar.load, config=config))


def _personalised(config: UhmConfig, enrolment: Recording, seed: int, progress: Progress) -> Avatar:
    """Fits the hand model (`hand.fitting`: key points 1, mask 50, depth 100), then shadows and texture.

    Raises `Unsupported` with the fit's reason if no hand is found.
    """
    return UhmAvatar(adapted(enrolled(enrolment, config.frames), config, seed, progress))
