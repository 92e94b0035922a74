"""Lights and kinds of frames are closed sets: what is none of them is an error, and unknown light is never black."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from handbench.bench.drawing import light_refusal
from handbench.errors import InputError, Unsupported
from handbench.light.lightset import light_samples
from handbench.method import MethodInfo
from handbench.registry import CAPTURES
from handbench.reports.frames import KINDS
from handbench.scene import (
    FRAME_KINDS,
    LIGHT_KINDS,
    Directional,
    Environment,
    Frame,
    Group,
    Light,
    Point,
    Single,
    Unknown,
    kind_of,
    known_leaves,
    leaves,
)

UP, WHITE = np.array([0.0, 1.0, 0.0]), np.ones(3)
SINGLES: dict[str, Single] = {
    "directional": Directional(UP, WHITE),
    "point": Point(UP, WHITE),
    "environment": Environment("white", np.ones((2, 4, 3))),
    "unknown": Unknown("studio"),
}


class Spot:
    """A light of somebody else's."""


@pytest.fixture(scope="module")
def frame() -> Frame:
    return CAPTURES.load("openstage")(size="mini").frames()[0]


def test_every_single_light_has_a_kind() -> None:
    assert {kind: kind_of(light) for kind, light in SINGLES.items()} == {kind: kind for kind in LIGHT_KINDS}
    assert {type(light) for light in SINGLES.values()} == set(get_args(Single))
    assert set(get_args(Light)) == {*get_args(Single), Group}


def test_what_is_no_light_is_refused(frame: Frame) -> None:
    spot: Any = Spot()
    with pytest.raises(InputError, match="group: light is a Spot; give a Directional, Point, Environment"):
        Group((SINGLES["point"], spot))
    with pytest.raises(InputError, match=r"query 's01/.*': light is a Spot"):
        replace(frame.query, light=spot)
    with pytest.raises(InputError, match="'spot'; use directional, environment, point, unknown"):
        MethodInfo("m", "M", "a method", lights=frozenset({"directional", "spot"}))  # type: ignore[arg-type]


def test_what_is_no_kind_of_frame_is_refused(frame: Frame) -> None:
    odd: Any = "olats"
    with pytest.raises(InputError, match="kind of frame is 'olats'; use one of olat, group, full, environment"):
        replace(frame, kind=odd)
    assert tuple(KINDS) == FRAME_KINDS


@pytest.mark.parametrize("light", [SINGLES["unknown"], Group((SINGLES["point"], Group((SINGLES["unknown"],))))])
def test_unknown_light_is_refused_where_it_would_shade(light: Light) -> None:
    assert Unknown in map(type, leaves(light))
    for shade in (light_samples, lambda light: list(known_leaves(light)), lambda light: light.scaled(2.0)):
        with pytest.raises(Unsupported, match="light 'studio' is not told by the recording"):
            shade(light)


def test_a_method_draws_unknown_light_if_it_says_so() -> None:
    for kind, light in SINGLES.items():
        able = MethodInfo("m", "M", "a method", lights=frozenset({kind_of(light)}))
        unable = replace(able, lights=LIGHT_KINDS - {kind_of(light)})
        assert light_refusal(able, Group((light,))) is None
        assert light_refusal(unable, Group((light,))) == f"M cannot draw {kind} lights"
