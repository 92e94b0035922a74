"""The quality knobs of the core, and which of their settings a study tries."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

Lights: TypeAlias = int | tuple[int, int]
Shadows: TypeAlias = Literal["hard", "soft", "none"]
Precision: TypeAlias = Literal["float32", "float64", "bfloat16"]


@dataclass(frozen=True)
class Configuration:
    """texture: side in texels; lights: a grid (rows, columns) over the map, or as many clustered lights; supersample:
    rays along a pixel's side; the rest as named."""

    texture: int = 128
    lights: Lights = 64
    shadows: Shadows = "hard"
    precision: Precision = "float32"
    skips: bool = True
    supersample: int = 2

    @property
    def label(self) -> str:
        lights = f"{self.lights} lights" if isinstance(self.lights, int) else "{}x{} grid".format(*self.lights)
        parts = [f"{self.texture}^2", lights, f"{self.supersample}x{self.supersample} samples"]
        parts += [] if self.shadows == "hard" else [f"{self.shadows} shadows"]
        parts += [] if self.precision == "float32" else [self.precision]
        return ", ".join(parts + ([] if self.skips else ["no skips"]))


Sweep: TypeAlias = list[tuple[str, Configuration]]


def new_pose_sweep(quick: bool) -> Sweep:
    """Settings for a new pose, each with the knob it belongs to."""
    base = Configuration()
    counts = (4, 16, 64, 256) if quick else (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)
    textures = (64, 96, 192, 384) if quick else (64, 96, 192, 256, 384, 512)
    grids = ((16, 32),) if quick else ((8, 16), (16, 32), (32, 64))
    sweep: Sweep = [("lights", replace(base, lights=count)) for count in counts]
    sweep += [("lights", replace(base, texture=96, lights=count, supersample=1)) for count in (4, 8, 16, 32)]
    sweep += [("lights", replace(base, texture=192, lights=count)) for count in (32, 128)]
    sweep += [("texture", replace(base, texture=texture)) for texture in textures]
    sweep += [("texture", replace(base, texture=64, supersample=1, lights=16))]
    sweep += [("texture", replace(base, texture=texture, lights=256, supersample=3)) for texture in (384, 512)]
    sweep += [("supersampling", replace(base, supersample=n)) for n in (1, 3)]
    sweep += [("grid", replace(base, lights=grid)) for grid in grids]
    sweep += [("shadows", replace(base, shadows=kind)) for kind in ("soft", "none")]
    sweep += [("precision", replace(base, precision=kind)) for kind in ("float64", "bfloat16")]
    sweep += [("skips", replace(base, skips=False))]
    return list({configuration: (knob, configuration) for knob, configuration in sweep}.values())


def known_pose_sweep(quick: bool) -> Sweep:
    """Settings for a known pose: its transfer is kept for a grid of directions, so any map can be put on it."""
    base = Configuration(lights=(16, 32))
    textures = (64, 128) if quick else (64, 96, 128, 192, 256)
    sweep: Sweep = [("texture", replace(base, texture=texture)) for texture in textures]
    sweep += [("grid", replace(base, lights=grid)) for grid in ((8, 16), (32, 64))]
    if not quick:
        sweep += [("grid", replace(base, texture=192, lights=(32, 64)))]
        sweep += [("shadows", replace(base, shadows=kind)) for kind in ("soft", "none")]
        sweep += [("precision", replace(base, precision=kind)) for kind in ("float64", "bfloat16")]
    return sweep
