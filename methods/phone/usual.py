"""What is assumed where pictures tell only light times albedo: that the light, or the skin, is as usual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, assert_never

import torch
from torch import Tensor

from handbench.method import Recording

from ..reflectance.model import full_exposure, normalised_texture

Assumed: TypeAlias = Literal["light", "skin"]


@dataclass(frozen=True)
class Usual:
    """The mean diffuse feature of the training's fully lit hands, and the mean (3,) of their normalised textures."""

    light: float
    skin: Tensor

    @staticmethod
    def of(recording: Recording, size: int) -> Usual:
        """What training shows, at textures of size x size."""
        each = [recording.of_subject(subject) for subject in recording.subjects]
        light = [full_exposure(one, size) for one in each]
        skin = [normalised_texture(one, size).mean(dim=(1, 2)) for one in each]
        return Usual(sum(light) / len(light), torch.stack(skin).mean(dim=0))

    def normalised(self, texture: Tensor, assumed: Assumed) -> Tensor:
        """A texture (3, R, R) as lit in its pictures, over the light that is assumed: an albedo over pi.

        "light": the pictures' mean light is white and as bright as the training's, as a camera's exposure and white
        balance make it. "skin": the mean colour is that of the training's people, whoever this is.
        """
        match assumed:
            case "light":
                return texture / self.light
            case "skin":
                return texture * (self.skin / texture.mean(dim=(1, 2)).clamp_min(1e-6))[:, None, None]
            case _:
                assert_never(assumed)
