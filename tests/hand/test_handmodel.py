"""Every hand model keeps the same laws: the open hand, and a small synthetic one of MANO's structure, both sides."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from handbench.data.openstage import open_capture
from handbench.errors import InputError, Unsupported
from handbench.hand import HandModel, hand_model, hand_of
from handbench.hand.handmodel import Side, vector
from handbench.scene import Mesh, Pose, Topology

# MANO's order: wrist, then index, middle, little, ring and thumb, three joints each
NAMES = ("wrist", *(f"{finger}{k}" for finger in ("index", "middle", "little", "ring", "thumb") for k in (1, 2, 3)))
PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
FINGERS = ("thumb", "index", "middle", "ring", "little")
OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
SIDES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])


class SyntheticMano(HandModel):
    """MANO's structure on beads: a template, 10 shapes, a joint regressor, weights, 135 pose blend shapes.

    vertices = template + shapes β, joints = regressor vertices; the left hand is the right one in a mirror.
    """

    def __init__(self, side: Side = "right") -> None:
        rng = np.random.default_rng(0)
        mirror = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
        self.name, self.side = f"synthetic-{side}", side
        self.joint_names, self.parents, self.fingers = NAMES, PARENTS, FINGERS
        self.wrist, self.shape_size, self.levels = 0, 10, 0
        self.chains = tuple(tuple(NAMES.index(f"{f}{k}") for k in (1, 2, 3)) for f in FINGERS)  # type: ignore[misc]
        last = {chain[-1]: 16 + f for f, chain in enumerate(self.chains)}
        self.ends = np.array([NAMES.index("middle1"), *(last.get(j, j + 1) for j in range(1, 16))])
        self.frames = np.tile(np.eye(3), (16, 1, 1))
        centres = np.zeros((16, 3))
        for f, chain in enumerate(self.chains):
            for k, joint in enumerate(chain):
                centres[joint] = [-0.04 + 0.02 * f, 0.08 + 0.03 * k, 0.0]
        beads = centres[:, None] + 0.01 * OCTAHEDRON
        self.template = (beads.reshape(-1, 3) + np.array([0.096, 0.006, 0.006])) * mirror  # off the origin, as MANO's
        self.shapes = 2e-3 * rng.standard_normal((96, 3, 10)) * mirror[:, None]
        self.regressor = np.kron(np.eye(16), np.full((1, 6), 1 / 6))
        near = np.exp(-(((self.template[:, None] - self.regressor @ self.template) / 0.012) ** 2).sum(-1))
        self.skinning = near / near.sum(1, keepdims=True)
        # a mirrored rotation is M R M: entry (a, b) of R - I changes its sign with both axes
        signs = np.tile(np.outer(mirror, mirror).ravel(), 15)
        self.pose_shapes = 1e-4 * rng.standard_normal((96, 3, 135)) * mirror[:, None] * signs
        self.tip_vertices = tuple(6 * chain[-1] + 2 for chain in self.chains)
        faces = (6 * np.arange(16)[:, None, None] + SIDES).reshape(-1, 3)
        corners = np.arange(3 * len(faces)).reshape(-1, 3)
        at = np.stack([corners[:, 0] % 16, corners[:, 0] // 16], axis=1)[:, None] / 32.0
        uvs = (at + np.array([[0, 0], [0.02, 0], [0, 0.02]])).reshape(-1, 2)
        turn = slice(None, None, -1 if side == "left" else 1)
        self._topology = Topology(faces[:, turn], uvs, corners[:, turn])
        self.points = self.rest_points(self.neutral(), torch.float64)[1].numpy()

    def neutral(self) -> NDArray[np.float64]:
        return np.zeros(10)

    def sample_identity(self, rng: np.random.Generator) -> NDArray[np.float64]:
        return rng.standard_normal(10)

    def sample_pose(self, rng: np.random.Generator, amount: float = 1.0) -> Pose:
        return Pose(amount * rng.uniform(-0.6, 0.6, (16, 3)))

    def named_pose(self, name: str) -> Pose:
        if name != "rest":
            raise InputError(f"unknown pose {name!r}")
        return Pose(np.zeros((16, 3)))

    def rest_points(self, shape: Tensor | ArrayLike, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
        template, shapes, regressor = (
            torch.tensor(a, dtype=dtype) for a in (self.template, self.shapes, self.regressor)
        )
        vertices = template + shapes @ vector("shape", shape, (10,), dtype)
        joints = regressor @ vertices
        vertices, joints = vertices - joints[0], joints - joints[0]
        return vertices, torch.cat([joints, vertices[list(self.tip_vertices or ())]])

    def rest_position(self, level: int) -> NDArray[np.float64]:
        return self.rest_points(self.neutral(), torch.float64)[0].numpy()

    def weights(self, level: int) -> NDArray[np.float64]:
        return self.skinning

    def topology(self, level: int) -> Topology:
        if level != 0:
            raise InputError(f"level {level} is not in 0…0")
        return self._topology

    def edges(self) -> NDArray[np.int32]:
        return np.concatenate([self._topology.faces[:, [i, (i + 1) % 3]] for i in range(3)])

    def subdivide(self, vertices: Tensor, level: int) -> Tensor:
        if level != 0 or len(vertices) != 96:
            raise InputError("subdivide: 96 vertices at level 0")
        return vertices


def mano_by_hand(hand: SyntheticMano, shape: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MANO as its paper writes it, vertex by vertex with 4 x 4 matrices: vertices and joints, wrist at the origin."""
    rest = hand.template + hand.shapes @ shape
    at = hand.regressor @ rest
    turns = Rotation.from_rotvec(joints).as_matrix()
    bent = rest + hand.pose_shapes @ (turns[1:] - np.eye(3)).ravel()
    world = np.zeros((16, 4, 4))
    for j, parent in enumerate(PARENTS):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turns[j], at[j] - (at[parent] if j else 0.0)
        world[j] = local if parent < 0 else world[parent] @ local
    moved = np.empty_like(rest)
    for v, point in enumerate(bent):
        blended = sum(hand.skinning[v, j] * (world[j] @ [*(point - at[j]), 1.0]) for j in range(16))
        moved[v] = blended[:3]
    return moved - at[0], world[:, :3, 3] - at[0]


