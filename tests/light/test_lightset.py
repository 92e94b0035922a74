from __future__ import annotations

import numpy as np
import pytest

from handbench.light.lightset import LightSet, light_samples
from handbench.light.reduction import reduced
from handbench.light.spread import CELLS
from handbench.scene import Directional, Environment, Group, Light, Point
from handbench.skips import NONE, Saved, Skips, skipping, tallied

SKY = Environment("sky", np.full((8, 16, 3), 0.25))
UP, DARK = Directional([0, 1, 0], [1, 2, 3]), Directional([1, 0, 0], [0, 0, 0])
NEAR, OUT = Point([0, 0, 2], [4, 5, 6]), Point([0, 1, 2], [0, 0, 0])


def arrays(lights: LightSet) -> tuple[np.ndarray, ...]:
    return lights.directions, lights.irradiance, lights.positions, lights.intensities


def same(first: LightSet, second: LightSet) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(arrays(first), arrays(second), strict=True))


def test_groups_are_flattened_and_dark_lights_left_out() -> None:
    lights = light_samples(Group((UP, Group((NEAR, DARK)), SKY)), (4, 8))
    assert len(lights) == 1 + 32 + 1
    assert np.array_equal(lights.directions[0], [0, 1, 0]) and np.array_equal(lights.irradiance[0], [1, 2, 3])
    assert np.array_equal(lights.positions, [[0, 0, 2]]) and np.array_equal(lights.intensities, [[4, 5, 6]])
    assert np.allclose(lights.irradiance[1:].sum(axis=0), 0.25 * 4 * np.pi)


@pytest.mark.parametrize("light", [Group(()), Group((Group(()), Group((Group(()),)))), DARK, OUT, SKY.scaled(0)])
def test_no_light_is_an_empty_set(light: Light) -> None:
    lights = light_samples(light)
    assert len(lights) == 0
    assert all(values.shape == (0, 3) and values.dtype == np.float64 for values in arrays(lights))


@pytest.mark.parametrize("light", [UP, NEAR, SKY, Group((UP, NEAR))])
def test_groups_in_groups_and_duplicates_add(light: Light) -> None:
    once = light_samples(light)
    assert same(once, light_samples(Group((Group((Group(()), light)), Group(())))))
    twice = light_samples(Group((light, Group((light,)))))
    assert len(twice) == 2 * len(once)
    for one, two in zip(arrays(once), arrays(twice), strict=True):
        assert np.array_equal(np.concatenate([one, one]), two)


def test_dark_lights_stay_when_the_skip_is_off_and_switches_do_not_mix() -> None:
    half = np.zeros((4, 8, 3))
    half[:2] = 1.0
    group = Group((UP, DARK, OUT, NEAR, Environment("half", half)))
    for _ in range(2):  # the second time with caches filled in either state
        with tallied() as tally:
            lights = light_samples(group, (4, 8))
        assert (len(lights.directions), len(lights.positions)) == (1 + 16, 1)
        assert tally.lines() == {"lights": Saved(36, 18)}
        with skipping(NONE), tallied() as tally:
            everything = light_samples(group, (4, 8))
        assert (len(everything.directions), len(everything.positions)) == (2 + 32, 2) and not tally.lines()
        lit = everything.irradiance.any(axis=1)
        assert np.array_equal(everything.directions[lit], lights.directions)
        assert np.array_equal(everything.irradiance[lit], lights.irradiance)


def test_faint_lights_go_up_to_their_share_of_power() -> None:
    powers = [5, 0.4, 3, 0.5, 1, 0.1]
    group = Group((*(Directional([0, 0, 1], [p, 0, 0]) for p in powers), Point([0, 0, 1], [1e-9] * 3)))
    for share, kept in ((0.0, powers), (0.05, [5, 3, 0.5, 1]), (0.0999, [5, 3, 0.5, 1]), (0.11, [5, 3, 1])):
        with skipping(Skips(faint_lights=share)), tallied() as tally:
            lights = light_samples(group)
        assert lights.irradiance[:, 0].tolist() == kept and len(lights.positions) == 1
        lines = tally.lines()
        if share == 0.0:
            assert "faint lights" not in lines
        else:
            assert lines["faint lights"] == Saved(6, 6 - len(kept))
            power = lines["faint power (billionths)"]
            assert power.skipped / power.total == pytest.approx((10 - sum(kept)) / 10, abs=1e-9)
            assert power.skipped / power.total <= share + 1e-9


def test_what_faint_lights_leave_is_admitted_at_every_normal() -> None:
    random = np.random.default_rng(0)
    environment = Environment("random", random.random((16, 32, 3)) ** 6)
    whole = light_samples(environment)
    with skipping(Skips(faint_lights=0.01)), tallied() as tally:
        fewer = light_samples(environment)
    normals = random.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    answer = [np.maximum(normals @ each.directions.T, 0) @ each.irradiance for each in (whole, fewer)]
    power = tally.lines()["faint power (billionths)"]
    assert len(fewer) < 0.8 * len(whole)
    lost = (answer[0] - answer[1]).sum(axis=1)
    assert (lost >= -1e-12).all() and lost.max() <= power.skipped / power.total * whole.irradiance.sum() <= 0.01001 * 99


def test_faint_dark_lights_cost_nothing() -> None:
    with skipping(Skips(dark_lights=False, faint_lights=0.5)), tallied() as tally:
        assert len(light_samples(Group((DARK, DARK)))) == 0
        assert len(light_samples(Group(()))) == 0
    assert tally.lines()["faint power (billionths)"].skipped == 0


def test_an_environment_as_a_number_of_lights() -> None:
    environment = Environment("random", np.random.default_rng(1).random((20, 30, 3)))
    lights = light_samples(Group((UP, environment)), environment_lights=24)
    towards, irradiance = reduced(environment, 24)
    assert np.array_equal(lights.directions[1:], towards) and np.array_equal(lights.irradiance[1:], irradiance)
    with skipping(NONE):
        assert same(lights, light_samples(Group((UP, environment)), environment_lights=24))


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (5, 3), (63, 129), (300, 500)])
def test_environments_of_any_size_keep_their_power(size: tuple[int, int]) -> None:
    lights = light_samples(Environment("grey", np.full((*size, 3), 0.5)))
    assert len(lights) == 512 and np.allclose(lights.irradiance.sum(axis=0), 2 * np.pi, rtol=1e-6)


def test_only_lights_that_stand_for_cells_are_coarse() -> None:
    radiance = np.full((16, 32, 3), 0.1, np.float32)
    radiance[4, 7] = 50.0
    sun = Directional(np.array([0.0, 1.0, 0.0]), np.ones(3))
    both = Group((sun, Environment("map", radiance)))
    few = light_samples(both, environment_error=0.0025)
    assert few.coarse is not None and few.coarse.sum() == CELLS and len(few.coarse) == len(few.directions)
    assert not few.coarse[0] and not few.coarse[1 + CELLS :].any() and len(few.coarse) > 1 + CELLS  # the lone texels
    for exact in (light_samples(both), light_samples(both, environment_lights=32), light_samples(sun)):
        assert exact.coarse is not None and not exact.coarse.any()
    with skipping(Skips(faint_lights=0.2)):
        some = light_samples(both, environment_error=0.0025)
    assert some.coarse is not None and 0 < some.coarse.sum() < CELLS and len(some.coarse) == len(some.directions)
