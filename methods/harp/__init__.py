"""HARP: a personalised, relightable hand from pictures under one light that nobody measured."""

from __future__ import annotations

from handbench.errors import unknown_name
from handbench.method import Method


def create(preset: str = "quick") -> Method:
    """The method at a preset: "quick", "released" (the authors' constants), "smoke"; `InputError` for others."""
    from .config import PRESETS
    from .method import Harp

    if preset not in PRESETS:
        raise unknown_name("preset of harp", preset, PRESETS)
    return Harp(PRESETS[preset])
