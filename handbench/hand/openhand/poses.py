"""Named poses and a sampler of natural ones."""

from __future__ import annotations

import numpy as np

from ...errors import InputError, unknown_name
from ...scene import Pose
from .anatomy import joint_limits
from .template import FINGERS, joint_names

Angles = tuple[float, float, float]  # degrees from the rest pose: flexion, twist, abduction


def _finger(name: str, *flexion: float, abduction: float = 0.0) -> dict[str, Angles]:
    mcp, pip, dip = flexion
    return {f"{name}1": (mcp, 0.0, abduction), f"{name}2": (pip, 0.0, 0.0), f"{name}3": (dip, 0.0, 0.0)}


_CURLED: dict[str, Angles] = {
    **_finger("middle", 68, 82, 36),
    **_finger("ring", 69, 77, 34, abduction=-2),
    **_finger("little", 69, 63, 28, abduction=-5),
    "ring0": (3, 0, 0),
    "little0": (6, 0, 0),
}

# pose -> joint -> angles; joints not named stay at rest
NAMED: dict[str, dict[str, Angles]] = {
    "rest": {},
    "open": {
        **_finger("index", -12, -6, -7, abduction=-3),
        **_finger("middle", -12, -6, -7),
        **_finger("ring", -12, -6, -7, abduction=2),
        **_finger("little", -12, -6, -7, abduction=4),
        "thumb1": (-8, 0, 0),
        "thumb3": (-8, 0, 0),
    },
    "fist": {
        **_CURLED,
        **_finger("index", 64, 66.4, 28, abduction=1),
        "thumb1": (19.1, 3.8, 16.2),
        "thumb2": (2.1, 0, 0),
        "thumb3": (6.3, 0, 0),
    },
    "point": {
        **_CURLED,
        **_finger("index", -5, 0, -3),
        "thumb1": (33, -3.6, 8),  # its pad on the back of the middle finger
        "thumb2": (15.3, 0, 0),
        "thumb3": (12, 0, 0),
    },
    "pinch": {
        **_finger("index", 45.9, 39.1, 7, abduction=-4.5),
        **_finger("middle", 30, 32, 20),
        **_finger("ring", 24, 30, 18),
        **_finger("little", 16, 28, 15),
        "thumb1": (14.6, -0.3, -1.7),
        "thumb2": (21.5, 0, 0),
        "thumb3": (-7.8, 0, 0),
    },
}


def named_pose(name: str) -> Pose:
    """The pose of this name, placed at the origin: rest, open, fist, point or pinch; `InputError` for other names."""
    if name not in NAMED:
        raise unknown_name("pose", name, NAMED)
    angles = [NAMED[name].get(joint, (0.0, 0.0, 0.0)) for joint in joint_names()]
    return Pose(np.radians(np.array(angles, dtype=np.float64)))


def sample_pose(rng: np.random.Generator, amount: float = 1.0) -> Pose:
    """A random natural pose within the joint limits, placed at the origin.

    `amount` in [0, 1] scales the angles towards the rest pose. All fingers share a bend, neighbours share more of it
    than distant ones (an AR(1) chain with correlation 0.7); the DIP joint follows the PIP joint at about two thirds,
    as its tendon does; fingers spread together, and less when bent. Poses may intersect: see `collision.relaxed`.
    """
    if not 0 <= amount <= 1:
        raise InputError(f"sample_pose: amount {amount} is not in 0…1")
    names = joint_names()
    degrees = np.zeros((len(names), 3))

    def put(joint: str, *angles: float) -> None:
        degrees[names.index(joint)] = angles

    chain = [rng.standard_normal()]
    for _ in FINGERS[2:]:
        chain.append(0.7 * chain[-1] + np.sqrt(1 - 0.7**2) * rng.standard_normal())
    overall = rng.uniform(-0.15, 0.9)
    spread = rng.normal(0, 1)
    for finger, own, outward in zip(FINGERS[1:], chain, (-6.0, -1.0, 3.0, 7.0), strict=True):
        bend = np.clip(overall + 0.2 * own, -0.25, 1)
        knuckle = np.clip(bend + 0.15 * rng.standard_normal(), -0.3, 1)
        pip = np.clip(95 * bend + 8 * rng.standard_normal(), -7, 100)
        dip = np.clip(2 / 3 * pip + 5 * rng.standard_normal(), -10, 70)
        fan = spread * outward * (1 - 0.8 * max(bend, 0)) + rng.normal(0, 1.5)
        put(f"{finger}1", 75 * knuckle, 0, fan)
        put(f"{finger}2", pip, 0, 0)
        put(f"{finger}3", dip, 0, 0)
    cup = max(overall, 0) * rng.uniform(0, 1)
    put("ring0", 7 * cup, 0, 0)
    put("little0", 14 * cup, 0, 0)
    opposition = np.clip(0.4 * overall + rng.normal(0.1, 0.3), -0.5, 1)
    put("thumb1", 22 * opposition, 8 * rng.standard_normal(), 8 * rng.standard_normal())
    put("thumb2", 25 * opposition + 5 * rng.standard_normal(), 0, 0)
    put("thumb3", 30 * opposition + 10 * rng.standard_normal(), 0, 0)
    put("wrist", 15 * rng.standard_normal(), 0, 7 * rng.standard_normal())
    limits = joint_limits(names)
    return Pose(amount * np.clip(np.radians(degrees), limits[..., 0], limits[..., 1]))