@pytest.fixture(scope="module", params=["openhand", "right", "left"])
def hand(request: pytest.FixtureRequest) -> HandModel:
    return hand_model() if request.param == "openhand" else SyntheticMano(request.param)


@pytest.fixture(scope="module")
def pose(hand: HandModel) -> Pose:
    return Pose(hand.sample_pose(np.random.default_rng(3)).joints, [0.3, -0.2, 0.9], [0.1, 0.5, -0.2])


def test_the_skeleton_is_a_hand(hand: HandModel) -> None:
    count = len(hand.joint_names)
    assert hand.side in ("left", "right") and hand.name
    assert len(set(hand.joint_names)) == len(hand.parents) == count
    assert all(parent < j for j, parent in enumerate(hand.parents)) and hand.parents.count(-1) == 1
    assert len(hand.fingers) == len(hand.chains) == 5 and hand.fingers[0] == "thumb"
    above = {j: hand.parents[j] for j in range(count)}
    for f, chain in enumerate(hand.chains):
        assert above[chain[2]] == chain[1] and above[chain[1]] == chain[0]
        assert hand.ends[chain[2]] == count + f
        root = chain[0]
        while root != hand.wrist:
            root = above[root]
            assert root >= 0, "every finger hangs on the wrist"
    for joint, end in enumerate(hand.ends.tolist()):
        below = hand.chains[end - count][2] if end >= count else above[end]
        while below != joint:
            below = above[below]
            assert below >= 0, "a bone ends in a point that hangs on it"
    assert np.allclose(hand.frames @ hand.frames.transpose(0, 2, 1), np.eye(3))
    assert (np.linalg.det(hand.frames) > 0).all()


def test_the_21_key_points_are_the_usual_ones(hand: HandModel) -> None:
    chosen = hand.key_points
    assert len(chosen) == len(set(chosen)) == 21 and chosen[0] == hand.wrist
    names = [*hand.joint_names, *(f"{finger} tip" for finger in hand.fingers)]
    for f, finger in enumerate(hand.fingers):
        assert [names[p] for p in chosen[1 + 4 * f : 5 + 4 * f]] == [f"{finger}{k}" for k in (1, 2, 3)] + [
            f"{finger} tip"
        ]
    away = np.linalg.norm(hand.points[list(chosen[1:])], axis=1).reshape(5, 4)
    assert (np.diff(away, axis=1) > 0).all(), "each is farther from the wrist than the one before"


