"""One capture made by several processes is the one that a single process makes, whoever is stopped on the way."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from quicktracer import Quick

from handbench.bench import making
from handbench.claims import claim
from handbench.cli import main
from handbench.data.inspection import troubles
from handbench.data.openstage import PRESETS, capture_folder, check_made, helpers, open_capture, thumbnails
from handbench.data.openstage import make as module
from handbench.data.openstage.capture import OpenCapture
from handbench.data.openstage.make import make
from handbench.data.openstage.manifest import read_manifest
from handbench.data.openstage.plans import production
from handbench.data.openstage.production import Production
from handbench.data.readers import open_at
from handbench.errors import InputError, StorageError
from handbench.shards import Shard

TINY = replace(
    PRESETS["openstage"]["mini"],
    subjects=2,
    train_poses=2,
    held_out_poses=0,
    cameras=("dorsal",),
    lights=2,
    held_out_lights=1,
    environments=("hall",),
    height=16,
    width=12,
    spp=32,
    truth_level=0,
    tracked_level=0,
    skin_size=64,
)


@cache
def plan() -> Production:
    """What is made of it; planned when it is wanted, since poses are moved until no finger is in another."""
    return production(TINY)


@pytest.fixture(autouse=True, scope="module")
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PathTracer", Quick)
        yield


HERE = Path(__file__).parent
PATIENCE = 120.0  # seconds, after which a process hangs
SCRIPT = """
import sys
from dataclasses import replace
from pathlib import Path
sys.path[:0] = [sys.argv[1], sys.argv[2]]
from quicktracer import Quick
from test_making import plan
from handbench.data.openstage import helpers
from handbench.data.openstage import make as module
from handbench.data.openstage import thumbnails
module.PathTracer = Quick
module.make(plan(), Path(sys.argv[3]))
"""


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny capture, made alone."""
    folder = tmp_path_factory.mktemp("whole")
    assert make(plan(), folder) == ()
    return folder


def test_made_in_parts_it_is_the_same_byte_for_byte(whole: Path, tmp_path: Path) -> None:
    left = []
    for number in (3, 1, 2):
        mine = {one.key for one in Shard(number, 3).of(plan().by_subject)}
        left.append(len(make(plan(), tmp_path, mine=mine)))
        assert (tmp_path / "capture.json").exists() == (left[-1] == 0)
    assert left[-1] == 0 and left == sorted(left, reverse=True)
    assert content(tmp_path) == content(whole)


def test_two_processes_never_make_the_same_view(whole: Path, tmp_path: Path) -> None:
    other = _start(tmp_path)
    while not (tmp_path / "begun.json").exists():
        assert other.poll() is None
        time.sleep(0.05)
    make(plan(), tmp_path)
    assert other.wait(PATIENCE) == 0
    assert content(tmp_path) == content(whole)


def test_who_waits_takes_over_from_a_process_that_is_killed(whole: Path, tmp_path: Path) -> None:
    code = f"""
import sys, time
sys.path.insert(0, {str(Path(__file__).parent)!r})
from handbench.claims import claim
from pathlib import Path
with claim(Path({str(tmp_path)!r}) / 'claims' / 's01--pose-0') as ours:
    print(ours, flush=True)
    time.sleep({PATIENCE})
"""
    holder = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None and holder.stdout.readline() == "True\n"
    told: list[int] = []

    def progress(step: int, total: int, **values: float) -> None:
        told.append(step)
        if step == total - 1:  # all but the claimed one
            assert not (tmp_path / "s01/pose-0").exists()
            holder.send_signal(signal.SIGKILL)
            holder.wait()

    assert make(plan(), tmp_path, progress) == ()
    assert told == [1, 2, 3, 4]
    assert content(tmp_path) == content(whole)


