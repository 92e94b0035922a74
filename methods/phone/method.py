"""Personalisation from a scan in unknown light (URHand supp. Sec. 3), behind the one interface.

The hand is fitted to the enrolment's pictures, their colours are unwrapped, and the light in them is taken out: what is
left is the texture that a universal prior, trained on the light stage, relights without fine-tuning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, assert_never

import torch
from torch import Tensor

from handbench.errors import unknown_name
from handbench.hand.fitting import QUICK, THOROUGH, FittingSettings
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.posed import PosedSurface
from handbench.scene import KNOWN_LIGHTS, LIGHT_KINDS, Baked, Camera, Light, Prediction, Unknown, Viewpoint, needed
from handbench.settings import UNCHANGED, Changes, changed, parted

from ..kit.fittedhand import FITTABLE, FittedAvatar, FittedHand, fitted_hand
from ..kit.picture import prediction
from ..kit.weights import load_state, save_state
from ..reflectance import physical
from ..reflectance.model import ReflectanceAvatar, ReflectancePrior
from ..urhand import method as urhand
from .joint import Decomposed, decomposed
from .shadow import shadow
from .unwrap import Unwrapped, unwrapped
from .usual import Assumed, Usual

Removal: TypeAlias = Literal["shadow", "joint"]
_OWN = "own light"  # of a kept avatar
_REFERENCE = 1024  # texels a side for which the weight of a shadow's variation is told


@dataclass(frozen=True)
class PhoneConfig:
    """The settings of a personalisation.

    removal         how light is taken out: "shadow", the seed's way, or "joint" (see `shadow.py`, `joint.py`)
    assumed         what is taken to be usual of light times albedo, see `Usual.normalised`
    variation       weight of a shadow's squared variation for textures of 1024 x 1024; of smaller ones it is less, for
                    the same blur on the skin
    shadow_most     most light that a shadow can be, of the mean; None: as bright as it comes
    rounds          of the joint solution
    thorough        whether the hand is fitted with more starts and steps
    """

    removal: Removal = "shadow"
    assumed: Assumed = "light"
    variation: float = 100.0
    shadow_most: float | None = None
    rounds: int = 8
    thorough: bool = False

    @property
    def fitting(self) -> FittingSettings:
        return THOROUGH if self.thorough else QUICK


def unlit(found: Unwrapped, config: PhoneConfig) -> tuple[Tensor, Decomposed | None]:
    """The texture (3, R, R) of unwrapped pictures without their light, as bright as they are, and the light if it was
    solved for."""
    match config.removal:
        case "shadow":
            blur = config.variation * (found.atlas.size / _REFERENCE) ** 2
            dark = shadow(found.mean, found.seen, found.foreground, found.atlas, blur, config.shadow_most)
            return found.texture(found.mean / dark), None
        case "joint":
            solved = decomposed(found.pictures, found.mean, found.foreground, config.rounds)
            return found.texture(solved.colour), solved
        case _:
            assert_never(config.removal)


Made: TypeAlias = Callable[[Prior, Tensor], Avatar]
"""The avatar of a prior and a normalised texture (3, R, R)."""


class PhonePrior(Prior):
    """What another method learned, and what is usual where it did."""

    def __init__(self, inner: Prior, usual: Usual, kind: PhoneKind, config: PhoneConfig, size: int) -> None:
        self.inner, self.usual = inner, usual
        self._kind, self._config, self._size = kind, config, size

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        """Raises `Unsupported`, with the reason, if no hand can be fitted to the pictures."""
        hand = fitted_hand(enrolment, self._config.fitting, progress=progress)
        found = unwrapped(hand, enrolment, self._size)
        texture, solved = unlit(found, self._config)
        avatar = self._kind.made(self.inner, self.usual.normalised(texture, self._config.assumed))
        if solved is not None:
            avatar = UnderOwnLight(avatar, found.atlas.gather(texture), solved, found.atlas)
        return FittedAvatar(hand, avatar)

    def save(self, folder: Path) -> None:
        (folder / "inner").mkdir()
        self.inner.save(folder / "inner")
        told = {"light": torch.tensor(self.usual.light, dtype=torch.float64), "skin": self.usual.skin}
        save_state(folder, self._kind.info.name, asdict(self._config), told)

    def restore(self, folder: Path) -> Avatar:
        return FittedAvatar.load(folder, self._restored)

    def _restored(self, folder: Path, hand: FittedHand) -> Avatar:
        if self._config.removal == "shadow":
            return self.inner.restore(folder)
        return UnderOwnLight.load(folder, self.inner.restore, hand.atlas(self._size))


class UnderOwnLight(Avatar):
    """An avatar that, asked for the light as enrolled, answers with the light that it found in the pictures."""

    def __init__(self, inner: Avatar, colour: Tensor, solved: Decomposed, atlas: Atlas) -> None:
        self._inner, self._colour, self._solved, self._atlas = inner, colour, solved, atlas

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        surface = PosedSurface(needed(viewpoint.mesh, "mesh"), self._atlas.size)
        shading = torch.from_numpy(self._solved.shading(surface.normal.T.numpy())).float()
        texture = self._atlas.dilate(self._atlas.scatter(self._colour * shading))
        return PosedUnderOwnLight(self._inner.pose(viewpoint), surface.mesh, texture, viewpoint.camera)

    def baked(self, viewpoint: Viewpoint) -> Baked:
        return self._inner.baked(viewpoint)

    def save(self, folder: Path) -> None:
        solved = {"colour": self._solved.colour, "light": self._solved.light}
        state = {name: torch.from_numpy(values.copy()) for name, values in solved.items()}
        save_state(folder, _OWN, {"texture": self._atlas.size}, {**state, "shown": self._colour.contiguous()})
        (folder / "relit").mkdir()
        self._inner.save(folder / "relit")

    @classmethod
    def load(cls, folder: Path, inner: Callable[[Path], Avatar], atlas: Atlas) -> UnderOwnLight:
        """The avatar that `save` wrote, on an atlas; `inner` reads the one that relights."""
        texels = (3, atlas.count)
        state = load_state(folder, _OWN, {"texture": atlas.size}, {"colour": texels, "shown": texels, "light": (9, 3)})
        solved = Decomposed(state["colour"].numpy(), state["light"].numpy())
        return cls(inner(folder / "relit"), state["shown"], solved, atlas)


class PosedUnderOwnLight(PosedAvatar):
    """A posed avatar, and its mesh with the texture (3, R, R) that it has in its own light."""

    def __init__(self, inner: PosedAvatar, mesh: PosedMesh, texture: Tensor, camera: Camera) -> None:
        self._inner, self._mesh, self._texture = inner, mesh, texture
        self._own = prediction(rasterise(mesh, camera), texture)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedUnderOwnLight(self._inner.seen_by(camera), self._mesh, self._texture, camera)

    def relight(self, light: Light) -> Prediction:
        return self._own if isinstance(light, Unknown) else self._inner.relight(light)


@dataclass(frozen=True)
class PhoneKind:
    """A method of the family: what it says of itself, the method that relights, and how it takes a texture."""

    info: MethodInfo
    create: Callable[[str, Changes], Method]
    made: Made


def _urhand(prior: Prior, texture: Tensor) -> Avatar:
    assert isinstance(prior, urhand.URHandPrior)
    return urhand.URHandAvatar(prior.model, texture)


def _physical(prior: Prior, texture: Tensor) -> Avatar:
    assert isinstance(prior, ReflectancePrior)
    return ReflectanceAvatar(texture, prior)


URHAND = PhoneKind(
    MethodInfo(
        name="urhand-phone",
        title="URHand from a phone",
        summary="URHand personalised from a scan in unknown light: fit, unwrap, shadow divided out; no fine-tuning",
        universal=True,
        needs=FITTABLE,
        trains_on=urhand.INFO.trains_on,
        linear=True,
        lights=KNOWN_LIGHTS,
        fidelity="reimplementation of URHand's supplement, Sec. 3; trained here on open data",
    ),
    lambda preset, changes: urhand.create(preset, changes=changes),
    _urhand,
)
HARMONIC = PhoneKind(
    MethodInfo(
        name="sh-phone",
        title="SH light, physical BRDF",
        summary="one world-fixed spherical-harmonic light and the albedo solved together; rendered as physical is",
        universal=True,
        needs=FITTABLE,
        trains_on=physical.INFO.trains_on,
        linear=True,
        lights=LIGHT_KINDS,
        fidelity="reference: no learned network",
    ),
    # the physical BRDF has no smaller preset than its quick one
    lambda preset, changes: physical.create("quick" if preset == "smoke" else preset, changes),
    _physical,
)


class FromPhone(Method):
    """A method of the family. Its configuration is its own and that of the method that relights."""

    def __init__(self, kind: PhoneKind, config: PhoneConfig, inner: Method) -> None:
        self.info, self._kind, self._config, self._inner = kind.info, kind, config, inner

    @property
    def config(self) -> dict[str, Any]:
        return {"phone": asdict(self._config), "method": self._inner.config}

    @property
    def _size(self) -> int:
        return int(self._inner.config["texture"])

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        usual = Usual.of(recording, self._size)
        return self._prior(self._inner.train(recording, seed, progress), usual)

    def load(self, folder: Path) -> Prior:
        state = load_state(folder, self.info.name, asdict(self._config))
        return self._prior(self._inner.load(folder / "inner"), Usual(float(state["light"]), state["skin"]))

    def _prior(self, inner: Prior, usual: Usual) -> PhonePrior:
        return PhonePrior(inner, usual, self._kind, self._config, self._size)


PRESETS: dict[str, dict[str, Any]] = {
    "smoke": {},
    "quick": {},
    "standard": {},
    "paper": {"thorough": True},
}


def _config(name: str, preset: str, **changes: Any) -> PhoneConfig:
    if preset not in PRESETS:
        raise unknown_name(f"preset of {name}", preset, PRESETS)
    return PhoneConfig(**PRESETS[preset], **changes)


def create_urhand(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """`urhand-phone` at a preset with changed settings; `InputError` for unknown ones."""
    return _created(URHAND, _config("urhand-phone", preset), preset, changes)


def create_harmonic(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """`sh-phone` at a preset with changed settings; `InputError` for unknown ones."""
    return _created(HARMONIC, _config("sh-phone", preset, removal="joint"), preset, changes)


def _created(kind: PhoneKind, config: PhoneConfig, preset: str, changes: Changes) -> Method:
    name = kind.info.name
    own, of_method = parted(changes, ("phone", "method"), name)
    return FromPhone(kind, changed(config, own, name), kind.create(preset, of_method))
