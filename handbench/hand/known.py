"""The hand models there are: by name, and by the surface that a mesh has."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress

import numpy as np

from ..errors import Absent, Unsupported
from ..registry import HANDS
from ..scene import Pose, Topology
from .handmodel import HandModel
from .watched import Watched

SHIPPED = "openhand"
"""The hand that comes with handbench."""


_models = Watched(HandModel)


def hand_model(name: str = SHIPPED) -> HandModel:
    """The registered hand model of a name; `InputError` with the closest names if there is none.

    It is one shared object, so its arrays are read-only. What a method writes into them all the same is found by
    `restored`.
    """

    def make() -> HandModel:
        model: HandModel = HANDS.load(name)()
        for value in vars(model).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        return model

    return _models(name, make)


def restored() -> list[str]:
    """Find shared hand models that somebody wrote into, put them back to what they were, and name them."""
    own = _models.changed()
    found = [name for name, model in _models.items() if name in own or model.kept.changed()]
    if found:
        _models.restore(own)  # first, since all else is made of them
        for name in found:
            hand_model(name).kept.restore()
    return found


def forget(*names: str) -> None:
    """Load hand models anew when they are asked for: their files may be others now."""
    for name in names:
        _models.drop(name)


def hand_of(topology: Topology) -> tuple[HandModel, int]:
    """The registered hand model whose surface has these triangles, and the level of its subdivision.

    Raises `Unsupported` if no model has.
    """
    known = list(_at_hand())
    for hand in known:
        for level in range(hand.levels + 1):
            faces = hand.topology(level).faces
            if len(faces) >= len(topology.faces):
                if np.array_equal(faces, topology.faces):
                    return hand, level
                break
    names = ", ".join(hand.name for hand in known)
    raise Unsupported(
        f"a mesh of {len(topology.faces)} triangles is of none of the hand models that are known ({names}); "
        "use a capture tracked with one of them"
    )


def hand_of_poses(poses: Iterable[Pose | None]) -> HandModel:
    """The shipped hand model, or another of right hands that has the joints which the first of these poses turns.

    Raises `Unsupported` if no model has so many.
    """
    pose = next((pose for pose in poses if pose is not None), None)
    for hand in _at_hand():
        if pose is None or (hand.side == "right" and len(hand.joint_names) == len(pose.joints)):
            return hand
    assert pose is not None
    raise Unsupported(
        f"a pose of {len(pose.joints)} joints is of none of the hand models that are known; use one of them"
    )


def _at_hand() -> Iterator[HandModel]:
    """The models that can be had: of some the file is licensed, and the user may have none."""
    for name in HANDS.entries():
        with suppress(Absent):
            yield hand_model(name)
