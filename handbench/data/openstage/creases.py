"""Lines of the hand: flexion creases of palm and fingers, folds over the knuckles, wrist lines.

Each function returns values per texel in [0, 1] or so: how deep a line is there. Palm lines are splines through
points of the neutral hand seen from the palm (x to the thumb side, y to the finger tips, metres).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial import cKDTree

from ...scene import Array
from .noise import NoiseFields
from .places import Places, smoothstep

_Line = tuple[tuple[tuple[float, float], ...], float, float]

_FATE = 0.3
# The three great lines and lesser ones: points in mm, depth, width in metres.
_PALM_LINES: tuple[_Line, ...] = (
    # life (thenar crease): around the ball of the thumb
    (((40, 73), (31, 70), (22, 63), (14.5, 53), (10, 41), (8.5, 28), (10.5, 15)), 1.0, 0.8e-3),
    # head (proximal transverse)
    (((39, 74.5), (28, 72.5), (16, 67), (3, 59.5), (-10, 52.5), (-21, 48), (-29, 45)), 0.9, 0.75e-3),
    # heart (distal transverse)
    (((-41, 63.5), (-31, 66.5), (-20, 68.5), (-8, 71), (4, 76), (11, 82), (14, 89)), 1.0, 0.8e-3),
    # fate, faint
    (((2, 20), (2.5, 33), (1, 47), (0, 60), (1, 70)), _FATE, 0.5e-3),
    # wrist (bracelet) lines
    (((-27, 0.5), (-14, -2.5), (0, -3), (13, -1.5), (24, 2)), 0.6, 0.6e-3),
    (((-27, -6.5), (-12, -9), (2, -9.5), (14, -8), (24, -5)), 0.4, 0.6e-3),
)

_FOLDS = (  # dorsal folds of a joint: number on either side, spacing, half width, depth; by joint, middle and end
    (4, 1.5e-3, 8.0e-3, 1.0),
    (3, 1.2e-3, 6.0e-3, 0.7),
)


def palm_lines(at: Places, noise: NoiseFields, rng: np.random.Generator) -> Array:
    """The great lines and many small ones, (N,): everybody's start, end, bend and break elsewhere."""
    depth = np.zeros(len(at.position), np.float32)
    on = np.flatnonzero((at.facing > -0.1) & (at.finger < 1) & (at.position[:, 1] > -0.02))
    shift, fine = noise.fields(at.position[on], 6e-3), noise.fields(at.position[on], 1.5e-3, 2)
    points = at.position[on, :2] + 0.5e-3 * shift[:2].T + 0.15e-3 * fine.T
    found = np.zeros(len(on), np.float32)
    fate = rng.random() < 0.5
    for way, strength, width in _PALM_LINES:
        line = np.array(way)
        line = line[0] + (line - line[0]) * rng.uniform(0.85, 1.12) + rng.normal(0, 1.6, 2)
        line += np.cumsum(rng.normal(0, 0.7, line.shape), axis=0)
        strength *= rng.uniform(0.75, 1.15) * (2.2 if strength == _FATE and fate else 1.0)
        found = np.maximum(found, stroke(points, line * 1e-3, strength, width))
        if rng.random() < 0.6:  # a companion that runs beside it for a while
            part = line[rng.integers(0, 2) :][: rng.integers(3, 5)] + rng.normal(0, 1.8, 2)
            found = np.maximum(found, stroke(points, part * 1e-3, 0.45 * strength, 0.7 * width))
    for _ in range(rng.integers(35, 90)):
        start = rng.uniform((-0.035, 0.012), (0.032, 0.09))
        angle = rng.choice([0.3, 1.2, 2.2, 2.7], p=[0.3, 0.2, 0.2, 0.3]) + rng.normal(0, 0.3)
        reach = rng.uniform(0.003, 0.012)
        bend = angle + rng.normal(0, 0.3)
        middle = start + reach * np.array([np.cos(angle), np.sin(angle)])
        line = np.array([start, middle, middle + reach * np.array([np.cos(bend), np.sin(bend)])])
        found = np.maximum(found, stroke(points, line, rng.uniform(0.1, 0.4), 0.4e-3))
    fade = smoothstep(-0.1, 0.35, at.facing[on])
    depth[on] = found * fade * np.clip(0.85 + 0.3 * shift[2], 0.3, 1.2)
    return depth


