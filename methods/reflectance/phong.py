"""Phong reflectance on the tracked mesh, with fitted scales."""

from __future__ import annotations

from handbench.method import Method
from handbench.settings import UNCHANGED, Changes

from . import model as reflectance

INFO = reflectance.described("phong", "Phong", "mean texture and Phong reflectance on the tracked mesh")


def create(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """The method at a preset with changed settings."""
    return reflectance.create(INFO, "phong", preset, changes)
