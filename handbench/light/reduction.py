"""An environment as few distant lights: as many as are asked for, or as few as an error allows.

Texels are clustered by direction: the cluster that spreads most, weighted by power, is cut in two until there are
enough (variance minimisation, Viriyothai and Debevec 2009, in three dimensions), then centres and clusters are
improved in turn (Lloyd 1982). A cluster becomes one light at its mean direction with its whole power. On ten HDR
maps its error is about half of that of median cut (Debevec 2005) at an equal number of lights, and on a hand with
shadows 128 of its lights do less wrong than the 512 texels of a map at 16 x 32 (measured on six).
Errors are those of the irradiance of unshadowed surfaces of every orientation.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from ..scene import Array, Environment
from .environment import directions, solid_angles, to_directional
from .stage import stage_directions

_BLOCKS = (64, 128)
"""Larger maps are clustered in this many blocks of texels (rows, columns), or more for many lights."""

_BLOCKS_PER_LIGHT = 8

_ROUNDS = 20
"""Of Lloyd's algorithm at most; the error hardly falls after ten."""

_PAIRS = 1 << 17
"""Texel-normal pairs in a tile: 1 MB."""

_NORMALS = stage_directions(1024)[:512]
"""Half of the sphere: the other half has the opposite normals."""


@dataclass(frozen=True, eq=False)
class Reduction:
    """Distant lights that stand for a map: unit directions (K, 3), irradiance (K, 3) float64, and what they miss.

    error   relative RMS error of the irradiance over 1,024 well-spread normals and the colour channels, measured
    bound   a bound of the same that is proven: power-weighted distances of texels to their lights
    """

    directions: Array
    irradiance: Array
    error: float
    bound: float

    def __len__(self) -> int:
        return len(self.directions)


def reduced(environment: Environment, lights: int) -> tuple[Array, Array]:
    """The map as at most `lights` distant lights: unit directions (K, 3) and irradiance (K, 3) float64.

    K is the lesser of `lights` and the number of lit texels; then every lit texel is a light, exactly. The power of
    each colour channel is kept. A map without light gives no lights. Raises `InputError` if `lights` is below 1.
    """
    return _reduce(environment, lights)[:2]


