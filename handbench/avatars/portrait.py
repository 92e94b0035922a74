"""An avatar with all that is needed to show it, wherever it comes from."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ..errors import Unsupported
from ..method import Avatar, MethodInfo, PosedAvatar, Prior
from ..scene import Camera, Light, Viewpoint, kind_of, leaves
from .repertoire import Repertoire, same_camera


@dataclass(frozen=True, eq=False)
class Held:
    """A posed avatar, and the camera that it was last drawn for."""

    camera: Camera
    posed: PosedAvatar


@dataclass(frozen=True, eq=False)
class Portrait:
    """An avatar, the method and prior that made it, and the poses and cameras that it can be shown in.

    name        what it is called beside others: its file's name, or the method's
    preset      and `config`: how the method was made
    source      what it was made from, for people
    licence     what must be known before it is given away
    digest      of all that decides its pictures
    """

    name: str
    info: MethodInfo
    preset: str
    config: dict[str, Any]
    prior: Prior
    avatar: Avatar
    repertoire: Repertoire
    source: str
    licence: str
    digest: str

    def check(self, light: Light) -> None:
        """Raises `Unsupported` for a light that the method cannot draw."""
        for single in leaves(light):
            if kind_of(single) not in self.info.lights:
                raise Unsupported(f"{self.info.title} cannot draw {kind_of(single)} lights")

    def posed(self, viewpoint: Viewpoint, held: Held | None) -> Held:
        """The avatar before a viewpoint's camera; `held` has the same pose, None: it is posed anew."""
        if held is not None:
            if same_camera(held.camera, viewpoint.camera):
                return held
            with suppress(Unsupported):
                return Held(viewpoint.camera, held.posed.seen_by(viewpoint.camera))
        return Held(viewpoint.camera, self.avatar.pose(viewpoint))


def licence_of(hand: str | None) -> str:
    """What is to be known of an avatar in a registered hand model."""
    if hand is not None and hand.startswith("mano"):
        return (
            "The shape is MANO's, whose licence allows non-commercial research only and asks users to get the model "
            "from its authors; the pictures' rights are their owners'."
        )
    return "The hand model is CC0; what was learned from pictures has the rights of the pictures and of who they show."
