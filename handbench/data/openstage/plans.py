"""From the preset of a capture to its plan."""

from __future__ import annotations

from ...errors import InputError
from . import stage
from .presets import Preset, StagePreset
from .production import Production


def production(preset: Preset) -> Production:
    """All of a capture, decided before the first ray; the same preset gives the same plan."""
    match preset:
        case StagePreset():
            return stage.production(preset)
        case _:
            raise InputError(f"there is no plan for {preset.label}; this is a fault of handbench")