def reduced_to(environment: Environment, error: float) -> Reduction:
    """The map as few lights whose measured error (see `Reduction`) is at most `error`.

    No number of lights that was tried and is smaller met the error; the search stops within a tenth. An error of 0
    gives every lit texel. Raises `InputError` for an error that is negative or NaN.
    """
    if not error >= 0.0:
        raise InputError(f"environment {environment.name!r}: an error of {error} cannot be met; give 0 or more")
    expected = irradiance_of(*_texel_lights(environment))
    failed, lights = 0, 1
    found = _measured(environment, lights, expected)
    while found.error > error:
        failed, lights = lights, 2 * lights
        found = _measured(environment, lights, expected)
    lights = len(found)
    while lights - failed > max(1, failed // 10):
        middle = (failed + lights) // 2
        other = _measured(environment, middle, expected)
        if other.error > error:
            failed = middle
        else:
            found, lights = other, middle
    return found


def irradiance_of(towards: Array, irradiance: Array) -> Array:
    """Irradiance (1024, 3) float64 on well-spread normals, the last half opposite to the first, without shadows.

    From unit directions (L, 3) and irradiance (L, 3) of distant lights. max(0, -c) = max(0, c) - c saves half.
    """
    total = np.zeros((len(_NORMALS), 3))
    step = _PAIRS // len(_NORMALS)
    for first in range(0, len(towards), step):
        cosines = _NORMALS @ towards[first : first + step].T
        total += np.maximum(cosines, 0.0, out=cosines) @ irradiance[first : first + step]
    return np.concatenate([total, np.maximum(total - _NORMALS @ (towards.T @ irradiance), 0.0)])


def _measured(environment: Environment, lights: int, expected: Array) -> Reduction:
    towards, irradiance, bound = _reduce(environment, lights)
    size = np.sqrt(np.mean(np.square(expected)))
    if size == 0.0 or bound == 0.0:
        return Reduction(towards, irradiance, 0.0, 0.0)
    error = np.sqrt(np.mean(np.square(irradiance_of(towards, irradiance) - expected)))
    return Reduction(towards, irradiance, float(error / size), float(bound / size))


def _texel_lights(environment: Environment) -> tuple[Array, Array]:
    """Every lit texel as a light."""
    return to_directional(environment, *environment.radiance.shape[:2])


def _reduce(environment: Environment, lights: int) -> tuple[Array, Array, float]:
    """Directions and irradiance of the lights, and the greatest RMS over the colours of the error of irradiance.

    |max(0, n.a) - max(0, n.b)| <= |a - b| for every normal n, so what a cluster's light c does wrong is at most the
    sum of |a - c| over its texels a, each times its power.
    """
    if lights < 1:
        raise InputError(f"environment {environment.name!r}: {lights} lights are too few; ask for at least 1")
    width = environment.radiance.shape[1]
    lit = int(np.count_nonzero(environment.radiance.any(axis=2)))
    if lights >= lit:
        return *_texel_lights(environment), 0.0
    rows, columns, blocks = _blocks(environment, _BLOCKS_PER_LIGHT * lights)
    on = blocks[:, :3].any(axis=1)
    found = _clusters(blocks[on, 3:], blocks[on, :3].sum(axis=1), lights)
    towards, irradiance = _lights_of(found, blocks[on], lights)
    labels = np.full((rows.size, columns.size), -1)
    labels[on.reshape(labels.shape)] = found
    column_block = np.repeat(np.arange(columns.size), np.diff(columns, append=width))
    moved = np.zeros(3)
    for block, (texels, power) in enumerate(_bands(environment, rows)):
        away = np.linalg.norm(texels - towards[labels[block, column_block]], axis=2)
        moved += np.einsum("ij,ijc->c", away, power)
    return towards, irradiance, float(np.sqrt(np.mean(np.square(moved))))


def _bands(environment: Environment, rows: Array) -> Iterator[tuple[Array, Array]]:
    """Directions and powers (h, W, 3) of the texels between one row of `rows` and the next, band by band."""
    height, width = environment.radiance.shape[:2]
    solid = solid_angles(height, 1) / width
    for first, last in zip(rows, [*rows[1:], height], strict=True):
        band = slice(first, last)
        yield directions(height, width, band), environment.radiance[band].astype(np.float64) * solid[band, :, None]


def _blocks(environment: Environment, enough: int) -> tuple[Array, Array, Array]:
    """First rows and first columns of blocks of texels, and for each block its power (3) and mean direction (3).

    The blocks are single texels in a small map, or where there would not be `enough` lit ones otherwise.
    """
    size = environment.radiance.shape[:2]
    parts = tuple(min(a, b) for a, b in zip(size, _BLOCKS, strict=True))
    while True:
        rows, columns = (np.arange(part) * whole // part for part, whole in zip(parts, size, strict=True))
        sums = np.empty((*parts, 6))
        for block, (towards, power) in enumerate(_bands(environment, rows)):
            weighted = towards * power.sum(axis=2, keepdims=True)
            for some, values in ((slice(0, 3), power), (slice(3, 6), weighted)):
                sums[block, :, some] = np.add.reduceat(values.sum(axis=0), columns, axis=0)
        flat = sums.reshape(-1, 6)
        if parts == size or np.count_nonzero(flat[:, :3].any(axis=1)) >= enough:
            break
        parts = tuple(min(a, 2 * b) for a, b in zip(size, parts, strict=True))
    flat[:, 3:] /= np.maximum(flat[:, :3].sum(axis=1, keepdims=True), np.finfo(float).tiny)
    return rows, columns, flat


def _lights_of(labels: Array, blocks: Array, count: int) -> tuple[Array, Array]:
    """Unit mean direction and power of each cluster of blocks (N, 6)."""
    power = np.stack([np.bincount(labels, values, count) for values in blocks[:, :3].T], axis=1)
    weighted = blocks[:, 3:] * blocks[:, :3].sum(axis=1, keepdims=True)
    mean = np.stack([np.bincount(labels, values, count) for values in weighted.T], axis=1)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0])  # light from all around has no direction
    return np.where(length > 1e-9 * power.sum(axis=1, keepdims=True), mean / np.maximum(length, 1e-300), up), power


def _clusters(points: Array, weights: Array, count: int) -> Array:
    """Labels (N) in 0 .. count - 1 of weighted points (N, 3), each used; count <= N."""
    weights = weights / weights.max()
    labels = _cut(points, weights, count)
    blocks = np.concatenate([np.repeat(weights[:, None] / 3.0, 3, axis=1), points], axis=1)
    for _ in range(_ROUNDS):
        _, nearest = cKDTree(_lights_of(labels, blocks, count)[0]).query(points)
        if (nearest == labels).all() or len(np.unique(nearest)) < count:
            break
        labels = nearest
    return labels


def _cut(points: Array, weights: Array, count: int) -> Array:
    """Labels after cutting the cluster of greatest weighted variance in two until there are `count`."""

    def node(members: Array) -> tuple[float, int, Array, Array]:
        weight = weights[members, None]
        offset = points[members] - (weight * points[members]).sum(axis=0) / weight.sum()
        spread = offset.T @ (weight * offset)
        cost = max(np.trace(spread), np.finfo(float).tiny) if len(members) > 1 else 0.0
        return -cost, int(members[0]), members, offset @ np.linalg.eigh(spread)[1][:, -1]

    heap = [node(np.arange(len(points)))]
    while len(heap) < count:
        _, _, members, along = heapq.heappop(heap)
        order = np.argsort(along, kind="stable")
        weight, along = weights[members[order]], along[order]
        # the cut that leaves the least variance on both sides; sums from either end, so that nothing cancels
        left, right = (np.cumsum(weight[::s])[:-1][::s] for s in (1, -1))
        first, last = (np.cumsum((weight * along)[::s])[:-1][::s] for s in (1, -1))
        where = int(np.argmax(first * first / left + last * last / right)) + 1
        for part in (members[order[:where]], members[order[where:]]):
            heapq.heappush(heap, node(np.sort(part)))
    labels = np.empty(len(points), dtype=np.int64)
    for label, (_, _, members, _) in enumerate(heap):
        labels[members] = label
    return labels
