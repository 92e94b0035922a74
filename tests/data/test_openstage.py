"""The open light stage: declared recipes, exact sums, resumable generation, damage named."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from handbench.data.capture import Capture, read
from handbench.data.contactsheet import contact_sheet, summary
from handbench.data.exr import read_exr, rgb, write_exr
from handbench.data.openstage import PRESETS, capture_folder, open_capture, preset
from handbench.data.openstage.capture import OpenCapture
from handbench.data.openstage.make import make
from handbench.data.openstage.performance import TRACKING_NOISE, smooth_noise
from handbench.data.openstage.plans import production
from handbench.data.openstage.presets import GENERATOR_VERSION
from handbench.data.openstage.production import Production
from handbench.data.openstage.stage import ENVIRONMENT_IRRADIANCE, lightings
from handbench.errors import BadFrame, InputError, StorageError
from handbench.hand.openhand import OpenHand
from handbench.light.environment import solid_angles
from handbench.render.see.raster import rasterise
from handbench.scene import Environment, leaves
from handbench.scene.colour import eight_bit

STAGES = PRESETS["openstage"]
TINY = replace(
    STAGES["mini"], subjects=1, train_poses=1, held_out_poses=0, lights=4, held_out_lights=1, environments=("hall",)
)
TINY = replace(TINY, height=32, width=24, spp=48, truth_level=1, skin_size=128)


@cache
def plan() -> Production:
    """What is made of it, which takes longer to decide than to draw."""
    return production(TINY)


@pytest.fixture(scope="module")
def mini() -> Capture:
    return open_capture("mini")


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny capture as it was made: no test gets it to change, they get copies."""
    folder = tmp_path_factory.mktemp("tiny") / "capture"
    make(plan(), folder)
    return folder


def test_presets_meet_their_promises() -> None:
    quick = preset("quick")
    assert quick.subjects >= 6 and quick.train_poses + quick.held_out_poses >= 6 and len(quick.cameras) >= 3
    assert quick.lights >= 24 and quick.held_out_lights >= 6 and len(quick.environments) >= 6
    assert len({p.recipe for p in STAGES.values()}) == len(STAGES)
    assert replace(quick, spp=quick.spp + 1).recipe != quick.recipe
    with pytest.raises(InputError, match="did you mean 'quick'"):
        preset("quik")


def test_mini_ships_small_and_of_this_recipe() -> None:
    folder = capture_folder("mini")
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) <= 6e6
    told = json.loads((folder / "capture.json").read_text())
    assert told["generator"] <= GENERATOR_VERSION  # it is made anew once a version, after the last change of pictures
    assert told["generator"] < GENERATOR_VERSION or told["recipe"] == preset("mini").recipe


def test_frames_are_named_once_and_cover_everything(mini: Capture) -> None:
    frames = mini.frames()
    assert len({frame.key for frame in frames}) == len(frames)
    assert {frame.kind for frame in frames} == {"olat", "group", "full", "environment"}
    assert {frame.segment for frame in frames} == {"train", "held-out"}
    for segment in ("train", "held-out"):
        assert {f.subject for f in frames if f.segment == segment} == {"s01", "s02"}


def test_groups_and_fully_lit_frames_are_exact_sums_of_single_lights(mini: Capture) -> None:
    frames = [f for f in mini.frames() if f.pose_key == "s01/pose-1" and f.camera.name == "dorsal"]
    single = {tuple(f.light.direction): (f, mini.observe(f).image) for f in frames if f.kind == "olat"}
    checked = 0
    for frame in frames:
        if frame.kind in ("group", "full"):
            expected = sum(
                np.float32(leaf.irradiance[0] / single[tuple(leaf.direction)][0].light.irradiance[0])
                * single[tuple(leaf.direction)][1]
                for leaf in leaves(frame.light)
            )
            assert np.allclose(mini.observe(frame).image, expected, rtol=1e-5, atol=1e-7)
            checked += 1
    assert checked == 3


