"""UHM-style adaptation: a shadow-free texture on a fitted hand, from pictures under one light that nobody measured."""

from __future__ import annotations

from handbench.errors import unknown_name
from handbench.method import Method
from handbench.settings import UNCHANGED, Changes, changed


def create(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """The method at a preset, "quick", "paper", "released" (textures hardly move) or "smoke", with changed settings;
    `InputError` for others."""
    from .config import PRESETS
    from .method import Uhm

    if preset not in PRESETS:
        raise unknown_name("preset of uhm", preset, PRESETS)
    return Uhm(changed(PRESETS[preset], changes, "uhm"))
