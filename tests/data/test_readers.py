"""Readers of published captures give back what look-alikes of their layouts were made from, conventions and all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lookalikes import CAMERAS, FRAMES, under, write_dataset_palm, write_goliath, write_harp, write_interhand

from handbench.data.capture import open_capture as by_name
from handbench.data.capture import read
from handbench.data.conventions import checked
from handbench.data.openstage import open_capture
from handbench.data.readers import interhand as module
from handbench.data.readers import open_at
from handbench.data.readers.goliath import GoliathCapture
from handbench.data.readers.harp import HarpCapture
from handbench.data.readers.interhand import InterHandCapture
from handbench.data.readers.palm import PalmCapture
from handbench.data.readers.zipped import Zips
from handbench.errors import Absent, BadFrame, InputError
from handbench.hand.known import forget
from handbench.scene import Group, Point, Unknown

STAGE = open_capture("mini")


pytestmark = pytest.mark.usefixtures("mano")


@pytest.fixture(scope="module")
def interhand(mano: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("interhand")
    return folder, write_interhand(folder, STAGE, mano)


@pytest.fixture(scope="module")
def harp(mano: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("harp")
    return folder, write_harp(folder, STAGE, mano)


@pytest.fixture(scope="module")
def goliath(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_goliath(tmp_path_factory.mktemp("goliath"), STAGE).parent


# --- InterHand2.6M


def test_interhand_comes_back(interhand: tuple[Path, dict], mano: Any) -> None:
    folder, told = interhand
    capture = open_at(folder)
    assert isinstance(capture, InterHandCapture) and capture.hand == "mano-right"
    assert len(capture.frames()) == 6, "the left hand's picture is left out"
    assert "1 moments are of a left hand" in capture.remarks[0] and "masks are what" in capture.remarks[1]
    assert {"image", "alpha", "camera", "pose", "shape", "mesh", "keypoints", "full"} <= capture.offers
    assert "light" not in capture.offers
    cameras = {f"cam{CAMERAS[f.camera.name]}": f.camera for f in under(STAGE, "env-hall")}
    for frame in capture.frames():
        true = cameras[frame.camera.name]
        assert np.allclose(frame.camera.K, true.K) and np.allclose(frame.camera.world_to_camera, true.world_to_camera)
        pose, shape = told[frame.pose_name]
        vertices, points = mano.posed(shape, pose)
        assert np.allclose(frame.mesh.vertices, vertices, atol=1e-9) and np.allclose(frame.shape, shape)
        assert np.allclose(frame.pose.joints[1:], pose.joints[1:], atol=1e-9), "the mean pose is added once"
        seen = capture.observe(frame)
        places, _ = frame.camera.project(points[list(mano.key_points)])
        assert np.allclose(seen.keypoints[:, :2], places, atol=1e-6) and (seen.keypoints[:, 2] == 1).all()
        assert frame.segment == "ROM03_RT_No_Occlusion" and isinstance(frame.light, Unknown)
    found = checked(capture)
    assert found.overlap is None and not found.doubts, "masks that are drawn from the fit say nothing of it"


def test_interhands_masks_are_taken_where_they_are(interhand: tuple[Path, dict], tmp_path: Path) -> None:
    from PIL import Image

    folder = Path(shutil.copytree(interhand[0], tmp_path / "copy"))
    for picture in (folder / "images").rglob("*.jpg"):
        mask = folder / "masks" / picture.relative_to(folder / "images").with_suffix(".png")
        mask.parent.mkdir(parents=True, exist_ok=True)
        width, height = Image.open(picture).size
        Image.fromarray(np.tile(np.uint8([255, 0]), (height, width // 2))).save(mask)
    capture = InterHandCapture(folder)
    seen = capture.observe(capture.frames()[0])
    assert seen.alpha[0, :4].tolist() == [1, 0, 1, 0] and not seen.image[:, 1::2].any()
    assert not any("masks" in remark for remark in capture.remarks)


def test_a_wrong_mean_pose_is_found(interhand: tuple[Path, dict], mano: Any, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(interhand[0], tmp_path / "copy"))
    path = folder / "annotations" / "train" / "InterHand2.6M_train_MANO_NeuralAnnot.json"
    table = json.loads(path.read_text())
    masks = {f.key: InterHandCapture(folder).observe(f).alpha for f in InterHandCapture(folder).frames()}
    for fit in table["0"].values():  # whole poses, where the layout has relative ones
        fit["right"]["pose"][3:] = (np.array(fit["right"]["pose"][3:]) + mano.file.hands_mean).tolist()
    path.write_text(json.dumps(table))
    (by_points,) = checked(InterHandCapture(folder)).doubts
    assert "key points" in by_points and "is not added (flat_hand_mean = true)" in by_points
    write_masks(folder, masks)
    _, by_masks = checked(InterHandCapture(folder)).doubts
    assert "masks share" in by_masks and "the mean pose is not added (flat_hand_mean = true)" in by_masks


def write_masks(folder: Path, masks: dict[str, np.ndarray]) -> None:
    from PIL import Image

    for key, alpha in masks.items():
        _, number, camera, _ = key.split("/")
        place = folder / "masks" / "train" / "Capture0" / "ROM03_RT_No_Occlusion" / camera
        place.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.round(255 * alpha).astype(np.uint8)).save(place / f"image{number}.png")


def test_interhand_without_mano_has_key_points_alone(
    interhand: tuple[Path, dict], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HANDBENCH_MANO")
    forget("mano-right", "mano-left")
    capture = InterHandCapture(interhand[0])
    assert not {"pose", "mesh", "alpha", "shape"} & capture.offers and "keypoints" in capture.offers
    assert "set HANDBENCH_MANO" in capture.remarks[0]
    monkeypatch.undo()
    forget("mano-right", "mano-left")


def test_a_captures_folder_is_named_by_its_variable(
    interhand: tuple[Path, dict], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(Absent, match="name its folder in HANDBENCH_INTERHAND"):
        by_name("interhand", "released", tmp_path)
    monkeypatch.setenv("HANDBENCH_INTERHAND", str(interhand[0]))
    assert len(by_name("interhand", "released").frames()) == 6
    with pytest.raises(InputError, match="unknown size of interhand: 'quick'; known: palm, released"):
        by_name("interhand", "quick")
    with pytest.raises(Absent, match="has no images/train/Capture0/ROM04"):
        by_name("interhand", "palm")


def test_interhand_lacks_an_annotation(interhand: tuple[Path, dict], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(interhand[0], tmp_path / "copy"))
    (folder / "annotations" / "train" / "InterHand2.6M_train_camera.json").unlink()
    with pytest.raises(Absent, match=r"has no annotations/train/InterHand2.6M_train_camera\.json"):
        open_at(folder)


def test_a_damaged_fit_of_interhand_is_one_sentence(interhand: tuple[Path, dict], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(interhand[0], tmp_path / "copy"))
    path = folder / "annotations" / "train" / "InterHand2.6M_train_MANO_NeuralAnnot.json"
    table = json.loads(path.read_text())
    for damaged in ([[1.0], 2.0], "none", [0.0] * 9):
        table["0"]["12001"]["right"]["shape"] = damaged
        path.write_text(json.dumps(table))
        with pytest.raises(InputError, match="the fit of Capture0 12001 has no shape of 10 numbers"):
            open_at(folder)


# --- HARP


def test_harp_comes_back(harp: tuple[Path, dict]) -> None:
    folder, told = harp
    capture = open_at(folder)
    assert isinstance(capture, HarpCapture) and len(capture.frames()) == 4
    assert [f.segment for f in capture.frames()] == ["fit", "fit", "test", "test"]
    for frame in capture.frames():
        pixels, _ = told[frame.pose_name]
        places, depth = frame.camera.project(frame.mesh.vertices)
        assert np.abs(places - pixels).max() < 0.01 and (depth > 0).all()
        seen = capture.observe(frame)
        assert abs(float(seen.alpha.mean()) - float((seen.image[..., 0] > 0.1).mean())) < 0.05
        assert isinstance(frame.light, Unknown) and frame.moment in (0, 1)
    assert checked(capture).overlap > 0.95
    up = capture.frames()[0].camera.rotation[1]
    assert up.tolist() == [0, -1, 0], "pictures' down is the world's -y"


def test_harps_estimates_are_read_and_not_run(harp: tuple[Path, dict], tmp_path: Path) -> None:
    import pickle

    folder = Path(shutil.copytree(harp[0], tmp_path / "copy"))
    path = folder / "subject_1" / "1" / "metro_mano" / "0001_mano.pkl"
    path.write_bytes(pickle.dumps({"rot": np.zeros(3), "run": os.getcwd}))
    with pytest.raises(InputError, match="do not trust it"):
        open_at(folder)
    path.write_bytes(pickle.dumps({"rot": np.zeros(3)}))
    with pytest.raises(InputError, match="has no pose of 45 numbers"):
        open_at(folder)


# --- PALM


def test_palm_comes_back(mano: Any, tmp_path: Path) -> None:
    told = write_dataset_palm(tmp_path, STAGE, mano)
    capture = open_at(tmp_path)
    assert isinstance(capture, PalmCapture) and len(capture.frames()) == 6
    cameras = {"MCU_01": "dorsal", "MCU_04": "palmar"}
    stage = {(f.camera.name, f.pose_name): f for f in under(STAGE, "env-hall")}
    names = list(dict.fromkeys(f.pose_name for f in under(STAGE, "env-hall")))
    for frame in capture.frames():
        pose, shape = told[frame.pose_name]
        true = stage[cameras[frame.camera.name], names[int(frame.pose_name) - 1]]
        assert np.allclose(frame.camera.K, true.camera.K) and np.allclose(frame.camera.centre, true.camera.centre)
        assert np.allclose(frame.pose.joints[1:], pose.joints[1:], atol=1e-5), "the mean pose is added once"
        assert np.allclose(frame.mesh.vertices, mano.mesh(shape, pose, 0).vertices, atol=1e-5)
        seen, was = capture.observe(frame), STAGE.observe(true)
        assert np.abs(seen.alpha - was.alpha).max() < 0.003
        inside = (was.alpha > 0.99) & (was.image.max(axis=-1) < 1)
        assert np.abs(seen.image - was.image)[inside].max() < 0.02
    seen = capture.enrolment(segment="scan")
    assert len(seen.frames) == 6 and "pose" in seen.gives and "light" not in seen.gives
    np.save(tmp_path / "folders" / "0001" / "poses.npy", {"run": os.getcwd}, allow_pickle=True)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="do not trust it"):
        open_at(tmp_path)


# --- Goliath


def test_goliath_comes_back(goliath: Path) -> None:
    capture = open_at(goliath)
    assert isinstance(capture, GoliathCapture)
    frames = {(f.pose_name, f.camera.name): f for f in capture.frames()}
    assert len(frames) == 6, "two cameras; the frame of one light, and the one far from a registration, are left out"
    assert any("1 of 3 cameras have no pictures" in r for r in capture.remarks)
    assert any("1 partially lit frames are far from a registration" in r for r in capture.remarks)
    assert {
        "full",
        "group",
        "mesh",
        "uv",
        "light",
        "camera",
        "alpha",
    } <= capture.offers and "pose" in capture.offers
    stage = {(f.pose_name, f.lighting, f.camera.name): f for f in STAGE.frames() if f.subject == "s01"}
    for (number, name), frame in frames.items():
        pose, lighting = FRAMES[int(number)]
        own = next(key for key, identity in CAMERAS.items() if name == f"cam{identity}")
        true = stage[pose, lighting, own]
        assert np.allclose(frame.camera.K, true.camera.K, atol=1e-9)
        assert np.allclose(frame.camera.world_to_camera, true.camera.world_to_camera, atol=1e-9)
        assert frame.subject == "6641280-right" and frame.segment == "train"
        assert frame.kind == ("full" if lighting == "full" else "group")
        seen, was = capture.observe(frame), STAGE.observe(true)
        assert np.allclose(frame.pose.translation, [int(number) / 1000, -0.002, 0.0035]) and capture.hand is None
        assert frame.pose.joints.shape == (21, 3) and frame.pose.joints.ravel()[61] == 1
        if lighting == "full":
            assert np.allclose(frame.mesh.vertices, true.mesh.vertices, atol=1e-6)
            assert np.array_equal(seen.alpha > 0.5, was.alpha > 0.5)
        inside = (was.alpha > 0.99) & (0.5 * was.image.max(-1) < 0.95)
        assert np.abs(seen.image - 0.5 * was.image)[inside].mean() < 0.01, "linear, black taken off, balanced"


def test_goliaths_lights_and_meshes_between_registrations(goliath: Path) -> None:
    frames = [f for f in GoliathCapture(goliath).frames() if f.camera.name == f"cam{CAMERAS['dorsal']}"]
    full, group, after = frames
    assert isinstance(group.light, Group) and len(group.light.lights) == 5 and len(full.light.lights) == 6
    for i, light in enumerate(group.light.lights):
        assert isinstance(light, Point)
        away = float(np.linalg.norm(light.position))
        assert away == pytest.approx(1.1, rel=1e-6), "metres"
        assert light.intensity[0] / away**2 == pytest.approx(1111 * (i + 1) / 5555), "irradiance at the centre"
        direction = under(STAGE, f"olat-0{i}")[0].light.direction
        assert np.allclose(light.position / away, direction, atol=1e-9)
    share = (101 - 100) / (104 - 100)
    expected = (1 - share) * full.mesh.vertices + share * after.mesh.vertices
    assert np.allclose(group.mesh.vertices, expected)
    capture = GoliathCapture(goliath)
    assert capture.observe(group).alpha.max() == 1, "the mask of a partially lit frame is drawn from its mesh"


def test_goliaths_damaged_calibration_is_one_sentence(goliath: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(goliath, tmp_path / "copy"))
    (path,) = folder.glob("*/camera_calibration.json")
    table = json.loads(path.read_text())
    table["KRT"][1]["K"] = [[1.0], [1.0, 2.0]]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match="has no KRT with cameraId, K and T; get it anew"):
        open_at(folder)


def test_goliath_without_a_topology_has_no_meshes(goliath: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(goliath, tmp_path / "copy"))
    (folder / "topology.obj").unlink()
    capture = open_at(folder)
    assert not {"mesh", "alpha"} & capture.offers and any("topology.obj" in r for r in capture.remarks)


def test_a_bomb_in_an_archive_is_one_bad_frame(goliath: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(goliath, tmp_path / "copy"))
    (root,) = (p for p in folder.iterdir() if p.is_dir())
    capture = GoliathCapture(folder)
    path = root / "image" / f"cam{CAMERAS['dorsal']}.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"cam{CAMERAS['dorsal']}/000100.avif", b"\0" * (200 << 20))
    capture._zips = Zips()
    with pytest.raises(BadFrame, match="unpacks to 209,715,200 bytes"):
        read(capture, next(f for f in capture.frames() if f.camera.name == path.stem))


# --- all of them


def test_a_folder_of_no_layout_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is of no layout that is known .*handbench data template"):
        open_at(tmp_path)


def test_a_million_frames_are_light(interhand: tuple[Path, dict], mano: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of them here, in a tenth of 5 s and 1 GB."""
    numbers, cameras = [str(12001 + 3 * i) for i in range(1_250)], [f"cam{i}" for i in range(80)]
    said = module.Annotations(interhand[0], "train", hashlib.sha256())
    for table in (said._fits, said._points):
        table["0"] = dict.fromkeys(numbers, table["0"]["12001"])
    camera = InterHandCapture(interhand[0]).frames()[0].camera
    monkeypatch.setattr(said, "camera", lambda *where: camera)
    monkeypatch.setattr(module, "Annotations", lambda *where: said)
    monkeypatch.setattr(module, "_numbers", lambda place: numbers)
    monkeypatch.setattr(module, "_names", lambda place: cameras if place.name.startswith("ROM") else ["ROM03"])
    start = time.process_time()
    count = len(InterHandCapture(interhand[0]).frames())
    took = time.process_time() - start
    assert count == 100_000 and took < 2.0, "ten times what it takes on an idle machine"
    tracemalloc.start()
    kept = InterHandCapture(interhand[0])
    size = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert size / len(kept.frames()) < 1000, "bytes a frame"
