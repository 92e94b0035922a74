"""The table of hand models; the package `hand`, which loads torch, is loaded by who takes one."""

from __future__ import annotations

from .registry import Entry

_MANO = "handbench.hand.mano:create"

ENTRIES: tuple[Entry, ...] = (
    Entry("openhand", "handbench.hand.openhand:create", "a right hand cut from a CC0 base: 21 joints, free to share"),
    Entry("mano-right", _MANO, "MANO's right hand: bring its authors' file, see HANDBENCH_MANO", (("side", "right"),)),
    Entry("mano-left", _MANO, "MANO's left hand: bring its authors' file, see HANDBENCH_MANO", (("side", "left"),)),
)
