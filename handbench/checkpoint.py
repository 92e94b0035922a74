"""Where a training may keep what it needs to go on after it was stopped.

The harness opens a folder around `Method.train` and `Prior.personalise`; a training that finds none keeps nothing.
What a training writes there must let it end exactly as if it had never been stopped.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path


@dataclass
class Checkpoints:
    """The folder, which trainings create when they need it, and the seconds that earlier, stopped runs took."""

    folder: Path
    earlier_s: float = 0.0


_current: ContextVar[Checkpoints | None] = ContextVar("checkpoints", default=None)


@contextmanager
def checkpoints_in(folder: Path) -> Iterator[Checkpoints]:
    """Let trainings inside the block keep their state in `folder`."""
    kept = Checkpoints(folder)
    before = _current.set(kept)
    try:
        yield kept
    finally:
        _current.reset(before)


def checkpoints() -> Checkpoints | None:
    """Where the training that is under way keeps its state, or None if nothing is to be kept."""
    return _current.get()
