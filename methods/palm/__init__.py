"""PALM-Net: an implicit, physically based hand prior of many people, personalised from one picture."""

from __future__ import annotations

from handbench.method import Method
from handbench.settings import UNCHANGED, Changes


def create(preset: str = "quick", ablation: str | None = None, changes: Changes = UNCHANGED) -> Method:
    """The method at a preset ("smoke", "quick", "seed", "released", "hand-scale"), or an ablation of it ("no-normals",
    "fixed-light"), with changed settings. Raises `InputError` for others."""
    from .method import Palm

    return Palm(preset, ablation, changes)
