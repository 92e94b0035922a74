"""Relighting: what frames show, that it goes on where it was stopped, one exposure, flicker, and the files."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handbench.avatars.portrait import Portrait
from handbench.avatars.repertoire import orbited, resized
from handbench.bench.progress import Steps
from handbench.data.exr import rgb, write_exr
from handbench.data.lights import NamedLight
from handbench.errors import InputError, StorageError
from handbench.light.environment import rotate
from handbench.method import Pose
from handbench.relighting.drawing import DrawingTimes, DrawnFrames
from handbench.relighting.drawing import draw as draw_under
from handbench.relighting.shots import Shots, Wish, between
from handbench.relighting.showing import Tiles, exposure_of, flicker_of
from handbench.relighting.video import check_video, write_video

HALL = NamedLight("hall")


def steps(label: str):  # type: ignore[no-untyped-def]
    return lambda step, total, **values: None


TOLD: Steps = steps


def draw(portraits: list[Portrait], wish: Wish, folder: Path, told: Steps) -> tuple[DrawnFrames, list[DrawingTimes]]:
    return draw_under(portraits, wish, [light.read() for light in wish.lights], folder, told)


@pytest.fixture(scope="session")
def turned(portrait: Portrait, tmp_path_factory: pytest.TempPathFactory) -> DrawnFrames:
    """Two portraits, one of them half as bright, under a light that turns in 6 frames."""
    avatar = type(portrait.avatar)(0.5 * portrait.avatar._texture, portrait.prior)  # type: ignore
    dim = replace(portrait, name="dim", avatar=avatar, digest="dim")
    wish = Wish((HALL,), turn_light=True, seconds=0.25)
    frames, times = draw([portrait, dim], wish, tmp_path_factory.mktemp("relight") / "out.frames", TOLD)
    assert [len(each.new_pose) for each in times] == [1, 1] and [len(each.known_pose) for each in times] == [5, 5]
    return frames


def test_each_frame_is_the_picture_under_its_light(portrait: Portrait, turned: DrawnFrames) -> None:
    shown = portrait.repertoire
    viewpoint = shown.viewpoint(shown.posture("rest"), shown.camera("front"))
    for frame in (0, 4):
        light = rotate(HALL.read(), 2 * np.pi * frame / 6)
        expected = portrait.avatar.pose(viewpoint).relight(light)
        image, alpha = turned.read(frame, 0)
        np.testing.assert_allclose(image, expected.image, rtol=2e-3, atol=1e-4)
        np.testing.assert_allclose(alpha, expected.alpha, atol=1e-3)


def test_a_stopped_relighting_goes_on_and_another_one_begins_anew(portrait: Portrait, tmp_path: Path) -> None:
    wish = Wish((HALL,), turn_light=True, seconds=2 / 24)
    frames, _ = draw([portrait], wish, tmp_path / "f", TOLD)
    stamp = frames.path(0, 0).stat().st_mtime_ns
    frames.path(1, 0).unlink()
    again, times = draw([portrait], wish, tmp_path / "f", TOLD)
    assert again.path(0, 0).stat().st_mtime_ns == stamp and again.path(1, 0).is_file()
    assert len(times[0].new_pose) + len(times[0].known_pose) == 1
    _, times = draw([portrait], replace(wish, yaw=10.0), tmp_path / "f", TOLD)
    assert len(times[0].new_pose) + len(times[0].known_pose) == 2
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "x").touch()
    with pytest.raises(StorageError, match="holds no frames"):
        draw([portrait], wish, tmp_path / "mine", TOLD)


def test_exposure_is_one_for_all_and_names_stand_below(turned: DrawnFrames) -> None:
    exposure = exposure_of(turned)
    both = np.concatenate([turned.read(f, p)[0][turned.read(f, p)[1] > 0.5] for f in range(6) for p in range(2)])
    assert np.percentile(both, 99) * exposure == pytest.approx(0.8, rel=1e-3)
    tiles = Tiles(turned, ["toy", "dim"], exposure)
    shown = tiles(0)
    assert shown.shape[1] == 48 and shown.shape[0] > 32 and shown.dtype == np.uint8
    assert shown[:32, :24].astype(int).sum() > 1.2 * shown[:32, 24:].astype(int).sum()
    assert Tiles(turned, ["toy"], exposure)(0).shape == (32, 24, 3)


def test_camera_goes_around_and_comes_back(portrait: Portrait) -> None:
    shown = portrait.repertoire
    camera, middle = shown.camera("front"), shown.middle(shown.posture("rest"))
    side = orbited(camera, middle, 90.0, 0.0)
    assert side.centre[0] > 0.3 and abs(side.centre[2] - middle[2]) < 0.02  # from +z to +x
    assert orbited(camera, middle, 0.0, 30.0).centre[1] > camera.centre[1] + 0.1
    for yaw, pitch in ((90.0, 0.0), (200.0, 40.0), (10.0, 500.0)):
        found = orbited(camera, middle, yaw, pitch)
        np.testing.assert_allclose(found.project(middle)[0], camera.project(middle)[0], atol=1e-6)
        assert found.rotation[1] @ [0.0, 1.0, 0.0] < 0  # never upside down
        assert np.linalg.norm(found.centre - middle) == pytest.approx(np.linalg.norm(camera.centre - middle))
    larger = resized(camera, 96, 64)
    np.testing.assert_allclose(larger.project(middle)[0] - [48, 32], 2 * (camera.project(middle)[0] - [12, 16]))
    table = Shots(portrait, Wish((HALL,), turntable=True, seconds=0.5))
    assert len(table) == 12 and np.allclose(table.viewpoint(3).camera.centre, side.centre)


def test_another_camera_sees_the_same(portrait: Portrait) -> None:
    shown = portrait.repertoire
    light = HALL.read()
    first = portrait.avatar.pose(shown.viewpoint(shown.posture("rest"), shown.camera("front")))
    first.relight(light)
    shared = first.seen_by(shown.camera("wide")).relight(light)
    anew = portrait.avatar.pose(shown.viewpoint(shown.posture("rest"), shown.camera("wide"))).relight(light)
    assert np.array_equal(shared.alpha, anew.alpha)
    # shadows of cells are filled in between other texels
    assert np.abs(shared.image - anew.image).mean() < 0.005 * anew.image.mean() and anew.image.max() > 0.05


def test_avatars_with_different_numbers_of_poses_are_told_before_any_is_drawn(
    portrait: Portrait, tmp_path: Path
) -> None:
    shown = portrait.repertoire
    fewer = replace(shown, postures={"rest": shown.posture("rest")}, views=shown.views[:1])
    other = replace(portrait, name="other", repertoire=fewer)
    wish = Wish((HALL,), pose="all")
    with pytest.raises(InputError, match="2 and 1 poses; give --seconds"):
        draw([portrait, other], wish, tmp_path / "f", TOLD)
    assert not (tmp_path / "f").exists()
    frames, _ = draw([portrait, other], replace(wish, seconds=3 / 24), tmp_path / "f", TOLD)
    assert frames.count == 3 and all(frames.path(frame, 1).is_file() for frame in range(3))


def test_poses_follow_each_other(portrait: Portrait) -> None:
    shown = portrait.repertoire
    rest, turned = (shown.posture(name).pose for name in ("rest", "turned"))
    assert rest is not None and turned is not None
    shots = Shots(portrait, Wish((HALL,), pose="all", seconds=5 / 24))
    assert len(shots) == 5 and len(Shots(portrait, Wish((HALL,), pose="all"))) == 2
    found = [shots.viewpoint(frame).pose for frame in range(5)]
    assert [pose.rotation[1] for pose in found if pose] == pytest.approx([0.0, 0.15, 0.3, 0.45, 0.6])
    given = Shots(portrait, Wish((HALL,), poses=(rest, turned, rest)))
    assert len(given) == 3 and given.viewpoint(1).mesh is not None
    half = between(Pose(np.array([[0, 0, 0.2]])), Pose(np.array([[0, 0, 0.6]]), translation=[1, 0, 0]), 0.5)
    assert half.joints[0, 2] == pytest.approx(0.4) and half.translation[0] == 0.5


def test_times_are_told_as_numbers_with_their_unit() -> None:
    told = DrawingTimes([9.0, 3.0, 4.0], []).told
    assert told == {"new_pose_ms": 4.0, "new_pose_frames": 3, "known_pose_ms": None, "known_pose_frames": 0}


def fake(folder: Path, values: list[float]) -> DrawnFrames:
    folder.mkdir()
    frames = DrawnFrames(folder, len(values), 1)
    for i, value in enumerate(values):
        image = np.full((4, 6, 3), value, np.float32)
        write_exr(frames.path(i, 0), {**rgb(image), "A": np.ones((4, 6), np.float16)})
    return frames


def test_flicker_counts_jumps_and_no_even_change(tmp_path: Path) -> None:
    even = np.linspace(0.2, 0.5, 12)
    steady = flicker_of(fake(tmp_path / "a", even.tolist()), 0, 1.0)
    jumping = flicker_of(fake(tmp_path / "b", (even + 0.03 * (-1.0) ** np.arange(12)).tolist()), 0, 1.0)
    assert steady is not None and jumping is not None and steady < 0.002 and jumping > 0.02
    assert flicker_of(fake(tmp_path / "c", [0.1, 0.2, 0.3]), 0, 1.0) is None


def test_gif_and_mp4_show_the_colours_that_they_are_given(tmp_path: Path) -> None:
    frames = [np.full((33, 47, 3), colour, np.uint8) for colour in ((200, 120, 90), (90, 60, 40), (30, 30, 200))]
    write_video(tmp_path / "a.gif", frames, 10.0)
    with Image.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.info["duration"], gif.size) == (3, 100, (47, 33))  # type: ignore[attr-defined]
    write_video(tmp_path / "slow.gif", frames, 1e-3)
    with Image.open(tmp_path / "slow.gif") as gif:
        assert gif.info["duration"] == 655350  # the longest there is
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    write_video(tmp_path / "a.mp4", frames, 10.0)
    decode = (ffmpeg, "-loglevel", "error", "-i", str(tmp_path / "a.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-")
    pictures = np.frombuffer(subprocess.run(decode, check=True, capture_output=True).stdout, np.uint8)
    for frame, read in zip(frames, pictures.reshape(3, 34, 48, 3), strict=True):  # even sides
        middle = read[5:25, 5:40].reshape(-1, 3).mean(axis=0)
        assert np.abs(middle - frame[0, 0]).max() < 4, middle


def test_mp4_without_the_extra_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'handbench\[video\]'.*\.gif"):
        check_video(tmp_path / "a.mp4")
    check_video(tmp_path / "a.gif")


def test_too_long_and_unknown_are_told(portrait: Portrait) -> None:
    with pytest.raises(InputError, match="20000 frames"):
        len(Shots(portrait, Wish((HALL,), turntable=True, seconds=9e4)))
    with pytest.raises(InputError, match="4 seconds at 90000 frames a second"):
        len(Shots(portrait, Wish((HALL,), turntable=True, fps=9e4)))
    with pytest.raises(InputError, match="did you mean 'rest'"):
        Shots(portrait, Wish((HALL,), pose="rst")).viewpoint(0)
    with pytest.raises(InputError, match="unknown camera 'back'"):
        Shots(portrait, Wish((HALL,), camera="back")).viewpoint(0)
