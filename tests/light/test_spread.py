"""Lights that stay for every map: power is kept, what may not be moved is a light of its own, and pictures agree."""

from __future__ import annotations

import numpy as np
import pytest

from handbench.errors import InputError
from handbench.light.environment import to_directional
from handbench.light.lightset import light_samples
from handbench.light.spread import CELLS, ENVIRONMENT_ERROR, spread
from handbench.scene import Directional, Environment, Group

SIZE = (16, 32)


def _map(seed: int, height: int = 32) -> Environment:
    rng = np.random.default_rng(seed)
    radiance = rng.gamma(0.4, size=(height, 2 * height, 3))
    radiance[height // 4, seed % (2 * height)] += 400.0  # a sun
    return Environment(f"map-{seed}", radiance)


@pytest.mark.parametrize("error", [0.0, 0.002, 0.02, 1.0])
def test_power_of_each_colour_is_kept_and_most_lights_are_the_same_for_every_map(error: float) -> None:
    found = [spread(_map(seed, height), SIZE, error) for seed, height in ((1, 32), (2, 64), (3, 16))]
    for seed, height, (where, power) in zip((1, 2, 3), (32, 64, 16), found, strict=True):
        texels = to_directional(_map(seed, height), *SIZE)[1]
        assert np.allclose(power.sum(axis=0), texels.sum(axis=0), rtol=1e-6)
        assert np.allclose(np.linalg.norm(where, axis=1), 1.0)
        assert np.array_equal(where[:CELLS], found[0][0][:CELLS])


def test_what_a_cell_would_move_is_a_light_of_its_own() -> None:
    environment = _map(5)
    everything, nothing = spread(environment, SIZE, 0.0), spread(environment, SIZE, 1e9)
    assert len(nothing[0]) == CELLS and len(everything[0]) > 500
    counts = [len(spread(environment, SIZE, error)[0]) for error in (0.001, 0.004, 0.016, 0.064)]
    assert counts == sorted(counts, reverse=True) and counts[0] > counts[-1]
    where, power = spread(environment, SIZE, ENVIRONMENT_ERROR)
    brightest = to_directional(environment, *SIZE)
    sun = brightest[0][brightest[1].sum(axis=1).argmax()]
    alone = where[CELLS:][power[CELLS:].sum(axis=1).argmax()]
    assert np.allclose(alone, sun)


def test_scaled_light_gives_scaled_lights() -> None:
    (where, power), (other, scaled) = (spread(_map(7).scaled(s), SIZE, 0.005) for s in (1.0, 8.0))
    assert np.array_equal(where, other) and np.allclose(scaled, 8.0 * power)


def test_a_dark_map_has_dark_lights() -> None:
    where, power = spread(Environment("night", np.zeros((4, 8, 3))), SIZE, 0.005)
    assert where.shape == (CELLS, 3) and not power.any()


@pytest.mark.parametrize("cells", [3, 513])
def test_cells_that_do_not_suit_the_map_are_refused(cells: int) -> None:
    with pytest.raises(InputError, match=f"{cells} cells"):
        spread(_map(1), SIZE, 0.1, cells)


def test_a_light_set_takes_the_lights_of_a_map_and_the_others_beside_it() -> None:
    environment = _map(1)
    alone = light_samples(environment, environment_error=0.005)
    assert CELLS <= len(alone) < len(light_samples(environment))
    both = Group((environment, Directional([0, 1, 0], [1, 1, 1])))
    assert len(light_samples(both, environment_error=0.005)) == len(alone) + 1
