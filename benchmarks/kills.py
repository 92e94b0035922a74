"""Kill a run at random moments, again and again, and see what is lost: `python -m benchmarks.kills`.

A run of `smoke` is started, killed (SIGKILL) after a random time, and started again in the same folder, until it gets
through; then the next folder begins. After each kill every finished cell and training must still be there, unchanged
and readable; what gets through must have the results of a run that was never killed, apart from times, and a whole
report of them. (That a report of equal results is equal byte for byte is a test: tests/bench/test_kills.py.)
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from handbench.bench.provenance import device
from handbench.bench.store import Store
from handbench.reports import write_reports
from handbench.results.recordfile import sealed

RESULTS = Path(__file__).parent / "kills.json"
RUN = ("run", "smoke", "--methods", "mean,urhand", "--out", "run")


@dataclass
class KillCosts:
    """What 50 kills, or so, lost. `phases` counts what a run was at when it was killed."""

    kills: int = 0
    finished_runs: int = 0
    phases: dict[str, int] = field(default_factory=dict)
    cells_lost: int = 0
    cells_changed: int = 0
    cells_unreadable: int = 0
    failed_starts: int = 0
    results_that_differ: int = 0
    reports_incomplete: int = 0
    leftovers: int = 0
    litter: int = 0

    @property
    def lost(self) -> int:
        """Everything that should be zero: all but litter."""
        results = (self.cells_lost, self.cells_changed, self.cells_unreadable, self.results_that_differ)
        return sum((*results, self.failed_starts, self.reports_incomplete, self.leftovers))


class Runs:
    """Processes with a whole run each, forked from one that has imported everything: see `kill_at.py`."""

    def __init__(self, arguments: Sequence[str] = RUN) -> None:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, str(Path(__file__).with_name("kill_at.py")), *arguments]
        self._server = subprocess.Popen(
            command, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def __enter__(self) -> Runs:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.communicate()

    def __call__(self, folder: Path, moment: str = "never", count: int = 1, together: int = 1) -> list[int]:
        """The exit codes of `together` runs in one folder, which die at the count-th time of a moment."""
        folder.mkdir(parents=True, exist_ok=True)
        asked = [{"folder": str(folder), "moment": moment, "count": count}] * together
        assert self._server.stdin is not None and self._server.stdout is not None
        self._server.stdin.write(json.dumps(asked) + "\n")
        self._server.stdin.flush()
        codes: list[int] = json.loads(self._server.stdout.readline())
        return codes


def finished(run: Path) -> dict[str, bytes]:
    """What must never be lost: the files of finished cells and trainings, by path."""
    found = [*run.glob("cells/*.json"), *run.glob("priors/*/train.json"), *run.glob("priors/*/state/**/*")]
    return {str(path.relative_to(run)): path.read_bytes() for path in sorted(found) if path.is_file()}


def leftovers(run: Path) -> list[str]:
    """Half-written results, claims and trainings under way that are still there."""
    names = [*run.rglob("*.tmp"), *run.glob("checkpoints/*"), *run.glob("claims/*")]
    return [str(path.relative_to(run)) for path in names]


def litter(run: Path) -> list[str]:
    """Hidden halves of pictures and reports, beside the whole file that a later start wrote: harmless, and not lost."""
    return [str(path.relative_to(run)) for path in run.rglob(".*.part")]


def timeless(run: Path) -> dict[str, bytes]:
    """The files of a run's report if every time were one second and every date the same, by path.

    Times are taken out of what the report is made from, not out of the report: nothing else in it may differ.
    """
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / run.name
        shutil.copytree(run, copy, ignore=shutil.ignore_patterns("report", "checkpoints", "claims"))
        for path in (copy / "run.json", *copy.glob("cells/*.json"), *copy.glob("priors/*/train.json")):
            path.write_text(json.dumps(sealed(without_times(json.loads(path.read_text())))))
        write_reports(copy)
        return files(copy / "report")


def fresh(run: Path) -> dict[str, bytes]:
    """The files of a run's report if it is made anew from what lies in the folder, by path."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / run.name
        shutil.copytree(run, copy, ignore=shutil.ignore_patterns("report"))
        write_reports(copy)
        return files(copy / "report")


