"""What is not given cannot be read: not from frames, nor observations, nor parts of a recording, nor copies of it."""

from __future__ import annotations

import copy
import pickle
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from handbench.errors import InputError, Unsupported
from handbench.method import silent
from handbench.recording import PARTS, Recording
from handbench.remote.method import _replies
from handbench.remote.wire import Codec
from handbench.render.see.raster import rasterise
from handbench.render.uv.atlas import Atlas
from handbench.scene import Camera, Directional, Frame, Mesh, Observation, Pose, Topology, Unknown, needed

SECRET = 0.123456789  # in every array that is not given below
_TOPOLOGY = Topology([[0, 1, 2]], [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
_CAMERA = Camera("front", 4, 4, [[8, 0, 2], [0, 8, 2], [0, 0, 1]], np.eye(3, 4))


def _frame(pose: str, lighting: str) -> Frame:
    light = Directional([0, 0, 1], [SECRET] * 3)
    mesh = Mesh(np.eye(3) + SECRET, _TOPOLOGY)
    return Frame("s01", pose, lighting, Pose(np.full((1, 3), SECRET)), mesh, _CAMERA, light, "train", "full", [SECRET])


def _observe(frame: Frame) -> Observation:
    maps = {"normal": np.full((4, 4, 3), SECRET), "depth": np.full((4, 4), SECRET), "uv": np.full((4, 4, 2), SECRET)}
    scan = Mesh(np.eye(3) + SECRET, _TOPOLOGY)
    return Observation(
        np.full((4, 4, 3), 0.5), np.full((4, 4), SECRET), **maps, keypoints=np.full((21, 3), SECRET), scan=scan
    )


FRAMES = tuple(_frame(pose, lighting) for pose in ("fist", "open") for lighting in ("env-park", "env-hall"))


def _secrets(value: object, seen: set[int] | None = None) -> list[str]:
    """Ways to the secret number, or to the lights' names, in everything that public fields lead to."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return []
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        return ["array"] if np.isclose(value, SECRET).any() or np.isclose(value, SECRET + 1).any() else []
    if isinstance(value, str):
        return [value] if "env" in value else []
    if isinstance(value, tuple | list):
        return [way for item in value for way in _secrets(item, seen)]
    if isinstance(value, dict):
        return [f"{key}.{way}" for key, item in value.items() for way in _secrets(item, seen)]
    if is_dataclass(value):
        names = [field.name for field in fields(value) if field.name in vars(value)]
        names += ["key", "query", "viewpoint"] if isinstance(value, Frame) else []
        return [f"{name}.{way}" for name in names for way in _secrets(getattr(value, name), seen)]
    return []


@pytest.mark.parametrize("way", ["itself", "where", "of_subject", "of_kind", "copied", "replaced"])
def test_nothing_that_is_not_given_can_be_read(way):
    recording = Recording(FRAMES, _observe, frozenset({"image", "camera"}))
    match way:
        case "where":
            recording = recording.where(lambda frame: True)
        case "of_subject":
            recording = recording.of_subject("s01")
        case "of_kind":
            recording = recording.of_kind("full")
        case "copied":
            recording = copy.copy(recording)
    frames = recording.frames
    if way == "replaced":
        frames = tuple(replace(frame, segment="held-out") for frame in frames)
        frames = pickle.loads(pickle.dumps(frames))
    assert len(frames) == 4
    assert not _secrets(frames)
    for frame in frames:
        seen = recording.observe(frame)
        assert seen.image.mean() == 0.5 and not _secrets(seen)
    whole = Recording(FRAMES, _observe)
    assert _secrets(whole.frames) and _secrets(whole.observe(whole.frames[0]))


@pytest.mark.parametrize("part", sorted(PARTS - {"image", "camera"}))
def test_one_part_is_left_out_and_the_others_stay(part):
    recording = Recording(FRAMES, _observe, PARTS - {part})
    frame = recording.frames[0]
    seen = recording.observe(frame)
    there = {
        "alpha": seen.alpha is not None,
        "depth": seen.depth is not None,
        "normal": seen.normal is not None,
        "uv": seen.uv is not None,
        "keypoints": seen.keypoints is not None,
        "scan": seen.scan is not None,
        "pose": frame.pose is not None,
        "shape": frame.shape is not None,
        "mesh": frame.mesh is not None,
        "light": not isinstance(frame.light, Unknown),
    }
    assert {name for name, given in there.items() if not given} == {part}
    if part == "uv":
        assert frame.mesh.topology.uvs is None


def test_an_uncalibrated_camera_tells_its_size_alone():
    camera = Recording(FRAMES, _observe, PARTS - {"camera"}).frames[0].camera
    assert (camera.name, camera.width, camera.height) == ("front", 4, 4)
    for ask in (lambda: camera.K, lambda: camera.world_to_camera, lambda: camera.centre):
        with pytest.raises(Unsupported, match="calibration of camera 'front' is not given"):
            ask()


def test_nothing_that_is_not_given_goes_over_the_wire():
    recording = Recording(FRAMES, _observe, frozenset({"image"}))
    frames = Codec().decode(*Codec().encode(recording.frames))
    assert len(frames) == 4 and not _secrets(frames)
    observe = _replies(recording, silent)["observe"]
    assert not _secrets([observe(frame.key) for frame in frames])
    with pytest.raises(KeyError):
        observe(FRAMES[0].key)


def test_frames_under_one_light_still_share_it():
    frames = Recording(FRAMES, _observe, PARTS - {"light"}).frames
    assert [frame.lighting for frame in frames] == ["light-0", "light-1", "light-0", "light-1"]
    assert frames[0].light is frames[2].light and frames[0].light is not frames[1].light
    assert len({frame.key for frame in frames}) == 4


def test_a_forged_frame_reads_nothing():
    recording = Recording(FRAMES[:2], _observe, PARTS - {"light"})
    for forged in (FRAMES[0], FRAMES[2], replace(recording.frames[0], pose_name="open")):
        with pytest.raises(InputError, match="not one of this recording"):
            recording.observe(forged)


def test_a_mesh_without_uvs_is_rasterised_and_has_no_texture():
    mesh = Mesh([[-0.2, -0.2, 1], [0.2, -0.2, 1], [0, 0.2, 1]], Topology([[0, 1, 2]]))
    raster = rasterise(mesh, _CAMERA)
    assert raster.alpha.any() and len(raster.normal)
    for ask in (lambda: Atlas.of(mesh.topology, 8), lambda: raster.uv):
        with pytest.raises(Unsupported, match="no UVs"):
            ask()


def test_a_needed_part_that_is_missing_is_named():
    assert needed(1.0, "mesh") == 1.0
    with pytest.raises(Unsupported, match="the mesh is not given"):
        needed(None, "mesh")
