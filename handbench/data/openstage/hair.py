"""Hair on the back of hand, fingers and forearm: single strands, drawn into the texture where they lie."""

from __future__ import annotations

import numpy as np

from ...scene import Array
from .places import Places, smoothstep

_STRANDS = 4200  # that a very hairy person has here
_WIDTH = 0.07e-3  # metres
_STEPS = 14  # points of a strand


def hair(at: Places, amount: float, rng: np.random.Generator) -> Array:
    """Share of a texel that strands cover, (N,) in [0, 1]; `amount` 0 (none) … 1 (very hairy)."""
    roots = _roots(at, amount, rng)
    if not len(roots):
        return np.zeros(len(at.position), np.float32)
    strands = _strands(at, roots, rng)
    texel = at.atlas.texels[at.tree.query(strands.reshape(-1, 3))[1]].reshape(strands.shape[:2])
    place = np.stack([texel // at.atlas.size, texel % at.atlas.size], axis=2).astype(np.float64)
    place[:, 1:-1] = 0.25 * place[:, :-2] + 0.5 * place[:, 1:-1] + 0.25 * place[:, 2:]  # points snap to texels: smooth
    return _drawn(at, place, np.linalg.norm(np.diff(strands, axis=1), axis=2))


def _roots(at: Places, amount: float, rng: np.random.Generator) -> Array:
    """Texels that a hair grows from: dense on the forearm, the little-finger side and the first finger bones."""
    drawn = rng.choice(len(at.position), int(_STRANDS * amount))
    x, y = at.position[drawn, 0], at.position[drawn, 1]
    finger, along = at.finger[drawn], at.along[drawn]
    back = smoothstep(0.25, -0.35, at.facing[drawn])
    arm = (0.12 + 0.88 * back) * smoothstep(0.0, -0.035, y)
    hand = back * smoothstep(-0.04, -0.01, y) * (0.25 + 0.75 * smoothstep(0.02, -0.03, x)) * smoothstep(0.08, 0.06, y)
    bone = np.where(finger > 0, at.knuckles[finger, 1], at.knuckles[0, 1])
    middle = np.exp(-(((along / bone - 0.55) / 0.22) ** 2)) * back
    density = np.where(finger > 0, 0.55 * middle, np.where(finger == 0, 0.2 * middle, np.maximum(arm, 0.6 * hand)))
    return drawn[rng.random(len(drawn)) < density * (at.nail[drawn] < 0.01)]


def _strands(at: Places, roots: Array, rng: np.random.Generator) -> Array:
    """Points (M, _STEPS, 3) along each hair: it leaves to the tips and the little-finger side, and bends."""
    root, normal, finger = at.position[roots], at.normal[roots], at.finger[roots]
    arm = smoothstep(0.0, -0.03, root[:, 1])[:, None]
    way = arm * np.array([-0.8, 0.45, -0.1]) + (1 - arm) * np.array([-0.65, 0.75, 0.0])
    way = np.where((finger > 0)[:, None], np.array([-0.25, 1.0, 0.0]), way)
    swirl = np.sin(2 * np.pi * (root @ rng.normal(0, 12, (3, 3)) + rng.random(3)))
    way = way + 0.3 * swirl + rng.normal(0, 0.22, root.shape)
    way -= (way * normal).sum(axis=1, keepdims=True) * normal
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    side = np.cross(normal, way)
    longest = np.where(finger >= 0, 5.5e-3, np.where(root[:, 1] > 0, 8e-3, 15e-3))
    length = longest * rng.uniform(0.45, 1.1, len(roots))
    bend = rng.normal(0, 0.22, len(roots)) + 0.15
    t = np.linspace(0, 1, _STEPS)[None, :, None]
    return root[:, None] + length[:, None, None] * (t * way[:, None] + bend[:, None, None] * t**2 * side[:, None])


def _drawn(at: Places, place: Array, reach: Array) -> Array:
    """Coverage (N,) of lines through texel coordinates place (M, K, 2) whose pieces are reach (M, K - 1) metres."""
    size = at.atlas.size
    step = np.diff(place, axis=1)
    whole = np.linalg.norm(step, axis=2) < 3 * reach / at.texel + 2  # a piece that crosses a seam is left out
    start, step = place[:, :-1][whole], step[whole]
    taper = np.broadcast_to(1 - 0.6 * np.linspace(0, 1, place.shape[1] - 1) ** 2, whole.shape)[whole]
    parts = max(2, int(np.ceil(1.5 * np.median(reach) / at.texel)))
    found = np.zeros(size * size)
    weight = taper * reach[whole] / parts * _WIDTH / at.texel**2
    for part in range(parts):
        point = start + step * ((part + 0.5) / parts)
        corner = np.floor(point).astype(np.int64)
        down, right = (point - corner).T
        for i, j, share in (
            (0, 0, (1 - down) * (1 - right)),
            (0, 1, (1 - down) * right),
            (1, 0, down * (1 - right)),
            (1, 1, down * right),
        ):
            row, column = np.minimum(corner[:, 0] + i, size - 1), np.minimum(corner[:, 1] + j, size - 1)
            found += np.bincount(row * size + column, weight * share, size * size)
    return np.clip(found[at.atlas.texels], 0, 1).astype(np.float32)