def test_what_another_process_makes_counts_as_soon_as_it_is_there(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def theirs(place: Path) -> Iterator[bool]:
        yield place.name != "s01--pose-0"

    told: list[int] = []

    def progress(step: int, total: int, **values: float) -> None:
        told.append(step)
        if step == 1:  # the other one is ready while our first is made
            shutil.copytree(whole / "s01/pose-0", tmp_path / "s01/pose-0")

    monkeypatch.setattr(module, "claim", theirs)
    assert make(plan(), tmp_path, progress) == ()
    assert told == [1, 2, 3, 4]
    assert content(tmp_path) == content(whole)


def test_a_disk_that_fills_leaves_nothing_half_written(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from handbench.data.openstage import performance

    real, calls = performance.write_exr, []

    def full(path: Path, channels: dict) -> None:
        calls.append(path)
        if len(calls) == 5:
            raise OSError(28, "No space left on device")
        real(path, channels)

    monkeypatch.setattr(performance, "write_exr", full)
    with pytest.raises(StorageError, match="the disk is full"):
        make(plan(), tmp_path)
    assert not list(tmp_path.rglob("*.part")) and not (tmp_path / "capture.json").exists()
    monkeypatch.undo()
    make(plan(), tmp_path)
    assert content(tmp_path) == content(whole)


def test_a_folder_begun_with_another_preset_is_refused(tmp_path: Path) -> None:
    (tmp_path / "begun.json").write_text(json.dumps({"recipe": "of old"}))
    with pytest.raises(InputError, match="was begun with another preset or generator"):
        make(plan(), tmp_path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda m: m["preset"].update(spp=5),
            r"the preset of .* was edited.* delete it .*: handbench data make openstage",
        ),
        (lambda m: m.update(generator=1), "was made by generator 1, .* delete it .*: .* --size mini --folder /"),
        (lambda m: m["subjects"][0]["poses"][0]["shots"][0].update(cameras=["../x"]), "none of its cameras"),
        (lambda m: m["subjects"][0]["poses"][0].update(estimate={"joints": 3}), "damaged"),
    ],
)
def test_an_edited_or_old_capture_is_one_sentence(
    whole: Path, tmp_path: Path, change: Callable[[dict], None], told: str
) -> None:
    tmp_path.rmdir()
    shutil.copytree(whole, tmp_path)
    manifest = json.loads((whole / "capture.json").read_text())
    change(manifest)
    (tmp_path / "capture.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=told):
        OpenCapture(tmp_path)


def test_what_a_command_that_only_looks_misses_is_told_with_the_command_that_makes_it(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS["openstage"], "mini", TINY)
    place, makes = capture_folder("mini", tmp_path), f"'handbench data make openstage --size mini --folder {tmp_path}'"
    shutil.copytree(whole, tmp_path / "openstage-mini-01234567")
    with pytest.raises(InputError, match=f"not made yet .*mini-01234567 is another version's, .*; {makes} makes it"):
        check_made("mini", tmp_path, "openstage")
    place.mkdir()
    with pytest.raises(InputError, match=f"made in part only; {makes} makes the rest"):
        check_made("mini", tmp_path, "openstage")
    shutil.copytree(whole, place, dirs_exist_ok=True)
    check_made("mini", tmp_path, "openstage")
    (place / "s01/pose-1/dorsal/env-hall.exr").unlink()
    with pytest.raises(InputError, match=f"lacks 1 of its files, .*pose-1/dorsal/env-hall.exr; {makes} makes them"):
        check_made("mini", tmp_path, "openstage")


def test_a_preset_that_was_edited_with_its_recipe_is_no_size_of_the_package(whole: Path, tmp_path: Path) -> None:
    """A tiny stage in the place of the package's mini."""
    shutil.copytree(whole, capture_folder("mini", tmp_path))
    with pytest.raises(InputError, match="is of another preset than openstage mini; delete it and make it again: "):
        open_capture("mini", tmp_path)


def test_a_folder_that_the_generator_made_is_read_by_its_place(whole: Path) -> None:
    assert open_at(whole).digest == TINY.recipe


def test_a_picture_that_was_cut_off_is_told_with_what_to_do(whole: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(whole, tmp_path / "copy"))
    picture = copy / "s01/pose-1/dorsal/env-hall.exr"
    picture.write_bytes(picture.read_bytes()[:300])
    (told,) = (one for one in troubles(OpenCapture(copy)) if one.startswith("s01/pose-1/dorsal/env-hall: "))
    assert "delete it and make the capture again" in told


def test_the_command_makes_shards(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(PRESETS["openstage"], "mini", TINY)
    monkeypatch.setattr(making, "_production", lambda capture, size: plan())
    command = ["data", "make", "openstage", "--size", "mini", "--folder", str(tmp_path)]
    assert main([*command, "--shard", "1/2"]) == 0
    assert "not there yet, of other shards: 2 poses" in capsys.readouterr().out
    assert main([*command, "--shard=2/2"]) == 0
    assert f"openstage-mini: 16 frames, digest {TINY.recipe}" in capsys.readouterr().out
    assert content(capture_folder("mini", tmp_path)) == content(whole)


def test_a_part_is_made_by_a_task_of_a_cluster(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PRESETS["openstage"], "mini", TINY)
    monkeypatch.setattr(making, "_production", lambda capture, size: plan())
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # which a task sets for good
    monkeypatch.setattr("handbench.bench.cluster._PATIENCE", 0.1)
    parts = [("openstage", "mini", tmp_path, 1, Shard(i, 3)) for i in (2, 3, 1)]
    with pytest.raises(InputError, match=r"node \S+ does not see .*openstage-mini-.* a disk that all nodes share"):
        making._task(*parts[0])
    capture_folder("mini", tmp_path).mkdir()
    assert [len(making._task(*part)) for part in parts] == [2, 1, 0]
    assert content(capture_folder("mini", tmp_path)) == content(whole)


def test_a_making_is_compared_with_that_of_the_package(whole: Path, tmp_path: Path) -> None:
    manifest = read_manifest(whole / "capture.json")
    chosen = thumbnails.chosen(manifest)
    kept = {f"{TINY.recipe}/{name}": thumbnails.thumbnail(whole / name).astype(np.float16) for name in chosen}
    assert len(kept) == 4
    off = thumbnails.difference(manifest, whole, kept)
    assert off is not None and off.views == 4 and off.largest < 5e-4, "half floats"
    assert thumbnails.difference(manifest, whole, {}) is None
    dimmer = {name: 0.98 * image for name, image in kept.items()}
    with pytest.raises(InputError, match=r"exr differs by 2\.\d\d% from the picture of the package, .* 1%"):
        thumbnails.difference(manifest, whole, dimmer)
    told = OpenCapture(whole).remarks
    assert told == ("the package has no pictures of this size to compare its own with",)


def test_a_helper_makes_poses_from_the_end_and_leaves_the_rest(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS["openstage"], "mini", TINY)
    made: list[str] = []
    real = module.Maker.make
    monkeypatch.setattr(module.Maker, "make", lambda self, one: made.append(one.key) or real(self, one))
    helpers.assist(json.dumps(["openstage", "mini", str(tmp_path), os.getppid()]))
    assert made == ["s02/pose-1", "s02/pose-0", "s01/pose-1", "s01/pose-0"]
    assert not (tmp_path / "capture.json").exists()
    make(plan(), tmp_path)
    assert len(made) == 4 and content(tmp_path) == content(whole)
    with pytest.raises(SystemExit):
        helpers.assist(json.dumps(["openstage", "mini", str(tmp_path), 1 - os.getppid()]))


def test_helpers_end_with_the_block(tmp_path: Path) -> None:
    started = time.monotonic()
    with helpers.helped("openstage", "quick", tmp_path, 1):
        pass
    assert time.monotonic() - started < 20 and not (tmp_path / "capture.json").exists()


def test_the_thumbnails_are_of_recipes_of_today_and_small() -> None:
    """Of every capture the package compares `mini` and `quick`."""
    assert thumbnails.KEPT.stat().st_size <= 200_000
    of = {name.partition("/")[0] for name in np.load(thumbnails.KEPT)}
    assert of <= {size.recipe for sizes in PRESETS.values() for size in sizes.values()}
    assert of >= {sizes[name].recipe for sizes in PRESETS.values() for name in ("mini", "quick")}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["openstage", "--shard", "3/2"], "shard 3/2 does not exist"),
        (["openstage", "--executor", "rye"], "unknown executor 'rye'; did you mean 'ray'?"),
        (["openstage", "--cpus", "2"], "--executor ray only"),
        (["openstage", "--executor", "ray", "--shard", "1/2"], "a shard is made by one process"),
        (["openstag", "--shard", "1/2"], "unknown capture 'openstag'; did you mean 'openstage' or 'openscans'?"),
        (["openstage", "--size", "hug", "--shard", "1/2"], "unknown openstage size 'hug'"),
    ],
)
def test_what_cannot_be_asked_is_one_sentence(
    arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["data", "make", *arguments]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1


def test_a_claim_whose_folder_goes_is_taken_in_a_new_one(tmp_path: Path) -> None:
    place = tmp_path / "claims"
    for _ in range(3):
        with claim(place / "one") as ours:
            assert ours
        place.rmdir()


def _start(folder: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen([sys.executable, "-c", SCRIPT, str(HERE), str(HERE.parent), str(folder)], env=environment)
