"""PALM-Net: an implicit, physically based hand prior of many people, personalised from one picture."""

from __future__ import annotations

from handbench.method import Method


def create(preset: str = "quick", ablation: str | None = None) -> Method:
    """The method at a preset ("smoke", "quick", "seed", "released", "hand-scale"), or an ablation of it ("no-normals",
    "fixed-light"). Raises `InputError` for others."""
    from .method import Palm

    return Palm(preset, ablation)
