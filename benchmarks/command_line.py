"""What a user waits for at the prompt: start-up, and a run in which everything is cached."""

from __future__ import annotations

import subprocess
import sys
import tempfile

from .measure import Measurement, seconds, summary


def _handbench(*arguments: str) -> None:
    command = [sys.executable, "-m", "handbench.cli", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def start_up() -> list[Measurement]:
    """`handbench --help`, the interpreter's own start included."""
    return [summary("handbench --help", "s", seconds(lambda: _handbench("--help"), 9), goal=0.3)]


def cached_run() -> list[Measurement]:
    """`handbench run smoke` from nothing, then with every cell and the report cached."""
    with tempfile.TemporaryDirectory() as folder:
        first = seconds(lambda: _handbench("run", "smoke", "--out", folder), 1)
        again = seconds(lambda: _handbench("run", "smoke", "--out", folder), 5)
    return [summary("run smoke, first", "s", first), summary("run smoke, cached", "s", again, goal=5)]
