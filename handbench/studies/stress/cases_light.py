"""Lights: empty, dark, hot, damaged; environments reduced, turned and fitted."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...data.environments import read_environment
from ...errors import InputError
from ...light import environment as env
from ...light.lightset import light_samples
from ...light.stage import stage_directions
from ...scene import Array, Directional, Environment, Group, Light, Point
from .case import Case
from .judgement import TruthPair, accurate, equal, refused
from .scenes import WHITE

FAMILY = "light"
UP = np.array([0.0, 1.0, 0.0])


def cases() -> Iterator[Case]:
    for name, make in _broken().items():
        yield Case(FAMILY, name, refused(InputError), make)
    for name, light in _dark().items():
        yield Case(FAMILY, f"{name} has no lights", equal(), partial(_no_lights, light), "zero")
    for name, environment in maps().items():
        yield Case(
            FAMILY, f"{name}, power kept when reduced", accurate(1e-6), partial(_power, environment), "numpy float64"
        )
        turn = partial(_turned, environment)
        yield Case(FAMILY, f"{name}, power kept when turned", accurate(1e-6), turn, "numpy float64")
        yield Case(FAMILY, f"{name}, a whole turn", equal(1e-6), partial(_whole_turn, environment), "the map itself")
    for shape in ((1, 1), (1, 2), (2, 1), (3, 5), (512, 1024)):
        name = f"solid angles of {shape[0]}x{shape[1]}"
        yield Case(FAMILY, name, accurate(1e-12), partial(_sphere, shape), "4 pi")
    for count in (1, 2, 10_000):
        yield Case(FAMILY, f"stage of {count} lights", equal(1e-12), partial(_stage, count), "unit length")
    group = Group(tuple(Directional(d, WHITE) for d in stage_directions(10_000)))
    yield Case(
        FAMILY, "group of 10000 lights", equal(), lambda: TruthPair(len(light_samples(group)), 10_000), "the count"
    )
    nested: Light = Point(UP, WHITE)
    for _ in range(100):
        nested = Group((nested,))
    yield Case(FAMILY, "group in 100 groups", equal(), lambda: TruthPair(len(light_samples(nested)), 1), "the count")


def maps() -> dict[str, Environment]:
    """Environments of extreme radiance."""
    rng = np.random.default_rng(0)
    plain = rng.uniform(0.5, 1.5, (32, 64, 3))
    hot = np.full((32, 64, 3), 1e-3)
    hot[7, 40] = 1e8
    pole = np.zeros((32, 64, 3))
    pole[0, 0] = 1.0
    return {
        "radiance 1e-8": Environment("dim", 1e-8 * plain),
        "radiance 1e8": Environment("bright", 1e8 * plain),
        "one hot texel": Environment("hot", hot),
        "one texel at the pole": Environment("pole", pole),
        "map of one texel": Environment("one", np.ones((1, 1, 3))),
        "map of one column": Environment("column", plain[:, :1]),
        "map of odd size": Environment("odd", plain[:31, :61]),
    }


def _broken() -> dict[str, Callable[[], Any]]:
    def radiance(value: float) -> Array:
        texels = np.ones((4, 8, 3))
        texels[1, 2, 0] = value
        return texels

    def environment(value: float) -> Environment:
        return Environment("broken", radiance(value))

    one = Environment("one", np.ones((4, 8, 3)))
    return {
        "environment without texels": lambda: Environment("empty", np.zeros((0, 0, 3))),
        "environment without columns": lambda: Environment("empty", np.zeros((4, 0, 3))),
        "environment of one channel": lambda: Environment("grey", np.ones((4, 8, 1))),
        "environment with NaN": lambda: environment(float("nan")),
        "environment with infinity": lambda: environment(float("inf")),
        "environment with negative radiance": lambda: environment(-1e-3),
        "environment beyond float32": lambda: environment(1e39),
        "environment scaled below zero": lambda: one.scaled(-1.0),
        "environment scaled by NaN": lambda: one.scaled(float("nan")),
        "environment scaled beyond float32": lambda: one.scaled(1e39),
        "environment turned by NaN": lambda: env.rotate(one, float("nan")),
        "environment turned by infinity": lambda: env.rotate(one, float("inf")),
        "environment reduced to nothing": lambda: env.resize(one, 0, 8),
        "environment reduced below nothing": lambda: env.resize(one, -4, 8),
        "distant light without direction": lambda: Directional(np.zeros(3), WHITE),
        "distant light that is not a unit vector": lambda: Directional(2.0 * UP, WHITE),
        "distant light with NaN": lambda: Directional(UP * np.nan, WHITE),
        "distant light of negative power": lambda: Directional(UP, -WHITE),
        "distant light of infinite power": lambda: Directional(UP, WHITE * np.inf),
        "near light at NaN": lambda: Point(UP * np.nan, WHITE),
        "near light at infinity": lambda: Point(UP * np.inf, WHITE),
        "near light of negative power": lambda: Point(UP, -WHITE),
        "stage without lights": lambda: stage_directions(0),
        "map file that is missing": lambda: read_environment(Path("nowhere/none.exr")),
        "map file of another kind": lambda: _file("map.txt", b"no picture"),
        "damaged .exr file": lambda: _file("map.exr", b"no picture"),
        "damaged .hdr file": lambda: _file("map.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n\x00"),
        "empty .exr file": lambda: _file("map.exr", b""),
    }


def _file(name: str, content: bytes) -> Environment:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        return read_environment(path)


def _dark() -> dict[str, Light]:
    return {
        "an all-zero environment": Environment("black", np.zeros((16, 32, 3))),
        "an empty group": Group(()),
        "a group of dark lights": Group((Directional(UP, 0 * WHITE), Point(UP, 0 * WHITE), Group(()))),
    }


def _no_lights(light: Light) -> TruthPair:
    return TruthPair(len(light_samples(light)), 0)


def irradiance(environment: Environment) -> Array:
    """Power (3,) over all directions, in float64."""
    solid = env.solid_angles(*environment.radiance.shape[:2])
    return np.einsum("ij,ijc->c", solid, environment.radiance.astype(np.float64))


def _power(environment: Environment) -> TruthPair:
    return TruthPair(light_samples(environment).irradiance.sum(axis=0), irradiance(environment))


def _turned(environment: Environment) -> TruthPair:
    return TruthPair(irradiance(env.rotate(environment, 1.2345)), irradiance(environment))


def _whole_turn(environment: Environment) -> TruthPair:
    return TruthPair(env.rotate(environment, 2 * np.pi).radiance, environment.radiance)


def _sphere(shape: tuple[int, int]) -> TruthPair:
    return TruthPair(env.solid_angles(*shape).sum(), 4 * np.pi)


def _stage(count: int) -> TruthPair:
    return TruthPair(np.linalg.norm(stage_directions(count), axis=1), np.ones(count))
