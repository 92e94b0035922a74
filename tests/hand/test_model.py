"""The open hand: template, shape space, skinning, limits and errors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.errors import InputError
from handbench.hand.openhand import Identity, OpenHand, named_pose, sample_pose
from handbench.scene import Pose


@pytest.fixture(scope="module")
def hand() -> OpenHand:
    return OpenHand.load()


def angles(hand: OpenHand, seed: int = 0) -> torch.Tensor:
    return torch.tensor(sample_pose(np.random.default_rng(seed)).joints)


def test_weights_sum_to_one_at_every_level(hand: OpenHand) -> None:
    for level in (0, 1, 2):
        weights = hand.weights(level)
        assert weights.shape == (hand.quads(level).max() + 1, len(hand.joint_names))
        np.testing.assert_allclose(weights.sum(1), 1, atol=1e-12)
        assert weights.min() > -1e-12


def test_canonical_space(hand: OpenHand) -> None:
    vertices, joints = hand.rest(hand.neutral(), torch.float64)
    at = {name: joints[i].numpy() for i, name in enumerate(hand.joint_names)}
    np.testing.assert_allclose(at["wrist"], 0, atol=1e-6)
    assert abs(at["middle1"][0]) < 0.02 and at["middle1"][1] > 0.08
    assert at["thumb3"][0] > at["index1"][0] > at["little1"][0]
    assert at["thumb3"][2] > 0, "the thumb stands on the palm's side, +z"
    assert -0.115 < vertices[:, 1].min() < -0.08, "8 to 11 cm of forearm"


def test_template_is_a_closed_oriented_sphere(hand: OpenHand) -> None:
    quads = hand.template.quads
    directed = np.stack([quads, np.roll(quads, -1, 1)], -1).reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    both = {tuple(edge) for edge in directed}
    assert all((b, a) in both for a, b in both)
    assert quads.max() + 1 - len(directed) // 2 + len(quads) == 2
    a, b, c = (hand.template.vertices[hand.topology(0).faces[:, k]] for k in range(3))
    volume = (a * np.cross(b, c)).sum() / 6
    assert 3e-4 < volume < 6e-4, "positive: outward faces; hand and forearm stub have about 0.4 litres"


def test_no_rotation_is_the_rest_pose(hand: OpenHand) -> None:
    identity = hand.sample_identity(np.random.default_rng(3))
    vertices, _ = hand.rest(identity, torch.float64)
    posed = hand.skin(identity, np.zeros((len(hand.joint_names), 3)), dtype=torch.float64)
    torch.testing.assert_close(posed, vertices, atol=1e-12, rtol=0)


def test_placement_moves_the_posed_hand_rigidly(hand: OpenHand) -> None:
    from scipy.spatial.transform import Rotation

    identity, joints = hand.neutral(), angles(hand)
    turn, shift = np.array([0.3, -1.1, 2.0]), np.array([0.1, 0.2, -0.4])
    plain = hand.skin(identity, joints).numpy()
    placed = hand.skin(identity, joints, turn, shift).numpy()
    np.testing.assert_allclose(placed, Rotation.from_rotvec(turn).apply(plain) + shift, atol=1e-12)


@pytest.mark.parametrize("finger", ["thumb", "index", "middle", "ring", "little"])
def test_positive_flexion_brings_the_tip_to_the_palm(hand: OpenHand, finger: str) -> None:
    j = hand.joint_names.index(f"{finger}2")
    joints = np.zeros((len(hand.joint_names), 3))
    joints[j, 0] = 0.6
    tip = hand.weights(0)[:, hand.joint_names.index(f"{finger}3")] > 0.9
    moved = (hand.skin(hand.neutral(), joints) - hand.rest(hand.neutral())[0])[torch.from_numpy(tip)].mean(0).numpy()
    assert moved @ hand.frames[j][:, 2] > 0.004
    if finger != "thumb":
        assert moved[2] > 0.004


def test_positive_abduction_moves_towards_the_little_finger(hand: OpenHand) -> None:
    joints = np.zeros((len(hand.joint_names), 3))
    joints[hand.joint_names.index("index1"), 2] = 0.2
    tip = torch.from_numpy(hand.weights(0)[:, hand.joint_names.index("index3")] > 0.9)
    moved = (hand.skin(hand.neutral(), joints) - hand.rest(hand.neutral())[0])[tip].mean(0)
    assert moved[0] < -0.005


def test_bone_length_stretches_one_bone_only(hand: OpenHand) -> None:
    j = hand.joint_names.index("index2")
    neutral = hand.neutral()
    length = neutral.bone_length.copy()
    length[j] = 1.2
    _, before = hand.rest(neutral, torch.float64)
    _, after = hand.rest(Identity(neutral.blend, length, neutral.bone_width), torch.float64)
    parents = np.array(hand.parents)
    bones = np.flatnonzero(parents >= 0)
    ratio = (after[bones] - after[parents[bones]]).norm(dim=1) / (before[bones] - before[parents[bones]]).norm(dim=1)
    expected = np.where(parents[bones] == j, 1.2, 1.0)
    np.testing.assert_allclose(ratio.numpy(), expected, atol=1e-9)


def test_scaled_identity_is_the_scaled_hand(hand: OpenHand) -> None:
    identity = hand.sample_identity(np.random.default_rng(5))
    vertices, joints = hand.rest(identity, torch.float64)
    larger, larger_joints = hand.rest(identity.scaled(1.1), torch.float64)
    torch.testing.assert_close(larger, 1.1 * vertices, atol=1e-12, rtol=0)
    torch.testing.assert_close(larger_joints, 1.1 * joints, atol=1e-12, rtol=0)


def test_gradient_of_skin_agrees_with_finite_differences(hand: OpenHand) -> None:
    identity = hand.sample_identity(np.random.default_rng(1))
    rows = torch.randperm(len(hand.template.vertices), generator=torch.Generator().manual_seed(0))[:8]

    def some(joints: torch.Tensor, rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
        return hand.skin(identity, joints, rotation, translation)[rows]

    start = [angles(hand), torch.tensor([0.2, 0.1, -0.3]).double(), torch.zeros(3).double()]
    assert torch.autograd.gradcheck(some, [x.requires_grad_() for x in start], eps=1e-6, atol=1e-6)


def test_gradient_is_finite_at_zero_rotation(hand: OpenHand) -> None:
    joints = torch.zeros(len(hand.joint_names), 3, dtype=torch.float64, requires_grad=True)
    hand.skin(hand.neutral(), joints).square().sum().backward()
    assert joints.grad is not None and torch.isfinite(joints.grad).all() and joints.grad.abs().max() > 1e-4


def test_float32_is_within_ten_micrometres(hand: OpenHand) -> None:
    identity = hand.sample_identity(np.random.default_rng(2))
    exact = hand.subdivide(hand.skin(identity, angles(hand)), 2)
    single = hand.subdivide(hand.skin(identity, angles(hand).float()), 2)
    assert single.dtype == torch.float32
    assert (single.double() - exact).abs().max() < 1e-5


def test_sampled_identities_are_human(hand: OpenHand) -> None:
    rng = np.random.default_rng(0)
    identities = [hand.sample_identity(rng) for _ in range(200)]
    lengths = np.array([hand.length(identity) for identity in identities])
    assert lengths.min() >= 0.16 - 1e-9 and lengths.max() <= 0.21 + 1e-9
    assert 0.17 < lengths.mean() < 0.19 and 0.005 < lengths.std() < 0.015
    palm = hand.joint_names.index("index1"), hand.joint_names.index("little1")
    for identity in identities[:40]:
        _, joints = hand.rest(identity)
        breadth = float((joints[palm[0]] - joints[palm[1]]).norm())
        assert 0.27 < breadth / hand.length(identity) < 0.45


def test_same_seed_same_hand(hand: OpenHand) -> None:
    one, two = (hand.sample_identity(np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(one.blend, two.blend)
    np.testing.assert_array_equal(one.bone_width, two.bone_width)
    other = hand.sample_identity(np.random.default_rng(8))
    assert np.abs(other.blend - one.blend).max() > 0.1


def test_mesh_is_the_skinned_subdivided_surface(hand: OpenHand) -> None:
    pose = Pose(angles(hand).numpy(), np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.1, 0.0]))
    mesh = hand.mesh(hand.neutral(), pose, 1)
    coarse = hand.skin(hand.neutral(), pose.joints, pose.rotation, pose.translation, torch.float64)
    np.testing.assert_allclose(mesh.vertices, hand.subdivide(coarse, 1).numpy(), atol=1e-15)
    assert mesh.topology is hand.topology(1)


def test_nails_are_five_and_at_the_tips(hand: OpenHand) -> None:
    nail = hand.vertex_map("nail", 2)
    assert nail.min() > -1e-9 and nail.max() < 1 + 1e-9
    owners = hand.weights(2)[nail > 0.5].argmax(1)
    assert {hand.joint_names[j] for j in np.unique(owners)} == {
        f"{finger}3" for finger in ("thumb", "index", "middle", "ring", "little")
    }


def test_bad_input_is_refused(hand: OpenHand) -> None:
    joints = np.zeros((len(hand.joint_names), 3))
    with pytest.raises(InputError, match="joint_rotations has shape"):
        hand.skin(hand.neutral(), joints[:-1])
    with pytest.raises(InputError, match="NaN"):
        hand.skin(hand.neutral(), joints * np.nan)
    with pytest.raises(InputError, match=r"rotation has shape \(4,\)"):
        hand.skin(hand.neutral(), joints, np.zeros(4))
    with pytest.raises(InputError, match="blend has shape"):
        hand.rest(Identity(np.zeros(3), hand.neutral().bone_length, hand.neutral().bone_width))
    with pytest.raises(InputError, match="positive"):
        Identity(np.zeros(3), np.zeros(3), np.ones(3))
    with pytest.raises(InputError, match="level 9"):
        hand.topology(9)
    with pytest.raises(InputError, match="subdivide"):
        hand.subdivide(torch.zeros(5, 3), 1)
    with pytest.raises(InputError, match="unknown vertex map 'nails'; did you mean"):
        hand.vertex_map("nails", 0)
    with pytest.raises(InputError, match="joint_rotations"):
        hand.mesh(hand.neutral(), Pose(np.zeros((3, 3))), 0)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_hand_of_any_scale_bends_alike(hand: OpenHand, scale: float) -> None:
    joints = named_pose("fist").joints
    small = hand.skin(hand.neutral().scaled(scale), joints).double() / scale
    truth = hand.skin(hand.neutral(), joints, dtype=torch.float64)
    assert (small - truth).abs().max() < 1e-6


def test_odd_bones_are_finite_or_refused(hand: OpenHand) -> None:
    neutral, ones = hand.neutral(), hand.neutral().bone_length
    for odd in (Identity(neutral.blend, 1e3 * ones, ones), Identity(neutral.blend, ones, 1e-6 * ones)):
        assert np.isfinite(hand.mesh(odd, named_pose("fist"), 1).vertices).all()
    for length in (0 * ones, -ones):
        with pytest.raises(InputError, match="positive"):
            Identity(neutral.blend, length, ones)
    with pytest.raises(InputError, match="positive"):
        neutral.scaled(0.0)
    with pytest.raises(InputError, match="NaN"):
        Identity(neutral.blend * np.nan, ones, ones)


def test_rest_named_pose_is_no_rotation(hand: OpenHand) -> None:
    assert not named_pose("rest").joints.any()
