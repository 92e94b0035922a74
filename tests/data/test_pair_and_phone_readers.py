"""Re:InterHand and UHM's phone scans give back what look-alikes of them were made from."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pairlookalike
import phonelookalike
import pytest
from lookalikes import CAMERAS, under
from PIL import Image

from handbench.data.capture import read
from handbench.data.conventions import checked
from handbench.data.inspection import troubles
from handbench.data.openstage import open_capture
from handbench.data.readers import open_at
from handbench.data.readers.reinterhand import ReInterHandCapture
from handbench.data.readers.uhm import UhmCapture, placed
from handbench.errors import BadFrame, InputError
from handbench.hand import hand_model
from handbench.hand.known import forget
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import Raster
from handbench.scene import Mesh, Unknown

STAGE = open_capture("mini")


pytestmark = pytest.mark.usefixtures("mano")


@pytest.fixture(scope="module")
def pair(mano: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("pair")
    return folder, pairlookalike.write(folder, STAGE, mano, hand_model("mano-left"))


@pytest.fixture(scope="module", params=["own", "goliath"])
def phone(request: pytest.FixtureRequest, mano: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list]:
    folder = tmp_path_factory.mktemp(request.param)
    write = phonelookalike.write_own if request.param == "own" else phonelookalike.write_goliath
    return folder, write(folder, STAGE, mano)


# --- Re:InterHand


def test_reinterhand_comes_back(pair: tuple[Path, dict], mano: Any) -> None:
    folder, told = pair
    capture = open_at(folder)
    assert isinstance(capture, ReInterHandCapture) and capture.hand == "mano-right"
    frames = capture.frames()
    assert len(frames) == 12 and len({f.key for f in frames}) == 12
    assert {"image", "alpha", "camera", "pose", "shape", "mesh", "keypoints", "environment"} <= capture.offers
    assert "light" not in capture.offers
    assert {f.segment for f in frames} == {"0001_clasp", "0002_touch", "unlisted"}
    lit = {f.lighting for f in frames}
    assert lit == {"frame-000012", "frame-000015", "frame-000018", "segment-0001_clasp", "segment-0002_touch",
                   "segment-unlisted"}  # fmt: skip
    cameras = {CAMERAS[f.camera.name]: f.camera for f in under(STAGE, "env-hall")}
    for frame in frames:
        moment, true = told[frame.camera.name, frame.pose_name], cameras[frame.camera.name]
        assert frame.subject == "RNS217" and isinstance(frame.light, Unknown)
        assert np.allclose(frame.camera.K, true.K) and np.allclose(frame.camera.world_to_camera, true.world_to_camera)
        vertices, points = mano.posed(moment.shape, moment.pose)
        assert np.allclose(frame.mesh.vertices, vertices, atol=1e-9), "the mean pose is added once, metres"
        seen = capture.observe(frame)
        places, _ = true.project(points[list(mano.key_points)])
        assert np.allclose(seen.keypoints[:, :2], places, atol=1e-6) and (seen.keypoints[:, 2] == 1).all()
    assert not list(troubles(capture)) and not checked(capture).doubts


def test_what_the_left_hand_hides_is_not_the_rights(pair: tuple[Path, dict], mano: Any) -> None:
    folder, told = pair
    capture = ReInterHandCapture(folder)
    hidden = 0
    for frame in capture.frames():
        moment = told[frame.camera.name, frame.pose_name]
        right, left = (
            Raster(PosedMesh(mesh), frame.camera, 1).depth_map
            for mesh in (Mesh(mano.posed(moment.shape, moment.pose)[0], mano.topology(0)), moment.left)
        )
        expected = (right > 0) & ((left == 0) | (right < left))
        hidden += int(((right > 0) & ~expected).sum())
        seen = capture.observe(frame)
        (mask,) = folder.glob(f"*/Mugsy_cameras/envmap_per_frame/masks/{frame.camera.name}/{frame.pose_name}.png")
        wrong = (seen.alpha > 0.5) != (expected & (np.asarray(Image.open(mask)) > 127))
        assert wrong.sum() < 0.1 * expected.sum(), "but for pixels at the edges"
        assert not seen.image[seen.alpha == 0].any()
    assert hidden > 100, "the left hand lies before the right in some pictures"


def test_reinterhand_without_a_left_hand_has_no_masks(
    pair: tuple[Path, dict], monkeypatch: Any, tmp_path: Path
) -> None:
    alone = tmp_path / "MANO_RIGHT.pkl"
    shutil.copy(Path(os.environ["HANDBENCH_MANO"]) / "MANO_RIGHT.pkl", alone)
    monkeypatch.setenv("HANDBENCH_MANO", str(tmp_path))
    forget("mano-right", "mano-left")
    capture = ReInterHandCapture(pair[0])
    assert "alpha" not in capture.offers and {"mesh", "pose"} <= capture.offers
    assert any("masks are not there" in remark for remark in capture.remarks)
    assert capture.observe(capture.frames()[0]).alpha is None
    monkeypatch.undo()
    forget("mano-right", "mano-left")


def test_reinterhands_other_key_points_are_read(pair: tuple[Path, dict], mano: Any, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(pair[0], tmp_path / "copy"))
    (root,) = folder.iterdir()
    shutil.rmtree(root / "orig_fits")
    assert "keypoints" not in ReInterHandCapture(folder).offers
    place = root / "keypoints_orig" / "keypoints_orig"
    place.mkdir(parents=True)
    for number in (12, 15, 18):
        moment = pair[1][CAMERAS["dorsal"], f"{number:06d}"]
        points = 1000 * mano.posed(moment.shape, moment.pose)[1][list(mano.key_points)]
        tips_first = [points[1 + 4 * finger + k] for finger in range(5) for k in (3, 2, 1, 0)]
        (place / f"{number}.json").write_text(json.dumps(np.r_[tips_first, points[:1], np.zeros((21, 3))].tolist()))
    capture, other = ReInterHandCapture(folder), ReInterHandCapture(pair[0])
    for frame in capture.frames():
        assert np.allclose(capture.observe(frame).keypoints, other.observe(frame).keypoints, atol=1e-6)


def test_a_wrong_mean_pose_of_reinterhand_is_found(pair: tuple[Path, dict], mano: Any, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(pair[0], tmp_path / "copy"))
    for path in folder.glob("*/mano_fits/params/*_right.json"):
        fit = json.loads(path.read_text())
        fit["pose"][3:] = (np.array(fit["pose"][3:]) + mano.file.hands_mean).tolist()
        path.write_text(json.dumps(fit))
    assert any("is not added (flat_hand_mean = true)" in doubt for doubt in checked(ReInterHandCapture(folder)).doubts)


def test_reinterhands_damage_is_one_sentence(pair: tuple[Path, dict], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(pair[0], tmp_path / "copy"))
    (root,) = folder.iterdir()
    (root / "mano_fits" / "params" / "15_left.json").unlink()
    capture = ReInterHandCapture(folder)
    assert len(capture.frames()) == 8 and any("1 moments are without a fit" in r for r in capture.remarks)
    fit = root / "mano_fits" / "params" / "12_right.json"
    kept = fit.read_text()
    for damaged in ('{"pose": [1]}', "[]", '{"pose": null, "shape": 3}'):
        fit.write_text(damaged)
        with pytest.raises(InputError, match=r"12_right\.json has no pose of 48 numbers"):
            open_at(folder)
    fit.write_text(kept)
    (root / "frame_list.txt").write_text("0001_clasp\n")
    with pytest.raises(InputError, match="no segment and frame"):
        open_at(folder)


# --- phone scans


def test_phone_scans_come_back(phone: tuple[Path, list]) -> None:
    folder, told = phone
    capture = open_at(folder)
    assert isinstance(capture, UhmCapture) and len(capture.frames()) == 3
    assert [f.segment for f in capture.frames()] == ["train", "train", "test"]
    assert {"image", "alpha", "camera", "pose", "shape", "mesh", "keypoints", "depth"} <= capture.offers
    assert {f.subject for f in capture.frames()} in ({"somebody"}, {"AXE977"})
    for frame, (true, vertices) in zip(capture.frames(), told, strict=True):
        places, depth = frame.camera.project(frame.mesh.vertices)
        expected, away = true.camera.project(vertices)
        assert np.abs(places - expected).max() < 0.02 and np.abs(depth - away).max() < 1e-4, "it is put where it was"
        seen, was = capture.observe(frame), STAGE.observe(true)
        assert np.abs(seen.alpha - was.alpha).max() < 0.003
        inside = (was.alpha > 0.99) & (was.image.max(axis=-1) < 1)
        assert np.abs(seen.image - was.image)[inside].mean() < 0.01
        near = Raster(PosedMesh(true.mesh), true.camera, 1).depth_map
        both = (seen.depth > 0) & (near > 0) & (was.alpha > 0.99)
        assert both.sum() > 0.8 * inside.sum() and np.median(np.abs(seen.depth - near)[both]) < 0.004
        assert seen.depth.max() < 1.3, "the wall two metres behind is not the hand's"
        assert isinstance(frame.light, Unknown) and frame.kind == "environment"
    assert checked(capture).overlap > 0.7 and not list(troubles(capture)) and not checked(capture).doubts


def test_a_point_cloud_is_put_where_it_is_seen() -> None:
    rng = np.random.default_rng(0)
    points, t = rng.normal(size=(21, 3)) * 0.05, np.array([0.1, -0.03, 0.6])
    K = np.array([[500.0, 0, 120], [0, 520.0, 90], [0, 0, 1]])
    flat = (points + t) @ K.T
    seen = np.c_[flat[:, :2] / flat[:, 2:], np.ones(21)]
    assert np.allclose(placed(points, seen, K), t)
    seen[3] = [1e4, 1e4, 0.0]  # not seen at all
    assert np.allclose(placed(points, seen, K), t)


def test_a_scan_without_camera_and_depth_is_read(mano: Any, tmp_path: Path) -> None:
    phonelookalike.write_own(tmp_path, STAGE, mano)
    video = tmp_path / "somebody" / "1"
    (video / "cam_param.json").unlink()
    shutil.rmtree(video / "depthmaps")
    capture = open_at(tmp_path)
    assert "depth" not in capture.offers
    frame = capture.frames()[0]
    assert frame.camera.K[0, 0] == 2000.0 and frame.camera.K[0, 2] == frame.camera.width / 2
    points = mano.posed(frame.shape, frame.pose)[1][list(mano.key_points)]
    off = frame.camera.project(points)[0] - capture.observe(frame).keypoints[:, :2]
    assert np.abs(off).mean() < 3, "the hand lies on what was detected, whatever the focal length"


def test_scans_of_strangers_are_read_with_care(mano: Any, tmp_path: Path) -> None:
    import pickle

    phonelookalike.write_own(tmp_path, STAGE, mano)
    person = tmp_path / "somebody"
    depth = person / "1" / "depthmaps" / "1.pkl"
    capture = open_at(tmp_path)
    for content, told in (
        (pickle.dumps(os.getcwd), "do not trust it"),
        (pickle.dumps({"depth": 1}), "expected .H, W. of metres"),
        (b"", "is no pickle that can be read"),
    ):
        depth.write_bytes(content)
        with pytest.raises(BadFrame, match=told):
            read(capture, capture.frames()[1])
    lists = person / "frame_list_train.txt"
    for line, told in (
        ("../1 0", "is no folder's name"),
        ("1 0 1", "expected sequence and frame"),
        ("1 x", "expected"),
    ):
        lists.write_text(f"{line}\n")
        with pytest.raises(InputError, match=told):
            open_at(tmp_path)
    lists.write_text("1 0\n1 0\n")
    with pytest.raises(InputError, match="is listed twice"):
        open_at(tmp_path)
