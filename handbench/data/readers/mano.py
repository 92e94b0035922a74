"""MANO's right hand for captures that tell their hands as its own: it, or why poses and meshes are not there."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from ...errors import Absent
from ...hand import hand_model
from ...scene import Array, Mesh, Pose

if TYPE_CHECKING:
    from ...hand.mano import ManoHand


def right_hand() -> tuple[ManoHand | None, tuple[str, ...]]:
    """MANO's right hand and no remark; without its file None, and a remark that says what is missing for want of it."""
    try:
        hand: ManoHand = hand_model("mano-right")  # type: ignore[assignment]
    except Absent as error:
        return None, (f"poses and meshes are not there: {error}",)
    return hand, ()


def posed(hand: ManoHand, shape: Array, pose: Pose) -> Mesh:
    """The mesh of a shape in a pose, worked out when it is asked for."""
    return Mesh.unread(partial(_vertices, hand, shape, pose), hand.topology(0))


def _vertices(hand: ManoHand, shape: Array, pose: Pose) -> Array:
    return hand.mesh(shape, pose, 0).vertices
