"""HARP: a personalised, relightable hand from pictures under one light that nobody measured."""

from __future__ import annotations

from handbench.errors import unknown_name
from handbench.method import Method
from handbench.settings import UNCHANGED, Changes, changed


def create(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """The method at a preset, "quick", "released" (the authors' constants) or "smoke", with changed settings;
    `InputError` for others."""
    from .config import PRESETS
    from .method import Harp

    if preset not in PRESETS:
        raise unknown_name("preset of harp", preset, PRESETS)
    return Harp(changed(PRESETS[preset], changes, "harp"))
