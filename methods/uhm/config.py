"""The settings of the UHM-style adaptation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from handbench.light.spread import ENVIRONMENT_ERROR


@dataclass(frozen=True)
class UhmWeights:
    """What the losses weigh: L1 and perceptual ones of pictures, the shadows' distance from none, and squared total
    variation at 1,024 texels a side; in the refinement L1 and perceptual ones weigh ten times as much."""

    photometric: float = 1.0
    perceptual: float = 1.0
    bright: float = 0.1
    variation: float = 100.0
    refined: float = 10.0


@dataclass(frozen=True)
class UhmConfig:
    """The settings of an adaptation, and of how its texture is relit.

    frames      enrolled pictures that are looked at, spread evenly; side: pixels of a crop's longer side
    level       of the hand's subdivision; texture: side of the texture and of shadow maps in texels
    shadow_steps, shadow_rate   of Adam for the shadow maps; refine_steps, refine_rate: for the
                texture, whose rate falls by the share `decay` in a straight line
    space       in which shadows multiply: "display" as UHM, whose pictures are sRGB values, or "linear", as light adds
    gloss       None: relit as Lambert's; else the roughness of a specular lobe with F0 = 0.04
    """

    frames: int = 8
    side: int = 176
    level: int = 1
    texture: int = 192
    shadow_steps: int = 60
    shadow_rate: float = 5e-2
    refine_steps: int = 120
    refine_rate: float = 4e-3
    decay: float = 1.0
    space: Literal["linear", "display"] = "linear"
    gloss: float | None = None
    environment_error: float = ENVIRONMENT_ERROR
    weights: UhmWeights = field(default_factory=UhmWeights)


_PAPER = UhmConfig(
    frames=60,
    side=448,
    texture=1024,
    shadow_steps=1500,
    shadow_rate=1e-2,
    refine_steps=1500,
    refine_rate=1e-2,
    decay=0.0,
    space="display",
    environment_error=0.0,
)
PRESETS = {
    "smoke": UhmConfig(frames=2, side=96, texture=64, shadow_steps=12, shadow_rate=0.1, refine_steps=12),
    "quick": UhmConfig(),
    "paper": _PAPER,
    # the code sets the texture's rate to the networks' 1e-5 at every epoch, so its textures hardly move
    "released": replace(_PAPER, refine_rate=1e-5),
}
