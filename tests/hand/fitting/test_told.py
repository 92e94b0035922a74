"""A pose that a picture brings is believed as far as trackers are, and tells what one camera cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.fitting import Sitter, errors, sitter
from benchmarks.spoiled import zoomed
from handbench.hand import hand_model
from handbench.hand.fitting import FittingSettings, HandPicture, Unfittable, fit
from handbench.hand.fitting.placed import Placed
from handbench.hand.fitting.quadratic import Quadratic
from handbench.hand.fitting.told import PoseNoise
from handbench.scene import Pose

BRIEF = FittingSettings(steps=12)


@pytest.fixture(scope="module")
def someone() -> Sitter:
    return sitter(np.random.default_rng(11))


@pytest.fixture(scope="module")
def flat(someone: Sitter) -> HandPicture:
    return someone.picture(np.random.default_rng(0), depth=False)


def tracked(true: Pose, away: float = 0.0, aside: float = 0.0) -> Pose:
    """A tracker's pose; also `away` metres farther from the camera, which looks along -z, and `aside` to the right."""
    rng = np.random.default_rng(3)
    turn = Rotation.from_rotvec(rng.normal(0, np.radians(1.5), 3)) * Rotation.from_rotvec(true.rotation.copy())
    moved = rng.normal(0, 0.002, 3) + np.array([aside, 0.0, -away])
    return Pose(
        true.joints + rng.normal(0, np.radians(1.5), true.joints.shape), turn.as_rotvec(), true.translation + moved
    )


def test_a_told_pose_tells_the_distance(someone: Sitter, flat: HandPicture) -> None:
    found = fit(hand_model(), [replace(flat, start=tracked(someone.pose))], BRIEF)
    assert found.converged and not found.problems, found.problems
    assert errors(someone, found).absolute < 0.007


def test_a_pose_that_is_far_off_keeps_no_hand_from_its_picture_and_is_told(someone: Sitter, flat: HandPicture) -> None:
    found = fit(hand_model(), [replace(flat, start=tracked(someone.pose, aside=0.1))], BRIEF)
    assert errors(someone, found).scaled < 0.010
    assert "pose" in [problem.kind for problem in found.problems] and found.converged


def test_a_pose_at_an_impossible_distance_is_told(someone: Sitter, flat: HandPicture) -> None:
    with pytest.raises(Unfittable, match=r"by its pose the hand is 1\."):
        fit(hand_model(), [replace(flat, start=tracked(someone.pose, away=0.25))], BRIEF)


def test_a_wrong_focal_length_is_told_by_the_pose(someone: Sitter, flat: HandPicture) -> None:
    wrong = replace(flat, camera=zoomed(flat.camera, 2.0), start=tracked(someone.pose))
    with pytest.raises(Unfittable, match=r"by its pose the hand is 0\.5"):
        fit(hand_model(), [wrong], BRIEF)


def test_the_pull_is_the_costs_gradient() -> None:
    rng, told = np.random.default_rng(0), Placed(np.zeros(2), np.eye(3), np.zeros(3))
    for size in (0.01, 1.0):  # near, and where some numbers are so far off that the pull stays as it is
        hand = Placed(
            size * rng.normal(0, 0.1, 2), Rotation.from_rotvec([0, 0, 0.02]).as_matrix(), size * rng.normal(0, 0.02, 3)
        )

        def cost(step: np.ndarray, hand: Placed = hand) -> Quadratic:
            total = Quadratic(0.0, np.zeros(9), np.zeros((9, 9)))  # one number of shape besides
            PoseNoise().add(total, 0.3, hand.moved(step), told)
            return total

        here = cost(np.zeros(8)).gradient
        steps = 1e-6 * np.eye(8)
        slopes = [(cost(step).cost - cost(-step).cost) / 2e-6 for step in steps]
        # rotations are compared to first order in how far they are from the told one
        np.testing.assert_allclose(here[:8], slopes, rtol=0.02, atol=1e-3 * np.abs(slopes).max())
        assert here[8] == 0.0


def test_a_pictures_key_points_stay_as_sure_as_they_were(flat: HandPicture) -> None:
    sure = np.linspace(0.2, 1.0, 21)
    picture = replace(flat, key_points=np.c_[flat.key_points, sure])
    assert np.array_equal(replace(picture, start=None, alpha=None).sure, sure)
