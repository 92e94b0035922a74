"""Whole or absent: what is on disk can be read, and a failed write harms nothing."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handbench.bench.run import run
from handbench.bench.store import Store
from handbench.errors import InputError, StorageError
from handbench.results.measured import CellTimes, ScoredFrame
from handbench.results.record import SCHEMA, CellRecord, MethodRecord
from handbench.scene import Prediction


def leftovers(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.name.endswith((".tmp", ".part"))]


def cell(key: str = "good", value: float | None = 30.0) -> CellRecord:
    frame = ScoredFrame("column", "s01/pose/cam/olat-00", "olat", (value,), () if value is not None else ("failed",))
    return CellRecord(key, MethodRecord("m", "M"), "s01", 0, ("psnr|v1",), (frame,), CellTimes())


def test_damaged_and_foreign_cells_are_absent(tmp_path):
    store = Store(tmp_path)
    store.write_cell(cell())
    assert store.cell("good") == cell()
    cells = tmp_path / "cells"
    (cells / "torn.json").write_text((cells / "good.json").read_text()[:20])
    (cells / "copied.json").write_text((cells / "good.json").read_text())
    (cells / "list.json").write_text("[]")
    assert [store.cell(key) for key in ("absent", "torn", "copied", "list")] == [None] * 4


def test_a_newer_schema_is_named(tmp_path):
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / "k.json").write_text(json.dumps({"schema": SCHEMA + 1, "key": "k"}))
    with pytest.raises(InputError, match=r"k\.json was written by a newer version .*upgrade"):
        Store(tmp_path).cell("k")


def test_non_finite_numbers_never_reach_the_disk(tmp_path):
    with pytest.raises(ValueError):
        Store(tmp_path).write_cell(cell("k", float("nan")))
    assert not leftovers(tmp_path) and Store(tmp_path).cell("k") is None


def test_a_full_disk_is_one_sentence_and_keeps_what_was_there(fakes, toy_protocol, tmp_path, monkeypatch):
    protocol = toy_protocol()
    run(protocol, out=tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.json")}

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match=r"the disk is full, .*; free some space"):
        run(protocol, seeds=[1], out=tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.json")} == before
    assert not leftovers(tmp_path)


def test_a_full_disk_under_a_cell_stops_the_run(fakes, toy_protocol, tmp_path, monkeypatch):
    def full(self: Store, *arguments: object) -> str:
        raise StorageError("the disk is full")

    monkeypatch.setattr(Store, "write_prediction", full)
    with pytest.raises(StorageError):
        run(toy_protocol(), out=tmp_path)
    assert not (tmp_path / "cells").exists()


def test_a_full_disk_under_a_method_is_not_the_methods_fault(fakes, toy_protocol, tmp_path):
    with pytest.raises(StorageError, match="the disk is full"):
        run(toy_protocol(), methods=["toy-full-disk"], out=tmp_path)
    assert not (tmp_path / "cells").exists() and not leftovers(tmp_path)


def test_a_folder_that_cannot_be_made(fakes, toy_protocol, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match=r"cannot be written .*choose another folder with --out"):
        run(toy_protocol(), out=tmp_path / "file" / "run")


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_read_only_folder(fakes, toy_protocol, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(StorageError, match="Permission denied"):
        run(toy_protocol(), out=tmp_path / "run")


def test_what_a_killed_process_left_is_removed_and_a_living_ones_is_not(tmp_path):
    script = (
        "import os, sys, pathlib\n"
        "from handbench.bench.store import Store\n"
        "from handbench.bench.wholefiles import part_of\n"
        "root = pathlib.Path(sys.argv[1])\n"
        "(root / 'cells').mkdir(); (root / 'priors').mkdir()\n"
        "part_of(root / 'cells' / 'a.json').write_text('{')\n"
        "with Store(root).writing_prior('p', 'm', 0, {}) as new:\n"
        "    (new.state / 'weights').write_text('half')\n"
        "    os._exit(9)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script, tmp_path]) as writer:
        os.waitid(os.P_PID, writer.pid, os.WEXITED | os.WNOWAIT)  # it has ended, and keeps its number: a zombie
        assert len(leftovers(tmp_path)) == 2
        Store(tmp_path).sweep()
        assert not leftovers(tmp_path)
    assert writer.returncode == 9
    with Store(tmp_path).writing_prior("q", "m", 0, {}):
        Store(tmp_path).prepare()
        assert len(leftovers(tmp_path)) == 1, "ours, still being written"
    assert not leftovers(tmp_path)
    assert Store(tmp_path).prior("p") is None and Store(tmp_path).prior("q") is not None


def test_a_prior_is_whole_or_absent(tmp_path):
    store = Store(tmp_path)
    with pytest.raises(RuntimeError), store.writing_prior("key", "m", 0, {}) as new:
        (new.state / "weights").write_text("half")
        raise RuntimeError
    assert store.prior("key") is None and not leftovers(tmp_path)
    for text in ("first", "second"):  # the second process finds the place taken
        with store.writing_prior("key", "m", 0, {}) as new:
            (new.state / "weights").write_text(text)
    assert (store.prior_state("key") / "weights").read_text() == "first"
    assert not leftovers(tmp_path)


def test_predictions_beyond_half_floats_are_clipped(tmp_path):
    from handbench.data.exr import read_exr

    image = np.full((2, 3, 3), 1e6, np.float32)
    Store(tmp_path).write_prediction("key", "s01/pose/cam/olat-00", Prediction(image, np.ones((2, 3))))
    kept = read_exr(tmp_path / "predictions" / "key" / "s01__pose__cam__olat-00.exr")
    assert (kept["R"] == 65504).all() and (kept["A"] == 1).all()


def test_json_is_strict(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), methods=["toy", "toy-nan", "toy-crash"], out=tmp_path)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    for path in tmp_path.rglob("*.json"):
        json.loads(path.read_text(), parse_constant=refuse)


@pytest.mark.parametrize("place", [".", "cells", "predictions", "priors"])
def test_a_folder_that_cannot_be_written_is_told_before_work_starts(fakes, toy_protocol, tmp_path, monkeypatch, place):
    run(toy_protocol(), out=tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    fakes.CALLS.clear()
    real = os.open

    def refuse(path, flags, *rest, **named):  # what a read-only folder does, also to root
        if flags & os.O_CREAT and Path(path).parent == (tmp_path / place):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return real(path, flags, *rest, **named)

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(StorageError, match=r"Permission denied.*--out"):
        run(toy_protocol(), seeds=[1], out=tmp_path)
    assert fakes.CALLS["open"] == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()} == before
