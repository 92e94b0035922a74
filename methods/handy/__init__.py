"""Inversion of a generator of textures in the manner of Handy: an albedo from pictures, lit as Phong's or as GGX's."""

from __future__ import annotations

from typing import get_args

from handbench.errors import unknown_name
from handbench.method import Method
from handbench.settings import UNCHANGED, Changes, changed


def create(preset: str = "quick", reflectance: str = "ggx", changes: Changes = UNCHANGED) -> Method:
    """The method at a preset, "quick", "standard", "paper", "seed", "smoke", with a reflectance, "phong" or "ggx", and
    with changed settings.

    Raises `InputError` for others.
    """
    from .config import PRESETS, Reflectance
    from .method import Handy

    if preset not in PRESETS:
        raise unknown_name(f"preset of handy-{reflectance}", preset, PRESETS)
    if reflectance not in get_args(Reflectance):
        raise unknown_name("reflectance", reflectance, get_args(Reflectance))
    config = changed(PRESETS[preset], changes, f"handy-{reflectance}")
    return Handy(reflectance, config)  # type: ignore[arg-type]
