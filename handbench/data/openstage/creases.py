"""Lines of the hand: flexion creases of palm and fingers, folds over the knuckles, wrist lines; veins and tendons.

Each function returns values per texel in [0, 1] or so: how deep a line is there. Palm lines are splines through
points of the neutral hand seen from the palm (x to the thumb side, y to the finger tips, metres).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial import cKDTree

from ...scene import Array
from .noise import Noise
from .places import Places, smoothstep

_Line = tuple[tuple[tuple[float, float], ...], float, float]

# The three great lines and lesser ones: points in mm, depth, width in metres.
_PALM_LINES: tuple[_Line, ...] = (
    # life (thenar crease): around the ball of the thumb
    (((40, 73), (31, 70), (22, 63), (14.5, 53), (10, 41), (8.5, 28), (10.5, 15)), 1.0, 0.8e-3),
    # head (proximal transverse)
    (((39, 74.5), (28, 72.5), (16, 67), (3, 59.5), (-10, 52.5), (-21, 48), (-29, 45)), 0.9, 0.75e-3),
    # heart (distal transverse)
    (((-41, 63.5), (-31, 66.5), (-20, 68.5), (-8, 71), (4, 76), (11, 82), (14, 89)), 1.0, 0.8e-3),
    # fate, faint
    (((2, 20), (2.5, 33), (1, 47), (0, 60), (1, 70)), 0.3, 0.5e-3),
    # wrist (bracelet) lines
    (((-27, 0.5), (-14, -2.5), (0, -3), (13, -1.5), (24, 2)), 0.6, 0.6e-3),
    (((-27, -6.5), (-12, -9), (2, -9.5), (14, -8), (24, -5)), 0.4, 0.6e-3),
)

_VEINS = (  # the dorsal venous network: points in mm, strength
    (((22, 86), (18, 72), (14, 58), (15, 42), (19, 25), (20, 5), (17, -25), (14, -60), (12, -90)), 1.0),
    (((-4, 84), (-2, 72), (3, 60), (14, 50)), 0.8),
    (((-22, 80), (-18, 66), (-13, 55), (-14, 40), (-12, 24), (-13, 6), (-15, -25), (-12, -55), (-10, -90)), 0.9),
    (((-13, 48), (-4, 44), (4, 46), (13, 55)), 0.6),
    (((-36, 74), (-30, 60), (-20, 48), (-14, 38)), 0.5),
    (((44, 62), (36, 48), (28, 32), (22, 18), (19, 8)), 0.5),
    (((-13, 10), (-3, -4), (4, -22), (14, -40)), 0.5),
)

_FOLDS = (  # dorsal folds of a joint: number on either side, spacing, half width, depth; by joint, middle and end
    (3, 1.7e-3, 8.0e-3, 1.0),
    (2, 1.3e-3, 6.0e-3, 0.6),
)


def palm_lines(at: Places, noise: Noise, rng: np.random.Generator) -> Array:
    """The great lines and many small ones, (N,)."""
    depth = np.zeros(len(at.position))
    on = (at.facing > -0.1) & (at.finger < 1) & (at.position[:, 1] > -0.02)
    points = _shaken(at.position[on], noise, 0.5e-3)
    found = depth[on]
    for way, strength, width in _PALM_LINES:
        moved = np.array(way) * 1e-3 + rng.normal(0, 1.0e-3, 2) + rng.normal(0, 0.7e-3, (len(way), 2))
        found = np.maximum(found, _stroke(points, moved, strength * rng.uniform(0.8, 1.1), width))
    for _ in range(46):
        start = rng.uniform((-0.035, 0.012), (0.032, 0.09))
        angle = rng.choice([0.3, 1.2, 2.2, 2.7], p=[0.3, 0.2, 0.2, 0.3]) + rng.normal(0, 0.3)
        reach = rng.uniform(0.004, 0.016)
        bend = angle + rng.normal(0, 0.25)
        middle = start + reach * np.array([np.cos(angle), np.sin(angle)])
        line = np.array([start, middle, middle + reach * np.array([np.cos(bend), np.sin(bend)])])
        found = np.maximum(found, _stroke(points, line, rng.uniform(0.1, 0.32), 0.45e-3))
    fade = smoothstep(-0.1, 0.35, at.facing[on])
    depth[on] = found * fade * np.clip(0.85 + 0.3 * noise.field(at.position[on], 0.004), 0.3, 1.2)
    return depth


def finger_lines(at: Places, noise: Noise) -> Array:
    """Flexion creases on the palm side of fingers and thumb, (N,)."""
    depth = np.zeros(len(at.position))
    for f, knuckles in enumerate(at.knuckles):
        on = (at.finger == f) & (at.facing > -0.25)
        position = at.position[on]
        first, middle, end, _ = knuckles
        lines = [(middle - 0.9e-3, 0.9), (middle + 1.1e-3, 0.75), (middle - 2.8e-3, 0.3), (end, 0.85)]
        lines.append((end + 1.8e-3, 0.3))
        if f:  # fingers also have a crease where they leave the palm
            base = middle - 0.52 * (middle - first)
            lines += [(base, 0.9), (base + 2.2e-3, 0.45), (base - 1.8e-3, 0.25)]
        along = at.along[on] + 0.35e-3 * noise.field(position, 0.005) + 0.12e-3 * noise.field(position, 0.0015)
        curve = 0.10 * np.abs(at.across[on])  # the ends of a crease lean towards the palm
        found = np.zeros(on.sum())
        for place, strength in lines:
            found = np.maximum(found, strength * np.exp(-(((along - place + curve) / 0.5e-3) ** 2)))
        broken = np.clip(0.9 + 0.25 * noise.field(position, 0.003), 0.3, 1.2)
        depth[on] = found * broken * smoothstep(-0.25, 0.3, at.facing[on])
    return depth


def knuckle_folds(at: Places, noise: Noise) -> Array:
    """Transverse skin folds on the back of the finger joints: arcs around the knuckle, (N,)."""
    depth = np.zeros(len(at.position))
    for f, knuckles in enumerate(at.knuckles):
        for (count, spacing, half, strength), joint in zip(_FOLDS, knuckles[1:3], strict=True):
            away = at.along - (joint - 0.5e-3)
            on = (at.finger == f) & (at.facing < 0.1) & (np.abs(away) < (count + 1) * spacing)
            position = at.position[on]
            beside = np.clip(np.abs(at.across[on]) / half, 0, 1)
            moved = away[on] + 0.4e-3 * noise.field(position, 0.003) + 0.15e-3 * noise.field(position, 0.0012)
            found = np.zeros(on.sum())
            for k in range(-count, count + 1):
                arc = k * spacing * (1 - 0.45 * beside**2)
                weight = strength * np.exp(-0.5 * (k / (0.6 * count)) ** 2) * (1.0 if k % 2 == 0 else 0.65)
                found = np.maximum(found, weight * np.exp(-(((moved - arc) / 0.42e-3) ** 2)))
            broken = np.clip(0.8 + 0.5 * noise.field(position, 0.0025), 0.1, 1.3)
            depth[on] = found * broken * (1 - beside**4) * smoothstep(0.1, -0.4, at.facing[on])
    return depth


def veins(at: Places, noise: Noise, rng: np.random.Generator) -> Array:
    """Soft cords under the skin of the back of the hand and the forearm, (N,)."""
    on = (at.facing < 0.1) & (at.finger < 1)
    depth = np.zeros(len(at.position))
    points = _shaken(at.position[on], noise, 1.6e-3, 0.012)
    found = np.zeros(on.sum())
    for line, strength in _VEINS:
        moved = np.array(line) * 1e-3 + rng.normal(0, 1.5e-3, (len(line), 2))
        found = np.maximum(found, _stroke(points, moved, strength * rng.uniform(0.5, 1.1), 1.7e-3))
    depth[on] = found * smoothstep(0.0, -0.5, at.facing[on])
    return depth


def tendons(at: Places, knuckle_points: Array) -> Array:
    """Ridges of the extensor tendons from the wrist to the four knuckles, (N,); `knuckle_points` (4, 3)."""
    on = (at.facing < 0) & (at.finger < 1)
    depth = np.zeros(len(at.position))
    found = np.zeros(on.sum())
    for point in knuckle_points[:, :2]:
        start = np.array([0.15 * point[0], 0.012])
        line = np.stack([start, 0.55 * start + 0.45 * point, point])
        found = np.maximum(found, _stroke(at.position[on][:, :2], line, 1.0, 2.0e-3))
    depth[on] = found * smoothstep(0.0, -0.5, at.facing[on])
    return depth


def _shaken(position: Array, noise: Noise, amount: float, size: float = 0.006) -> Array:
    """x, y of positions, moved a little at random so that drawn lines waver."""
    shift = np.stack([noise.field(position, size), noise.field(position, size)], axis=1)
    fine = np.stack([noise.field(position, size / 4), noise.field(position, size / 4)], axis=1)
    return position[:, :2] + amount * shift + 0.3 * amount * fine


def _stroke(points: Array, line: Array, strength: float, width: float) -> Array:
    """Depth (N,) at points (N, 2) of a smooth line through (K, 2), thinning out at both ends."""
    knots = np.linspace(0, 1, len(line))
    t = np.linspace(0, 1, 160)
    path = make_interp_spline(knots, line, k=min(3, len(line) - 1))(t)
    inside = ((points > path.min(axis=0) - 3 * width) & (points < path.max(axis=0) + 3 * width)).all(axis=1)
    distance, nearest = cKDTree(path).query(points[inside])
    taper = np.clip(8 * t * (1 - t), 0, 1) ** 0.7
    depth = np.zeros(len(points))
    depth[inside] = strength * taper[nearest] * np.exp(-((distance / width) ** 2))
    return depth
