"""Who is in the open captures: people with their identity and skin, and the poses they take."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...hand.collision import relaxed
from ...hand.openhand import Identity, OpenHand, named_pose, sample_pose
from ...scene import Pose
from .people import look
from .skin import SkinLook
from .tattoo import Tattoo

_DECLARED: tuple[tuple[float, tuple[float, float, float] | None, tuple[Tattoo, ...]], ...] = (
    (0.26, None, ()),  # melanin, polish and tattoos of the first six: tones from very light to very dark
    (0.74, None, ()),
    (0.42, (0.45, 0.02, 0.04), ()),
    (0.60, None, (Tattoo("mandala"),)),
    (0.05, None, ()),
    (1.0, None, ()),
)


@dataclass(frozen=True, eq=False)
class Subject:
    """A person: name, shape of the hand, and look of its skin."""

    name: str
    identity: Identity
    look: SkinLook


def person(index: int, hand: OpenHand) -> Subject:
    """The person of an index: the same one in every capture and size. The first six wear what is declared."""
    if index < len(_DECLARED):
        melanin, polish, tattoos = _DECLARED[index]
        skin = look(index, melanin)
        skin = replace(skin, nails=replace(skin.nails, polish=polish, tips=False), tattoos=tattoos, bleached=0)
    else:
        skin = look(index)
    return Subject(f"s{index + 1:02d}", hand.sample_identity(np.random.default_rng([2401, index])), skin)


def pose(hand: OpenHand, subject: Subject, k: int) -> Pose:
    """A subject's k-th pose: the neutral one first, then poses of its own without collisions, each placed a little
    differently."""
    if k == 0:
        return named_pose("rest")
    rng = np.random.default_rng([1005, subject.look.seed, k])
    found = relaxed(hand, subject.identity, own_pose(hand, rng))
    return Pose(found.joints, rng.normal(0.0, np.radians([7.0, 16.0, 6.0])), np.zeros(3))


def own_pose(hand: OpenHand, rng: np.random.Generator) -> Pose:
    """A random pose for a picture that anyone may see: the middle finger is not stretched alone."""
    while True:
        pose = sample_pose(rng)
        flexion = dict(zip(hand.joint_names, pose.joints[:, 0], strict=True))
        index, middle, ring = (flexion[f"{finger}1"] + flexion[f"{finger}2"] for finger in ("index", "middle", "ring"))
        if min(index, ring) - middle < np.radians(20.0):
            return pose
