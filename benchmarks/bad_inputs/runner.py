"""Cases through workers: each with a time limit, a worker that hangs or dies is replaced."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import local

from .case import BadInput, CommandResult
from .clock import STEP, Clock

LIMIT = 60.0  # seconds of a `Clock` that a case may take
START = 300.0  # until a worker is ready
_OWN = {"OMP_NUM_THREADS": "1", "PYTHONFAULTHANDLER": ""}


class CaseWorker:
    """A process that is asked one case after another."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, case: BadInput, folder: Path, limit: float) -> CommandResult:
        if self._process is None:
            self._start()
        assert self._process is not None and self._process.stdin is not None
        asked = {"words": case.words, "folder": str(folder), "environment": case.environment}
        self._process.stdin.write(json.dumps(asked).encode() + b"\n")
        self._process.stdin.flush()
        line = self._line(limit)
        if line:
            return CommandResult(**json.loads(line))
        lost = "hang" if line is None else "died"
        self.end()
        return CommandResult(None, lost=lost)

    def _start(self) -> None:
        command = [sys.executable, "-m", "benchmarks.bad_inputs.worker"]
        root, env = Path(__file__).resolve().parents[2], {**os.environ, **_OWN}
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=nothing, cwd=root, env=env, process_group=0
        )
        if self._line(START) != b"ready\n":
            raise RuntimeError("a worker cannot start: try python -m benchmarks.bad_inputs.worker")

    def _line(self, limit: float) -> bytes | None:
        """The next line, b"" at the end, None if there is none in time."""
        assert self._process is not None and self._process.stdout is not None
        clock = Clock(self._process.pid)
        while clock.seconds() < limit:
            if select.select([self._process.stdout], [], [], min(STEP, limit))[0]:
                return self._process.stdout.readline()
        return None

    def end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def process(case: BadInput, folder: Path, limit: float) -> CommandResult:
    """The answer of a case that needs a process of its own: "$H" in its shell line is handbench."""
    handbench = f"{sys.executable} -m handbench.cli"
    environment = {**os.environ, **_OWN, "H": handbench, **case.environment}
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        command = ["bash", "-c", *case.process]
        root = {"PYTHONPATH": str(Path(__file__).resolve().parents[2])} if "PYTHONPATH" not in environment else {}
        started = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            cwd=folder,
            env=environment | root,
            start_new_session=True,
        )
        clock = Clock(started.pid)
        while (code := _ended(started, min(STEP, limit))) is None:
            if clock.seconds() >= limit:
                os.killpg(started.pid, signal.SIGKILL)
                started.wait()
                return CommandResult(None, lost="hang")
        for file in (out, err):
            file.seek(0)
        texts = [file.read(200_000).decode("utf-8", "replace") for file in (out, err)]
    return CommandResult(code, *texts)


def _ended(process: subprocess.Popen[bytes], seconds: float) -> int | None:
    """The exit code of a process, None if it goes on for longer."""
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        return None


def lay_out(case: BadInput, folder: Path) -> None:
    """The files of a case; those that it does not spoil are shared with the sound ones."""
    if case.tree is not None:
        name, sound = case.tree
        shutil.copytree(sound, folder / name, copy_function=os.link)
    for name, content in case.files.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.unlink(missing_ok=True)
        place.write_bytes(content)
    if case.special:
        subprocess.run(["sh", "-c", case.special], cwd=folder, check=True)


def answers(cases: Iterable[BadInput], jobs: int = 2, limit: float = LIMIT) -> Iterator[tuple[BadInput, CommandResult]]:
    """Every case with its answer, in their order; each is tried in a folder of its own."""
    own, workers = local(), []

    def attempt(case: BadInput) -> tuple[BadInput, CommandResult]:
        with tempfile.TemporaryDirectory(prefix="bad-", ignore_cleanup_errors=True) as place:
            folder = Path(place)
            lay_out(case, folder)
            if case.process:
                return case, process(case, folder, limit)
            if not hasattr(own, "worker"):
                own.worker = CaseWorker()
                workers.append(own.worker)
            return case, own.worker.ask(case, folder, limit)

    try:
        with ThreadPoolExecutor(jobs) as pool:
            yield from pool.map(attempt, cases)
    finally:
        for worker in workers:
            worker.end()
