"""Poses and textures between the open hand and MANO: there and back, and what is lost is told."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import syntheticmano

from handbench.cli import main
from handbench.data.exr import rgb, write_exr
from handbench.data.pictures import read_picture
from handbench.data.poses import read_poses, write_poses
from handbench.errors import Unsupported
from handbench.hand import HandModel, hand_model, known
from handbench.hand.conversion import _aligned, converted
from handbench.hand.mano import ManoHand, create
from handbench.hand.textures import converted_texture
from handbench.render.uv.atlas import Atlas
from handbench.scene import Pose

OPEN = hand_model()


@pytest.fixture(scope="module")
def mano(tmp_path_factory: pytest.TempPathFactory) -> ManoHand:
    with pytest.MonkeyPatch.context() as patch:
        if "HANDBENCH_MANO" not in os.environ:
            patch.setenv("HANDBENCH_MANO", str(syntheticmano.write(tmp_path_factory.mktemp("mano"))))
        return create("right")


def placed(pose: Pose) -> Pose:
    return Pose(pose.joints, [0.4, -0.9, 0.3], [0.1, 0.2, 0.5])


@pytest.mark.parametrize("name", ["rest", "fist", "random"])
def test_key_points_meet(mano: ManoHand, name: str) -> None:
    pose = OPEN.sample_pose(np.random.default_rng(1)) if name == "random" else OPEN.named_pose(name)
    found = converted(placed(pose), OPEN.neutral(), OPEN, mano)
    assert found.residual.shape == (21,) and found.residual.mean() < 4e-3 and found.residual.max() < 0.012
    _, points = mano.posed(found.shape, found.pose)
    _, wanted = OPEN.posed(OPEN.neutral(), placed(pose))
    off = np.linalg.norm(points[list(mano.key_points)] - wanted[list(OPEN.key_points)], axis=1)
    assert np.allclose(off, found.residual), "the residual is what is left"
    assert f"{1e3 * off.mean():.1f} mm on average" in str(found)


def test_there_and_back_is_the_same_pose(mano: ManoHand) -> None:
    pose = placed(OPEN.sample_pose(np.random.default_rng(2), 0.7))
    there = converted(pose, OPEN.neutral(), OPEN, mano)
    back = converted(there.pose, there.shape, mano, OPEN, OPEN.neutral())
    _, one = OPEN.posed(OPEN.neutral(), pose)
    _, two = OPEN.posed(OPEN.neutral(), back.pose)
    assert np.linalg.norm(one - two, axis=1)[list(OPEN.key_points)].mean() < 4e-3
    assert np.allclose(back.shape, np.asarray(OPEN.neutral()))


def test_bones_point_alike_before_anything_is_refined(mano: ManoHand) -> None:
    pose = placed(OPEN.sample_pose(np.random.default_rng(3)))
    _, points = OPEN.posed(OPEN.neutral(), pose)
    start = _aligned(pose, OPEN, mano, points[OPEN.wrist])
    _, theirs = mano.posed(mano.neutral(), start)
    for ours, other in zip(OPEN.chains, mano.chains, strict=True):
        for a, b in zip(ours, other, strict=True):
            bone = points[OPEN.ends[a]] - points[a]
            same = theirs[mano.ends[b]] - theirs[b]
            assert bone @ same / np.linalg.norm(bone) / np.linalg.norm(same) > np.cos(np.radians(8))


def test_a_left_hand_is_not_taken_for_a_right_one(mano: ManoHand) -> None:
    left = ManoHand(mano.file, "left")
    with pytest.raises(Unsupported, match="mirror it first"):
        converted(OPEN.named_pose("rest"), OPEN.neutral(), OPEN, left)


def coloured(hand: HandModel, size: int, level: int) -> np.ndarray:
    """A texture that shows where on the hand it is: along the fingers, across, palm or back."""
    atlas = Atlas.of(hand.topology(level), size)
    at = atlas.interpolate(hand.rest_position(level)) if isinstance(hand, type(OPEN)) else None
    assert at is not None
    texture = np.zeros((3, size * size), np.float32)
    texture[:, atlas.texels] = at.T
    return texture.reshape(3, size, size)


def test_a_texture_shows_the_same_places(mano: ManoHand) -> None:
    found = converted_texture(coloured(OPEN, 256, 1), OPEN, mano, 192)
    assert found.texture.shape == (3, 192, 192) and found.distance.mean() < 3e-3
    assert "mm on average" in str(found)
    pose = converted(OPEN.named_pose("rest"), OPEN.neutral(), OPEN, mano)
    mesh = mano.mesh(pose.shape, pose.pose, 0)
    atlas = Atlas(mesh.topology, 192)
    shown = found.texture.reshape(3, -1)[:, atlas.texels].T
    off = np.linalg.norm(shown - atlas.interpolate(mesh.vertices), axis=1)
    assert np.median(off) < 3e-3 and np.percentile(off, 95) < 1e-2
    assert not found.texture[:, ~atlas.covered].any()


def test_the_verbs_convert_there_and_back(
    mano: ManoHand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    if "HANDBENCH_MANO" not in os.environ:
        monkeypatch.setenv("HANDBENCH_MANO", str(syntheticmano.write(tmp_path / "mano")))
    known.forget("mano-right", "mano-left")
    rng = np.random.default_rng(5)
    poses = [(placed(OPEN.sample_pose(rng, 0.6)), np.asarray(OPEN.neutral())) for _ in range(2)]
    write_poses(tmp_path / "open.npz", poses, OPEN)
    there = ["--to", "mano-right", "--flat-hand-mean", "no", "--out", str(tmp_path / "mano.npz")]
    assert main(["hand", "poses", str(tmp_path / "open.npz"), *there]) == 0
    assert "2 poses: key points differ by" in capsys.readouterr().out
    back = [
        "--from",
        "mano-right",
        "--flat-hand-mean",
        "no",
        "--to",
        "openhand",
        "--out",
        str(tmp_path / "back.npz"),
    ]
    assert main(["hand", "poses", str(tmp_path / "mano.npz"), *back]) == 0
    for (pose, shape), found in zip(poses, read_poses(tmp_path / "back.npz", OPEN), strict=True):
        _, one = OPEN.posed(shape, pose)
        _, two = OPEN.posed(found.shape, found.pose)
        assert np.linalg.norm(one - two, axis=1)[list(OPEN.key_points)].mean() < 4e-3
    assert main(["hand", "poses", str(tmp_path / "open.npz"), "--to", "mano-right", "--out", "x.npz"]) == 2
    assert "say which" in capsys.readouterr().err
    texture = tmp_path / "skin.exr"
    write_exr(texture, rgb(np.moveaxis(coloured(OPEN, 64, 1), 0, -1), dtype=np.float32))
    asked = ["--to", "mano-right", "--size", "64", "--out", str(tmp_path / "made.exr")]
    assert main(["hand", "texture", str(texture), *asked]) == 0
    assert "surfaces are apart by" in capsys.readouterr().out and read_picture(tmp_path / "made.exr").image.any()
    known.forget("mano-right", "mano-left")
