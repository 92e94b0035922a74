"""The settings of HARP: which are the authors', and which fit two cores and a minute and a half."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from handbench.light.spread import ENVIRONMENT_ERROR


@dataclass(frozen=True)
class HarpWeights:
    """What the losses weigh, as in the authors' code (`optimize_sequence.py`)."""

    silhouette: float = 7.0
    key_points: float = 10.0
    displacement: float = 2.0
    normal: float = 0.1
    laplacian: float = 4.0
    rigid: float = 0.2
    photometric: float = 1.0
    perceptual: float = 1.0
    albedo: float = 0.5
    normal_map: float = 0.1


@dataclass(frozen=True)
class HarpConfig:
    """The settings of a personalisation, and of how its result is relit.

    frames      enrolled pictures that are looked at, spread evenly; side: pixels of a crop's longer side
    supersample rays along a pixel's side: one would leave many texels to the smoothness alone
    level       of the hand's subdivision, once as in the paper
    texture     side of albedo and normal map in texels
    steps       with shape alone, with both, with appearance alone; batch: pictures a step
    rate        of Adam for shape and poses; appearance_rate for albedo, normals and light
    decay       whether the latter falls to nothing (quick fits would keep the noise of single steps)
    refresh     steps of a picture after which its rays and shadows are cast anew
    space       in which colours are multiplied: "display" as the authors' code, whose pictures are sRGB values, or
                "linear", as light adds; either way losses compare display values
    tangents    frames of the normal map: "duff", of the normal alone as in the code (so a normal map turns with the
                hand), or "uv", along the texture
    start       of light and albedo: "released" are the code's constants, "seen" come from how the pictures' brightness
                follows the normals, and from what is left of their texels without that
    unseen      texels that no picture showed: "start" leaves them, "completed" takes what was seen elsewhere
    weights     of the losses; "quick" trusts its few pictures more than smoothness
    gloss       None: relit as Lambert's; else the roughness of a specular lobe with F0 = 0.04
    """

    frames: int = 8
    side: int = 176
    supersample: int = 2
    level: int = 1
    texture: int = 128
    steps: tuple[int, int, int] = (48, 72, 120)
    batch: int = 1
    rate: float = 3e-4
    appearance_rate: float = 6e-3
    decay: bool = True
    refresh: int = 6
    shadow_size: int = 192
    space: Literal["linear", "display"] = "linear"
    tangents: Literal["uv", "duff"] = "uv"
    start: Literal["seen", "released"] = "seen"
    unseen: Literal["completed", "start"] = "completed"
    gloss: float | None = None
    environment_error: float = ENVIRONMENT_ERROR
    weights: HarpWeights = field(default_factory=lambda: HarpWeights(albedo=0.1))


PRESETS = {
    "smoke": HarpConfig(frames=2, side=96, texture=64, steps=(6, 6, 24), refresh=3, shadow_size=64),
    "quick": HarpConfig(),
    # 100 epochs a stage, of ten batches for a sequence as long as the authors'
    "released": HarpConfig(
        frames=180,
        side=448,
        supersample=1,
        texture=512,
        steps=(1000, 1000, 1000),
        batch=18,
        rate=1e-3,
        appearance_rate=1e-2,
        decay=False,
        refresh=1,
        shadow_size=448,
        space="display",
        tangents="duff",
        start="released",
        unseen="start",
        environment_error=0.0,
        weights=HarpWeights(),
    ),
}
