"""Measured points: what was set, how wrong the picture is, and how long it took, every repeat kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median, quantiles
from typing import Any, Literal, TypeVar

from ...results.schema import told

T = TypeVar("T")


@dataclass(frozen=True)
class Trial:
    """One setting of a renderer, how wrong the picture is, and how long it took."""

    knob: str = told("what was turned")
    label: str = told("to what")
    error: float = told("relative RMSE")
    seconds: tuple[float, ...] = told("of every repeat")

    @property
    def time(self) -> float:
        return median(self.seconds)

    @property
    def spread(self) -> tuple[float, float]:
        """Quartiles of the seconds, or least and greatest of few."""
        if len(self.seconds) < 4:
            return min(self.seconds), max(self.seconds)
        low, _, high = quantiles(self.seconds, n=4, method="inclusive")
        return low, high


@dataclass(frozen=True)
class ErrorCurve:
    """The points of one renderer for new poses or for known ones."""

    renderer: str = told("its name")
    pose: Literal["new", "known"] = told("which poses")
    points: tuple[Trial, ...] = told("one a setting")


def timed(prepare: Callable[[int], Any], work: Callable[[Any], T], repeats: int) -> tuple[tuple[float, ...], list[T]]:
    """Seconds of `repeats` calls of `work(prepare(i))`, and their answers; `prepare` is off the clock.

    One more call comes first and is not counted: it compiles kernels and fills caches that outlive a pose.
    """
    work(prepare(0))
    seconds, answers = [], []
    for repeat in range(1, repeats + 1):
        given = prepare(repeat)
        start = time.perf_counter()
        answers.append(work(given))
        seconds.append(time.perf_counter() - start)
    return tuple(seconds), answers
