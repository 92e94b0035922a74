"""Any light as a list of directions and positions: the form in which shading sums it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import Array, Directional, Environment, Light, Point, leaves
from .environment import to_directional


@dataclass(frozen=True)
class LightSet:
    """L distant lights: unit directions (L, 3), irradiance (L, 3); P near ones: positions (P, 3), intensities (P, 3).

    Rows of visibility belong to the distant lights first, then to the near ones. To differentiate in the
    irradiance or the intensities, give them as torch tensors; shading takes both.
    """

    directions: Array
    irradiance: Array
    positions: Array
    intensities: Array

    def __len__(self) -> int:
        return len(self.directions) + len(self.positions)


def light_samples(light: Light, environment_size: tuple[int, int] = (16, 32)) -> LightSet:
    """A light as distant and near lights, in float64; those without power are left out.

    Environments are reduced to `environment_size` texels (rows, columns; URHand uses 16 x 32) with their
    power kept, one distant light a texel.
    """
    distant: list[tuple[Array, Array]] = []
    near: list[tuple[Array, Array]] = []
    for leaf in leaves(light):
        if isinstance(leaf, Environment):
            distant.append(to_directional(leaf, *environment_size))
        elif isinstance(leaf, Directional):
            distant.append((leaf.direction[None], leaf.irradiance[None]))
        elif isinstance(leaf, Point):
            near.append((leaf.position[None], leaf.intensity[None]))
    return LightSet(*_lit(distant), *_lit(near))


def _lit(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    where = np.concatenate([part[0] for part in parts]) if parts else np.zeros((0, 3))
    power = np.concatenate([part[1] for part in parts]) if parts else np.zeros((0, 3))
    lit = power.any(axis=1)
    return where[lit], power[lit]
