"""Cameras of a file in a relighting: fixed ones and paths, in both forms, turned and scaled into our world."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handbench.avatars.portrait import Portrait
from handbench.avatars.repertoire import orbited
from handbench.data.camerafile import FLAGS, NUMBERS, is_camera_file, read_cameras
from handbench.data.lights import NamedLight
from handbench.data.options import split_options
from handbench.errors import InputError
from handbench.relighting.shots import Shots, Wish, moved
from handbench.scene import Camera

HALL = NamedLight("hall")
OURS = np.eye(3)
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # ours into a world with z up


def around(portrait: Portrait, count: int) -> list[Camera]:
    shown = portrait.repertoire
    middle = shown.middle(shown.posture("rest"))
    return [orbited(shown.camera("front"), middle, 20.0 * i, 5.0 * i) for i in range(count)]


def nerfstudio(path: Path, cameras: list[Camera], turn: np.ndarray = OURS, unit: float = 1.0) -> Path:
    frames = []
    for i, camera in enumerate(cameras):
        placed = np.eye(4)
        placed[:3, :3] = turn @ camera.rotation.T @ np.diag([1, -1, -1])  # OpenGL's camera to world
        placed[:3, 3] = turn @ camera.centre / unit
        own = {"fl_x": camera.K[0, 0], "fl_y": camera.K[1, 1], "cx": camera.K[0, 2], "cy": camera.K[1, 2],
               "w": camera.width, "h": camera.height}  # fmt: skip
        frames.append({"file_path": f"images/{i}.png", "transform_matrix": placed.tolist(), **own})
    path.write_text(json.dumps({"frames": frames}))
    return path


def colmap(folder: Path, cameras: list[Camera]) -> Path:
    folder.mkdir()
    K, rows = cameras[0].K, []
    size = f"{cameras[0].width} {cameras[0].height}"
    (folder / "cameras.txt").write_text(f"1 PINHOLE {size} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}\n")
    for i, camera in reversed(list(enumerate(cameras))):
        q = np.roll(Rotation.from_matrix(camera.rotation).as_quat(), 1)
        rows.append(" ".join(map(str, [i + 1, *q, *camera.world_to_camera[:, 3], 1, f"{i:03d}.png"])) + "\n\n")
    (folder / "images.txt").write_text("".join(rows))
    return folder


def read(text: str) -> tuple[Camera, ...]:
    name, options = split_options(text, "camera", ("yaw", *NUMBERS), FLAGS)
    assert is_camera_file(name)
    return read_cameras(name, options)


def same(one: Camera, other: Camera) -> bool:
    return np.allclose(one.world_to_camera, other.world_to_camera, atol=1e-6) and np.allclose(one.K, other.K)


def test_both_forms_give_the_cameras_back(portrait: Portrait, tmp_path: Path) -> None:
    cameras = around(portrait, 3)
    plain = nerfstudio(tmp_path / "plain.json", cameras)
    turned = nerfstudio(tmp_path / "turned.json", cameras, Z_UP, 0.001)
    sparse = colmap(tmp_path / "sparse", cameras)
    for text in (f"{plain}", f"{turned}:z-up,millimetres", f"{sparse}"):
        assert all(same(a, b) for a, b in zip(read(text), cameras, strict=True)), text
    (third,) = read(f"{turned}:millimetres,frame=2,z-up")
    assert same(third, cameras[2])


def test_a_path_is_followed_with_poses_and_light(portrait: Portrait) -> None:
    cameras = around(portrait, 3)
    wish = Wish((HALL,), cameras=tuple(cameras))
    shots = Shots(portrait, wish)
    shots.check()
    assert wish.moves and not wish.still_view and len(shots) == 3
    assert [same(shots.viewpoint(i).camera, cameras[i]) for i in range(3)] == [True] * 3
    assert shots.same_pose(0, 2), "the hand stands still"
    longer = Shots(portrait, replace(wish, seconds=5 / 24))
    assert len(longer) == 5 and same(longer.viewpoint(4).camera, cameras[2])
    half = longer.viewpoint(1).camera
    assert same(half, moved(cameras[0], cameras[1], 0.5)) and not same(half, cameras[0])
    away = [np.linalg.norm(c.centre - portrait.repertoire.middle(longer.postures[0])) for c in (half, cameras[0])]
    assert abs(away[0] - away[1]) < 0.02, "it stays about as far away"
    both = Shots(portrait, replace(wish, pose="all"))
    assert len(both) == 2 and same(both.viewpoint(1).camera, cameras[2])
    fixed = Shots(portrait, Wish((HALL,), cameras=(cameras[1],), turn_light=True, seconds=0.25))
    assert fixed.wish.still_view and len(fixed) == 6 and same(fixed.viewpoint(5).camera, cameras[1])
    plans = [replace(wish, cameras=tuple(some)).said() for some in (cameras, cameras[:2])]
    assert plans[0] != plans[1], "frames of other cameras are not taken for these"


def test_cameras_that_see_no_hand_are_told(portrait: Portrait, tmp_path: Path) -> None:
    cameras = around(portrait, 2)
    path = nerfstudio(tmp_path / "c.json", cameras, Z_UP, 0.001)
    for text in (f"{path}", f"{path}:z-up"):
        shots = Shots(portrait, Wish((HALL,), cameras=read(text)))
        with pytest.raises(InputError, match="none of the cameras sees the hand of toy"):
            shots.check()
    Shots(portrait, Wish((HALL,), cameras=read(f"{path}:z-up,millimetres"))).check()
    metres = nerfstudio(tmp_path / "m.json", cameras)
    with pytest.raises(InputError, match="none of the cameras sees the hand of toy"):
        Shots(portrait, Wish((HALL,), cameras=read(f"{metres}:millimetres"))).check()
    odd = (cameras[0], replace(cameras[1], width=48))
    with pytest.raises(InputError, match=r"have 2 sizes; .*--size"):
        Shots(portrait, Wish((HALL,), cameras=odd)).check()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("z-up,y-down", "both z-up and y-down"),
        ("millimetres,metres", "both metres and millimetres"),
        ("frame=2", "has no frame 2; give 0 to 1"),
        ("frame=0.5", "has no frame 0.5"),
        ("z-up=1", "z-up takes no value"),
        ("tilt=3", "did you mean|known"),
    ],
)
def test_options_that_mean_nothing_are_told(portrait: Portrait, tmp_path: Path, options: str, told: str) -> None:
    path = nerfstudio(tmp_path / "c.json", around(portrait, 2))
    with pytest.raises(InputError, match=told):
        name, said = split_options(f"{path}:{options}", "camera", NUMBERS, FLAGS)
        read_cameras(name, said)


def test_damaged_camera_files_are_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    for content, told in (
        ("{", "is no JSON"),
        ('{"frames": []}', "has no frames"),
        ('{"frames": [{"file_path": "a"}]}', "transform_matrix"),
        ('{"camera_path": []}', "has no frames"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=told):
            read_cameras(str(path), {})
    with pytest.raises(InputError, match="does not exist"):
        read_cameras(str(tmp_path / "none.json"), {})
