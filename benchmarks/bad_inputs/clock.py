"""Time that a process had: on a busy machine a minute by the clock may be a second of it, and no hang."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

STEP = 1.0  # seconds between two looks


class Clock:
    """Seconds that a process group ran or slept since the clock was made; those for which it waited for a processor do
    not count, where the kernel tells (Linux)."""

    def __init__(self, group: int) -> None:
        self._group, self._at, self._waits = group, time.monotonic(), dict(_waits(group))
        self._seconds = 0.0

    def seconds(self) -> float:
        """To be asked every `STEP` or so: what is lost between two looks is what the thread lost that lost most."""
        now, waits = time.monotonic(), dict(_waits(self._group))
        lost = max((wait - self._waits.get(thread, 0.0) for thread, wait in waits.items()), default=0.0)
        self._seconds += max(now - self._at - lost, 0.0)
        self._at, self._waits = now, waits
        return self._seconds


def _waits(group: int) -> Iterator[tuple[str, float]]:
    """Threads of a process group, and the seconds that each has waited for a processor so far."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if int((process / "stat").read_text().rpartition(")")[2].split()[2]) != group:
                continue
            for thread in (process / "task").iterdir():
                yield thread.name, int((thread / "schedstat").read_text().split()[1]) / 1e9
        except (OSError, ValueError, IndexError):  # it has ended meanwhile, or this system does not tell
            continue
