from __future__ import annotations

import time
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest

from handbench.errors import InputError
from handbench.light.environment import directions, solid_angles, to_directional
from handbench.light.reduction import irradiance_of, reduced, reduced_to
from handbench.light.skybox import SKYBOXES, skybox
from handbench.light.stage import stage_directions
from handbench.scene import Array, Environment


@lru_cache
def real_map(name: str) -> Environment:
    return skybox(name, 16, 32)


def random_map(height: int, width: int, seed: int = 0) -> Environment:
    return Environment("random", np.random.default_rng(seed).random((height, width, 3)) ** 4)


def texel_lights(environment: Environment) -> tuple[Array, Array]:
    return to_directional(environment, *environment.radiance.shape[:2])


def mean_products(first: Array, second: Array) -> Array:
    """Mean over all normals n of max(0, n.a) max(0, n.b): the arc-cosine kernel of order 1 (Cho and Saul 2009)."""
    sine = np.linalg.norm(np.cross(first[:, None], second[None]), axis=2)
    cosine = first @ second.T
    return (sine + (np.pi - np.arctan2(sine, cosine)) * cosine) / (6 * np.pi)


def exact_error(environment: Environment, towards: Array, irradiance: Array) -> float:
    """Relative RMS error over every normal there is, in closed form."""
    where, power = texel_lights(environment)
    both, signed = np.concatenate([where, towards]), np.concatenate([power, -irradiance])
    squares = np.einsum("ic,ij,jc->", signed, mean_products(both, both), signed)
    return float(np.sqrt(max(squares, 0.0) / np.einsum("ic,ij,jc->", power, mean_products(where, where), power)))


def measured_error(environment: Environment, towards: Array, irradiance: Array) -> float:
    """The same on well-spread normals, which is faster."""
    expected = irradiance_of(*texel_lights(environment))
    return float(np.linalg.norm(irradiance_of(towards, irradiance) - expected) / np.linalg.norm(expected))


@pytest.mark.parametrize("size", [(16, 32), (7, 13), (64, 128), (100, 150)])
def test_power_of_each_colour_is_kept(size: tuple[int, int]) -> None:
    environment = random_map(*size)
    power = texel_lights(environment)[1].sum(axis=0)
    for lights in (1, 2, 17, 90):
        towards, irradiance = reduced(environment, lights)
        assert towards.shape == irradiance.shape == (lights, 3)
        assert np.allclose(np.linalg.norm(towards, axis=1), 1, atol=1e-14) and (irradiance >= 0).all()
        assert np.allclose(irradiance.sum(axis=0), power, rtol=1e-12)


def test_irradiance_is_the_sum_of_cosines() -> None:
    towards, power = texel_lights(random_map(9, 14))
    half = stage_directions(1024)[:512]
    expected = np.maximum(np.concatenate([half, -half]) @ towards.T, 0) @ power
    assert np.allclose(irradiance_of(towards, power), expected, rtol=1e-12)


def test_the_measured_error_is_that_of_every_normal() -> None:
    for name in ("crossroads", "hall"):  # a sun and lamps
        environment = real_map(name)
        for target in (0.1, 0.01):
            found = reduced_to(environment, target)
            exact = exact_error(environment, found.directions, found.irradiance)
            assert found.error == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("name", SKYBOXES)
def test_errors_fall_with_lights_and_stay_under_the_bound(name: str) -> None:
    environment = real_map(name)
    found = [reduced_to(environment, error) for error in (0.2, 0.02, 0.002)]
    counts = [len(each) for each in found]
    assert counts == sorted(counts) and counts[-1] < 300
    for each, error in zip(found, (0.2, 0.02, 0.002), strict=True):
        assert 0 < each.error <= error and each.error <= each.bound
    errors = [measured_error(environment, *reduced(environment, lights)) for lights in (4, 16, 64, 256)]
    assert all(after < 0.6 * before for before, after in pairwise(errors))


def test_clusters_beat_median_cut() -> None:
    # Debevec's median cut on the same ten maps at 64 lights, measured: 0.0030 in the geometric mean
    errors = [measured_error(env, *reduced(env, 64)) for env in map(real_map, SKYBOXES)]
    assert np.exp(np.mean(np.log(errors))) < 0.0021


def test_the_bound_is_that_of_the_texels() -> None:
    environment = random_map(12, 24)
    where, power = texel_lights(environment)
    found = reduced_to(environment, 0.05)
    best = np.linalg.norm(where[:, None] - found.directions, axis=2).min(axis=1)
    least = np.sqrt(np.mean((best @ power) ** 2)) / np.sqrt(np.mean(irradiance_of(where, power) ** 2))
    # texels belong to their nearest light, but for the last round of Lloyd's algorithm
    assert found.error < least and 1 - 1e-12 < found.bound / least < 1.05


