"""The settings of an inversion and their presets; light data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from handbench.light.spread import ENVIRONMENT_ERROR

Reflectance: TypeAlias = Literal["phong", "ggx"]
"""With what specular part the albedo is drawn."""

Space: TypeAlias = Literal["w", "w+", "pca"]
"""Where a texture is sought: one code for all layers of the generator, one for each, or its principal components."""

Start: TypeAlias = Literal["random", "mean"]
"""The code of a random person, as the seed's, or that of the mean person."""


@dataclass(frozen=True)
class HandyConfig:
    """The settings of a method of the family.

    space, start    where a texture is sought, and from where on
    prior           weight of the mean squared code, which has unit variance over people, beside the sum of all
                    pictures: one picture moves a code less than many do. The seed has none
    lit             whether pictures are drawn in their light, with shadows, where it is told. False: they show the
                    texture as it is, and what they have of shading ends in the albedo
    exposure        what is free of pictures that are drawn without their light: their brightness ("grey"), or that of
                    each channel ("colour")
    steps, rate     of Adam; the rate falls from the first value to the second
    frames, batch   how many pictures are looked at, and how many at each step
    side            pixels of a crop's longer side
    features        weight of the perceptual distance of a patch beside the mean absolute difference of display values
    gloss           roughness of "ggx"; the highlights of "phong" are as bright
    level           of the fitted hand's subdivision, where no tracked mesh is given
    environment_error   see `handbench.light.spread`
    """

    space: Space = "w"
    start: Start = "mean"
    prior: float = 2e-2
    lit: bool = True
    exposure: Literal["grey", "colour"] = "grey"
    steps: int = 300
    rate: tuple[float, float] = (5e-2, 5e-3)
    frames: int = 12
    batch: int = 3
    side: int = 192
    features: float = 0.02
    gloss: float = 0.45
    level: int = 1
    environment_error: float = ENVIRONMENT_ERROR


PRESETS = {
    "smoke": HandyConfig(steps=20, rate=(1e-1, 5e-2), frames=2, batch=1, side=96),
    "quick": HandyConfig(),
    "standard": HandyConfig(steps=1000, frames=24, side=384),
    "paper": HandyConfig(start="random", steps=5000, frames=60, batch=4, side=1024, environment_error=0.0),
    # URHand supp. Sec. 5.1: random w, nothing that holds it, and pictures "rendered with the current predicted texture"
    "seed": HandyConfig(
        start="random",
        prior=0.0,
        lit=False,
        steps=50_000,
        rate=(1e-3, 1e-3),
        frames=60,
        batch=4,
        side=1024,
        features=0.0,
        environment_error=0.0,
    ),
}
