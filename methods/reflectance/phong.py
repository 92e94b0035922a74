"""Phong reflectance on the tracked mesh, with fitted scales."""

from __future__ import annotations

from handbench.method import Method

from . import model as reflectance

INFO = reflectance.described("phong", "Phong", "mean texture and Phong reflectance on the tracked mesh")


def create(preset: str = "quick") -> Method:
    """The method at a preset."""
    return reflectance.create(INFO, "phong", preset)
