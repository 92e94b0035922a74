"""Runs of the toy capture in processes of their own, forked from one that has loaded handbench: they start at once."""

from __future__ import annotations

import multiprocessing
import os
import traceback
from multiprocessing.connection import Connection
from pathlib import Path

import clusterfakes

from handbench.bench.run import run
from handbench.protocols import parse
from handbench.shards import Shard

_PROCESSES = multiprocessing.get_context("forkserver")
_PROCESSES.set_forkserver_preload(
    ["handbench.bench.run", "handbench.bench.cell", "handbench.bench.rescoring", "handbench.metrics.psnr"]
)


class ToyRun:
    """A run with two seeds, at work; `told` waits for what it did."""

    def __init__(self, table: dict, folder: Path, methods: str, shard: str = "") -> None:
        self._answer, told = _PROCESSES.Pipe(duplex=False)
        arguments = (told, dict(os.environ), table, folder, methods, shard)
        self.process = _PROCESSES.Process(target=_run, args=arguments, daemon=True)
        self.process.start()
        told.close()

    def told(self, patience: float) -> list:
        """Cells computed and reused, and the crashes."""
        assert self._answer.poll(patience), "waited in vain"
        answer = self._answer.recv()
        self.process.join()
        assert isinstance(answer, list), answer
        return answer


def toy_run(table: dict, folder: Path, methods: str, shard: str = "") -> list:
    """The same in the process that asks."""
    names = methods.split(",")
    extra = [clusterfakes.METHODS[name] for name in names]
    part = Shard.parse(shard) if shard else None
    outcome = run(parse(table, "toy"), names, [0, 1], out=folder, extra=extra, shard=part, command=["handbench"])
    return [outcome.computed, outcome.reused, list(outcome.crashed)]


def _run(told: Connection, environment: dict[str, str], *arguments: object) -> None:
    os.environ.clear()
    os.environ.update(environment)
    try:
        told.send(toy_run(*arguments))
    except BaseException:
        told.send(traceback.format_exc())
