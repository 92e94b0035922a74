"""The floor of personalisation from pictures: their mean, whatever the light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, Recording, silent
from handbench.scene import LIGHT_KINDS

from ..kit.fittedhand import FITTABLE, FittedAvatar, fitted_hand
from ..kit.weights import load_state, save_state
from ..mean import TEXTURE, MeanAvatar
from .unwrap import unwrapped


class MeanPhone(Method):
    """The mean texture of the pictures, whatever the light: what a scan must beat."""

    info = MethodInfo(
        name="mean-phone",
        title="Mean of the pictures",
        summary="the unwrapped pictures' mean on the fitted hand, whatever the light",
        universal=True,
        needs=FITTABLE,
        role="calibration",
        lights=LIGHT_KINDS,
        fidelity="calibration: the floor",
    )

    @property
    def config(self) -> dict[str, Any]:
        return {"texture": TEXTURE}

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        return MeanPhonePrior()

    def load(self, folder: Path) -> Prior:
        load_state(folder, self.info.name, self.config)
        return MeanPhonePrior()


class MeanPhonePrior(Prior):
    """Nothing: training teaches it nothing."""

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        hand = fitted_hand(enrolment, progress=progress)
        found = unwrapped(hand, enrolment, TEXTURE)
        return FittedAvatar(hand, MeanAvatar(found.texture(found.mean)))

    def save(self, folder: Path) -> None:
        save_state(folder, MeanPhone.info.name, {"texture": TEXTURE}, {})


def create(preset: str = "quick") -> Method:
    """`mean-phone`; every preset is the same."""
    return MeanPhone()
