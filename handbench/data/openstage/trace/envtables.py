"""Environment maps on the Dr.Jit side: bright texels to sample by power, and the smooth rest to look up.

Both read texels as constant over their solid angle, as `handbench.light.environment` integrates them, so a
path-traced image and a sum over texels agree without an interpolation error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ....light.environment import solid_angles
from ....scene import Array, Environment

BRIGHT = 2.0
"""Texels this many times brighter than their map's mean are sampled; the others are found by chance."""

_SLOTS = 1 << 12

_CAP = 8.0

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def environment_tables(environments: Sequence[Environment]) -> EnvironmentTables:
    """Tables of the given maps, which may differ in size."""
    shapes, starts, rest = [], [0], []
    counts, firsts, shares, bright = [], [0], [], []
    for environment in environments:
        radiance = environment.radiance.astype(np.float64)
        height, width = radiance.shape[:2]
        above = _bright_mask(radiance)
        shapes.append((height, width))
        starts.append(starts[-1] + height * width)
        rest.append(np.where(above[..., None], 0.0, radiance).reshape(-1, 3))
        for rows, share in _octants(radiance, above):
            bright.append(rows)
            counts.append(len(rows))
            firsts.append(firsts[-1] + len(rows))
            shares.append(share)
    return EnvironmentTables(
        shapes=mi.UInt32(np.ravel(shapes).astype(np.uint32)),
        starts=mi.UInt32(np.array(starts, dtype=np.uint32)),
        rest_texels=mi.Float(np.ravel(np.concatenate([*rest, np.zeros((1, 3))])).astype(np.float32)),
        counts=mi.UInt32(np.array([*counts, 0], dtype=np.uint32)),
        firsts=mi.UInt32(np.array(firsts, dtype=np.uint32)),
        shares=mi.Float(np.array([*shares, 0], dtype=np.float32)),
        rows=mi.Float(np.ravel(np.concatenate([*bright, np.zeros((1, 8))])).astype(np.float32)),
    )


def _bright_mask(radiance: Array) -> Array:
    """Which texels (H, W) stand out of the map's mean."""
    height, width = radiance.shape[:2]
    luminance = radiance @ _LUMINANCE
    mean = (luminance * solid_angles(height, width)).sum() / (4 * np.pi)
    return luminance > BRIGHT * mean


def _octants(radiance: Array, above: Array) -> list[tuple[Array, float]]:
    """Slots and share of the power of the bright texels in each octant of directions.

    Half of the samples follow power, half follow power without its peaks, so a sun leaves some for the sky.
    """
    row, column = np.nonzero(above)
    height, width = radiance.shape[:2]
    flux = radiance[row, column] * solid_angles(height, width)[row, column, None]
    power = flux @ _LUMINANCE
    capped = np.minimum(power, _CAP * power.mean()) if len(power) else power
    share = 0.5 * power / power.sum() + 0.5 * capped / capped.sum() if len(power) else power
    quarter = column * 4 // width  # of the turn, from -z over +x: x > 0 in the first two, z > 0 in the middle two
    octant = (quarter < 2) + 2 * (row * 2 < height) + 4 * ((quarter == 1) | (quarter == 2))
    found = []
    for o in range(8):
        on = octant == o
        found.append((_slots(row[on], column[on], flux[on], share[on]), float(share[on].sum())))
    return found


def _slots(row: Array, column: Array, flux: Array, share: Array) -> Array:
    """Equally likely slots to pick from, (n, 8): row, column, RGB of flux / probability, three zeros.

    A texel owns as many slots as its share asks for, at least one, so its probability is known exactly and one
    gather picks it. Slots follow a Morton curve: stratified picks are then stratified over the sky.
    """
    if len(row) == 0:
        return np.zeros((0, 8))
    order = np.argsort(_interleave(row) << 1 | _interleave(column), kind="stable")
    row, column, flux, share = row[order], column[order], flux[order], share[order]
    owned = np.maximum(1, np.rint(share / share.sum() * _SLOTS).astype(np.int64))
    rows = np.zeros((len(row), 8))
    rows[:, 0], rows[:, 1] = row, column
    rows[:, 2:5] = flux * (owned.sum() / owned)[:, None]
    return np.repeat(rows, owned, axis=0)


