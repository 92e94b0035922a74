"""Fine relief of the skin: furrows that cross on the back of the hand, pores, and the ridges of palm and finger tips.

Each function returns values per texel (N,); detail too fine for the texture is left out (`Places.shows`).
"""

from __future__ import annotations

import numpy as np

from ...scene import Array
from .noise import Bands, NoiseFields
from .places import Places, smoothstep

_FAMILIES = (  # furrows run across these directions: unit vector, metres from furrow to furrow, strength
    ((0.68, 0.73, 0.0), 0.66e-3, 1.0),
    ((-0.72, 0.69, 0.0), 0.61e-3, 1.0),
    ((0.05, 0.97, -0.24), 1.05e-3, 0.6),
    ((0.0, 0.62, 0.78), 0.70e-3, 0.8),
    ((0.0, 0.58, -0.81), 0.74e-3, 0.8),
)
_RIDGE = 0.52e-3  # metres from ridge to ridge of a finger tip


def furrows(at: Places, bands: Bands, palm: Array) -> Array:
    """1 in a furrow and 0 on the small plateaus between; weaker on the palm."""
    bend, fine = bands.mm11, bands.mm3
    plateau = np.ones(len(palm), np.float32)
    for i, (direction, spacing, strength) in enumerate(_FAMILIES):
        way = np.array(direction, np.float32)
        lies = smoothstep(0.45, 0.9, 1 - (at.normal @ way) ** 2)  # seen along its own direction a furrow is none
        phase = (
            at.position @ (way / np.float32(spacing)) + 0.7 * bend[i % 4] + 0.2 * fine[i % 3] + 0.13 * bands.mm1[i % 4]
        )
        away = phase - np.round(phase)
        broken = np.clip(0.65 + 0.35 * bands.mm1[(i + 1) % 4] + 0.3 * fine[(i + 2) % 4], 0.0, 1.0)
        plateau *= 1 - at.shows(spacing) * strength * lies * broken * np.exp(-((away / 0.18) ** 2))
    return (1 - plateau) * (1 - 0.75 * palm) * (0.8 + 0.2 * at.hand)


def pores(at: Places, noise: NoiseFields, palm: Array) -> Array:
    """1 in a pore; on the back of the hand and the forearm."""
    size = 0.45e-3
    if not at.shows(2 * size):
        return np.zeros(len(palm), np.float32)
    return at.shows(2 * size) * smoothstep(1.5, 2.4, noise.field(at.position, size)) * (1 - palm)


def ridges(at: Places, noise: NoiseFields, palm: Array) -> Array:
    """Ridges of palm and finger tips, -1 between them … 1 on top: whorls on the tips, waves elsewhere."""
    found = np.zeros(len(palm), np.float32)
    seen = at.shows(_RIDGE)
    if not seen:
        return found
    on = np.flatnonzero(palm * at.hand > 0.05)
    finger, along, across = at.finger[on], at.along[on], at.across[on]
    bend = noise.fields(at.position[on], 9e-3, 2)
    wobble = noise.field(at.position[on], 1.6e-3)
    x, y = at.position[on, 0], at.position[on, 1]
    flow = 0.75 * y - 0.65 * x + 1.6e-3 * bend[0]  # over the palm ridges run to the thumb side
    for f, knuckles in enumerate(at.knuckles):
        mine = finger == f
        core = knuckles[2] + 0.42 * (knuckles[3] - knuckles[2])
        whorl = np.hypot(1.15 * across[mine], along[mine] - core)
        waves = along[mine] - knuckles[2] + 0.5e-3 * bend[0][mine]
        tip = smoothstep(knuckles[2] - 1e-3, knuckles[2] + 3e-3, along[mine])
        flow[mine] = waves * (1 - tip) + whorl * tip
    phase = (flow + 0.35e-3 * bend[1] + 0.06e-3 * wobble) / _RIDGE
    found[on] = seen * np.cos(2 * np.pi * phase) * palm[on] * np.clip(0.8 + 0.25 * wobble, 0.3, 1)
    return found
