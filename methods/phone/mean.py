"""The floor of personalisation from pictures: their mean, whatever the light."""

from __future__ import annotations

from handbench.method import Avatar, Method, MethodInfo, Progress, Recording
from handbench.scene import LIGHT_KINDS

from ..kit.fittedhand import FITTABLE, FittedAvatar, fitted_hand
from ..kit.untaught import Untaught
from ..mean import TEXTURE, MeanAvatar
from .unwrap import unwrapped

INFO = MethodInfo(
    name="mean-phone",
    title="Mean of the pictures",
    summary="the unwrapped pictures' mean on the fitted hand, whatever the light",
    universal=True,
    needs=FITTABLE,
    role="calibration",
    lights=LIGHT_KINDS,
    fidelity="calibration: the floor",
)


def _personalised(enrolment: Recording, seed: int, progress: Progress) -> Avatar:
    """The mean texture of the pictures, whatever the light: what a scan must beat."""
    hand = fitted_hand(enrolment, progress=progress)
    found = unwrapped(hand, enrolment, TEXTURE)
    return FittedAvatar(hand, MeanAvatar(found.texture(found.mean)))


def create(preset: str = "quick") -> Method:
    """`mean-phone`; every preset is the same."""
    return Untaught(
        INFO,
        {"texture": TEXTURE},
        _personalised,
        lambda folder: FittedAvatar.load(folder, lambda at, hand: MeanAvatar.load(at)),
    )
