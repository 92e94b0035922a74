from __future__ import annotations

import numpy as np

from handbench.light.lightset import light_samples
from handbench.scene import Directional, Environment, Group, Point


def test_groups_are_flattened_and_dark_lights_left_out() -> None:
    up, dark = Directional([0, 1, 0], [1, 2, 3]), Directional([1, 0, 0], [0, 0, 0])
    near = Point([0, 0, 2], [4, 5, 6])
    sky = Environment("sky", np.full((8, 16, 3), 0.25))
    lights = light_samples(Group((up, Group((near, dark)), sky)), (4, 8))
    assert len(lights) == 1 + 32 + 1
    assert np.array_equal(lights.directions[0], [0, 1, 0]) and np.array_equal(lights.irradiance[0], [1, 2, 3])
    assert np.array_equal(lights.positions, [[0, 0, 2]]) and np.array_equal(lights.intensities, [[4, 5, 6]])
    assert np.allclose(lights.irradiance[1:].sum(axis=0), 0.25 * 4 * np.pi)


def test_no_light_is_an_empty_set() -> None:
    lights = light_samples(Group(()))
    assert len(lights) == 0 and lights.directions.shape == lights.intensities.shape == (0, 3)
