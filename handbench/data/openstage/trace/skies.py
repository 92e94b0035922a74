"""Environment maps as the tracer needs them: bright texels to aim at, the smooth rest, and unshadowed irradiance.

Texels are constant over their solid angle, as `handbench.light.environment` integrates them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from ....light.environment import directions, places, resize, solid_angles, texels
from ....scene import Array, Environment
from .gloss import dot, reflected

BRIGHT = 2.0
"""Texels this many times brighter than their map's mean are aimed at; the others are found by chance."""

REFERENCE_ROUGHNESS = 0.45
"""What of a map enters skin depends a little on its roughness; tables are made for this one."""

_SLOTS, _CAP = 1 << 12, 8.0
_TABLE = (64, 128)
_REST = (32, 64)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True, eq=False)
class Sky:
    """One map: rest and bright (H, W, 3) add up to its radiance; density (H, W) of what `aim` finds, per steradian.

    slots (n, 12): of equally likely bright texels the direction to the middle and the steps over the texel to the
    right and down, then RGB of radiance / probability density.
    enters (64, 128, 2, 3): light that enters an unshadowed surface of each normal, from the rest and from the bright
    texels; turns (64, 128, 2, 3, 3): how it grows as the normal turns to x, y, z.
    """

    rest: Array
    bright: Array
    density: Array
    slots: Array
    enters: Array
    turns: Array

    def aim(self, pick: Array, u: Array, v: Array) -> tuple[Array, Array]:
        """Directions (N, 3) to bright texels, chosen by power, and radiance / probability density (N, 3)."""
        slot = self.slots[np.minimum((pick * len(self.slots)).astype(np.int32), len(self.slots) - 1)]
        direction = slot[:, :3] + (u - 0.5)[:, None] * slot[:, 3:6] + (v - 0.5)[:, None] * slot[:, 6:9]
        return direction / np.sqrt(dot(direction, direction))[:, None], slot[:, 9:]

    def unshadowed(self, normals: Array) -> tuple[Array, Array]:
        """`enters` (N, 2, 3) and `turns` (N, 2, 3, 3) at unit normals (N, 3)."""
        height, width = _TABLE
        row, column = (place - 0.5 for place in places(normals, height, width))
        padded = np.concatenate([self.enters[:, -1:], self.enters, self.enters[:, :1]], axis=1).reshape(height, -1, 6)
        at = np.stack([row, column + 1])
        enters = np.stack([map_coordinates(padded[..., k], at, order=1, mode="nearest") for k in range(6)], axis=1)
        return enters.reshape(-1, 2, 3), self.turns[texels(normals, height, width)]


def sky(environment: Environment, specular: float) -> Sky:
    """The tables of a map for surfaces of a specular reflectance."""
    radiance = environment.radiance.astype(np.float64)
    finer = max(1, -(-_REST[0] // radiance.shape[0]))
    radiance = radiance.repeat(finer, axis=0).repeat(finer, axis=1)
    height, width = radiance.shape[:2]
    solid = solid_angles(height, width)
    luminance = radiance @ _LUMINANCE
    above = luminance > BRIGHT * (luminance * solid).sum() / (4 * np.pi)
    rest = np.where(above[..., None], 0.0, radiance)
    parts = ((rest, _REST), (radiance - rest, (min(height, _TABLE[0]), min(width, _TABLE[1]))))
    found = [_irradiance(resize(Environment(environment.name, part), *size), specular) for part, size in parts]
    enters, turns = (np.stack([each[k] for each in found], axis=2) for k in range(2))
    row, column, owned = _slots(radiance, above, solid)
    density = np.zeros((height, width), np.float32)
    density[row, column] = owned / max(owned.sum(), 1) / solid[row, column]
    rgb = radiance[row, column] / np.maximum(density[row, column, None], 1e-30)
    ways = np.concatenate([*_texel_frames(row, column, height, width), rgb], axis=1).astype(np.float32)
    bright = (radiance - rest).astype(np.float32)
    return Sky(rest.astype(np.float32), bright, density, np.repeat(ways, owned, axis=0), enters, turns)


def _irradiance(part: Environment, specular: float) -> tuple[Array, Array]:
    """Light of a map that enters (64, 128, 3), and its gradient (64, 128, 3 channels, 3 axes)."""
    tables, normals = reflected(specular), directions(*_TABLE)
    size = part.radiance.shape[:2]
    lit = part.radiance.any(axis=2)
    towards, flux = directions(*size)[lit], (part.radiance * solid_angles(*size)[..., None])[lit]
    enters, turns = np.zeros((*_TABLE, 3)), np.zeros((*_TABLE, 3, 3))
    vectors = (flux[:, :, None] * towards[:, None, :]).reshape(-1, 9)
    for row in range(_TABLE[0]):
        cosine = np.maximum(np.einsum("wc,nc->wn", normals[row], towards), 0.0)
        entering = cosine * (1 - tables.at(cosine, np.array(REFERENCE_ROUGHNESS)))
        enters[row] = np.einsum("wn,nc->wc", entering, flux)
        turns[row] = np.einsum("wn,nc->wc", (cosine > 0).astype(float), vectors).reshape(-1, 3, 3)
    return enters, turns * (1 - tables.mean(np.array(REFERENCE_ROUGHNESS)))


def _slots(radiance: Array, above: Array, solid: Array) -> tuple[Array, Array, Array]:
    """Row and column of the bright texels, along a Morton curve, and how many of the equally likely slots each owns.

    Stratified picks are then stratified in the sky. A texel owns as many slots as its share asks for, at least one, so
    its probability is known exactly. Half of the slots follow power, half follow power without its peaks, so a sun
    leaves some for the sky.
    """
    row, column = np.nonzero(above)
    order = np.argsort(_interleave(row) << 1 | _interleave(column), kind="stable")
    row, column = row[order], column[order]
    if len(row) == 0:
        return row, column, np.zeros(0, np.int64)
    power = (radiance[row, column] * solid[row, column, None]) @ _LUMINANCE
    capped = np.minimum(power, _CAP * power.mean())
    share = 0.5 * power / power.sum() + 0.5 * capped / capped.sum()
    return row, column, np.maximum(1, np.rint(share * _SLOTS).astype(np.int64))


def _texel_frames(row: Array, column: Array, height: int, width: int) -> tuple[Array, Array, Array]:
    """Directions (n, 3) to the middles of texels, and the steps over them to the right and down."""
    polar, turn = (row + 0.5) * np.pi / height, (column + 0.5) * 2 * np.pi / width
    sine, cosine, zero = np.sin(polar), np.cos(polar), np.zeros(len(row))
    middle = np.stack([sine * np.sin(turn), cosine, -sine * np.cos(turn)], axis=1)
    right = np.stack([sine * np.cos(turn), zero, sine * np.sin(turn)], axis=1) * (2 * np.pi / width)
    down = np.stack([cosine * np.sin(turn), -sine, -cosine * np.cos(turn)], axis=1) * (np.pi / height)
    return middle, right, down


def _interleave(values: Array) -> Array:
    """Bits of integers below 2^16 spread to every second place."""
    spread = values.astype(np.int64)
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        spread = (spread | spread << shift) & mask
    return spread
