"""Where the fingers of a hand are alike, and how textures that pictures show in part are completed by that."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..render.uv.atlas import Atlas
from ..render.uv.inpaint import Guide, Inpainted, inpainted
from ..scene import Array
from .handmodel import HandModel

_REACH = 0.006  # metres on a finger of the usual size: what is farther has no twin


def completed(
    hand: HandModel, level: int, atlas: Atlas, colour: Array, seen: Array, prior: Array | None = None
) -> Inpainted:
    """A texture (C, N) of which only some texels were seen (N,), over an atlas of the hand's surface of a level.

    An unseen texel of a finger takes its structure from the same place of the nearest finger that was seen there
    ("finger"), other ones from a prior texture (C, N), such as the mean of other people's ("prior"), and without one
    colours spread smoothly. Raises `InputError` if nothing was seen.
    """
    position, weights = atlas.interpolate(hand.rest_position(level)), atlas.interpolate(hand.weights(level))
    guides = [Guide("finger", colour[:, twin], (twin >= 0) & seen[twin]) for twin in twins(hand, position, weights)]
    if prior is not None:
        guides.append(Guide("prior", prior, np.ones(len(seen), dtype=bool)))
    return inpainted(colour, seen, position, guides)


def twins(hand: HandModel, position: Array, weights: Array) -> list[Array]:
    """For points of the neutral hand at rest, (N, 3) with skinning weights (N, J), the same places on other fingers.

    One array (N,) of indices of points for each step from finger to finger, nearest fingers first; -1 where there is no
    twin. Index to little finger are twins, bone by bone: what is as far along the bone and lies in the same direction
    from it. Thumb, palm, back and forearm have none.
    """
    fingers = np.full(len(position), -1)
    place = np.zeros((len(position), 4))
    owner = weights.argmax(axis=1)
    across = palm(hand)
    for f, chain in enumerate(hand.chains[1:]):
        for k, joint in enumerate(chain):
            own = owner == joint
            bone = hand.points[hand.ends[joint]] - hand.points[joint]
            length = float(np.linalg.norm(bone))
            y = bone / length
            z = across - (across @ y) * y
            z /= np.linalg.norm(z)
            local = (position[own] - hand.points[joint]) @ np.stack([np.cross(y, z), y, z], axis=1) / length
            place[own] = np.c_[local, np.full(int(own.sum()), 10.0 * k)]  # bones of a number only match each other
            fingers[own] = f
    typical = float(
        np.mean([np.linalg.norm(hand.points[hand.ends[c[1]]] - hand.points[c[1]]) for c in hand.chains[1:]])
    )
    found = []
    count = len(hand.chains) - 1
    for step in [s for away in range(1, count) for s in (away, -away)]:
        twin = np.full(len(position), -1)
        for f in range(max(0, -step), count - max(0, step)):
            ours, theirs = np.flatnonzero(fingers == f), np.flatnonzero(fingers == f + step)
            if not len(ours) or not len(theirs):
                continue
            distance, nearest = cKDTree(place[theirs]).query(place[ours])
            twin[ours] = np.where(distance * typical < _REACH, theirs[nearest], -1)
        found.append(twin)
    return found


def palm(hand: HandModel) -> Array:
    """The direction (3,) in which the palm, or the back, faces: across the knuckles and along the hand."""
    knuckles = [hand.points[chain[0]] for chain in hand.chains[1:]]
    return np.cross(knuckles[-1] - knuckles[0], np.mean(knuckles, axis=0) - hand.points[hand.wrist])