def test_few_lights_are_enough_for_an_error() -> None:
    environment = skybox("park", 32, 64)
    found = reduced_to(environment, 0.01)
    fewer = reduced(environment, int(0.85 * len(found)))
    assert measured_error(environment, *fewer) > 0.01 and len(found) < 64


def test_as_many_lights_as_lit_texels_are_the_texels() -> None:
    radiance = random_map(10, 20).radiance.copy()
    radiance[3:] = 0
    environment = Environment("cut", radiance)
    for lights in (60, 61, 10_000):
        for ours, theirs in zip(reduced(environment, lights), texel_lights(environment), strict=True):
            assert np.array_equal(ours, theirs)
    found = reduced_to(environment, 0.0)
    assert len(found) == 60 and found.error == found.bound == 0
    assert len(reduced(environment, 59)[0]) == 59


def test_a_tiny_sun_stays_in_its_place() -> None:
    radiance = np.full((64, 128, 3), 0.1)
    radiance[20, 33] = [4e6, 3e6, 2e6]
    towards, irradiance = reduced(Environment("sun", radiance), 4)
    sun = irradiance[:, 0].argmax()
    assert np.linalg.norm(towards[sun] - directions(64, 128)[20, 33]) < 1e-4
    only = np.zeros((64, 128, 3))
    only[20, 33] = 5.0
    towards, irradiance = reduced(Environment("only", only), 1)
    assert np.allclose(towards, directions(64, 128)[20, 33]) and len(towards) == 1
    assert np.allclose(irradiance, 5.0 * solid_angles(64, 128)[20, 33])


def test_a_uniform_map_is_spread() -> None:
    environment = Environment("grey", np.ones((16, 32, 3)))
    towards, irradiance = reduced(environment, 32)
    gaps = towards @ towards.T - 2 * np.eye(32)
    assert gaps.max() < np.cos(0.6 * np.sqrt(4 * np.pi / 32)) and irradiance.max() < 1.6 * irradiance.min()
    assert reduced_to(environment, 0.01).error <= 0.01
    one, power = reduced(environment, 1)  # light from all around has no mean direction, but its power
    assert np.linalg.norm(one) == pytest.approx(1) and np.allclose(power, 4 * np.pi)


def test_no_light_is_no_lights() -> None:
    dark = Environment("dark", np.zeros((8, 16, 3)))
    assert [part.shape for part in reduced(dark, 5)] == [(0, 3), (0, 3)]
    found = reduced_to(dark, 0.01)
    assert len(found) == 0 and found.directions.shape == (0, 3) and found.error == found.bound == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (3, 5), (1, 300), (300, 1)])
def test_any_size_of_map(size: tuple[int, int]) -> None:
    environment = random_map(*size)
    power = texel_lights(environment)[1].sum(axis=0)
    for lights in (1, 2, 7):
        towards, irradiance = reduced(environment, lights)
        assert len(towards) == min(lights, size[0] * size[1])
        assert np.allclose(irradiance.sum(axis=0), power, rtol=1e-12)
    assert reduced_to(environment, 0.1).error <= 0.1


def test_scale_does_not_matter() -> None:
    environment = random_map(16, 32)
    towards, irradiance = reduced(environment, 20)
    for factor in (2.0**-60, 2.0**100):
        other, scaled = reduced(environment.scaled(factor), 20)
        assert np.array_equal(towards, other) and np.allclose(scaled / factor, irradiance, rtol=1e-12)
    extreme = np.full((16, 32, 3), 1e-40)
    extreme[4, 4] = 1e38
    towards, irradiance = reduced(Environment("extreme", extreme), 6)
    assert len(towards) == 6 and np.isfinite(irradiance).all() and np.isfinite(towards).all()


def test_colours_of_one_light_may_lie_apart_and_the_bound_knows() -> None:
    radiance = np.zeros((8, 16, 3))
    radiance[4, 2, 0] = radiance[4, 6, 2] = 1.0  # red and blue, a right angle apart
    environment = Environment("two", radiance)
    found = reduced_to(environment, 0.7)
    assert len(found) == 1 and 0.3 < found.error <= found.bound
    assert len(reduced_to(environment, 0.1)) == 2


def test_answers_repeat() -> None:
    environment = random_map(30, 40)
    first, again = reduced(environment, 33), reduced(environment, 33)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_large_maps_are_fast() -> None:
    environment = random_map(512, 1024)
    start = time.process_time()
    towards, _ = reduced(environment, 64)
    assert len(towards) == 64 and time.process_time() - start < 1.0  # 0.1 s on an idle machine


def test_bad_wishes_are_named() -> None:
    environment = random_map(2, 4)
    with pytest.raises(InputError, match=r"'random'.* 0 lights"):
        reduced(environment, 0)
    for error in (-0.1, float("nan")):
        with pytest.raises(InputError, match=r"'random'.*error"):
            reduced_to(environment, error)
