"""A convention that a capture has wrong is named by a sentence; one that is right raises no doubt."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import syntheticmano
from PIL import Image
from plainfolder import write_folder

from handbench.cli import main
from handbench.data.capture import Capture, usual_size
from handbench.data.conventions import checked
from handbench.data.folder import FILE, open_folder
from handbench.data.inspection import troubles
from handbench.data.openstage import open_capture
from handbench.data.overlay import sheet
from handbench.errors import InputError
from handbench.hand import hand_model
from handbench.hand.known import forget
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import Raster
from handbench.scene import Camera, Directional, Frame, Group, Mesh, Observation, Pose, Topology, Unknown

STAGE = open_capture("mini")
SOME = [f for f in STAGE.frames() if f.lighting in ("olat-04", "olat-05", "env-hall") and f.subject == "s01"]


class Told(Capture):
    """Frames of the light stage as a test tells them, with its pictures."""

    name, digest = "told", "told"

    def __init__(
        self,
        frame: Callable[[Frame], Frame] = lambda f: f,
        seen: Callable[[Observation], Observation] = lambda s: s,
        hand: str | None = None,
    ) -> None:
        self._of = {f.key: f for f in SOME}
        self._frames, self._seen, self.hand = tuple(frame(f) for f in SOME), seen, hand

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    def observe(self, frame: Frame) -> Observation:
        return self._seen(STAGE.observe(self._of[frame.key]))


def meshed(change: Callable[[Mesh], Mesh]) -> Callable[[Frame], Frame]:
    return lambda frame: replace(frame, mesh=change(frame.mesh))


def shot(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Frame], Frame]:
    def of(frame: Frame) -> Frame:
        c = frame.camera
        return replace(frame, camera=Camera(c.name, c.width, c.height, c.K, change(c.world_to_camera)))

    return of


def lit(flip: list[int]) -> Callable[[Frame], Frame]:
    def of(frame: Frame) -> Frame:
        if not isinstance(frame.light, Directional):
            return frame
        return replace(frame, light=Group((Directional(frame.light.direction * flip, frame.light.irradiance),)))

    return of


def flipped(mesh: Mesh) -> Mesh:
    uvs, uv_faces = mesh.topology.unwrapped
    return Mesh(mesh.vertices, Topology(mesh.topology.faces, np.c_[uvs[:, 0], 1 - uvs[:, 1]], uv_faces))


def test_what_is_right_raises_no_doubt() -> None:
    found = checked(Told())
    assert not found.doubts and found.overlap is not None and found.overlap > 0.9


@pytest.mark.parametrize(
    ("capture", "told"),
    [
        (
            lambda: Told(meshed(lambda m: Mesh(1000 * m.vertices, m.topology))),
            "in millimetres, not metres, it would be 9",
        ),
        (
            lambda: Told(shot(lambda m: np.c_[m[:, :3], 1000 * m[:, 3]])),
            "cameras in millimetres, not metres, it would be",
        ),
        (lambda: Told(shot(lambda m: m * [[1.0], [-1], [-1]])), r"\(OpenGL's axes for OpenCV's\) it would be 9"),
        (lambda: Told(shot(lambda m: np.c_[m[:, :3].T, -m[:, :3].T @ m[:, 3]])), "from camera to world"),
        (lambda: Told(seen=lambda s: replace(s, alpha=s.alpha[::-1])), "masks upside down it would be 9"),
        (
            lambda: Told(seen=lambda s: replace(s, alpha=np.roll(s.alpha, 60, 1))),
            "no convention that is known does better",
        ),
        (lambda: Told(meshed(flipped)), "V of its UVs seems to count from the top"),
        (lambda: Told(meshed(lambda m: Mesh(m.vertices, Topology(m.topology.faces)))), "have no UVs"),
        (lambda: Told(lit([1, 1, -1])), "with z turned round; mend the directions"),
        (lambda: Told(lit([-1, -1, -1])), "from the light, not to it"),
    ],
)
def test_what_is_wrong_is_named(capture: Callable[[], Capture], told: str) -> None:
    import re

    found = checked(capture())
    assert len(found.doubts) == 1 and re.search(told, found.doubts[0]), found


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain folder as it was written: no test gets it, they get copies."""
    return write_folder(tmp_path_factory.mktemp("untouched") / "hand", STAGE, colour='"srgb"')


@pytest.fixture
def folder(untouched: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(untouched, tmp_path / "hand"))


def test_codes_that_are_called_linear_are_found(folder: Path) -> None:
    assert not checked(open_folder(folder)).doubts
    text = (folder / FILE).read_text()
    (folder / FILE).write_text(text.replace('"srgb"', '"linear"'))
    (doubt,) = checked(open_folder(folder)).doubts
    assert 'say colour = "srgb"' in doubt


