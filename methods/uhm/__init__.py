"""UHM-style adaptation: a shadow-free texture on a fitted hand, from pictures under one light that nobody measured."""

from __future__ import annotations

from handbench.errors import unknown_name
from handbench.method import Method


def create(preset: str = "quick") -> Method:
    """The method at a preset: "quick", "paper", "released" (textures hardly move), "smoke"; `InputError` for others."""
    from .config import PRESETS
    from .method import Uhm

    if preset not in PRESETS:
        raise unknown_name("preset of uhm", preset, PRESETS)
    return Uhm(PRESETS[preset])