@pytest.mark.parametrize("level", [0, 1])
def test_the_surface(hand: HandModel, level: int) -> None:
    if level > hand.levels:
        with pytest.raises(InputError, match="level"):
            hand.topology(level)
        return
    weights, topology = hand.weights(level), hand.topology(level)
    count = len(weights)
    assert weights.shape == (count, len(hand.joint_names)) and (weights >= 0).all()
    assert np.allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert topology is hand.topology(level)
    assert topology.faces.max() == count - 1 and topology.uvs.min() >= 0 and topology.uvs.max() <= 1
    assert hand.rest_position(level).shape == (count, 3)
    ones = hand.subdivide(torch.ones(len(hand.weights(0)), 1, dtype=torch.float64), level)
    assert ones.shape == (count, 1) and torch.allclose(ones, torch.ones_like(ones))
    mesh = hand.mesh(hand.neutral(), hand.named_pose("rest"), level)
    assert mesh.topology is topology and np.allclose(mesh.vertices, hand.rest_position(level), atol=1e-9)


def test_edges_are_those_of_the_coarse_surface(hand: HandModel) -> None:
    faces = hand.topology(0).faces
    of_faces = {frozenset(edge) for face in faces.tolist() for edge in zip(face, face[1:] + face[:1], strict=True)}
    edges = {frozenset(edge) for edge in hand.edges().tolist()}
    assert edges <= of_faces and {v for edge in edges for v in edge} == set(range(int(faces.max()) + 1))


def test_no_rotation_is_rest_and_the_wrist_is_the_origin(hand: HandModel) -> None:
    shape = hand.sample_identity(np.random.default_rng(1))
    vertices, joints = hand.rest(shape, torch.float64)
    assert joints.shape == (len(hand.joint_names), 3) and joints[hand.wrist].abs().max() < 1e-12
    posed, points = hand.posed(shape, hand.named_pose("rest"))
    assert np.allclose(posed, vertices, atol=1e-12) and np.allclose(points[: len(joints)], joints, atol=1e-12)
    assert np.allclose(hand.rest_points(hand.neutral(), torch.float64)[1], hand.points, atol=1e-12)
    assert not hand.named_pose("rest").joints.any()


def test_placement_is_rigid(hand: HandModel, pose: Pose) -> None:
    shape = hand.sample_identity(np.random.default_rng(1))
    placed, here = hand.posed(shape, pose), hand.posed(shape, Pose(pose.joints))
    turn = Rotation.from_rotvec(pose.rotation.copy())
    for there, own in zip(placed, here, strict=True):
        assert np.allclose(there, turn.apply(own) + pose.translation, atol=1e-12)


def test_a_finger_moves_what_hangs_on_it(hand: HandModel) -> None:
    chain = hand.chains[1]
    joints = np.zeros((len(hand.joint_names), 3))
    joints[chain[1]] = [0.5, 0.0, 0.0]
    _, points = hand.posed(hand.neutral(), Pose(joints))
    moved = np.flatnonzero(np.linalg.norm(points - hand.points, axis=1) > 3e-3)
    assert moved.tolist() == [chain[2], len(hand.joint_names) + 1]


def test_a_shape_is_a_vector_and_has_gradients(hand: HandModel, pose: Pose) -> None:
    given = hand.sample_identity(np.random.default_rng(2))
    shape = torch.tensor(np.asarray(given), dtype=torch.float64).requires_grad_()
    assert shape.shape == (hand.shape_size,)
    joints = torch.tensor(pose.joints).requires_grad_()
    skinned = hand.skin(shape, joints, pose.rotation, pose.translation)
    assert torch.equal(skinned.detach(), hand.skin(given, pose.joints, pose.rotation, pose.translation, torch.float64))
    probe = torch.from_numpy(np.random.default_rng(0).standard_normal(skinned.shape))
    (skinned * probe).sum().backward()
    for value, gradient in ((shape, shape.grad), (joints, joints.grad)):
        step = torch.zeros_like(value)
        step.view(-1)[2] = 1e-6
        with torch.no_grad():
            ends = [
                (hand.skin(*((value + s * step, joints) if value is shape else (shape, value + s * step)),
                           pose.rotation, pose.translation) * probe).sum()
                for s in (1.0, -1.0)
            ]  # fmt: skip
        assert gradient is not None
        assert float((ends[0] - ends[1]) / 2e-6) == pytest.approx(float(gradient.view(-1)[2]), rel=1e-4, abs=1e-5)


