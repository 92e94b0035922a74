"""The sizes of the open light stage, each a declared recipe with a digest."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass

from ...errors import unknown_name

# Raise when the generator changes what any recipe produces: captures of another version are then made anew.
GENERATOR_VERSION = 3
# The layout of a capture folder; readers refuse another one.
SCHEMA = 1


@dataclass(frozen=True)
class Preset:
    """One size of the open light stage.

    Counts of subjects, poses (train and held-out segment), cameras, one-light-at-a-time directions (the last
    `held_out_lights` are meant never to be trained on); image height and width in pixels; samples per pixel;
    subdivision levels of the truth and of the tracked mesh; side of the skin textures in texels.
    """

    name: str
    subjects: int
    train_poses: int
    held_out_poses: int
    cameras: tuple[str, ...]
    lights: int
    held_out_lights: int
    environments: tuple[str, ...]
    height: int
    width: int
    spp: int
    truth_level: int
    tracked_level: int
    skin_size: int
    environment_height: int = 128

    @property
    def recipe(self) -> str:
        """Digest of everything that determines the capture except code and rounding."""
        text = json.dumps({"generator": GENERATOR_VERSION, **asdict(self)}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


_THREE = ("dorsal", "palmar", "oblique")
_ALL = ("dorsal", "palmar", "oblique", "radial", "ulnar", "fingertip")
_SIX = ("brightday", "park", "streetlamp", "nightlights", "hall", "pillars")
_TEN = (*_SIX, "crossroads", "park2", "konzerthaus", "default")

PRESETS: dict[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset("mini", 2, 2, 1, ("dorsal", "palmar"), 8, 2, ("brightday", "hall"), 128, 96, 128, 2, 1, 512, 32),
        Preset("quick", 6, 4, 2, _THREE, 24, 6, _SIX, 256, 192, 96, 3, 1, 1024),
        # quick with five times the lights: a few lights at a time are far from the whole stage, as on URHand's 350
        Preset("dense", 6, 4, 2, _THREE, 120, 20, _SIX, 256, 192, 96, 3, 1, 1024),
        Preset("standard", 12, 8, 4, _ALL, 60, 12, _TEN, 512, 384, 128, 3, 1, 2048, 256),
        Preset("full", 24, 16, 8, _ALL, 150, 30, _TEN, 1024, 768, 256, 4, 1, 4096, 256),
    )
}


def preset(size: str) -> Preset:
    """The preset of a size; `InputError` with the closest names for an unknown one."""
    if size not in PRESETS:
        raise unknown_name("openstage size", size, PRESETS)
    return PRESETS[size]