def test_held_out_lights_are_in_no_group(mini: Capture) -> None:
    held_out = {tuple(f.light.direction) for f in mini.frames() if f.lighting in ("olat-06", "olat-07")}
    grouped = {tuple(leaf.direction) for f in mini.frames() if f.kind == "group" for leaf in leaves(f.light)}
    assert len(held_out) == 2 and not held_out & grouped


def test_geometry_channels_agree_with_the_tracked_mesh(mini: Capture) -> None:
    frame = next(f for f in mini.frames() if f.key == "s01/pose-0/dorsal/full")
    seen = mini.observe(frame)
    drawn = rasterise(frame.mesh, frame.camera)
    inside = (seen.alpha > 0.999) & (drawn.alpha > 0.999)
    assert inside.sum() > 1000
    assert abs(float(seen.alpha.mean() - drawn.alpha.mean())) < 0.003
    assert np.allclose(np.linalg.norm(seen.normal[inside], axis=-1), 1.0, atol=2e-3)
    depth = drawn.mean(drawn.depth[:, None])[..., 0]
    assert np.median(np.abs(seen.depth[inside] - depth[inside])) < 1e-3
    normal = drawn.mean(drawn.normal)
    assert np.median((seen.normal * normal).sum(-1)[inside]) > 0.95
    uv = drawn.mean(drawn.uv)
    assert np.median(np.abs(seen.uv[inside] - uv[inside])) < 0.01


def test_the_tracked_mesh_is_coarser_and_off_by_less_than_a_millimetre() -> None:
    hand = OpenHand.load()
    noise = smooth_noise(hand.topology(1), len(hand.rest_position(1)), np.random.default_rng(0))
    length = np.linalg.norm(noise, axis=1)
    assert np.isclose(np.sqrt((length**2).mean()), TRACKING_NOISE)
    assert length.max() < 1e-3
    assert all(p.tracked_level < p.truth_level for p in STAGES.values())


def test_environments_are_exposed_alike() -> None:
    for light in lightings(preset("mini")):
        if light.kind == "environment":
            assert isinstance(light.light, Environment)
            radiance = light.light.radiance
            power = (radiance * solid_angles(*radiance.shape[:2])[..., None]).sum() / 3
            assert np.isclose(power / 4, ENVIRONMENT_IRRADIANCE, rtol=1e-3)


def test_generation_resumes_after_a_kill_and_costs_nothing_twice(tmp_path: Path) -> None:
    folder = tmp_path / "capture"

    def killed(step: int, total: int, **values: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(plan(), folder, killed)
    assert not (folder / "capture.json").exists()
    first = folder / "s01" / "pose-0" / "dorsal" / "geometry.exr"
    stamp = first.stat().st_mtime_ns
    assert not (folder / "s01" / "pose-0" / "palmar").exists()
    make(plan(), folder)
    assert first.stat().st_mtime_ns == stamp
    capture = OpenCapture(folder)
    assert len(capture.frames()) == 2 * (4 + 1 + 1 + 1)
    assert not list(folder.rglob("*.part"))
    assert capture.digest == OpenCapture(folder).digest


def test_generation_repeats(untouched: Path, tmp_path: Path) -> None:
    one, two = untouched, tmp_path
    make(plan(), two)
    files = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(two) for path in two.rglob("*") if path.is_file())
    first, second = (OpenCapture(folder) for folder in (one, two))
    for a, b in zip(first.frames(), second.frames(), strict=True):
        assert np.allclose(first.observe(a).image, second.observe(b).image, rtol=2e-3, atol=1e-3)


def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        make(plan(), blocked / "capture")