def files(folder: Path) -> dict[str, bytes]:
    """Every file of a folder but hidden ones, by path."""
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file() and not file.name.startswith(".")
    }


def without_times(value: Any, is_time: bool = False) -> Any:
    """JSON values with 1 for every number under a name of a time, of memory or of energy (_s, _ms, _mb, _j), but for
    counts, no dates, and no digest of a record, which seals them."""
    if isinstance(value, dict):
        return {
            name: ""
            if name == "started" or (name == "digest" and "schema" in value)
            else without_times(each, name != "n" and (is_time or name.endswith(("_s", "_ms", "_mb", "_j"))))
            for name, each in value.items()
        }
    if isinstance(value, list):
        return [without_times(each, is_time) for each in value]
    return 1.0 if is_time and isinstance(value, int | float) else value


def results(run: Path) -> dict[str, Any]:
    """What a report is made from, by path, without times: plan, cells, trainings, pictures."""
    told = {run / "run.json", *run.glob("cells/*.json"), *run.glob("priors/*/train.json")}
    found: dict[str, Any] = {
        str(path.relative_to(run)): without_times(json.loads(path.read_text())) for path in sorted(told)
    }
    return found | files(run / "predictions")


def kills(count: int, seed: int, places: Path) -> KillCosts:
    """Kill runs in folders of `places` until `count` have died."""
    rng, losses = np.random.default_rng(seed), KillCosts()
    whole = places / "whole"
    with Runs() as runs:
        begin = time.monotonic()
        if runs(whole) != [0]:
            raise SystemExit(f"the run does not even get through alone; see {whole / 'output.txt'}")
        longest = round(1e3 * (time.monotonic() - begin))
        truth, reported = results(whole / "run"), set(files(whole / "run" / "report"))
        while losses.kills < count:
            folder = places / f"killed-{losses.finished_runs}"
            while not _once(runs, folder, int(rng.integers(longest)), losses, killing=losses.kills < count):
                pass
            losses.finished_runs += 1
            losses.results_that_differ += results(folder / "run") != truth
            losses.reports_incomplete += set(files(folder / "run" / "report")) != reported
            losses.leftovers += len(leftovers(folder / "run"))
            losses.litter += len(litter(folder / "run"))
            shutil.rmtree(folder)
    return losses


def _once(runs: Runs, folder: Path, milliseconds: int, losses: KillCosts, killing: bool) -> bool:
    """Start a run that dies after a time; True if it got through before."""
    run = folder / "run"
    before = finished(run)
    (code,) = runs(folder, "after", milliseconds) if killing else runs(folder)
    died = code == -signal.SIGKILL
    if died:
        losses.kills += 1
        phase = _phase(run)
        losses.phases[phase] = losses.phases.get(phase, 0) + 1
        print(f"kill {losses.kills}: {phase}, {losses.lost} lost so far", file=sys.stderr, flush=True)
    else:
        losses.failed_starts += code != 0
    now = finished(run)
    losses.cells_lost += len(before.keys() - now.keys())
    losses.cells_changed += sum(now[name] != content for name, content in before.items() if name in now)
    losses.cells_unreadable += sum(Store(run).cell(path.stem) is None for path in run.glob("cells/*.json"))
    if losses.failed_starts:
        raise SystemExit(f"a start after a kill failed; see {folder / 'output.txt'}")
    return not died


def _phase(run: Path) -> str:
    """What a run was at, from what it left."""
    planned = Store(run).run()
    if planned is None:
        return "starting"
    done = sum((run / "cells" / f"{key}.json").is_file() for key in planned.cells)
    if done == len(planned.cells):
        return "reports"
    if any(run.glob("checkpoints/*/*")):
        return "training"
    return f"cells, {done} of {len(planned.cells)} done"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description="Kill runs; nothing may be lost.")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as places:
        losses = kills(arguments.kills, arguments.seed, Path(places))
    told = {
        **asdict(losses),
        "seed": arguments.seed,
        "seconds": round(time.monotonic() - begin),
        "device": asdict(device()),
    }
    RESULTS.write_text(json.dumps(told, indent=1) + "\n")
    print(json.dumps(told, indent=1))
    sys.exit(1 if losses.lost else 0)


if __name__ == "__main__":
    main()