def test_bad_input_is_one_sentence(hand: HandModel) -> None:
    shape, joints = hand.neutral(), np.zeros((len(hand.joint_names), 3))
    for wrong in (np.zeros(hand.shape_size + 1), np.full(hand.shape_size, np.nan)):
        with pytest.raises(InputError, match="shape"):
            hand.rest(wrong)
    with pytest.raises(InputError, match="joint_rotations has shape"):
        hand.skin(shape, joints[1:])
    with pytest.raises(InputError, match="NaN"):
        hand.skin(shape, joints * np.nan)
    with pytest.raises(InputError, match="unknown pose"):
        hand.named_pose("no such")


def test_the_same_seed_gives_the_same_hand(hand: HandModel) -> None:
    one, two, other = (np.asarray(hand.sample_identity(np.random.default_rng(seed))) for seed in (5, 5, 6))
    assert np.array_equal(one, two) and not np.array_equal(one, other)
    one, two = (hand.sample_pose(np.random.default_rng(seed)).joints for seed in (5, 5))
    assert np.array_equal(one, two)
    assert not hand.sample_pose(np.random.default_rng(5), 0.0).joints.any()


@pytest.mark.parametrize("side", ["right", "left"])
def test_manos_structure_is_followed(side: Side) -> None:
    hand, rng = SyntheticMano(side), np.random.default_rng(7)
    shape, joints = rng.standard_normal(10), rng.uniform(-1.0, 1.0, (16, 3))
    vertices, points = hand.posed(shape, Pose(joints))
    expected, at = mano_by_hand(hand, shape, joints)
    assert np.allclose(vertices, expected, atol=1e-12) and np.allclose(points[:16], at, atol=1e-12)
    assert np.array_equal(points[16:], vertices[list(hand.tip_vertices or ())])
    stiff = SyntheticMano(side)
    stiff.pose_shapes = None
    assert np.abs(stiff.posed(shape, Pose(joints))[0] - vertices).max() > 1e-4  # the correctives do something


def test_a_left_hand_is_a_right_one_in_a_mirror() -> None:
    rng = np.random.default_rng(8)
    shape, joints = rng.standard_normal(10), rng.uniform(-1.0, 1.0, (16, 3))
    right, left = SyntheticMano("right"), SyntheticMano("left")
    vertices, _ = right.posed(shape, Pose(joints))
    mirrored, _ = left.posed(shape, Pose(joints * [1.0, -1.0, -1.0]))
    assert np.allclose(mirrored, vertices * [-1.0, 1.0, 1.0], atol=1e-12)


def test_a_capture_names_its_hand_model() -> None:
    mini = open_capture("mini")
    hand = hand_model(mini.hand)
    assert hand_of(mini.frames()[0].mesh.topology) == (hand, 1)
    assert mini.frames()[0].pose.joints.shape == (len(hand.joint_names), 3)
    with pytest.raises(InputError, match="did you mean 'openhand'"):
        hand_model("openhands")


@pytest.mark.parametrize("part", ["points", "ends", "frames", "limits"])
def test_the_hand_that_all_share_is_read_only(part: str) -> None:
    with pytest.raises(ValueError, match="read-only"):
        getattr(hand_model(), part)[...] = 0


def test_a_foreign_surface_is_refused() -> None:
    foreign = SyntheticMano().mesh(np.zeros(10), Pose(np.zeros((16, 3))), 0)
    assert isinstance(foreign, Mesh)
    with pytest.raises(Unsupported, match="128 triangles is of none of the hand models that are known"):
        hand_of(foreign.topology)
