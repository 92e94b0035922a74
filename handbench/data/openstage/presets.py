"""The sizes of the open captures, each a declared recipe with a digest."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Literal, get_args

from ...errors import unknown_name

# Raise when the generator changes what any recipe produces: captures of another version are then made anew.
GENERATOR_VERSION = 3
# The layout of a capture folder; readers refuse another one.
SCHEMA = 2

CaptureName = Literal["openstage", "openscans", "openwild", "openphone"]
"""The captures that this generator makes."""


@dataclass(frozen=True, kw_only=True)
class Preset:
    """One size of a capture.

    name            of the size
    height, width   of pictures, in pixels
    spp             samples per pixel
    truth_level     of subdivision of the surface that is traced
    skin_size       side of the skin's textures, in texels
    environment_height  of environment maps, in texels
    """

    capture: ClassVar[CaptureName]

    name: str
    height: int
    width: int
    spp: int
    truth_level: int
    skin_size: int
    environment_height: int = 128

    @property
    def recipe(self) -> str:
        """Digest of everything that determines the capture except code and rounding."""
        return recipe(self.capture, GENERATOR_VERSION, asdict(self))

    @property
    def label(self) -> str:
        return f"{self.capture} {self.name}"


def recipe(capture: str, generator: int, values: dict[str, Any]) -> str:
    """The digest of a preset's values in the hands of a version of the generator."""
    text = json.dumps({"capture": capture, "generator": generator, **values}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True)
class StagePreset(Preset):
    """One size of the light stage.

    Counts of subjects, poses (train and held-out segment), cameras, one-light-at-a-time directions (the last
    `held_out_lights` are meant never to be trained on); `tracked_level` of subdivision of tracked meshes.
    """

    capture: ClassVar[CaptureName] = "openstage"

    subjects: int
    train_poses: int
    held_out_poses: int
    cameras: tuple[str, ...]
    lights: int
    held_out_lights: int
    environments: tuple[str, ...]
    tracked_level: int = 1


@dataclass(frozen=True, kw_only=True)
class ScansPreset(Preset):
    """One size of the scans: subjects, poses of each, cameras, and the level of subdivision of the scanned meshes."""

    capture: ClassVar[CaptureName] = "openscans"

    subjects: int
    poses: int
    cameras: tuple[str, ...]
    scan_level: int = 2


@dataclass(frozen=True, kw_only=True)
class WildPreset(Preset):
    """One size of hands in the wild: a sequence of each subject, its moments, and those that come later.

    Every `every`-th moment is also shown by other cameras and in other light.
    """

    capture: ClassVar[CaptureName] = "openwild"

    subjects: int
    moments: int
    later: int
    every: int


@dataclass(frozen=True, kw_only=True)
class PhonePreset(Preset):
    """One size of the scans by phone: subjects, moments of a turn of the hand, and new poses in known light."""

    capture: ClassVar[CaptureName] = "openphone"

    subjects: int
    moments: int
    poses: int


_THREE = ("dorsal", "palmar", "oblique")
_ALL = ("dorsal", "palmar", "oblique", "radial", "ulnar", "fingertip")
_SIX = ("brightday", "park", "streetlamp", "nightlights", "hall", "pillars")
_TEN = (*_SIX, "crossroads", "park2", "konzerthaus", "default")


_MINI = StagePreset(
    name="mini",
    subjects=2,
    train_poses=2,
    held_out_poses=1,
    cameras=("dorsal", "palmar"),
    lights=8,
    held_out_lights=2,
    environments=("brightday", "hall"),
    height=128,
    width=96,
    spp=128,
    truth_level=2,
    skin_size=512,
    environment_height=32,
)
_QUICK = StagePreset(
    name="quick",
    subjects=6,
    train_poses=4,
    held_out_poses=2,
    cameras=_THREE,
    lights=24,
    held_out_lights=6,
    environments=_SIX,
    height=256,
    width=192,
    spp=96,
    truth_level=3,
    skin_size=1024,
)
# quick with five times the lights: a few lights at a time are far from the whole stage, as on URHand's 350
_DENSE = replace(_QUICK, name="dense", lights=120, held_out_lights=20)
_STANDARD = StagePreset(
    name="standard",
    subjects=12,
    train_poses=8,
    held_out_poses=4,
    cameras=_ALL,
    lights=60,
    held_out_lights=12,
    environments=_TEN,
    height=512,
    width=384,
    spp=192,
    truth_level=3,
    skin_size=2048,
    environment_height=256,
)
_FULL = replace(
    _STANDARD,
    name="full",
    subjects=24,
    train_poses=16,
    held_out_poses=8,
    lights=150,
    held_out_lights=30,
    height=1024,
    width=768,
    spp=256,
    truth_level=4,
    skin_size=4096,
)

_EIGHT = (*_ALL, "back-ulnar", "palm-radial")
_SMALL: dict[str, Any] = {"height": 64, "width": 48, "spp": 48, "truth_level": 1, "skin_size": 256}
_SMALL |= {"environment_height": 32}
_MEDIUM: dict[str, Any] = {"height": 256, "width": 192, "spp": 48, "truth_level": 2, "skin_size": 1024}
_LARGE: dict[str, Any] = {"height": 512, "width": 384, "spp": 144, "truth_level": 3, "skin_size": 2048}
_SCANS = (
    ScansPreset(name="mini", subjects=2, poses=2, cameras=("dorsal", "palmar"), scan_level=1, **_SMALL),
    ScansPreset(name="quick", subjects=24, poses=6, cameras=_EIGHT, **_MEDIUM | {"height": 192, "width": 144}),
    ScansPreset(name="standard", subjects=48, poses=6, cameras=_EIGHT, **_LARGE),
)
_WILD = (
    WildPreset(name="mini", subjects=2, moments=3, later=1, every=2, **_SMALL),
    WildPreset(name="quick", subjects=12, moments=21, later=6, every=5, **_MEDIUM),
    WildPreset(name="standard", subjects=24, moments=31, later=9, every=5, **_LARGE),
)
_PHONE = (
    PhonePreset(name="mini", subjects=2, moments=4, poses=1, **_SMALL),
    PhonePreset(name="quick", subjects=4, moments=60, poses=4, **_MEDIUM),
    PhonePreset(name="standard", subjects=8, moments=60, poses=8, **_LARGE),
)
PRESETS: dict[CaptureName, dict[str, Preset]] = {
    "openstage": {preset.name: preset for preset in (_MINI, _QUICK, _DENSE, _STANDARD, _FULL)},
    "openscans": {preset.name: preset for preset in _SCANS},
    "openwild": {preset.name: preset for preset in _WILD},
    "openphone": {preset.name: preset for preset in _PHONE},
}
assert tuple(PRESETS) == get_args(CaptureName)


def preset(size: str, capture: CaptureName = "openstage") -> Preset:
    """The preset of a size; `InputError` with the closest names for an unknown one."""
    if size not in PRESETS[capture]:
        raise unknown_name(f"{capture} size", size, PRESETS[capture])
    return PRESETS[capture][size]
