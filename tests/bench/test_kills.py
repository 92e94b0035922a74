"""A run that is killed at any moment, or shared by two processes, loses nothing and reports what a whole one does."""

from __future__ import annotations

import json
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from handbench.bench.store import Store
from handbench.results.recordfile import sealed

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def kills() -> Iterator[ModuleType]:
    """The tools of the benchmark that kills runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT))
        import benchmarks.kills

        yield benchmarks.kills
    for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def runs(kills: ModuleType) -> Iterator[Any]:
    with kills.Runs((*kills.RUN, "--limit", "1", "--set", "urhand:steps=5")) as started:
        yield started


@pytest.fixture(scope="module")
def whole(runs: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that nobody killed."""
    folder = tmp_path_factory.mktemp("whole")
    assert runs(folder) == [0], (folder / "output.txt").read_text()
    return folder


@pytest.fixture(scope="module")
def truth(kills: ModuleType, whole: Path) -> dict[str, bytes]:
    """Its report without times."""
    return kills.timeless(whole / "run")


def steps(folder: Path) -> int:
    """How many training steps the runs in a folder have done, all together."""
    log = folder / "steps.txt"
    return len(log.read_text().splitlines()) if log.exists() else 0


# In the order in which a run comes to them; each start goes on from what the one before left.
MOMENTS = (
    ("plan", 1, 0),
    ("reading", 3, 0),
    ("cell", 2, 1),  # the second cell is half written: the first one stays
    ("step", 3, 2),
    ("checkpoint", 2, 2),  # the second checkpoint after the resumption is half written
    ("prediction", 3, 2),
    ("report", 2, 4),
)


def test_killed_at_any_moment_nothing_is_lost_and_nothing_is_done_twice(
    kills: ModuleType, runs: Any, whole: Path, truth: dict[str, bytes], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    told = 0
    for moment, count, cells in MOMENTS:
        before = kills.finished(run)
        assert runs(tmp_path, moment, count) == [-signal.SIGKILL], f"{moment} was never reached"
        after = kills.finished(run)
        assert before.items() <= after.items(), f"killed at {moment}, finished files are gone or changed"
        keys = [path.stem for path in run.glob("cells/*.json")]
        assert len(keys) == cells, moment
        assert all(Store(run).cell(key) is not None for key in keys), f"killed at {moment}, half a cell can be seen"
        told += moment in ("step", "checkpoint")
    before = kills.finished(run)
    assert runs(tmp_path) == [0], (tmp_path / "output.txt").read_text()
    assert "0 cells computed, 4 reused" in (tmp_path / "output.txt").read_text()
    assert kills.finished(run) == before, "what was finished is not computed again"
    assert kills.leftovers(run) == []
    # The step that a kill falls into is lost, and so is one whose checkpoint was half written; no others.
    assert steps(whole) <= steps(tmp_path) <= steps(whole) + told
    assert kills.results(run) == kills.results(whole / "run")
    assert kills.timeless(run) == truth
    assert kills.files(run / "report") == kills.fresh(run), "the report was made anew, whole"


def test_times_alone_are_left_out_of_the_comparison(
    kills: ModuleType, whole: Path, truth: dict[str, bytes], tmp_path: Path
) -> None:
    """The comparison above sees a score that differs in its ninth digit, and does not see a time."""
    copy = Path(shutil.copytree(whole / "run", tmp_path / "run"))
    path = next(path for path in copy.glob("cells/*.json") if json.loads(path.read_text())["method"]["name"] == "mean")
    cell = json.loads(path.read_text())
    before = kills.without_times(cell)
    cell["times"]["personalise_s"] *= 3
    next(iter(cell["times"]["new_pose_ms"].values()))["median"] += 5
    cell["provenance"]["started"] = "yesterday"
    assert kills.without_times(cell) == before
    cell["scores"][0]["values"][0] += 1e-9
    path.write_text(json.dumps(sealed(cell)))
    assert kills.timeless(copy)["table.csv"] != truth["table.csv"]


def test_two_processes_share_a_run(
    kills: ModuleType, runs: Any, whole: Path, truth: dict[str, bytes], tmp_path: Path
) -> None:
    assert runs(tmp_path, together=2) == [0, 0], (tmp_path / "output.txt").read_text()
    run = tmp_path / "run"
    assert len(list(run.glob("cells/*.json"))) == 4 and kills.leftovers(run) == []
    assert steps(tmp_path) == steps(whole), "one process trained, the other waited"
    assert kills.timeless(run) == truth