def test_pictures_of_another_size_than_their_cameras_say_nothing_of_conventions(folder: Path) -> None:
    for place in ("images", "masks"):
        for path in (folder / place).rglob("*.png"):
            picture = Image.open(path)
            picture.resize((picture.width // 2, picture.height // 2)).save(path)
    capture = open_folder(folder)
    assert not checked(capture).doubts and checked(capture).overlap is None
    assert all("its camera says" in trouble for trouble in troubles(capture))


def test_a_transposed_matrix_is_named() -> None:
    camera = SOME[0].camera
    with pytest.raises(InputError, match="K is transposed"):
        Camera("c", camera.width, camera.height, camera.K.T, camera.world_to_camera)


# --- MANO


@pytest.fixture(scope="module")
def hands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, Any]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDBENCH_MANO", str(syntheticmano.write(tmp_path_factory.mktemp("mano"))))
        forget("mano-right", "mano-left")
        yield hand_model("mano-right"), hand_model("mano-left")
    forget("mano-right", "mano-left")


class Posed(Capture):
    """Two poses of one MANO hand before a camera, told as poses of another convention; masks are drawn."""

    name, digest = "posed", "posed"

    def __init__(self, hand: str, poses: list[Pose], drawn: list[Mesh]) -> None:
        self.hand, camera = hand, next(f.camera for f in SOME)
        place = np.c_[np.diag([1.0, -1, -1]), [0, 0, 0.5]]
        self._camera = Camera("c", camera.width, camera.height, camera.K, place)
        frames = [
            Frame("me", f"p{i}", "room", pose, None, self._camera, Unknown("room"), "all", "environment", np.zeros(10))
            for i, pose in enumerate(poses)
        ]
        self._frames = tuple(frames)
        masks = [Raster(PosedMesh(mesh), self._camera, 2).alpha for mesh in drawn]
        self._masks = {f.key: mask for f, mask in zip(frames, masks, strict=True)}

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    def observe(self, frame: Frame) -> Observation:
        mask = self._masks[frame.key]
        return Observation(0.3 * mask[..., None].repeat(3, -1), mask)


def poses(hand: Any) -> list[Pose]:
    """Seen from the side, where bent fingers show."""
    rng = np.random.default_rng(0)
    turns = ([0.0, 1.2, 0.0], [0.3, 0.9, 1.0])
    return [Pose(hand.sample_pose(rng).joints, turn, [0.05, 0, 0]) for turn in turns]


@pytest.mark.parametrize(("added", "told"), [(1, "flat_hand_mean = true"), (-1, "flat_hand_mean = false")])
def test_the_wrong_mean_pose_is_named(hands: tuple[Any, Any], added: int, told: str) -> None:
    right, _ = hands
    mean, true = right.named_pose("mean").joints, poses(right)
    drawn = [right.mesh(np.zeros(10), pose, 0) for pose in true]
    assert not checked(Posed("mano-right", true, drawn)).doubts
    (doubt,) = checked(Posed("mano-right", [replace(p, joints=p.joints + added * mean) for p in true], drawn)).doubts
    assert told in doubt


def test_a_left_hand_that_is_called_right_is_named(hands: tuple[Any, Any]) -> None:
    right, left = hands
    true = [replace(p, rotation=[0.2, 0.1, 0.0]) for p in poses(left)]
    drawn = [left.mesh(np.zeros(10), pose, 0) for pose in true]
    (doubt,) = checked(Posed("mano-right", true, drawn)).doubts
    assert "as the other hand (not mano-right)" in doubt
    assert not checked(Posed("mano-left", true, drawn)).doubts and right.side != left.side


# --- what is seen


def test_the_sheet_shows_what_is_told() -> None:
    page = np.asarray(sheet(Told()))
    for colour in ((70, 220, 255), (255, 190, 60)):  # the outline, and arrows towards the lights
        assert (page[40:] == colour).all(axis=-1).sum() > 20
    without = np.asarray(sheet(Told(lambda f: replace(f, mesh=None))))
    assert not (without[40:] == (70, 220, 255)).all(axis=-1).any()


def test_a_capture_has_a_usual_size() -> None:
    assert [usual_size(name) for name in ("openstage", "harp", "interhand")] == ["quick", "released", "released"]


def test_the_verb_tells_and_draws(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["data", "check", "hand"]) == 0
    said = capsys.readouterr().out
    assert "a plain folder, offers" in said and "all sound" in said and (tmp_path / "hand-check.png").is_file()
    folder.rename(tmp_path / "harp")  # a folder is meant, whatever published capture is called like it
    assert main(["data", "check", "harp"]) == 0 and "a plain folder" in capsys.readouterr().out
    folder = (tmp_path / "harp").rename(folder)
    obj = folder / "meshes" / "pose-0.obj"
    obj.write_text("\n".join(line for line in obj.read_text().splitlines() if not line.startswith("f 1")))
    (folder / "masks" / "dorsal" / "pose-1.png").write_bytes(b"no picture")
    assert main(["data", "check", "hand/"]) == 2
    said = capsys.readouterr().out
    assert "me/pose-1/dorsal/room: mask" in said and "has other faces or UVs than the folder's first" in said
