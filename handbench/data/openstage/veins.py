"""Veins and tendons under the skin of the back of the hand and the forearm: cords that every person has differently.

Lines are in millimetres of the neutral hand seen from the back (x to the thumb side, y to the finger tips).
"""

from __future__ import annotations

import itertools

import numpy as np

from ...scene import Array
from .creases import stroke
from .noise import Bands
from .places import Places, smoothstep

_WEBS = ((31.0, 84.0), (13.0, 86.0), (-7.0, 83.0), (-24.0, 77.0), (-39.0, 68.0))  # where veins come from the fingers

_Cord = tuple[Array, float, float]
"""Points (K, 2) in millimetres, strength, half width in metres."""


def veins(at: Places, bands: Bands, rng: np.random.Generator) -> Array:
    """How much of a vein lies under the skin, (N,) in [0, 1]; of one person's own network."""
    on = np.flatnonzero((at.facing < 0.1) & (at.finger < 1))
    depth = np.zeros(len(at.position), np.float32)
    points = at.position[on, :2] + 1.3e-3 * bands.mm11[:2, on].T + 0.4e-3 * bands.mm3[:2, on].T
    found = np.zeros(len(on), np.float32)
    for line, strength, width in _network(rng):
        found = np.maximum(found, stroke(points, line * 1e-3, strength, width))
    sunk = np.clip(0.75 + 0.35 * bands.mm11[2, on], 0.1, 1)  # in places they lie deeper
    depth[on] = found * sunk * smoothstep(0.05, -0.45, at.facing[on])
    return depth


def _network(rng: np.random.Generator) -> list[_Cord]:
    """Two trunks up the forearm, a vein from each web of the fingers, and what joins them."""
    radial, ulnar = (_trunk(rng, x) for x in (17.0 + rng.normal(0, 3), -14.0 + rng.normal(0, 3)))
    found: list[_Cord] = [(radial, rng.uniform(0.7, 1), 1.7e-3), (ulnar, rng.uniform(0.6, 1), 1.6e-3)]
    if rng.random() < 0.6:
        found.append((_trunk(rng, rng.normal(1, 4))[3:], rng.uniform(0.4, 0.9), 1.4e-3))
    ends = []
    for x, y in _WEBS:
        if rng.random() < 0.15:
            continue
        trunk = radial if x + rng.normal(0, 12) > 2 else ulnar
        joint = trunk[rng.integers(0, 3)]
        start = np.array([x, y]) + rng.normal(0, (2.5, 3))
        middle = 0.5 * start + 0.5 * joint + rng.normal(0, (3.0, 4))
        upper = 0.55 * start + 0.45 * middle + rng.normal(0, (1.5, 1))
        found.append((np.stack([start, upper, middle, joint]), rng.uniform(0.4, 1), rng.uniform(1.1e-3, 1.6e-3)))
        ends.append((upper, middle))
    for left, right in itertools.pairwise(ends):
        if rng.random() < 0.6:
            a, b = left[rng.integers(2)], right[rng.integers(2)]
            bend = 0.5 * (a + b) - np.array([0, abs(rng.normal(0, 5))])
            found.append((np.stack([a, bend, b]), rng.uniform(0.4, 0.9), 1.2e-3))
    for _ in range(rng.integers(1, 5)):
        y = rng.uniform(-80, 0)
        a, b = np.array([rng.uniform(8, 20), y]), np.array([rng.uniform(-18, 0), y + rng.uniform(-25, 25)])
        found.append((np.stack([a, 0.5 * (a + b) + rng.normal(0, 4, 2), b]), rng.uniform(0.3, 0.8), 1.2e-3))
    return found


def _trunk(rng: np.random.Generator, x: float) -> Array:
    """A vein from the middle of the hand up the forearm."""
    heights = np.array([56.0, 38.0, 22.0, 4.0, -22.0, -50.0, -78.0, -100.0])
    sway = np.cumsum(rng.normal(0, 2.6, len(heights)))
    return np.stack([x * np.linspace(1.1, 0.75, len(heights)) + sway - sway[3], heights], axis=1)


def tendons(at: Places, knuckle_points: Array) -> Array:
    """Ridges of the extensor tendons from the wrist to the four knuckles, (N,); `knuckle_points` (4, 3)."""
    on = np.flatnonzero((at.facing < 0) & (at.finger < 1) & (at.position[:, 1] > 0))
    depth = np.zeros(len(at.position), np.float32)
    found = np.zeros(len(on), np.float32)
    for point in knuckle_points[:, :2]:
        start = np.array([0.15 * point[0], 0.012])
        line = np.stack([start, 0.55 * start + 0.45 * point, point])
        found = np.maximum(found, stroke(at.position[on, :2], line, 1.0, 2.0e-3))
    depth[on] = found * smoothstep(0.0, -0.5, at.facing[on])
    return depth
