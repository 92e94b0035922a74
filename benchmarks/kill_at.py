"""`handbench` in processes that kill themselves (SIGKILL) at an exact moment: `python kill_at.py run smoke …`.

Each line of standard input is a JSON list of processes to start together, each {"folder", "moment", "count"}: a whole
`handbench run smoke …` in that folder, which dies the COUNT-th time it comes to MOMENT, one of `MOMENTS`, or after
COUNT milliseconds. The answer is a line with their exit codes. Trainings write a checkpoint after every step, and each
step adds a line to steps.txt in the folder. Processes are forked from this one, which has imported everything and
started no thread, so that they start at once.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeAlias

import handbench.bench.store as store
import handbench.methods.kit.checkpoint as checkpoint
import handbench.methods.kit.engine as engine
import handbench.reports.write as write
from handbench.bench.plan import make_plan
from handbench.bench.run import find_protocol
from handbench.cli import main
from handbench.data.openstage.capture import OpenCapture
from handbench.lean import open3d

Strike: TypeAlias = Callable[[int], None]
PRELOADED = (
    *("handbench.bench.cell", "handbench.methods.mean", "handbench.methods.urhand"),
    *("handbench.reports.page", "handbench.reports.curves", "handbench.metrics.ssim", "scipy.stats", "jax"),
)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def part_of(path: Path) -> Path:
    """The name under which a report's file is written before it takes its place."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")


def half(path: Path, content: bytes = b"") -> None:
    """Leave half of a file behind, then die."""
    content = content or path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    die()


def struck(owner: Any, name: str, strike: Callable[..., None], counts: Callable[..., bool] = lambda *_: True) -> Strike:
    """Let the n-th call of a function for which `counts` is true run into `strike` in its stead."""

    def at(nth: int) -> None:
        real, calls = getattr(owner, name), 0

        @wraps(real)
        def wrapped(*arguments: Any, **named: Any) -> Any:
            nonlocal calls
            calls += counts(*arguments)
            if calls == nth and counts(*arguments):
                strike(*arguments, **named)
            return real(*arguments, **named)

        setattr(owner, name, wrapped)

    return at


def after(milliseconds: int) -> None:
    """Die after a time, whatever the process is at then."""
    timer = threading.Timer(milliseconds / 1e3, die)
    timer.daemon = True
    timer.start()


def half_dump(path: Path, text: str) -> None:
    path.write_text('{"schema": 1, "key": "' + "0" * 40)
    die()


def half_weights(tensors: Any, path: Path, metadata: Any) -> None:
    REAL_SAVE(tensors, path, metadata)
    half(path)


REAL_SAVE = checkpoint.save_file
MOMENTS: dict[str, Strike] = {
    "reading": struck(OpenCapture, "observe", lambda *_: die()),
    "plan": struck(store, "put", half_dump, lambda path, _: ".run.json." in path.name),
    "cell": struck(store, "put", half_dump, lambda path, _: path.parent.name == "cells"),
    "step": struck(engine, "_step", lambda *_: die()),
    "checkpoint": struck(checkpoint, "save_file", half_weights),
    "prediction": struck(store.Store, "write_prediction", lambda *_: die()),
    "report": struck(write, "whole", lambda path, _: half(part_of(path), b"<!doctype html><html>")),
    "after": after,
    "never": lambda nth: None,
}


def logged() -> None:
    """Tell every training step."""
    real = engine._step

    def step(*arguments: Any) -> Any:
        done = real(*arguments)
        with Path("steps.txt").open("a") as file:
            file.write("step\n")
        return done

    engine._step = step


def born(folder: str, moment: str, count: int, arguments: list[str]) -> int:
    """The process that runs handbench in a folder until a moment comes."""
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.chdir(folder)
        output = os.open("output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(output, stream)
        os.environ["HANDBENCH_DATA"] = str(Path("cache").resolve())
        checkpoint.EVERY = 0.0
        logged()
        MOMENTS[moment](count)
        sys.argv = ["handbench", *arguments]
        code = main(arguments)
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
        os._exit(code)


if __name__ == "__main__":
    for name in PRELOADED:
        importlib.import_module(name)
    open3d()
    make_plan(find_protocol("smoke"), "")  # what modules hold is remembered
    warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)  # of JAX, which has no thread yet
    threads = len(list(Path("/proc/self/task").iterdir()))
    assert threads == 1, f"{threads} threads: a forked process would lack {threads - 1} of them"
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        children = [born(**asked, arguments=sys.argv[1:]) for asked in json.loads(line)]
        codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
        print(json.dumps(codes), file=answers, flush=True)
