"""Hand models: what every one is, those there are, and the open hand with its identities and poses."""

from __future__ import annotations

from ..registry import Entry
from .handmodel import HandModel
from .identity import Identity
from .known import hand_model, hand_of
from .model import OpenHand
from .poses import named_pose, sample_pose

__all__ = ["ENTRIES", "HandModel", "Identity", "OpenHand", "hand_model", "hand_of", "named_pose", "sample_pose"]

ENTRIES: tuple[Entry, ...] = (
    Entry("openhand", "handbench.hand.model:create", "a right hand cut from a CC0 base: 21 joints, free to share"),
)
