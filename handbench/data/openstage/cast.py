"""Who is in the open captures: people with their identity and skin, and the poses they take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...hand.collision import relaxed
from ...hand.openhand import Identity, OpenHand, named_pose, sample_pose
from ...scene import Pose
from .skin import SkinLook

_LOOKS = (  # melanin, haemoglobin, freckles, polish, tattoo: tones from very light to very dark, then repeated
    (0.26, 0.50, 0.3, None, None),
    (0.74, 0.45, 0.1, None, None),
    (0.42, 0.55, 0.2, (0.45, 0.02, 0.04), None),
    (0.60, 0.50, 0.1, None, "mandala"),
    (0.05, 0.60, 0.8, None, None),
    (1.0, 0.40, 0.0, None, None),
)
_POLISH = ((0.02, 0.06, 0.30), (0.02, 0.02, 0.02), (0.30, 0.05, 0.20))
_TATTOOS = ("star", "mandala")


@dataclass(frozen=True, eq=False)
class Subject:
    """A person: name, shape of the hand, and look of its skin."""

    name: str
    identity: Identity
    look: SkinLook


def person(index: int, hand: OpenHand) -> Subject:
    """The person of an index: the same one in every capture and size."""
    rng = np.random.default_rng([2401, index])
    melanin, haemoglobin, freckles, polish, tattoo = _LOOKS[index % len(_LOOKS)]
    if index >= len(_LOOKS):  # beyond the declared six, every tone comes back with other details
        melanin = float(np.clip(melanin + rng.uniform(-0.12, 0.12), 0.0, 1.0))
        polish = _POLISH[index % len(_POLISH)] if rng.random() < 0.25 else None
        tattoo = _TATTOOS[index % len(_TATTOOS)] if rng.random() < 0.25 else None
    look = SkinLook(
        melanin=melanin,
        haemoglobin=haemoglobin,
        freckles=freckles,
        creases=float(rng.uniform(0.7, 1.2)),
        roughness=float(rng.uniform(0.40, 0.52)),
        polish=polish,
        tattoo=tattoo,
        seed=index,
    )
    return Subject(f"s{index + 1:02d}", hand.sample_identity(rng), look)


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
