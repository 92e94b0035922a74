"""An environment as distant lights most of which never change their place: what a known pose is relit by.

The sphere is cut into cells of equal size, once for all maps, each with a light at its middle. Texels whose light
would be moved too far by that are lights of their own. So under another map only those few ask for new shadows;
those of the cells are known.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from ..scene import Array, Environment
from .environment import directions, resize, solid_angles
from .stage import stage_directions

CELLS = 96
"""Cells of the sphere: with 64, smooth skies alone cost 2 % of a picture with hard shadows."""

ENVIRONMENT_ERROR = 0.0025
"""Moved power at which pictures differ by 0.5 % (median; at most 1.6 %) from those of all 512 texels, as measured."""

_ROUNDS = 40
"""Of Lloyd's algorithm, which makes the cells even."""


def spread(environment: Environment, size: tuple[int, int], error: float, cells: int = CELLS) -> tuple[Array, Array]:
    """The map at `size` (rows, columns) as distant lights: unit directions (L, 3), irradiance (L, 3) float64.

    The first `cells` lights are the same for every map of whatever size and may be dark; the others are single texels,
    those that a cell would move most. Moved power m_i = power times distance to the cell's middle; so many texels are
    lights of their own that the root of the sum of the other m_i² is at most `error` times the map's power. The power
    of each colour channel is kept. Raises `InputError` for fewer than 4 cells, or more cells than texels.
    """
    rows, columns = size
    if not 4 <= cells <= rows * columns:
        raise InputError(
            f"environment {environment.name!r}: {cells} cells do not suit a map of {rows}x{columns} texels; "
            f"give 4 to {rows * columns}"
        )
    middle, owner, away = _cells(rows, columns, cells)
    where = directions(rows, columns).reshape(-1, 3)
    radiance = resize(environment, rows, columns).radiance.astype(np.float64)
    power = (radiance * solid_angles(rows, columns)[..., None]).reshape(-1, 3)
    strength = power.sum(axis=1)
    moved = np.square(strength * away)
    order = np.argsort(-moved, kind="stable")
    left = np.append(np.cumsum(moved[order][::-1])[::-1], 0.0)  # once the first n are lights of their own
    alone = order[: int(np.argmax(left <= (error * strength.sum()) ** 2))]
    shared = power.copy()
    shared[alone] = 0.0
    of_cells = np.stack([np.bincount(owner, channel, cells) for channel in shared.T], axis=1)
    return np.concatenate([middle, where[alone]]), np.concatenate([of_cells, power[alone]])


@lru_cache(maxsize=8)
def _cells(rows: int, columns: int, count: int) -> tuple[Array, Array, Array]:
    """Middles (K, 3) of the cells, and for each texel of a map of this size its cell and the distance to its middle.

    The middles are those of the texels of a fine map, so that they do not depend on the size.
    """
    fine, weight = directions(32, 64).reshape(-1, 3), solid_angles(32, 64).ravel()
    middle = stage_directions(count)
    for _ in range(_ROUNDS):
        nearest = cKDTree(middle).query(fine)[1]
        total = np.stack([np.bincount(nearest, weight * axis, count) for axis in fine.T], axis=1)
        middle = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    away, owner = cKDTree(middle).query(directions(rows, columns).reshape(-1, 3))
    return middle, owner, away
