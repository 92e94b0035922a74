"""Cases in a worker process: one that dies or hangs fails its case, and the next worker goes on.

The worker builds the suite itself from "module:function" and arguments, so that cases need not be pickled and what
they share (meshes, trained methods) is made once a worker.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from ...errors import HandbenchError
from .case import Case, Result
from .judgement import Judgement, observe

START = 120.0
"""Seconds a worker may take to import everything and build the suite."""


@dataclass(frozen=True)
class Source:
    """Where a suite comes from: `target` "module:function", called with `arguments`, gives its cases."""

    target: str
    arguments: tuple[Any, ...] = ()

    def cases(self) -> tuple[Case, ...]:
        module, _, function = self.target.partition(":")
        return tuple(getattr(importlib.import_module(module), function)(*self.arguments))


def run_cases(source: Source, chosen: Sequence[Case]) -> Iterator[Result]:
    """The results of the chosen cases of a suite, in their order, each as soon as it is there.

    Raises `HandbenchError` if a worker cannot even start.
    """
    worker: _Worker | None = None
    try:
        for case in chosen:
            if worker is None or not worker.alive:
                worker = _Worker(source)
            start = time.perf_counter()
            outcome, milliseconds = worker.ask(case)
            took = milliseconds if milliseconds is not None else 1e3 * (time.perf_counter() - start)
            yield result(case, outcome, took)
    finally:
        if worker is not None:
            worker.end()


def result(case: Case, outcome: Judgement, milliseconds: float) -> Result:
    return Result(
        case.family,
        case.name,
        case.expected.text,
        case.reference,
        outcome.observed,
        outcome.error,
        milliseconds,
        outcome.passed,
    )


class _Worker:
    """A process that answers case ids with outcomes."""

    def __init__(self, source: Source) -> None:
        context = multiprocessing.get_context("spawn")  # a fork of a process that has threads may hang
        self._here, there = context.Pipe()
        self._process = context.Process(target=_serve, args=(there, source), daemon=True)
        self._process.start()
        there.close()
        ready = self._receive(START)
        if isinstance(ready, Judgement):
            raise HandbenchError(f"stress: a worker cannot start: {ready.observed}")

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    def ask(self, case: Case) -> tuple[Judgement, float | None]:
        """The outcome of a case and its milliseconds; None if the worker never answered, and then it is gone."""
        self._here.send(case.id)
        answer = self._receive(case.limit)
        return (answer, None) if isinstance(answer, Judgement) else answer

    def _receive(self, limit: float) -> Any:
        """What the worker sends, or the failure in its place."""
        if not self._here.poll(limit):
            self.end()
            return Judgement(f"hangs: no answer within {limit:g} s", None, False)
        try:
            return self._here.recv()
        except (EOFError, ConnectionResetError):
            self._process.join(10)
            how = _exit_text(self._process.exitcode)
            self.end()
            return Judgement(f"crashes: the process ended with {how}", None, False)

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self._here.close()


def _exit_text(code: int | None) -> str:
    if code is not None and code < 0:
        return signal.Signals(-code).name
    return f"exit code {code}"


def _serve(pipe: Connection, source: Source) -> None:
    """The worker's loop. What libraries print goes nowhere: the terminal belongs to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    warnings.simplefilter("ignore")
    nothing = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # those of native code included
        os.dup2(nothing, stream)
    try:
        cases = {case.id: case for case in source.cases()}
    except Exception as error:
        pipe.send(Judgement(f"{type(error).__name__}: {' '.join(str(error).split())}", None, False))
        return
    pipe.send("ready")
    while True:
        try:
            case = cases[pipe.recv()]
        except EOFError:
            return
        start = time.perf_counter()
        outcome = observe(case.expected, case.run)
        pipe.send((outcome, 1e3 * (time.perf_counter() - start)))
