"""Inversion of a generator of textures in the manner of Handy: an albedo from pictures, lit as Phong's or as GGX's."""

from __future__ import annotations

from typing import TYPE_CHECKING

from handbench.errors import unknown_name
from handbench.method import Method
from handbench.settings import UNCHANGED, Changes, changed

if TYPE_CHECKING:
    from .config import Reflectance


def create_phong(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """`handy-phong` at a preset, "quick", "standard", "paper", "seed" or "smoke", with changed settings; `InputError`
    for others."""
    return _create("phong", preset, changes)


def create_ggx(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """`handy-ggx` at one of the same presets, with changed settings; `InputError` for others."""
    return _create("ggx", preset, changes)


def _create(reflectance: Reflectance, preset: str, changes: Changes) -> Method:
    from .config import PRESETS
    from .method import Handy

    name = f"handy-{reflectance}"
    if preset not in PRESETS:
        raise unknown_name(f"preset of {name}", preset, PRESETS)
    return Handy(reflectance, changed(PRESETS[preset], changes, name))