def test_a_full_disk_is_refused_before_work_starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10, 10, 0))
    with pytest.raises(StorageError, match=r"0\.00 GB free"):
        make(plan(), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    return Path(shutil.copytree(capture_folder("mini"), tmp_path / "mini"))


def test_an_image_of_the_wrong_size_is_named(copy: Path) -> None:
    write_exr(copy / "s01" / "pose-0" / "dorsal" / "olat-00.exr", rgb(np.zeros((10, 20, 3))))
    capture = OpenCapture(copy)
    frame = next(f for f in capture.frames() if f.lighting == "olat-00")
    with pytest.raises(InputError, match=r"olat-00\.exr is 20x10, its camera says 96x128"):
        capture.observe(frame)


def test_a_damaged_environment_is_named(copy: Path) -> None:
    write_exr(copy / "environments" / "env-hall.exr", rgb(np.full((4, 8, 3), -1.0)))
    with pytest.raises(InputError, match=r"env-hall\.exr is damaged: it is not what was generated"):
        OpenCapture(copy)


def test_a_capture_of_another_version_is_refused(copy: Path) -> None:
    path = copy / "capture.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "schema": 99}))
    with pytest.raises(InputError, match="schema 99"):
        OpenCapture(copy)
    path.write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        OpenCapture(copy)


def test_the_contact_sheet_shows_every_row_and_column(mini: Capture) -> None:
    sheet = np.asarray(contact_sheet(mini, cell_height=32))
    rows, columns = 2 * 2, 3 * 4
    cell = sheet[40 : 40 + rows * 35, 64 : 64 + columns * 27].reshape(rows, 35, columns, 27, 3)[:, :32, :, :24]
    assert (cell.max(axis=(1, 3, 4)) > 60).all()  # a hand in every cell
    assert "s01, s02" in summary(mini)


def test_display_is_srgb() -> None:
    assert eight_bit(np.array([0.0, 0.0031308, 0.2140411, 1.0, 7.0])).tolist() == [0, 10, 127, 255, 255]


def test_a_lost_file_is_made_again_and_nothing_else(
    untouched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(STAGES, "mini", TINY)
    folder = Path(shutil.copytree(untouched, capture_folder("mini", tmp_path)))
    lost, kept = (folder / "s01" / "pose-0" / camera / "olat-01.exr" for camera in ("dorsal", "palmar"))
    before, stamp = read_exr(lost), kept.stat().st_mtime_ns
    lost.unlink()
    open_capture("mini", tmp_path)
    assert all(np.allclose(read_exr(lost)[name], before[name], rtol=2e-3, atol=1e-3) for name in "RGB")
    assert kept.stat().st_mtime_ns == stamp


def test_making_again_does_not_vouch_for_a_picture_that_was_changed(untouched: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(untouched, tmp_path / "capture"))
    assert OpenCapture(folder).digest == TINY.recipe
    name = "s01/pose-0/dorsal/olat-00"
    write_exr(folder / f"{name}.exr", rgb(np.full((32, 24, 3), 0.5)))
    (folder / "s01/pose-0/palmar/olat-01.exr").unlink()
    make(plan(), folder)
    capture = OpenCapture(folder)
    with pytest.raises(BadFrame, match=rf"{name}: .*not what was generated"):
        read(capture, next(frame for frame in capture.frames() if frame.key == name))


@pytest.mark.parametrize("name", ["topology.npz", "s01/pose-0/tracked.npy"])
@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", b"nonsense"])
def test_damaged_meshes_are_named(copy: Path, name: str, damage: bytes) -> None:
    (copy / name).write_bytes(damage)
    with pytest.raises(InputError, match=Path(name).name):
        OpenCapture(copy)


def test_fully_lit_frames_hold_no_held_out_light(mini: Capture) -> None:
    held_out = {tuple(f.light.direction) for f in mini.frames() if f.lighting in ("olat-06", "olat-07")}
    full = next(f for f in mini.frames() if f.kind == "full")
    assert not held_out & {tuple(leaf.direction) for leaf in leaves(full.light)}


@pytest.mark.parametrize("at", [0.3, 0.6, 0.999])
@pytest.mark.parametrize("name", ["topology.npz", "s01/pose-0/tracked.npy", "environments/env-hall.exr"])
def test_a_flipped_bit_is_found_when_the_capture_is_opened(copy: Path, name: str, at: float) -> None:
    path = copy / name
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=path.name):
        OpenCapture(copy)


@pytest.mark.parametrize("sums", [True, False])
def test_a_flipped_bit_in_a_picture_is_found_when_it_is_read(copy: Path, sums: bool) -> None:
    path = copy / "s01/pose-0/dorsal/geometry.exr"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    if not sums:
        (copy / "sums.json").unlink()
        with pytest.raises(InputError, match="are not what was generated"):
            OpenCapture(copy)
        return
    capture = OpenCapture(copy)
    bad, sound = (next(f for f in capture.frames() if f.key == f"s01/pose-{i}/dorsal/olat-00") for i in (0, 1))
    with pytest.raises(BadFrame, match=r"s01/pose-0/dorsal/olat-00: .*geometry\.exr"):
        read(capture, bad)
    read(capture, sound)


def test_sums_are_made_again_where_they_are_missing_or_damaged(copy: Path) -> None:
    whole = (copy / "sums.json").read_text()
    for content in (None, "", "[]", '{"topology.npz": 3}', whole.replace("a", "b")):
        (copy / "sums.json").unlink() if content is None else (copy / "sums.json").write_text(content)
        OpenCapture(copy)
        assert (copy / "sums.json").read_text() == whole


def _first(kind: str, **values: object) -> Callable[[dict], None]:
    return lambda manifest: manifest[kind][0].update(values)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda m: m.update(cameras=[]), "it has no cameras"),
        (lambda m: m.update(subjects=[]), "it has no subjects"),
        (lambda m: m.pop("olat"), "'olat' is missing"),
        (lambda m: m.update(subjects="s01"), "is damaged"),
        (_first("cameras", width=5_000_000), "has 5000000 x 128 pixels, at most 32768 a side"),
        (_first("cameras", width="96"), "has 96 x 128 pixels"),
        (_first("cameras", K=[[1, 2], [3]]), "damaged"),
        (_first("lightings", weights=[1.0]), "has 1 weights"),
        (lambda m: m.update(generator=1), "was made by generator 1, .*: handbench data make openstage --size mini"),
        (_first("subjects", name="../s01"), r"'\.\./s01' cannot be the name of one of its subjects"),
        (_first("subjects", name="/etc"), "cannot be the name"),
        (_first("subjects", poses=3), "damaged"),
        (_first("subjects", poses=[{"name": "pose-0"}]), "damaged|lacks|cannot be read|not what"),
        (lambda m: m.pop("content"), "'content' is missing"),
        (lambda m: m.update(content=7), "not what was generated"),
    ],
)
def test_a_manifest_that_nobody_writes_is_one_sentence(copy: Path, change: Callable[[dict], None], told: str) -> None:
    path = copy / "capture.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=told):
        OpenCapture(copy)


def test_what_a_killed_generation_left_half_written_goes(tmp_path: Path) -> None:
    def still_there(age: float) -> bool:
        part = tmp_path / "s01" / ".olat-00.exr.1.part"
        part.parent.mkdir(exist_ok=True)
        part.write_text("half")
        os.utime(part, (time.time() - age,) * 2)
        make(plan(), tmp_path)
        return part.exists()

    assert not still_there(1000.0), "when a making starts"
    assert not still_there(30.0), "when it is finished"
    assert still_there(-1000.0), "another may be writing it"


@pytest.mark.parametrize("name", ["capture.json", "s01/pose-0/tracked.npy", "topology.npz"])
def test_a_capture_of_named_pipes_is_refused_at_once(copy: Path, name: str) -> None:
    (copy / name).unlink()
    os.mkfifo(copy / name)
    with pytest.raises(InputError, match="regular file"):
        _ = [frame.mesh.vertices for frame in OpenCapture(copy).frames()]
