"""The open hand: a right hand cut from a CC0 base, with its identities and poses."""

from __future__ import annotations

from .identity import Identity
from .model import OpenHand, create
from .poses import named_pose, sample_pose

__all__ = ["Identity", "OpenHand", "create", "named_pose", "sample_pose"]
