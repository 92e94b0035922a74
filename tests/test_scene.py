"""The contracts: frozen values, checked at the border, with errors that name what is wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from handbench.errors import InputError, unknown_name
from handbench.scene import (
    Camera,
    Directional,
    Environment,
    Group,
    Mesh,
    Observation,
    Point,
    Pose,
    Prediction,
    Topology,
    leaves,
)

EYE = np.eye(3)
RIGID = np.concatenate([EYE, [[0.0], [0.0], [2.0]]], axis=1)


def test_camera_centre_is_where_the_camera_stands() -> None:
    assert np.allclose(Camera("c", 4, 3, EYE, RIGID).centre, [0, 0, -2])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Camera("c", 0, 3, EYE, RIGID), "0x3"),
        (lambda: Camera("c", 4, 3, np.eye(4), RIGID), r"K has shape \(4, 4\), expected \(3, 3\)"),
        (lambda: Camera("c", 4, 3, EYE, 2 * RIGID), "not a rigid transform"),
        (lambda: Camera("c", 4, 3, EYE, np.diag([1, 1, -1]) @ RIGID), "not a rigid transform"),
        (lambda: Directional([0, 0, 2], [1, 1, 1]), "not a unit vector"),
        (lambda: Directional([0, 0, 1], [1, -1, 1]), "negative"),
        (lambda: Directional([0, 0, 1], [1, np.nan, 1]), "NaN"),
        (lambda: Point([0, 0, np.inf], [1, 1, 1]), "infinite"),
        (lambda: Environment("e", np.full((2, 4, 3), -1.0)), "negative"),
        (lambda: Environment("e", np.full((2, 4, 3), np.nan)), "24 values that are NaN"),
        (lambda: Environment("e", np.zeros((0, 4, 3))), "empty"),
        (lambda: Environment("e", np.zeros((2, 4))), r"shape \(2, 4\)"),
        (lambda: Pose(np.zeros((3, 4))), r"expected \(n, 3\)"),
        (lambda: Topology([[0, 1, 2]], np.zeros((0, 2)), [[0, 1, 2]]), "uvs is empty"),
        (lambda: Topology([[0, 1, 2]], np.zeros((2, 2))), "uv_faces is missing"),
        (lambda: Topology([[0, 1, 2]], np.zeros((2, 2)), [[0, 1, 2]]), "outside the 2 UVs"),
        (
            lambda: Mesh(np.zeros((2, 3)), Topology([[0, 1, 2]], np.zeros((3, 2)), [[0, 1, 2]])),
            "outside the 2 vertices",
        ),
        (lambda: Observation(np.zeros((4, 5, 3)), np.zeros((5, 4))), r"alpha has shape \(5, 4\), expected \(4, 5\)"),
        (lambda: Prediction(np.zeros((4, 5)), np.zeros((4, 5))), "do not fit"),
    ],
)
def test_bad_values_are_refused_with_their_name(make, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()


def test_values_are_frozen_and_do_not_alias_the_caller() -> None:
    direction = np.array([0.0, 0.0, 1.0])
    light = Directional(direction, [1, 1, 1])
    direction[2] = -1.0
    assert light.direction[2] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        light.direction[2] = -1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        light.direction = direction  # type: ignore[misc]


def test_groups_open_in_order_and_scale_every_kind_of_light() -> None:
    sun, lamp, sky = (
        Directional([0, 1, 0], [1, 2, 3]),
        Point([0, 1, 0], [1, 1, 1]),
        Environment("e", np.ones((1, 2, 3))),
    )
    group = Group((sun, Group((lamp, sky))))
    assert list(leaves(group)) == [sun, lamp, sky]
    doubled = list(leaves(group.scaled(2.0)))
    assert np.allclose(doubled[0].irradiance, [2, 4, 6])
    assert np.allclose(doubled[1].intensity, 2)
    assert np.allclose(doubled[2].radiance, 2)


def test_a_prediction_may_hold_nan_so_that_scoring_can_see_it() -> None:
    assert np.isnan(Prediction(np.full((1, 1, 3), np.nan), np.ones((1, 1))).image).all()


def test_unknown_names_come_with_the_closest_known_ones() -> None:
    assert "did you mean 'urhand'?" in str(unknown_name("method", "urhnad", ["urhand", "oracle"]))
    assert "known: oracle, urhand" in str(unknown_name("method", "xyz", ["urhand", "oracle"]))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int64, bool])
@pytest.mark.parametrize("made", [Observation, Prediction])
def test_codes_are_no_light(kind: type, made: type) -> None:
    image, alpha = np.ones((2, 3, 3)), np.ones((2, 3))
    with pytest.raises(InputError, match=r"image holds whole numbers .* divide .*, then make sRGB linear"):
        made(image.astype(kind), alpha)
    if kind is bool:
        assert made(image, alpha.astype(bool)).alpha.dtype == np.float32
    else:
        with pytest.raises(InputError, match=r"alpha holds whole numbers .* divide by the greatest code$"):
            made(image, alpha.astype(kind))


def test_uvs_beyond_the_unit_square_are_refused() -> None:
    with pytest.raises(InputError, match=r"uvs reach from 0 to 3, expected 0 to 1"):
        Topology([[0, 1, 2]], [[0, 0], [3, 0], [0, 1]], [[0, 1, 2]])
