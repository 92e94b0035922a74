"""Hand models: the open hand, its identities and poses."""

from __future__ import annotations

from .identity import Identity
from .model import OpenHand
from .poses import named_pose, sample_pose

__all__ = ["Identity", "OpenHand", "named_pose", "sample_pose"]
