"""Plug-ins that reach every process by an installed package's entry points, and a method that can be held up."""

from __future__ import annotations

import os
import time
from pathlib import Path

import benchfakes

from handbench.method import Method, Prior, Progress, Recording, silent
from handbench.registry import Entry

CAPTURE = Entry("toy", "benchfakes:open_toy", "for tests")
METHODS = {name: Entry(name, f"clusterfakes:{name}", "for tests") for name in ("toy", "slow", "fails", "deadly")}


class Slow(benchfakes.Toy):
    """Tells in $TOYS/trainings who trains, and is not through before there is $TOYS/go or, of its seed, $TOYS/go-1."""

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        folder = Path(os.environ["TOYS"])
        (folder / "trainings" / f"{os.getpid()}-{seed}").touch()
        while not any((folder / name).exists() for name in ("go", f"go-{seed}")):
            time.sleep(0.02)
        return super().train(recording, seed, progress)


class Fails(benchfakes.Toy):
    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        (Path(os.environ["TOYS"]) / "trainings" / f"fails-{time.monotonic_ns()}").touch()
        raise ValueError("no such layer")


class Deadly(benchfakes.Toy):
    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        os._exit(9)


def toy(preset: str = "quick") -> Method:
    return benchfakes.Toy("toy", {"preset": preset})


def slow(preset: str = "quick") -> Method:
    return Slow("slow", {"preset": preset})


def fails(preset: str = "quick") -> Method:
    return Fails("fails", {"preset": preset})


def deadly(preset: str = "quick") -> Method:
    return Deadly("deadly", {"preset": preset})
