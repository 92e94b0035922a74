"""The whole of `make quick` after installation: from nothing, with the data cached, with everything cached."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from .measure import Measurement, seconds, summary


def whole_run() -> list[Measurement]:
    """Seconds of each of the three, and the greatest memory of one process in GB (Linux counts in KiB)."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "HANDBENCH_DATA": str(Path(folder) / "data")}

        def handbench(*arguments: str) -> None:
            command = [sys.executable, "-m", "handbench.cli", *arguments]
            subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)

        out = str(Path(folder) / "run")
        data = seconds(lambda: handbench("data", "make", "openstage", "--size", "quick"), 1)
        run = seconds(lambda: handbench("run", "quick", "--out", out), 1)
        again = seconds(lambda: handbench("run", "quick", "--out", out), 3)
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
    return [
        summary("quick: generate the data", "s", data, goal=360),
        summary("quick: run, data cached", "s", run, goal=480),
        summary("quick: data and run", "s", [data[0] + run[0]], goal=720),
        summary("quick: everything cached", "s", again, goal=20),
        summary("quick: peak memory", "GB", [memory], goal=6),
    ]
