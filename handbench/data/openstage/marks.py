"""Marks a person has on the skin: freckles, moles, spots of age, birthmarks, scars, and where sun did not reach.

Each function returns how much of a mark is there, per texel (N,), about 0 … 1.
"""

from __future__ import annotations

import numpy as np

from ...scene import Array
from .creases import stroke
from .noise import Bands
from .places import Places, smoothstep


def freckles(at: Places, bands: Bands) -> Array:
    """Small flat spots on the back of the hand and the forearm, denser in some places than in others."""
    dense = 0.5 * bands.mm26[2] + 0.15 * bands.mm6[3]
    large, tiny = smoothstep(1.5, 2.1, bands.mm1[3] + dense), smoothstep(1.9, 2.4, bands.fine[2] + dense)
    return np.maximum(large, 0.8 * tiny) * smoothstep(0.2, -0.3, at.facing)


def moles(at: Places, rng: np.random.Generator) -> Array:
    """A few dark round spots on the back of the hand and the forearm."""
    total = np.zeros(len(at.position), np.float32)
    for near, distance in _around(at, rng, rng.poisson(3), 2.4e-3):
        radius = rng.uniform(0.5e-3, 1.3e-3)
        total[near] += rng.uniform(0.4, 1.0) * smoothstep(1.3 * radius, 0.6 * radius, distance)
    return total


def spots(at: Places, bands: Bands, rng: np.random.Generator, amount: float) -> Array:
    """Spots of age: flat, brown, of ragged outline, 2 to 9 mm wide, on the back of the hand."""
    total = np.zeros(len(at.position), np.float32)
    for near, distance in _around(at, rng, rng.poisson(60 * amount), 7e-3):
        radius = min(rng.lognormal(np.log(1.2e-3), 0.55), 4.5e-3)
        ragged = distance / radius - 0.12 * bands.mm3[3, near] - 0.07 * bands.mm1[0, near]
        uneven = np.clip(0.85 + 0.12 * bands.mm1[1, near], 0.5, 1.2)
        spot = rng.uniform(0.2, 0.9) * uneven * smoothstep(1.4, 0.7, ragged)
        total[near] = np.maximum(total[near], spot)
    return total


def patches(at: Places, bands: Bands, rng: np.random.Generator, count: int, size: float) -> Array:
    """Large patches of ragged outline anywhere: birthmarks, skin that lost its pigment."""
    total = np.zeros(len(at.position), np.float32)
    wobble = 0.8 * bands.mm11[3] + 0.5 * bands.mm6[2] + 0.3 * bands.mm3[0]
    for centre in rng.choice(len(at.position), count):
        distance = np.linalg.norm(at.position - at.position[centre], axis=1) / (size * rng.uniform(0.6, 1.4))
        total = np.maximum(total, smoothstep(1.06, 0.94, distance - 0.35 * wobble))
    return total


def scars(at: Places, rng: np.random.Generator, count: int) -> Array:
    """Healed cuts: thin lines, 4 to 30 mm long, on either side of the hand."""
    total = np.zeros(len(at.position), np.float32)
    for centre in rng.choice(len(at.position), count):
        normal, start = at.normal[centre], at.position[centre]
        way = np.cross(normal, rng.normal(size=3))
        way *= rng.uniform(2e-3, 10e-3) / np.linalg.norm(way)
        bend = np.cross(normal, way) * rng.normal(0, 0.2)
        line = np.stack([start - way, start + bend, start + way])
        total = np.maximum(total, stroke(at.position, line, rng.uniform(0.5, 1.0), rng.uniform(0.3e-3, 0.9e-3)))
    return total


def ring(at: Places, finger: int, bands: Bands) -> Array:
    """The paler skin under a ring that is taken off."""
    end = at.knuckles[finger, 1]
    on = np.flatnonzero((at.finger == finger) & (at.along < end))
    covered = np.zeros(len(at.position), np.float32)
    away = np.abs(at.along[on] - 0.68 * end + 0.4e-3 * bands.mm6[0, on])
    covered[on] = smoothstep(3.4e-3, 2.2e-3, away)
    return covered


def watch(at: Places, rng: np.random.Generator) -> Array:
    """The paler skin under a watch and its strap."""
    x, y = at.position[:, 0], at.position[:, 1] + rng.uniform(0.03, 0.042)
    strap = smoothstep(1.2e-3, -1.2e-3, np.abs(y) - rng.uniform(6e-3, 11e-3))
    dial = smoothstep(1.2e-3, -1.2e-3, np.hypot(x, y) - rng.uniform(14e-3, 20e-3))
    return np.maximum(strap, dial * (at.facing < 0))


def _around(at: Places, rng: np.random.Generator, count: int, reach: float) -> list[tuple[Array, Array]]:
    """Texels near `count` random points of the back of the hand and the forearm, and their distances in metres."""
    back = np.flatnonzero((at.facing < -0.2) & (at.nail < 0.01))
    found = []
    for centre in rng.choice(back, count):
        near = np.array(at.tree.query_ball_point(at.position[centre], reach))
        found.append((near, np.linalg.norm(at.position[near] - at.position[centre], axis=1)))
    return found