def finger_lines(at: Places, noise: NoiseFields, rng: np.random.Generator) -> Array:
    """Flexion creases on the palm side of fingers and thumb, (N,)."""
    depth = np.zeros(len(at.position), np.float32)
    for f, knuckles in enumerate(at.knuckles):
        on = np.flatnonzero((at.finger == f) & (at.facing > -0.25))
        position = at.position[on]
        first, middle, end, _ = knuckles
        lines = [(middle - 0.9e-3, 0.9), (middle + 1.1e-3, 0.75), (middle - 2.8e-3, 0.3), (end, 0.85)]
        lines.append((end + 1.8e-3, 0.3))
        if f:  # fingers also have a crease where they leave the palm
            base = middle - 0.52 * (middle - first)
            lines += [(base, 0.9), (base + 2.2e-3, 0.45), (base - 1.8e-3, 0.25)]
        lines += [(rng.uniform(middle - 8e-3, end + 4e-3), rng.uniform(0.05, 0.2)) for _ in range(5)]
        slow, quick, breaks = noise.fields(position, 0.005, 3)
        along = at.along[on] + 0.35e-3 * slow + 0.12e-3 * noise.field(position, 0.0015)
        found = np.zeros(len(on), np.float32)
        for place, strength in lines:
            lean = rng.normal(0, 0.05) * at.across[on] + rng.uniform(0.02, 0.16) * np.abs(at.across[on])
            away = (along - place - rng.normal(0, 0.35e-3) + lean) / rng.uniform(0.36e-3, 0.55e-3)
            found = np.maximum(found, strength * rng.uniform(0.7, 1.1) * np.exp(-(away**2)))
        broken = np.clip(0.9 + 0.2 * breaks + 0.15 * quick, 0.3, 1.2)
        depth[on] = found * broken * smoothstep(-0.25, 0.3, at.facing[on])
    return depth


def knuckle_folds(at: Places, noise: NoiseFields, rng: np.random.Generator) -> Array:
    """Transverse skin folds on the back of the finger joints: arcs around the knuckle, (N,)."""
    depth = np.zeros(len(at.position), np.float32)
    for f, knuckles in enumerate(at.knuckles):
        for (count, spacing, half, strength), joint in zip(_FOLDS, knuckles[1:3], strict=True):
            away = at.along - (joint - 0.5e-3 + rng.normal(0, 0.5e-3))
            on = np.flatnonzero((at.finger == f) & (at.facing < 0.1) & (np.abs(away) < (count + 1) * spacing))
            position = at.position[on]
            beside = np.clip(np.abs(at.across[on]) / half, 0, 1)
            slow, breaks = noise.fields(position, 0.0028, 2)
            moved = away[on] + 0.45e-3 * slow + 0.16e-3 * noise.field(position, 0.0011)
            found = np.zeros(len(on), np.float32)
            for k in range(-count, count + 1):
                arc = k * spacing * rng.uniform(0.9, 1.1) * (1 - rng.uniform(0.3, 0.55) * beside**2)
                weight = strength * np.exp(-0.5 * (k / (0.65 * count)) ** 2) * rng.uniform(0.5, 1.1)
                wide = rng.uniform(0.26e-3, 0.45e-3)
                found = np.maximum(found, weight * np.exp(-(((moved - arc) / wide) ** 2)))
            broken = np.clip(0.8 + 0.5 * breaks, 0.1, 1.3)
            depth[on] = found * broken * (1 - beside**4) * smoothstep(0.1, -0.4, at.facing[on])
    return depth


def stroke(points: Array, line: Array, strength: float, width: float) -> Array:
    """Depth (N,) at points (N, D) of a smooth line through (K, D), thinning out at both ends."""
    knots = np.linspace(0, 1, len(line))
    t = np.linspace(0, 1, max(40, int(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() / (0.25 * width))))
    path = make_interp_spline(knots, line, k=min(3, len(line) - 1))(t)
    inside = np.arange(len(points))
    for axis, (low, high) in enumerate(zip(path.min(0) - 3 * width, path.max(0) + 3 * width, strict=True)):
        inside = inside[(points[inside, axis] > low) & (points[inside, axis] < high)]
    distance, nearest = cKDTree(path).query(points[inside], distance_upper_bound=3 * width)
    near = np.isfinite(distance)
    taper = np.clip(8 * t * (1 - t), 0, 1) ** 0.7
    depth = np.zeros(len(points), np.float32)
    depth[inside[near]] = strength * taper[nearest[near]] * np.exp(-((distance[near] / width) ** 2))
    return depth
