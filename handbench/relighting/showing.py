"""Drawn frames as they are shown: one exposure for all of them, avatars side by side, and how much they flicker."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..evenly import evenly
from ..scene import Array
from ..scene.colour import eight_bit
from .drawing import DrawnFrames

EXPOSED = 0.8
"""The linear display value that the 99th percentile of all that is shown is brought to."""
_LOOKED_AT = 12  # frames of each portrait that decide the exposure
_STRIP = 0.075  # of a picture's height: the strip with a name
_LEAST_STRIP = 14  # pixels
_INK, _GROUND = (235, 235, 235), (24, 24, 24)


def exposure_of(frames: DrawnFrames) -> float:
    """The factor that suits all frames of all portraits: nothing that is shown changes it from frame to frame."""
    bright = []
    for frame in evenly(range(frames.count), _LOOKED_AT):
        for portrait in range(frames.portraits):
            image, alpha = frames.read(frame, portrait)
            bright.append(image[alpha > 0.5].ravel())
    values = np.concatenate(bright) if bright else np.zeros(0)
    return EXPOSED / max(float(np.percentile(values, 99)), 1e-6) if len(values) else 1.0


@dataclass(frozen=True)
class Tiles:
    """Pictures of several portraits side by side, each with its name below it; one alone has none."""

    frames: DrawnFrames
    names: Sequence[str]
    exposure: float

    def __call__(self, frame: int) -> Array:
        """A frame as shown, (H, W, 3) uint8 sRGB."""
        tiles = []
        for portrait, name in enumerate(self.names):
            image, _ = self.frames.read(frame, portrait)
            shown = eight_bit(image * np.float32(self.exposure))
            tiles.append(shown if len(self.names) == 1 else np.concatenate([shown, _strip(name, *shown.shape[:2])]))
        height = max(len(tile) for tile in tiles)
        return np.concatenate([np.pad(t, ((0, height - len(t)), (0, 0), (0, 0))) for t in tiles], axis=1)

    def all(self) -> Iterator[Array]:
        return map(self, range(self.frames.count))


@lru_cache(maxsize=64)
def _strip(name: str, height: int, width: int) -> Array:
    """A name in a strip as wide as a picture."""
    import matplotlib

    tall = max(_LEAST_STRIP, round(_STRIP * height))
    strip = Image.new("RGB", (width, tall), _GROUND)
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", 0.62 * tall)
    while len(name) > 1 and font.getlength(name) > width - 8:
        name = name[:-2] + "…"
    ImageDraw.Draw(strip).text((width / 2, tall / 2), name, _INK, font, anchor="mm")
    return np.asarray(strip)


def flicker_of(frames: DrawnFrames, portrait: int, exposure: float) -> float | None:
    """How unsteady a portrait is in time, in display values; None for fewer than four frames, or nothing shown.

    The measure is `handbench.metrics.geometry.flicker` of the frames against themselves evened out over three frames,
    since no truth is known: what changes evenly, such as shading under a light that turns, scores close to 0, and jumps
    from frame to frame count. For a hand and a camera that stand still.
    """
    from ..metrics.geometry.flicker import flicker
    from ..metrics.pair import Pair

    if frames.count < 4:
        return None
    kept = [frames.read(frame, portrait) for frame in range(3)]
    scores: list[float] = []
    before: Pair | None = None
    for frame in range(1, frames.count - 1):
        image = exposure * kept[1][0]
        even = exposure * np.mean([each for each, _ in kept], axis=0)
        pair = Pair(image, even, kept[1][1])
        if before is not None:
            value = flicker([before, pair]).value
            scores += [] if value is None else [value]
        before = pair
        if frame + 2 < frames.count:
            kept = [*kept[1:], frames.read(frame + 2, portrait)]
    return float(np.mean(scores)) if scores else None
