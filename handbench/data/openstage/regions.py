"""Parts of the hand that pigment and blood know: joints, finger tips and pads, webs. Values per texel (N,)."""

from __future__ import annotations

import numpy as np

from ...scene import Array
from .places import Places, smoothstep


def near_joints(at: Places, rng: np.random.Generator) -> Array:
    """1 on the back of every finger joint, fading over a centimetre; each joint darker or paler than others."""
    near = np.zeros(len(at.along), np.float32)
    for joints in at.joints:
        for joint, reach, weight in zip(joints[:3], (10e-3, 7e-3, 5e-3), (0.7, 1.0, 0.7), strict=True):
            reach, weight = reach * rng.uniform(0.8, 1.2), weight * rng.uniform(0.1, 1.3)
            on = np.flatnonzero(np.abs(at.position[:, 1] - joint[1]) < 2.5 * reach)
            away = ((at.position[on] - joint) ** 2) @ np.array([0.55, 1.0, 0.2], np.float32)
            near[on] = np.maximum(near[on], weight * np.exp(-away / np.float32(reach**2)))
    return near


def warm_fingers(at: Places, rng: np.random.Generator) -> Array:
    """How much more blood each finger has than its neighbours, rising to its tip."""
    warm = np.append(rng.normal(0, 0.35, len(at.knuckles)), 0)[at.finger].astype(np.float32)  # -1 is no finger
    knuckles = at.knuckles[at.finger]
    return warm * np.clip((at.along - 0.6 * knuckles[:, 1]) / (knuckles[:, 3] - 0.6 * knuckles[:, 1]), 0, 1)


def pads(at: Places) -> Array:
    """1 on the finger tips, thenar and hypothenar: where palms are reddest."""
    tips = np.zeros(len(at.along), np.float32)
    for f, knuckles in enumerate(at.knuckles):
        on = at.finger == f
        tips[on] = smoothstep(knuckles[2] + 2e-3, knuckles[3] - 4e-3, at.along[on])
    x, y = at.position[:, 0], at.position[:, 1]
    thenar = np.exp(-(((x - 0.024) / 0.014) ** 2 + ((y - 0.042) / 0.02) ** 2))
    hypothenar = np.exp(-(((x + 0.027) / 0.011) ** 2 + ((y - 0.035) / 0.022) ** 2))
    heads = np.exp(-(((y - 0.083) / 0.009) ** 2))
    found = np.maximum(np.maximum(tips, 0.8 * thenar), np.maximum(0.8 * hypothenar, 0.6 * heads))
    return found


def webs(at: Places) -> Array:
    """1 on the thin skin between two fingers where they part."""
    beside = smoothstep(0.35, 0.8, np.abs(at.normal[:, 0])) * (at.finger > 0)
    reach = np.where(at.finger > 0, at.along / at.knuckles[np.maximum(at.finger, 0), 1], 0)
    return beside * np.exp(-(((reach - 0.45) / 0.2) ** 2))