def _interleave(values: Array) -> Array:
    """Bits of integers below 2^16 spread to every second place."""
    spread = values.astype(np.int64)
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        spread = (spread | spread << shift) & mask
    return spread


@dataclass(frozen=True)
class EnvironmentTables:
    """Flattened tables of several maps; built by `environment_tables`."""

    shapes: Any
    starts: Any
    rest_texels: Any
    counts: Any
    firsts: Any
    shares: Any
    rows: Any

    def rest(self, map_index: Any, direction: Any) -> Any:
        """Radiance of the smooth part of a map from a direction (unit, towards the sky)."""
        shape = dr.gather(mi.Point2u, self.shapes, map_index)
        row, column = _texel(direction, shape)
        texel = dr.gather(mi.UInt32, self.starts, map_index) + row * shape.y + column
        return dr.gather(mi.Color3f, self.rest_texels, texel)

    def sample_bright(self, map_index: Any, normal: Any, pick: Any, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """A direction to a bright texel, its radiance / probability density, and whether there is one.

        Octants are chosen by power times the greatest cosine to the normal in them, so hardly any below the horizon is.
        """
        weights = []
        for o in range(8):
            sides = [dr.maximum(normal[k] if o >> k & 1 else -normal[k], 0) for k in range(3)]
            cosine = dr.sqrt(sum(side * side for side in sides)) + 0.01  # texels may reach over an octant's edge
            weights.append(cosine * dr.gather(mi.Float, self.shares, map_index * 8 + o))
        total = sum(weights)
        target, chosen, there = pick * total, mi.UInt32(0), mi.Bool(False)
        within, scale = mi.Float(0), mi.Float(0)
        for o, weight in enumerate(weights):
            here = ~there & (target < weight)
            chosen, there = dr.select(here, o, chosen), there | here
            within, scale = dr.select(here, target / weight, within), dr.select(here, total / weight, scale)
            target -= weight
        chosen += map_index * 8
        count = dr.gather(mi.UInt32, self.counts, chosen)
        there &= count > 0
        first = dr.gather(mi.UInt32, self.firsts, chosen)
        slot = 2 * (first + dr.minimum(mi.UInt32(within * mi.Float(count)), dr.select(there, count - 1, 0)))
        head = dr.gather(mi.Vector4f, self.rows, slot, there)
        tail = dr.gather(mi.Vector4f, self.rows, slot + 1, there)
        shape = mi.Vector2f(dr.gather(mi.Point2u, self.shapes, map_index))
        top, bottom = dr.cos(dr.pi * head.x / shape.x), dr.cos(dr.pi * (head.x + 1) / shape.x)
        y = dr.lerp(top, bottom, v)
        towards = _direction((head.y + u) / shape.y, y)
        radiance: Any = mi.Color3f(head.z, head.w, tail.x)
        return towards, radiance * scale, there


def _direction(turn: Any, y: Any) -> Any:
    """Unit direction at a fraction of the map's width and a height y; the inverse of `_texel`."""
    sine, cosine = dr.sincos(dr.two_pi * turn)
    radius = dr.safe_sqrt(1 - y * y)
    return mi.Vector3f(radius * sine, y, -radius * cosine)


def _texel(direction: Any, shape: Any) -> tuple[Any, Any]:
    """Row and column of the texel a direction falls in; `shape` is (height, width)."""
    turn = dr.atan2(direction.x, -direction.z) * dr.inv_two_pi
    turn -= dr.floor(turn)
    row = mi.UInt32(dr.safe_acos(direction.y) * dr.inv_pi * mi.Float(shape.x))
    column = mi.UInt32(turn * mi.Float(shape.y))
    return dr.minimum(row, shape.x - 1), dr.minimum(column, shape.y - 1)
