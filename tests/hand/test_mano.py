"""MANO: read from its pickle and nothing else, posed as its paper and smplx pose it. No file of MANO's is needed.

With HANDBENCH_MANO set to a real one, the same tests run on it.
"""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import syntheticmano
from scipy.spatial.transform import Rotation

from handbench.errors import Absent, InputError
from handbench.hand import hand_of
from handbench.hand.mano import ManoHand, create, find_mano, read_mano
from handbench.hand.mano.unpickle import read_pickle
from handbench.scene import Pose

REAL = os.environ.get("HANDBENCH_MANO")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(REAL) if REAL else syntheticmano.write(tmp_path_factory.mktemp("mano"))


@pytest.fixture(scope="module", params=["right", "left"])
def hand(request: pytest.FixtureRequest, folder: Path) -> ManoHand:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDBENCH_MANO", str(folder))
        try:
            return create(request.param)
        except Absent:
            pytest.skip(f"no file of the {request.param} hand")


def as_smplx(
    hand: ManoHand, betas: np.ndarray, hand_pose: np.ndarray, orient: np.ndarray, transl: np.ndarray, flat: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and 16 joints as smplx's MANO layer computes them, bone by bone, in float64."""
    file, shapes = hand.file, hand.file.shapedirs
    if not np.allclose(hand._shapes, shapes):  # its users mend the left hand before
        shapes = shapes * np.array([-1.0, 1, 1])[:, None]
    full = np.concatenate([orient, hand_pose + (0 if flat else file.hands_mean)]).reshape(16, 3)
    shaped = file.v_template + np.einsum("vck,k->vc", shapes, betas)
    joints = file.J_regressor @ shaped
    turns = Rotation.from_rotvec(full).as_matrix()
    bent = shaped + np.einsum("vcf,f->vc", file.posedirs, (turns[1:] - np.eye(3)).ravel())
    world = [np.eye(4)] * 16
    for j, parent in enumerate(file.parents):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turns[j], joints[j] - (joints[parent] if j else 0)
        world[j] = world[parent] @ local if j else local
    placed = np.array(world)
    relative = placed.copy()
    relative[:, :3, 3] -= np.einsum("jab,jb->ja", placed[:, :3, :3], joints)
    blended = np.einsum("vj,jab->vab", file.weights, relative)
    moved = np.einsum("vab,vb->va", blended[:, :3, :3], bent) + blended[:, :3, 3]
    return moved + transl, placed[:, :3, 3] + transl


@pytest.mark.parametrize("flat", [True, False])
def test_a_pose_is_what_smplx_makes_of_the_same_parameters(hand: ManoHand, flat: bool) -> None:
    rng = np.random.default_rng(1)
    betas, angles = rng.standard_normal(10), rng.uniform(-0.4, 0.4, 45)
    orient, transl = rng.standard_normal(3), np.array([0.1, -0.3, 0.8])
    pose = hand.pose_of(angles, orient, transl, betas, flat_hand_mean=flat)
    vertices, points = hand.posed(betas, pose)
    expected, joints = as_smplx(hand, betas, angles, orient, transl, flat)
    assert np.allclose(vertices, expected, atol=1e-9) and np.allclose(points[:16], joints, atol=1e-9)
    assert np.array_equal(points[16:], vertices[[744, 320, 443, 554, 671]])
    back = hand.parameters_of(pose, betas, flat_hand_mean=flat)
    for name, value in (("hand_pose", angles), ("global_orient", orient), ("transl", transl), ("betas", betas)):
        assert np.allclose(back[name], value, atol=1e-9), name


def test_what_the_mean_pose_is_for_must_be_said_and_matters(hand: ManoHand) -> None:
    with pytest.raises(TypeError, match="flat_hand_mean"):
        hand.pose_of(np.zeros(45), np.zeros(3), np.zeros(3), np.zeros(10))  # type: ignore[call-arg]
    flat, bent = (hand.pose_of(np.zeros(45), np.zeros(3), np.zeros(3), np.zeros(10), flat_hand_mean=f) for f in (1, 0))
    assert not flat.joints.any() and np.allclose(bent.joints, hand.named_pose("mean").joints)
    off = np.linalg.norm(hand.posed(np.zeros(10), flat)[1] - hand.posed(np.zeros(10), bent)[1], axis=1)
    assert off.max() > 0.01


def test_coefficients_are_of_the_first_components(hand: ManoHand) -> None:
    few = np.array([0.5, -0.2, 0.1])
    pose = hand.pose_of(few, np.zeros(3), np.zeros(3), np.zeros(10), flat_hand_mean=True)
    expected = sum(c * row for c, row in zip(few, hand.file.hands_components, strict=False))
    assert np.allclose(pose.joints[1:].ravel(), expected)


def test_the_chumpy_select_is_reduced_and_not_cut(folder: Path) -> None:
    if REAL:
        pytest.skip("of the synthetic file, whose 20 shapes are known")
    whole = syntheticmano.arrays()["shapedirs"]
    assert np.array_equal(read_mano(folder / "MANO_RIGHT.pkl").shapedirs, whole[:, :, :10])
    table = dict(syntheticmano.arrays())
    kept = read_mano(folder / "MANO_RIGHT.pkl")  # the second time from what was kept
    assert np.allclose(kept.J_regressor, table["J_regressor"]) and np.allclose(kept.weights, table["weights"])


def test_the_left_hand_is_the_right_one_in_a_mirror(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDBENCH_MANO", str(folder))
    right, left = create("right"), create("left")
    alone = ManoHand(left.file, "left")  # judged by its own first shape
    rng = np.random.default_rng(4)
    betas, joints = rng.standard_normal(10), np.r_[np.zeros((1, 3)), rng.uniform(-0.5, 0.5, (15, 3))]
    vertices, points = right.posed(betas, Pose(joints))
    for other in (left, alone):
        mirrored, at = other.posed(betas, Pose(joints * [1, -1, -1]))
        limit = 2e-3 if REAL else 1e-9
        assert np.abs(mirrored * [-1, 1, 1] - vertices).max() < limit
        assert np.abs(at * [-1, 1, 1] - points).max() < limit


def test_the_axes_are_manos(hand: ManoHand) -> None:
    sign = 1 if hand.side == "right" else -1
    tips = hand.points[16:]
    assert (sign * tips[1:, 0] < -0.1).all(), "fingers to -x"
    assert tips[0, 2] > 0.03, "thumb to +z"
    level = hand.rest_position(0)
    corners = level[hand.topology(0).faces]
    volume = np.linalg.det(corners - level.mean(axis=0)).sum()
    assert volume > 0, "faces look outwards"


def test_every_triangle_has_its_own_place_in_uv(hand: ManoHand) -> None:
    uvs, uv_faces = hand.topology(0).unwrapped
    corners = uvs[uv_faces]
    across, along = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0])
    assert (area > 0).all() and uvs.min() >= 0 and uvs.max() <= 1


