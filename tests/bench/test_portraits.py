"""Portraits made of runs and of captures, on the toy capture."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from handbench.avatars.folder import read_avatar, write_avatar
from handbench.avatars.making import drawing_methods, from_capture, from_run
from handbench.avatars.repertoire import resized
from handbench.bench.narrowing import narrowed
from handbench.bench.protocol import Protocol
from handbench.bench.run import find_protocol, run
from handbench.bench.scoring import SHOWN
from handbench.errors import InputError, Unsupported
from handbench.recording import Recording
from handbench.results.reading import read_run
from handbench.scene import Directional
from handbench.settings import Setting


def told(label: str):  # type: ignore[no-untyped-def]
    return lambda step, total, **values: None


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the first test makes the run that all get copies of."""
    return tmp_path_factory.mktemp("untouched") / "run"


@pytest.fixture
def ran(
    fakes: ModuleType,
    toy_protocol: Callable[..., Protocol],
    untouched: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Path:
    protocol = toy_protocol()
    monkeypatch.setattr("handbench.bench.reopening.find_protocol", lambda name: protocol)
    if not untouched.exists():
        run(protocol, ["oracle", "toy", "toy-crash-train"], [0, 1], out=untouched)
        fakes.CALLS.clear()
    return Path(shutil.copytree(untouched, tmp_path / "run"))


def test_a_subject_of_a_run_is_drawn_with_its_kept_training(ran: Path, fakes: ModuleType) -> None:
    fakes.CALLS.clear()
    found = from_run(ran, "toy", "s02", told, seed=1)
    shown = found.repertoire
    assert fakes.CALLS["toy train"] == 0 and fakes.CALLS["toy personalise"] == 1
    assert fakes.CALLS["toy enrolled with full"] == 1  # as the protocol enrols, and no more
    assert list(shown.postures) == ["pose-0", "pose-1", "pose-2"] and list(shown.cameras) == ["front", "side"]
    viewpoint = shown.viewpoint(shown.posture("pose-2"), shown.camera_of("pose-2"))
    picture = found.avatar.pose(viewpoint).relight(Directional([0, 0, 1], [1.0, 1.0, 1.0]))
    assert np.allclose(picture.image, 0.6)  # the gain of seed 1
    assert from_run(ran, "toy", None, told).repertoire.subject == "s01"
    assert found.digest != from_run(ran, "toy", "s02", told, seed=0).digest
    assert drawing_methods(ran)[0] == "toy"


def test_what_a_run_cannot_give_is_told(
    ran: Path, toy_protocol: Callable[..., Protocol], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for asked, message in (
        (("toi", "s01"), "did you mean 'toy'"),
        (("toy", "s03"), "unknown subject of .*'s03'"),
        (("toy-crash-train", "s01"), "keeps no training of toy-crash-train"),
        (("oracle", "s01"), "draws none"),
    ):
        with pytest.raises(InputError, match=message):
            from_run(ran, *asked, told)
    with pytest.raises(InputError, match="keeps no training of toy with seed 7"):
        from_run(ran, "toy", "s01", told, seed=7)
    with pytest.raises(InputError, match=r"run\.json"):
        from_run(tmp_path, "toy", "s01", told)
    other = toy_protocol(metrics=["ssim"])
    monkeypatch.setattr("handbench.bench.reopening.find_protocol", lambda name: other)
    with pytest.raises(InputError, match=r"protocol toy@1 is not the one that .* was run with \(toy@1.*--protocol"):
        from_run(ran, "toy", "s01", told)


def test_a_method_that_ran_with_other_settings_or_seeds(
    ran: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = read_run(ran)
    plan = replace(found.plan, seeds=(7,), seeds_of={"toy": (1, 0)})
    monkeypatch.setattr("handbench.avatars.making.read_run", lambda folder: replace(found, plan=plan))
    assert "seed 1" in from_run(ran, "toy", "s01", told).source
    changed = [replace(each, config={"gain": 9}) if each.name == "toy" else each for each in plan.methods]
    plan = replace(plan, methods=tuple(changed))
    with pytest.raises(InputError, match=r"toy has other settings here \(gain, preset\) and cannot be given those"):
        from_run(ran, "toy", "s01", told)
    capture = fakes.open_toy("tiny")
    enrolment = capture.recording(f for f in capture.frames() if f.subject == "s01" and f.kind == "full")
    with pytest.raises(InputError, match="toy has other settings here"):
        from_capture(capture, enrolment, "toy", told, prior_run=ran)


def test_a_run_with_other_settings_is_shown_as_it_was_set(tmp_path: Path) -> None:
    """A part of a protocol, too; and the avatar is read back with its settings."""
    settings = [Setting.parse("phong:texture=24"), Setting.parse("phong:roughness=0.3, 0.5")]
    run(narrowed(find_protocol("smoke"), ("s02",), 1), ["oracle", "phong"], out=tmp_path / "run", settings=settings)
    found = from_run(tmp_path / "run", "phong", None, told)
    assert found.repertoire.subject == "s02" and found.config["texture"] == 24
    kept = read_avatar(write_avatar(found, tmp_path / "a.avatar"))
    assert kept.config["texture"] == 24 and list(kept.config["roughness"]) == [0.3, 0.5]
    shown = kept.repertoire
    viewpoint = shown.viewpoint(shown.posture(shown.views[0][0]), resized(shown.camera(shown.views[0][1]), 24, 32))
    light = Directional([0, 0, 1], [1.0, 1.0, 1.0])
    pictures = [each.avatar.pose(viewpoint).relight(light).image for each in (found, kept)]
    assert np.allclose(*pictures, atol=1e-5) and pictures[0].max() > 0.01


def test_pictures_of_ones_own(fakes: ModuleType, ran: Path) -> None:
    capture = fakes.open_toy("tiny")
    enrolment = capture.recording(f for f in capture.frames() if f.subject == "s01" and f.kind == "full")
    found = from_capture(capture, enrolment, "toy", told, licence="mine")
    assert found.licence == "mine" and found.repertoire.subject == "s01" and "6 pictures" in found.source
    trained = from_capture(capture, enrolment, "toy", told, prior_run=ran)
    assert trained.digest != found.digest
    with pytest.raises(Unsupported, match="Toy-Needy needs depth maps, which toy-8 does not have"):
        from_capture(capture, enrolment, "toy-needy", told)
    with pytest.raises(InputError, match=r"learns from other people first.*--prior"):
        from_capture(capture, enrolment, "physical", told)
    blind = Recording(enrolment.frames, capture.observe, frozenset({"image", "alpha"}))
    with pytest.raises(InputError, match="no pose of the hand is told"):
        from_capture(capture, blind, "toy", told)


def test_columns_under_maps_of_ones_own_are_shown_and_not_scored(
    fakes: ModuleType, toy_protocol: Callable[..., Protocol], toy_table: Callable[..., dict], tmp_path: Path
) -> None:
    light = {"name": "mine", "title": "Mine", "subjects": "trained", "segments": ["held-out"]}
    columns = [*toy_table()["column"], {**light, "maps": ["hall", "park:exposure=1"], "shares": ["subject"]}]
    protocol = toy_protocol(column=columns)
    run(protocol, ["oracle", "toy"], out=tmp_path / "run")
    found = read_run(tmp_path / "run")
    for cell in found.cells:
        mine = [frame for frame in cell.scores if frame.column == "mine"]
        if cell.subject == "s02":
            assert not mine
            continue
        assert {frame.query for frame in mine} == {
            f"s01/pose-2/{camera}/map-{name}" for camera in ("front", "side") for name in ("hall", "park-exposure-1")
        }
        assert all(frame.values == (None,) and frame.reason == SHOWN for frame in mine)
        kept = {frame.query for frame in mine} & set(cell.predictions)
        assert len(kept) == (4 if cell.method.name == "toy" else 0) and cell.error is None
        others = [frame for frame in cell.scores if frame.column != "mine"]
        assert others and all(frame.values[0] is not None for frame in others)
    one, other = (toy_protocol(column=[{**columns[-1], "maps": [m]}]).digest for m in ("hall", "hall:rotate=3"))
    assert one != other
    with pytest.raises(InputError, match="two maps named map-hall"):
        run(toy_protocol(column=[{**columns[-1], "maps": ["hall", "hall:exposure=0"]}]), ["toy"], out=tmp_path / "b")
    with pytest.raises(InputError, match="leave out light, or maps"):
        toy_protocol(column=[{**columns[-1], "light": "as enrolled"}])
