"""Named poses, the sampler, and the search for self-intersection."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.errors import InputError
from handbench.hand.collision import TOLERANCE, penetration, relaxed
from handbench.hand.openhand import OpenHand, named_pose, sample_pose
from handbench.hand.openhand.poses import NAMED
from handbench.scene import Pose


@pytest.fixture(scope="module")
def hand() -> OpenHand:
    return OpenHand.load()


def posed(hand: OpenHand, pose: Pose) -> np.ndarray:
    return hand.skin(hand.neutral(), pose.joints, dtype=torch.float64).numpy()


@pytest.mark.parametrize("name", sorted(NAMED))
def test_named_poses_keep_limits_and_do_not_intersect_deeply(hand: OpenHand, name: str) -> None:
    pose = named_pose(name)
    assert (pose.joints >= hand.limits[..., 0] - 1e-9).all() and (pose.joints <= hand.limits[..., 1] + 1e-9).all()
    assert penetration(hand, posed(hand, pose)).depth < 0.0035, "skin gives way by 3 mm, not by more"


def test_pinch_brings_thumb_and_index_together(hand: OpenHand) -> None:
    pinched = posed(hand, named_pose("pinch"))
    owner = hand.weights(0).argmax(1)
    tips = [pinched[owner == hand.joint_names.index(name)] for name in ("thumb3", "index3")]
    nearest = np.linalg.norm(tips[0][:, None] - tips[1][None], axis=-1).min()
    assert nearest < 0.005


def test_a_finger_through_the_palm_is_found(hand: OpenHand) -> None:
    joints = np.zeros((len(hand.joint_names), 3))
    for k, angle in ((1, 80), (2, 103), (3, 73)):
        joints[hand.joint_names.index(f"middle{k}"), 0] = np.radians(angle)
    found = penetration(hand, posed(hand, Pose(joints)))
    assert found.depth > 2 * TOLERANCE and found.count > 10 and not found.free


def test_relaxed_poses_are_free_and_as_strong_as_can_be(hand: OpenHand) -> None:
    pose = sample_pose(np.random.default_rng(0))
    assert not penetration(hand, posed(hand, pose)).free
    calm = relaxed(hand, hand.neutral(), pose)
    assert penetration(hand, posed(hand, calm)).free
    amount = calm.joints[np.abs(pose.joints) > 0.1] / pose.joints[np.abs(pose.joints) > 0.1]
    assert np.ptp(amount) < 1e-9 and 0.3 < amount[0] < 1
    rest = named_pose("rest")
    assert relaxed(hand, hand.neutral(), rest) is rest


def test_sampled_poses_keep_limits_and_correlate(hand: OpenHand) -> None:
    rng = np.random.default_rng(0)
    joints = np.stack([sample_pose(rng).joints for _ in range(400)])
    assert (joints >= hand.limits[..., 0] - 1e-12).all() and (joints <= hand.limits[..., 1] + 1e-12).all()
    flexion = {name: joints[:, j, 0] for j, name in enumerate(hand.joint_names)}
    slope = np.polyfit(flexion["middle2"], flexion["middle3"], 1)[0]
    assert 0.5 < slope < 0.8, "DIP follows PIP at about two thirds"
    near = np.corrcoef(flexion["index2"], flexion["middle2"])[0, 1]
    far = np.corrcoef(flexion["index2"], flexion["little2"])[0, 1]
    assert near > far > 0.3


def test_sampler_repeats_by_seed_and_scales_with_amount() -> None:
    full, half = (sample_pose(np.random.default_rng(4), amount) for amount in (1.0, 0.5))
    np.testing.assert_array_equal(full.joints, sample_pose(np.random.default_rng(4)).joints)
    np.testing.assert_allclose(half.joints, full.joints / 2)
    with pytest.raises(InputError, match="amount 2"):
        sample_pose(np.random.default_rng(0), 2.0)


def test_unknown_pose_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'fist'"):
        named_pose("fits")
