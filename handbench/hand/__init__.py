"""Hand models: what every one is, and those there are; each lives in a folder of its own."""

from __future__ import annotations

from ..registry import Entry
from .handmodel import HandModel
from .known import hand_model, hand_of, hand_of_poses

__all__ = ["ENTRIES", "HandModel", "hand_model", "hand_of", "hand_of_poses"]

_MANO = "handbench.hand.mano:create"

ENTRIES: tuple[Entry, ...] = (
    Entry("openhand", "handbench.hand.openhand:create", "a right hand cut from a CC0 base: 21 joints, free to share"),
    Entry("mano-right", _MANO, "MANO's right hand: bring its authors' file, see HANDBENCH_MANO", (("side", "right"),)),
    Entry("mano-left", _MANO, "MANO's left hand: bring its authors' file, see HANDBENCH_MANO", (("side", "left"),)),
)
