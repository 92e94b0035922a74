"""A measurement, and how to take one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Measurement:
    """Median, least and most of `count` values; `goal` is what the median should not exceed."""

    name: str
    unit: str
    median: float
    least: float
    most: float
    count: int
    goal: float | None = None


def summary(name: str, unit: str, values: Sequence[float], goal: float | None = None) -> Measurement:
    return Measurement(name, unit, median(values), min(values), max(values), len(values), goal)


def seconds(work: Callable[[], object], repeats: int) -> list[float]:
    """The seconds of each of `repeats` calls."""
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        found.append(time.perf_counter() - start)
    return found
