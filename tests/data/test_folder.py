"""A plain folder tells what was written into it, whatever its units, axes and files; what is wrong is a sentence."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import syntheticmano
from PIL import Image
from plainfolder import frames_of, shown, write_folder

from handbench.cli import main
from handbench.data.capture import read
from handbench.data.folder import FILE, open_folder
from handbench.data.folder.template import write_template
from handbench.data.openstage import open_capture
from handbench.errors import BadFrame, InputError
from handbench.scene import Directional, Environment, Group, Uncalibrated, Unknown

STAGE = open_capture("mini")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("folder") / "hand", STAGE)


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "hand"))


@pytest.mark.parametrize(
    ("suffix", "cameras", "unit", "z_up"),
    [
        (".png", "nerfstudio", 1.0, False),
        (".exr", "colmap", 0.001, True),
        (".avif", "nerfstudio", 0.01, True),
        (".jpg", "colmap", 1.0, False),
    ],
)
def test_what_was_written_comes_back(suffix: str, cameras: str, unit: float, z_up: bool, tmp_path: Path) -> None:
    capture = open_folder(write_folder(tmp_path / "hand", STAGE, suffix=suffix, cameras=cameras, unit=unit, z_up=z_up))
    true = {(f.pose_name, f.camera.name): f for f in frames_of(STAGE)}
    assert len(capture.frames()) == len(true) == 6 and capture.hand == "openhand"
    assert {
        "mesh",
        "uv",
        "pose",
        "shape",
        "camera",
        "alpha",
        "image",
    } <= capture.offers and "light" not in capture.offers
    for frame in capture.frames():
        expected = true[frame.pose_name, frame.camera.name]
        assert np.allclose(frame.camera.K, expected.camera.K)
        assert np.allclose(frame.camera.world_to_camera, expected.camera.world_to_camera, atol=1e-9)
        assert np.allclose(frame.mesh.vertices, expected.mesh.vertices, atol=1e-9)
        assert np.array_equal(frame.mesh.topology.faces, expected.mesh.topology.faces)
        assert np.allclose(frame.pose.joints, expected.pose.joints) and np.allclose(frame.shape, expected.shape)
        assert np.allclose(frame.pose.translation, expected.pose.translation, atol=1e-9)
        assert np.allclose(frame.pose.rotation, expected.pose.rotation, atol=1e-9)
        assert isinstance(frame.light, Unknown) and frame.subject == "me"
        seen, was = capture.observe(frame), STAGE.observe(expected)
        assert np.abs(seen.alpha - was.alpha).max() < 0.003
        inside = was.alpha > 0.99
        if suffix == ".exr":
            assert np.allclose(seen.image[inside], was.image[inside], atol=1e-6)
        else:
            off = np.abs(shown(seen.image).astype(int) - shown(was.image))[inside]
            assert (off.max() <= 1) if suffix == ".png" else (off.mean() < 3)
        assert not seen.image[was.alpha == 0].any(), "black outside the mask"


def test_meshes_share_a_topology_and_are_read_when_asked_for(folder: Path) -> None:
    capture = open_folder(folder)
    meshes = {f.pose_key: f.mesh for f in capture.frames()}
    assert len({id(mesh) for mesh in meshes.values()}) == 3 and len({m.topology.digest for m in meshes.values()}) == 1
    (folder / "meshes" / "pose-2.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"pose-2\.obj has other faces or UVs"):
        _ = meshes["me/pose-2"].vertices


def test_the_digest_is_of_the_content(folder: Path, tmp_path: Path) -> None:
    before = open_folder(folder).digest
    assert open_folder(Path(shutil.copytree(folder, tmp_path / "elsewhere"))).digest == before
    picture = folder / "masks" / "dorsal" / "pose-0.png"
    Image.fromarray(255 - np.asarray(Image.open(picture))).save(picture)
    assert open_folder(folder).digest != before


def test_enrolment_is_one_subject_with_what_there_is(folder: Path) -> None:
    seen = open_folder(folder).enrolment()
    assert len(seen.frames) == 6 and {"image", "alpha", "mesh", "pose"} <= seen.gives
    assert not {"light", "depth", "keypoints"} & seen.gives
    with pytest.raises(InputError, match="no subject 'you'"):
        open_folder(folder).enrolment("you")


def test_one_picture_with_alpha_is_a_folder(tmp_path: Path) -> None:
    frame = frames_of(STAGE)[0]
    seen = STAGE.observe(frame)
    codes = np.dstack([shown(seen.image), np.round(255 * seen.alpha).astype(np.uint8)])
    Image.fromarray(codes).save(tmp_path / "hand.png")
    write_template(tmp_path)
    capture = open_folder(tmp_path)
    (found,) = capture.frames()
    assert capture.offers == {"image", "alpha", "camera", "environment"} and found.key == "me/hand/camera/room"
    assert found.camera.centre.tolist() == [0, 0, 0]
    assert np.allclose(found.camera.rotation[2], [0, 0, -1]), "it looks to -z, +y is up"
    with pytest.raises(InputError, match="is there already"):
        write_template(tmp_path)


def test_the_template_fits_what_is_there(folder: Path, capsys: pytest.CaptureFixture) -> None:
    (folder / FILE).unlink()
    assert main(["data", "template", str(folder)]) == 0
    assert FILE in capsys.readouterr().out
    capture = open_folder(folder)
    assert len(capture.frames()) == 6 and {"mesh", "pose", "alpha", "camera"} <= capture.offers
    (folder / FILE).unlink()
    (folder / "poses" / "pose-0.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"pose-0\.npz is damaged or no \.npz"):
        write_template(folder)


def test_lights_that_are_told(folder: Path) -> None:
    with (folder / FILE).open("a") as file:
        for x in (2.0, -2.0):
            file.write(f'[[light]]\nname = "room"\ndirection = [{x}, 0, 0]\nirradiance = [1, 1, 1]\n')
    frame = open_folder(folder).frames()[0]
    assert isinstance(frame.light, Group) and frame.kind == "group"
    first = frame.light.lights[0]
    assert isinstance(first, Directional) and first.direction.tolist() == [1, 0, 0]
    text = (folder / FILE).read_text().split("[[light]]")[0]
    shutil.copy(Path(STAGE.folder) / "environments" / "env-hall.exr", folder / "hall.exr")  # type: ignore[attr-defined]
    (folder / FILE).write_text(text + '[[light]]\nname = "room"\nenvironment = "hall.exr"\n')
    frame = open_folder(folder).frames()[0]
    assert isinstance(frame.light, Environment) and frame.kind == "environment"


def test_without_cameras_they_are_uncalibrated_and_fields_name_frames(folder: Path) -> None:
    text = (folder / FILE).read_text().split("[cameras]")[0]
    (folder / FILE).write_text(text.replace('lighting = "room"', 'sequence = true\nlighting = "lamp"'))
    frames = open_folder(folder).frames()
    assert all(isinstance(f.camera, Uncalibrated) and f.camera.width == 64 for f in frames) or frames[0].camera.width
    assert {f.lighting for f in frames} == {"lamp"} and {f.moment for f in frames} == {0, 1, 2}


def test_depth_and_key_points(folder: Path) -> None:
    frames, rng = frames_of(STAGE), np.random.default_rng(0)
    depth = np.full((frames[0].camera.height, frames[0].camera.width), 520, np.uint16)
    points = rng.uniform(0, 40, (21, 3))
    for frame in frames:
        for kind in ("depth", "keypoints"):
            (folder / kind / frame.camera.name).mkdir(parents=True, exist_ok=True)
        Image.fromarray(depth).save(folder / "depth" / frame.camera.name / f"{frame.pose_name}.png")
        np.save(folder / "keypoints" / frame.camera.name / f"{frame.pose_name}.npy", points)
    more = 'depth = "depth/{camera}/{pose}.png"\nkeypoints = "keypoints/{camera}/{pose}.npy"\n[cameras]'
    (folder / FILE).write_text((folder / FILE).read_text().replace("[cameras]", more))
    capture = open_folder(folder)
    seen = capture.observe(capture.frames()[0])
    assert {"depth", "keypoints"} <= capture.offers
    assert np.allclose(seen.depth[seen.alpha > 0], 0.52) and np.allclose(seen.keypoints, points)


def test_manos_parameters_need_their_convention(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from handbench.hand import hand_model
    from handbench.hand.known import forget

    monkeypatch.setenv("HANDBENCH_MANO", str(syntheticmano.write(tmp_path / "mano")))
    forget("mano-right", "mano-left")
    rng = np.random.default_rng(0)
    for path in (folder / "poses").iterdir():
        np.savez(path, hand_pose=rng.uniform(-0.1, 0.1, 45), global_orient=np.zeros(3), transl=[0, 0, 500.0],
                 betas=np.zeros(10))  # fmt: skip
    text = (
        (folder / FILE).read_text().replace('"openhand"', '"mano-right"').replace('"meshes/{pose}.obj"', '"from poses"')
    )
    (folder / FILE).write_text(text)
    with pytest.raises(
        InputError, match=r"500 m away; if these are millimetres|say flat_hand_mean = true if it is whole"
    ):
        open_folder(folder)
    for flat in ("true", "false"):
        (folder / FILE).write_text(f"flat_hand_mean = {flat}\n" + text.replace('"metres"', '"millimetres"'))
        frame = open_folder(folder).frames()[0]
        mean = hand_model("mano-right").named_pose("mean").joints
        assert np.abs(frame.pose.joints - (mean if flat == "false" else 0)).max() < 0.1
        assert frame.pose.translation[2] == pytest.approx(0.5 + 0.0062, abs=1e-3), "the wrist is at J_0 + transl"
        assert len(frame.mesh.vertices) == 778
    forget("mano-right", "mano-left")


def toml(old: str, new: str) -> Callable[[Path], None]:
    return lambda folder: (folder / FILE).write_text((folder / FILE).read_text().replace(old, new)) and None


def transforms(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        table = json.loads((folder / "transforms.json").read_text())
        change(table)
        (folder / "transforms.json").write_text(json.dumps(table))

    return apply


def link(folder: Path) -> None:
    picture = folder / "images" / "dorsal" / "pose-0.png"
    picture.rename(folder.parent / "outside.png")
    picture.symlink_to(folder.parent / "outside.png")


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda f: (f / FILE).unlink(), "has no handbench.toml; write one with 'handbench data template"),
        (lambda f: (f / FILE).write_text("= ="), "is not valid TOML"),
        (toml("version = 1", "version = 7"), "must begin with format"),
        (toml("units", "unit"), "did you mean 'units'"),
        (toml('"metres"', '"inches"'), "units is 'inches'; use one of metres, centimetres, millimetres"),
        (toml("images/{camera}", "../images/{camera}"), "leads out of the folder"),
        (toml("images/{camera}", "/images/{camera}"), "leads out of the folder"),
        (toml("images/{camera}/{pose}.png", "images/{camera}/{frame}.png"), "has {frame}; its fields are subject"),
        (toml("images/{camera}/{pose}.png", "pictures/{camera}/{pose}.png"), "no picture that fits"),
        (toml('hand = "openhand"', ""), "of which hand model"),
        (toml('hand = "openhand"', 'hand = "openhand"\nflat_hand_mean = true'), "flat_hand_mean is of MANO's poses"),
        (toml('"poses/{pose}.npz"', '"poses/{camera}.npz"'), "a pose has one for all cameras"),
        (toml("lighting =", 'pose = "a"\nlighting ='), "pose is given, and read from images too"),
        (lambda f: (f / "masks" / "dorsal" / "pose-1.png").unlink(), "has no masks/dorsal/pose-1.png; add it"),
        (lambda f: np.savez(f / "poses" / "pose-1.npz", joints=np.zeros((16, 3))), r"shape \(16, 3\), expected \(21, "),
        (lambda f: np.savez(f / "poses" / "pose-1.npz", angles=np.zeros(3)), "holds angles; expected joints"),
        (lambda f: np.savez(f / "poses" / "pose-1.npz", joints=np.full((21, 3), 40.0)), "give radians, not degrees"),
        (lambda f: np.savez(f / "poses" / "pose-1.npz", joints=np.zeros((21, 3)), translation=[0, 0, 520.0]),
         'say units = "millimetres"'),
        (lambda f: np.savez(f / "poses" / "pose-1.npz", joints=np.array([{}])), "damaged|holds object"),
        (transforms(lambda t: t.update(k1=0.1)), "the lens distorts"),
        (transforms(lambda t: t.update(frames=[])), "has no frames"),
        (transforms(lambda t: [f.update(file_path="x.png") for f in t["frames"]]), "none of its pictures is in"),
        (transforms(lambda t: [(f.pop("fl_x"), f.update(camera_angle_x=0)) for f in t["frames"]]), "radians between 0"),
        (transforms(lambda t: t["frames"][0].update(transform_matrix=[[1]])), "give 4 rows of 4 numbers"),
        (transforms(lambda t: t["frames"][0].update(transform_matrix=(2 * np.eye(4)).tolist())), "not a rigid"),
        (link, "is a link that leads out of the folder"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_sentence(spoil: Callable[[Path], object], told: str, folder: Path) -> None:
    spoil(folder)
    with pytest.raises(InputError, match=told) as error:
        open_folder(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda f: (f / "images" / "dorsal" / "pose-0.png").write_bytes(b"\x89PNG\r\n\x1a\n"), "damaged or no picture"),
        (
            lambda f: Image.new("L", (3, 3)).save(f / "masks" / "dorsal" / "pose-0.png"),
            "mask masks/dorsal/pose-0.png is 3x3",
        ),
        (lambda f: Image.new("RGB", (9, 9)).save(f / "images" / "dorsal" / "pose-0.png"), "its picture 9x9"),
    ],
)
def test_a_bad_picture_is_one_bad_frame(spoil: Callable[[Path], object], told: str, folder: Path) -> None:
    spoil(folder)
    capture = open_folder(folder)
    with pytest.raises(BadFrame, match=f"me/pose-0/dorsal/room: .*{told}"):
        read(capture, capture.frames()[0])


def test_pictures_without_a_camera_are_left_out_and_told(folder: Path) -> None:
    transforms(lambda t: t["frames"].pop())(folder)
    capture = open_folder(folder)
    assert len(capture.frames()) == 5 and "1 pictures have no camera" in capture.remarks[0]
