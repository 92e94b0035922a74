"""What a run costs beside training, relighting and metrics: `python -m benchmarks.overhead`.

    python -m benchmarks.overhead smoke
    python -m benchmarks.overhead quick --data DIR --methods mean,phong

A run is started in a temporary folder as a process of its own and its wall clock compared with what its cells say:
trainings and personalisations, relighting (warm-up and repeats included), the laws' pictures, and metrics (reading the
truth included). What is left is the harness: start-up, planning, writing predictions and results, provenance and the
report. The report is measured on its own, by writing it again.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .measure import Measurement, seconds, summary

GOAL = 2.0  # per cent of the wall clock


@dataclass(frozen=True)
class Share:
    """Seconds of one run, from nothing to its report."""

    wall: float
    methods: float
    metrics: float
    report: float

    @property
    def harness(self) -> float:
        return self.wall - self.methods - self.metrics


def overhead(protocol: str = "smoke", arguments: Sequence[str] = ()) -> list[Measurement]:
    """Where the time of one run of a protocol goes, and the seconds of the same run when everything is cached."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        command = [sys.executable, "-m", "handbench.cli", "run", protocol, "--out", str(folder), *arguments]

        def start() -> None:
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        (wall,) = seconds(start, 1)
        cached = seconds(start, 3)
        shutil.rmtree(folder / "report")
        (written,) = seconds(start, 1)
        share = _share(wall, written - min(cached), folder)
    parts = {"methods": share.methods, "metrics": share.metrics, "report": share.report}
    rest = share.harness - share.report
    return [
        summary(f"{protocol}: wall clock", "s", [share.wall]),
        *(summary(f"{protocol}: {name}", "s", [value]) for name, value in parts.items()),
        summary(f"{protocol}: harness without report", "s", [rest]),
        summary(f"{protocol}: harness", "%", [100 * share.harness / share.wall], goal=GOAL),
        summary(f"{protocol}: everything cached", "s", cached, goal=5),
    ]


def _share(wall: float, report: float, folder: Path) -> Share:
    told = json.loads((folder / "run.json").read_text())
    cells = [json.loads((folder / "cells" / f"{key}.json").read_text()) for key in told["cells"]]
    trainings = {cell["prior"]: cell["times"]["train_s"] or 0.0 for cell in cells}
    methods = sum(trainings.values()) + sum(_seconds(cell, "personalise_s", "relight_s", "laws_s") for cell in cells)
    return Share(wall, methods, sum(_seconds(cell, "score_s") for cell in cells), report)


def _seconds(cell: dict[str, Any], *names: str) -> float:
    return sum(cell["times"].get(name) or 0.0 for name in names)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.overhead", description="Measure what the harness costs."
    )
    parser.add_argument("protocol", nargs="?", default="smoke")
    known, rest = parser.parse_known_args()
    for m in overhead(known.protocol, rest):
        print(f"{m.name:<40} {m.median:8.2f} {m.unit}" + ("" if m.goal is None else f"   (goal: ≤ {m.goal:g})"))


if __name__ == "__main__":
    main()
