"""Lights, a closed set: what branches on one does so with `match` and ends with `assert_never`; none is forgotten.

Directions are unit vectors from the surface to the light; light adds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NoReturn, TypeAlias, assert_never, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, Unsupported
from .arrays import Array, checked, put

LightKind = Literal["directional", "point", "environment", "unknown"]
"""What a single light is: what a method declares it can draw (`MethodInfo.lights`)."""
LIGHT_KINDS: frozenset[LightKind] = frozenset(get_args(LightKind))
KNOWN_LIGHTS: frozenset[LightKind] = LIGHT_KINDS - {"unknown"}
"""Those that can be shaded with."""

FrameKind = Literal["olat", "group", "full", "environment"]
"""How a frame is lit: by one light at a time, a group of a stage's lights, all of them, or an environment."""
FRAME_KINDS: tuple[FrameKind, ...] = get_args(FrameKind)
TimedKind = Literal[FrameKind, "unknown"]
"""What a picture is timed under: a frame's light, or one that nobody tells, whatever it was."""
TIMED_KINDS: tuple[TimedKind, ...] = get_args(TimedKind)


@dataclass(frozen=True, eq=False)
class Directional:
    """A distant light: unit direction (3,) to the light, irradiance (3,) on a surface that faces it."""

    direction: Array
    irradiance: Array

    def __post_init__(self) -> None:
        direction = checked("directional light", "direction", self.direction, (3,), np.float64)
        if abs(np.linalg.norm(direction) - 1.0) > 1e-4:
            raise InputError(f"directional light: direction {direction.tolist()} is not a unit vector; normalise it")
        put(self, "direction", direction)
        put(self, "irradiance", _nonnegative("directional light", "irradiance", self.irradiance, (3,), np.float64))

    def scaled(self, factor: float) -> Directional:
        return Directional(self.direction, self.irradiance * factor)


@dataclass(frozen=True, eq=False)
class Point:
    """A near light: position (3,) in metres, radiant intensity (3,) per steradian."""

    position: Array
    intensity: Array

    def __post_init__(self) -> None:
        put(self, "position", checked("point light", "position", self.position, (3,), np.float64))
        put(self, "intensity", _nonnegative("point light", "intensity", self.intensity, (3,), np.float64))

    def scaled(self, factor: float) -> Point:
        return Point(self.position, self.intensity * factor)


@dataclass(frozen=True, eq=False)
class Environment:
    """Distant radiance (H, W, 3) in all directions: equirectangular, row 0 = +y, see `handbench.light`."""

    name: str
    radiance: Array

    def __post_init__(self) -> None:
        owner = f"environment {self.name!r}"
        radiance = _nonnegative(owner, "radiance", self.radiance, (None, None, 3), np.float32)
        if radiance.size == 0:
            raise InputError(f"{owner}: radiance is empty; give at least one texel")
        put(self, "radiance", radiance)

    def scaled(self, factor: float) -> Environment:
        return Environment(self.name, self.radiance * np.float32(factor))


@dataclass(frozen=True, eq=False)
class Unknown:
    """Light that the recording does not tell; frames under the same light share its `name`.

    Frames under it can be looked at, but nothing can be shaded with it: who tries raises `Unsupported`.
    """

    name: str

    def refuse(self) -> NoReturn:
        """Raise the `Unsupported` of whoever is asked to shade with this light."""
        raise Unsupported(
            f"light {self.name!r} is not told by the recording, so nothing can be shaded under it; give a known light"
        )

    def scaled(self, factor: float) -> Unknown:
        """Raises `Unsupported`: how bright an unknown light is nobody knows."""
        self.refuse()


@dataclass(frozen=True, eq=False)
class Group:
    """Several lights at once; light adds."""

    lights: tuple[Light, ...]

    def __post_init__(self) -> None:
        put(self, "lights", tuple(self.lights))
        for member in self.lights:
            check_light("group", member)

    def scaled(self, factor: float) -> Group:
        return Group(tuple(light.scaled(factor) for light in self.lights))


Known: TypeAlias = Directional | Point | Environment
"""A single light that can be shaded with."""
Single: TypeAlias = Known | Unknown
Light: TypeAlias = Single | Group


def check_light(owner: str, light: object) -> None:
    """Raises `InputError` for what is none of the lights there are."""
    if not isinstance(light, Light):
        known = "Directional, Point, Environment, Unknown or Group"
        raise InputError(f"{owner}: light is a {type(light).__name__}; give a {known} of handbench.scene")


def check_frame_kind(owner: str, kind: str) -> FrameKind:
    """The kind, or an `InputError` that names those there are."""
    if kind not in FRAME_KINDS:
        raise InputError(f"{owner}: kind of frame is {kind!r}; use one of {', '.join(FRAME_KINDS)}")
    return kind


def kind_of(light: Single) -> LightKind:
    """What a single light is."""
    match light:
        case Directional():
            return "directional"
        case Point():
            return "point"
        case Environment():
            return "environment"
        case Unknown():
            return "unknown"
        case _:
            assert_never(light)


def leaves(light: Light) -> Iterator[Single]:
    """The single lights of a light, groups opened in order."""
    if isinstance(light, Group):
        for member in light.lights:
            yield from leaves(member)
    else:
        yield light


def known_leaves(light: Light) -> Iterator[Known]:
    """The single lights of a light that is to be shaded with. Raises `Unsupported` if one of them is unknown."""
    for leaf in leaves(light):
        if isinstance(leaf, Unknown):
            leaf.refuse()
        yield leaf


def _nonnegative(owner: str, name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: type) -> Array:
    array = checked(owner, name, value, shape, dtype)
    if (array < 0).any():
        raise InputError(f"{owner}: {name} has negative values (least {array.min():g}); light cannot be negative")
    return array
