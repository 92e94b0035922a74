"""Joint frames and limits: which component of a joint's axis-angle bends, spreads and twists it.

Every joint has a frame of its own, fixed in the neutral hand: y along its bone towards the tip, z out of the palm
side (against the nail for fingers and thumb), x = y × z. A joint's axis-angle has its components in this frame:

    x  flexion    positive closes the hand
    y  twist      along the bone
    z  abduction  positive moves the tip towards the little finger (ulnar), negative towards the thumb (radial)

Angles count from the rest pose of the template, whose fingers are already bent by about 10° (knuckle), 7° and 7°
and spread by about 8° a finger; the limits below are the usual anatomical ranges minus that.
Ranges, rounded from those that anatomy gives for adults: knuckle (MCP) −20…90°, ±20° sideways;
PIP 0…110°; DIP 0…80°; wrist −70…80° and −20…35°; fourth and fifth metacarpal 10° and 20°; thumb IP −15…80°.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .template import FINGERS, Template

# joint -> (flexion, twist, abduction), each (least, greatest) in degrees from the rest pose
LIMITS: dict[str, tuple[tuple[float, float], ...]] = {
    "forearm": ((0, 0), (0, 0), (0, 0)),  # the rigid placement of the hand moves the forearm
    "wrist": ((-50, 60), (0, 0), (-20, 30)),
    "index0": ((-2, 2), (0, 0), (0, 0)),
    "middle0": ((-2, 2), (0, 0), (0, 0)),
    "ring0": ((-2, 9), (0, 0), (0, 0)),
    "little0": ((-3, 16), (0, 0), (0, 0)),
    "thumb1": ((-20, 35), (-15, 35), (-25, 25)),
    "thumb2": ((-10, 60), (-5, 10), (-8, 8)),
    "thumb3": ((-20, 80), (0, 0), (0, 0)),
    "index1": ((-25, 80), (-4, 4), (-12, 16)),
    "middle1": ((-25, 80), (-4, 4), (-12, 12)),
    "ring1": ((-25, 80), (-4, 4), (-16, 10)),
    "little1": ((-25, 80), (-4, 4), (-22, 12)),
}
for _finger in FINGERS[1:]:
    LIMITS[f"{_finger}2"] = ((-7, 103), (0, 0), (0, 0))
    LIMITS[f"{_finger}3"] = ((-10, 73), (0, 0), (0, 0))


def joint_limits(names: tuple[str, ...]) -> NDArray[Any]:
    """(J, 3, 2) radians: least and greatest of each axis-angle component."""
    return np.radians(np.array([LIMITS[name] for name in names], dtype=np.float64))


def bone_ends(template: Template) -> NDArray[Any]:
    """(J,) index into `template.points` of the point where each joint's bone ends."""
    names = template.joint_names
    ends = []
    for name in names:
        if name == "forearm":
            ends.append(names.index("wrist"))
        elif name == "wrist":
            ends.append(names.index("middle1"))
        elif name[-1] == "3":
            ends.append(len(names) + FINGERS.index(name[:-1]))
        else:
            ends.append(names.index(f"{name[:-1]}{int(name[-1]) + 1}"))
    return np.array(ends)


def joint_frames(template: Template) -> NDArray[Any]:
    """(J, 3, 3) rotations whose columns are the joints' x, y, z axes in canonical space."""
    frames = np.empty((len(template.joint_names), 3, 3))
    ends = template.points[bone_ends(template)]
    for j, name in enumerate(template.joint_names):
        if name == "wrist":  # bends about the axes of the whole hand
            frames[j] = np.eye(3)
            continue
        y = ends[j] - template.points[j]
        y /= np.linalg.norm(y)
        finger = name[:-1]
        palmar = -template.dorsal[FINGERS.index(finger)] if finger in FINGERS and name[-1] != "0" else np.eye(3)[2]
        z = palmar - (palmar @ y) * y
        z /= np.linalg.norm(z)
        frames[j] = np.stack([np.cross(y, z), y, z], axis=1)
    return frames
