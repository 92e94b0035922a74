"""Any light as a list of directions and positions: the form in which shading sums it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never

import numpy as np

from ..scene import Array, Directional, Environment, Light, Point, known_leaves
from ..skips import note, skips
from .environment import to_directional
from .reduction import reduced
from .spread import CELLS, spread

_BILLION = 10**9


@dataclass(frozen=True)
class LightSet:
    """L distant lights: unit directions (L, 3), irradiance (L, 3); P near ones: positions (P, 3), intensities (P, 3).

    Rows of visibility belong to the distant lights first, then to the near ones. To differentiate in the
    irradiance or the intensities, give them as torch tensors; shading takes both.

    of_map (L,) bool: distant lights that are one of the few of an environment; coarse (L,) bool: those of them that
    stand for a cell of it each, so that their shadows need not be sharp. None: there are none.
    """

    directions: Array
    irradiance: Array
    positions: Array
    intensities: Array
    of_map: Array | None = None
    coarse: Array | None = None

    def __len__(self) -> int:
        return len(self.directions) + len(self.positions)

    def only(self, distant: Array, near: Array | None = None) -> LightSet:
        """The distant lights (L,) bool and the near ones (P,) bool that are chosen; None: all near ones."""
        chosen = slice(None) if near is None else near
        kinds = (None if kind is None else kind[distant] for kind in (self.of_map, self.coarse))
        near_ones = self.positions[chosen], self.intensities[chosen]
        return LightSet(self.directions[distant], self.irradiance[distant], *near_ones, *kinds)


def light_samples(
    light: Light,
    environment_size: tuple[int, int] = (16, 32),
    environment_lights: int | None = None,
    environment_error: float = 0.0,
) -> LightSet:
    """A light as distant and near lights, in float64; groups are opened in order.

    Environments are reduced to `environment_size` texels (rows, columns; URHand uses 16 x 32) with their power kept,
    one distant light a texel; or those to as few as `environment_error` allows, most of them the same for every map
    (`spread`); or the map to at most `environment_lights` lights where the light is (`reduced`).
    Lights without power are left out, and with `Skips.faint_lights` the faintest distant ones too: what is admitted
    is noted in billionths of their power. Near lights are never faint: how far away they are decides.
    Raises `Unsupported` for an unknown light.
    """
    distant: list[tuple[Array, Array]] = []
    of_map, coarse = [np.zeros(0, dtype=bool)], [np.zeros(0, dtype=bool)]
    few = environment_lights is None and environment_error > 0.0
    near: list[tuple[Array, Array]] = []
    for leaf in known_leaves(light):
        match leaf:
            case Environment():
                distant.append(_environment(leaf, environment_size, environment_lights, environment_error))
                count = len(distant[-1][0])
                of_map.append(np.full(count, few))
                coarse.append(np.arange(count) < (CELLS if few else 0))
            case Directional():
                distant.append((leaf.direction[None], leaf.irradiance[None]))
                of_map.append(np.zeros(1, dtype=bool))
                coarse.append(np.zeros(1, dtype=bool))
            case Point():
                near.append((leaf.position[None], leaf.intensity[None]))
            case _:
                assert_never(leaf)
    found = LightSet(*_joined(distant), *_joined(near), np.concatenate(of_map), np.concatenate(coarse))
    if skips().dark_lights:
        lit = found.only(np.asarray(found.irradiance.any(axis=1)), np.asarray(found.intensities.any(axis=1)))
        note("lights", len(found), len(found) - len(lit))
        found = lit
    if skips().faint_lights > 0.0:
        found = found.only(_not_faint(found.irradiance, skips().faint_lights))
    return found


def _environment(leaf: Environment, size: tuple[int, int], lights: int | None, error: float) -> tuple[Array, Array]:
    if lights is not None:
        return reduced(leaf, lights)
    return spread(leaf, size, error) if error > 0.0 else to_directional(leaf, *size, dark=True)


def _joined(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    where = np.concatenate([part[0] for part in parts]) if parts else np.zeros((0, 3))
    power = np.concatenate([part[1] for part in parts]) if parts else np.zeros((0, 3))
    return where, power


def _not_faint(power: Array, share: float) -> Array:
    """The lights (L,) bool without the faintest, whose power together is at most `share` of the whole."""
    strength = power.sum(axis=1)
    order = np.argsort(strength, kind="stable")
    gone = np.cumsum(strength[order])
    count = int(np.searchsorted(gone, share * strength.sum(), side="right"))
    keep = np.ones(len(power), dtype=bool)
    keep[order[:count]] = False
    admitted = gone[count - 1] / strength.sum() if count and strength.any() else 0.0
    note("faint lights", len(power), count)
    note("faint power (billionths)", _BILLION, int(np.ceil(admitted * _BILLION)))
    return keep
