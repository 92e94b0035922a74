"""Closed-form derivatives against differences, and points against the models' own, for both structures of a hand."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from handbench.hand import HandModel, hand_model
from handbench.hand.fitting.rig import Rest, Rig, rodrigues

_spec = importlib.util.spec_from_file_location("handmodels", Path(__file__).parents[1] / "test_handmodel.py")
assert _spec is not None and _spec.loader is not None
_module = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_module)
SyntheticMano = _module.SyntheticMano


@pytest.fixture(scope="module", params=["openhand", "right", "left"])
def hand(request: pytest.FixtureRequest) -> HandModel:
    return hand_model() if request.param == "openhand" else SyntheticMano(request.param)


def test_rows_are_the_model_s_own_points(hand: HandModel) -> None:
    rig = Rig.of(hand, min(1, hand.levels))
    rng = np.random.default_rng(0)
    shape, pose = np.asarray(hand.sample_identity(rng), dtype=float), hand.sample_pose(rng)
    rest = Rest(rig.at_rest(shape), np.zeros((len(rig.weights), 3, 0)))
    rows = rig.pose(rest, pose.joints[None], np.arange(3)).rows[0]
    vertices, points = hand.posed(shape, pose)
    np.testing.assert_allclose(rows[: rig.vertices], vertices, atol=1e-12)
    np.testing.assert_allclose(rows[rig.key_points], points[list(hand.key_points)], atol=1e-12)
    mesh = hand.mesh(shape, pose, rig.level)
    np.testing.assert_allclose(rig.fine @ rows[: rig.vertices], mesh.vertices, atol=1e-12)


def test_derivatives_are_those_of_differences(hand: HandModel) -> None:
    rig = Rig.of(hand, 0)
    rng = np.random.default_rng(1)
    shape, pose = np.asarray(hand.sample_identity(rng), dtype=float), hand.sample_pose(rng).joints
    basis = rng.normal(0, 0.1, (hand.shape_size, 4))
    every = np.arange(pose.size)
    by_shape = rig.along(shape, basis)
    found = rig.pose(Rest(rig.at_rest(shape), by_shape), pose[None], every)
    turn, z, step = rng.normal(size=pose.shape), rng.normal(size=4), 1e-6

    def rows(sign: float, turning: float, shaping: float) -> np.ndarray:
        moved = Rest(rig.at_rest(shape + sign * step * shaping * basis @ z), by_shape)
        return rig.pose(moved, (pose + sign * step * turning * turn)[None], every).rows[0]

    by_joints = (rows(1, 1, 0) - rows(-1, 1, 0)) / (2 * step)
    np.testing.assert_allclose(found.by_joints[0] @ turn.ravel(), by_joints, atol=1e-8)
    shaped = (rows(1, 0, 1) - rows(-1, 0, 1)) / (2 * step)
    np.testing.assert_allclose(found.by_shape[0] @ z, shaped, atol=1e-8)
    some = np.array([5, 4, 11])
    np.testing.assert_array_equal(
        rig.pose(Rest(rig.at_rest(shape), by_shape), pose[None], some, np.array([7, 3])).by_joints,
        found.by_joints[:, [7, 3]][..., some],
    )


def test_rotations_are_smooth_at_zero() -> None:
    small, large = rodrigues(np.array([[1e-9, 0, 0], [0, 1e-5, 2e-5]])), rodrigues(np.array([[0.0, 0, np.pi / 2]]))
    np.testing.assert_allclose(small[0][0], np.eye(3), atol=1e-8)
    np.testing.assert_allclose(large[0][0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(small[1], np.broadcast_to(np.eye(3), (2, 3, 3)), atol=2e-5)
