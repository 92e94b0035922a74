"""Measured points: what was set, how wrong the picture is, and how long it took, every repeat kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from statistics import median, quantiles
from typing import Any, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Point:
    """One setting of a renderer: `knob` names what was turned, `label` says to what; seconds of every repeat."""

    knob: str
    label: str
    error: float
    seconds: tuple[float, ...]

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

    def json(self) -> dict[str, Any]:
        return {**asdict(self), "seconds": list(self.seconds)}


@dataclass(frozen=True)
class Curve:
    """The points of one renderer for new poses or for known ones."""

    renderer: str
    pose: str
    points: tuple[Point, ...]

    def json(self) -> dict[str, Any]:
        return {"renderer": self.renderer, "pose": self.pose, "points": [point.json() for point in self.points]}


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
