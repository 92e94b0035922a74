"""A finished cell or training of another run folder is taken, whole, and nothing else of it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from handbench.bench.reuse import run_folders
from handbench.bench.run import run
from handbench.bench.store import Store
from handbench.keeping import in_run, remove


def pictures(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.glob("predictions/*/*"))}


def test_cells_of_another_folder_are_not_computed_again(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path / "a")
    fakes.CALLS.clear()
    outcome = run(toy_protocol(), out=tmp_path / "b", reuse=tuple(run_folders(tmp_path)))
    assert (outcome.computed, outcome.reused, outcome.taken) == (0, 2, 2)
    assert fakes.CALLS["toy relight"] == fakes.CALLS["toy train"] == 0
    assert pictures(tmp_path / "a") == pictures(tmp_path / "b") != {}
    for key in Store(tmp_path / "b").run().cells:
        assert Store(tmp_path / "a").cell(key) == Store(tmp_path / "b").cell(key)


def test_without_being_told_a_run_takes_nothing(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path / "a")
    assert run(toy_protocol(), out=tmp_path / "b").computed == 2


def test_a_training_is_taken_where_the_cells_differ(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path / "a")
    fakes.CALLS.clear()
    other = toy_protocol()
    other = replace(other, sample_seed=other.sample_seed + 1)
    outcome = run(other, out=tmp_path / "b", reuse=(tmp_path / "a",))
    assert (outcome.computed, outcome.taken) == (2, 0)
    assert fakes.CALLS["toy train"] == 0 and fakes.CALLS["toy relight"] > 0


@pytest.mark.parametrize("elsewhere", [False, True])
def test_kept_pictures_are_scored_again_where_only_metrics_differ(fakes, toy_protocol, tmp_path, elsewhere):
    """In the folder or another one: the scores are those of drawing anew, up to half floats, and nothing is drawn."""
    run(toy_protocol(), out=tmp_path / "a")
    anew = run(toy_protocol(metrics=["ssim", "psnr"]), out=tmp_path / "anew")
    fakes.CALLS.clear()
    out = tmp_path / ("b" if elsewhere else "a")
    reuse = (tmp_path / "a",) if elsewhere else ()
    outcome = run(toy_protocol(metrics=["ssim", "psnr"]), out=out, reuse=reuse)
    assert (outcome.computed, outcome.taken) == (2, 0) and not outcome.crashed
    assert fakes.CALLS["toy train"] == fakes.CALLS["toy relight"] == fakes.CALLS["toy personalise"] == 0
    for key in Store(out).run().cells:
        now, then = Store(out).cell(key), Store(anew.folder).cell(key)
        assert [s.query for s in now.scores] == [s.query for s in then.scores]
        for one, other in zip(now.scores, then.scores, strict=True):
            assert one.values == pytest.approx(other.values, abs=2e-3)
        assert now.times.new_pose_ms and now.predictions.keys() == then.predictions.keys()
        assert any("scored again" in remark for remark in now.remarks)
        assert all(Store(out).picture(key, query).is_file() for query in now.predictions)


def test_pictures_that_were_changed_are_drawn_again(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path)
    next(tmp_path.glob("predictions/*/*")).write_bytes(b"other")
    fakes.CALLS.clear()
    assert run(toy_protocol(metrics=["ssim"]), out=tmp_path).computed == 2
    assert fakes.CALLS["toy relight"] > 0


def test_what_links_are_missing_is_copied(fakes, toy_protocol, tmp_path, monkeypatch):
    run(toy_protocol(), out=tmp_path / "a")

    def refuse(*arguments: object, **named: object) -> None:
        raise PermissionError("no links on this disk")

    monkeypatch.setattr(os, "link", refuse)
    assert run(toy_protocol(), out=tmp_path / "b", reuse=(tmp_path / "a",)).taken == 2
    assert pictures(tmp_path / "a") == pictures(tmp_path / "b")
    assert not list((tmp_path / "b").rglob("*.tmp"))


@pytest.mark.parametrize("damage", ["picture", "other picture", "linked pictures", "cell", "state"])
def test_what_is_not_whole_there_is_computed_here(fakes, toy_protocol, tmp_path, damage):
    run(toy_protocol(), out=tmp_path / "a")
    if damage == "picture":
        next((tmp_path / "a").glob("predictions/*/*")).unlink()
    elif damage == "other picture":
        next((tmp_path / "a").glob("predictions/*/*")).write_bytes(b"other")
    elif damage == "linked pictures":  # out of the folder, as to a larger disk
        (tmp_path / "a" / "predictions").rename(tmp_path / "elsewhere")
        (tmp_path / "a" / "predictions").symlink_to(tmp_path / "elsewhere")
    elif damage == "cell":
        next((tmp_path / "a").glob("cells/*")).write_text("{")
    else:
        for path in (tmp_path / "a").glob("priors/*/state/*"):
            path.write_bytes(b"other")
        for path in (tmp_path / "a").glob("cells/*"):
            path.unlink()
    outcome = run(toy_protocol(), out=tmp_path / "b", reuse=(tmp_path / "a",))
    assert outcome.computed == {"picture": 1, "other picture": 1, "cell": 1}.get(damage, 2)
    assert len(Store(tmp_path / "b").run().cells) == 2


def test_leavings_of_earlier_plans_are_found_and_nothing_that_is_needed(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path)
    run(toy_protocol(metrics=["ssim"]), out=tmp_path)
    left = {part.name: len(part.left) for part in in_run(tmp_path)}
    assert left == {"cells": 2, "predictions": 2, "priors": 0, "checkpoints": 0, "report": 0}
    freed = remove(path for part in in_run(tmp_path) for path in part.left)
    assert freed > 0
    outcome = run(toy_protocol(metrics=["ssim"]), out=tmp_path)
    assert (outcome.computed, outcome.reused) == (0, 2)
    assert not any(part.left for part in in_run(tmp_path))