def test_a_mesh_is_known_by_its_surface(hand: ManoHand, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from handbench.hand import known

    monkeypatch.setenv("HANDBENCH_MANO", str(folder))
    known.forget("mano-right", "mano-left")
    found, level = hand_of(hand.topology(0))
    assert found.name == hand.name and level == 0
    known.forget("mano-right", "mano-left")


def test_without_a_file_the_sentence_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("HANDBENCH_MANO", raising=False)
    with pytest.raises(Absent, match=r"MANO_RIGHT\.pkl.*set HANDBENCH_MANO"):
        find_mano("right")
    monkeypatch.setenv("HANDBENCH_MANO", str(tmp_path))
    with pytest.raises(Absent, match=r"MANO_LEFT\.pkl"):
        find_mano("left")


class _Evil:
    def __reduce__(self) -> tuple[object, ...]:
        return os.system, ("touch owned",)


class _Print:
    def __reduce__(self) -> tuple[object, ...]:
        return eval, ("1 + 1",)


def _huge() -> bytes:
    """An array that announces a terabyte."""
    head = pickle.dumps(np.zeros(3), protocol=2)
    return head.replace(b"K\x03", b"\x8a\x06\x00\x00\x00\x00\x00\x01")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (pickle.dumps(_Evil()), "names (posix|nt).system, which no file of hand data needs; do not trust it"),
        (pickle.dumps({"f": _Print()}), "names (__builtin__|builtins).eval"),
        (pickle.dumps(np.array([{}, []], dtype=object)), "array of objects"),
        (pickle.dumps(np.zeros(3), protocol=2)[:-20], "no pickle that can be read"),
        (b"solid cube", "no pickle that can be read"),
        (b"", "no pickle that can be read"),
        (_huge(), "array|no pickle"),
        (pickle.dumps({"x": 1 + 2j}), "names __builtin__.complex|names builtins.complex"),
    ],
)
def test_a_pickle_can_do_nothing(content: bytes, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(content)
    with pytest.raises(InputError, match=told):
        read_pickle(path, "MANO file")
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: t.pop("posedirs"), "has no posedirs"),
        (lambda t: t.update(v_template=t["v_template"] * 1000), "hand that is .* m across"),
        (lambda t: t.update(weights=t["weights"] * 0.5), "weights that do not sum to one"),
        (lambda t: t.update(weights=t["weights"][:, :15]), r"weights of shape \(778, 15\)"),
        (lambda t: t.update(f=t["f"] + 1), "faces that point outside"),
        (lambda t: t.update(hands_mean=t["hands_mean"] * np.nan), "NaN in hands_mean"),
    ],
)
def test_a_file_that_is_none_is_refused_by_name(change, told: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    table = dict(syntheticmano.arrays())
    change(table)
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(syntheticmano.pickled(table))
    with pytest.raises(InputError, match=told):
        read_mano(path)
