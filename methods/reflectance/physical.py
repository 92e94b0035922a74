"""The parametric BRDF of URHand (supp. Eqs. 1-6) on the tracked mesh, with one fitted roughness."""

from __future__ import annotations

from handbench.method import Method
from handbench.settings import UNCHANGED, Changes

from . import model as reflectance

INFO = reflectance.described("physical", "Physical BRDF", "mean texture and the parametric BRDF on the tracked mesh")


def create(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """The method at a preset with changed settings."""
    return reflectance.create(INFO, "brdf", preset, changes)
