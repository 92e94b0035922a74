"""From the preset of a capture to its plan."""

from __future__ import annotations

from ...errors import InputError
from . import phone, scans, stage, wild
from .presets import PhonePreset, Preset, ScansPreset, StagePreset, WildPreset
from .production import Production


def production(preset: Preset) -> Production:
    """All of a capture, decided before the first ray; the same preset gives the same plan."""
    match preset:
        case StagePreset():
            return stage.production(preset)
        case ScansPreset():
            return scans.production(preset)
        case WildPreset():
            return wild.production(preset)
        case PhonePreset():
            return phone.production(preset)
        case _:
            raise InputError(f"there is no plan for {preset.label}; this is a fault of handbench")
