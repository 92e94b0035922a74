"""Hand models: what every one is, and those there are; each lives in a folder of its own."""

from __future__ import annotations

from .handmodel import HandModel
from .known import hand_model, hand_of, hand_of_poses

__all__ = ["HandModel", "hand_model", "hand_of", "hand_of_poses"]
