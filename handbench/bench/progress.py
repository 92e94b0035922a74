"""What a run tells while it works: bars with loss and remaining time on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from ..method import Progress
from ..terminal import complain, console, printable

Steps: TypeAlias = Callable[[str], Progress]  # a label to the progress of that piece of work

_EVERY = 10.0  # seconds between plain lines of one piece of work


@contextmanager
def steps() -> Iterator[Steps]:
    """Progress on stderr. A piece of work is shown when it first reports, and its bar goes when it is done."""
    if sys.stderr.isatty():
        with _bars() as told:
            yield told
    else:
        yield _lines


def _lines(label: str) -> Progress:
    start = time.monotonic()
    last = start

    def tell(step: int, total: int, **values: float) -> None:
        nonlocal last
        now = time.monotonic()
        if step < total and now - last < _EVERY:
            return
        last = now
        took = now - start
        rest = "" if step >= total or not step else f", {_clock(took / step * (total - step))} left"
        complain(f"{label} {step}/{total}{_values(values)} ({_clock(took)}{rest})")

    return tell


@contextmanager
def _bars() -> Iterator[Steps]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[values]}", markup=False),
    )
    bars = Bars(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console(stderr=True), transient=True)

    def told(label: str) -> Progress:
        label = printable(label)
        task = None
        start = time.monotonic()

        def tell(step: int, total: int, **values: float) -> None:
            nonlocal task
            if task is None:
                task = bars.add_task(label, total=total, values="")
            bars.update(task, completed=step, total=total, values=_values(values))
            if step >= total:
                bars.remove_task(task)
                task = None
                bars.console.print(f"{label} {step}/{total}{_values(values)} ({_clock(time.monotonic() - start)})")

        return tell

    with bars:
        yield told


def _values(values: dict[str, float]) -> str:
    return "".join(f" {name} {value:.4g}" for name, value in values.items())


def _clock(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60 else f"{int(seconds // 60)} min {int(seconds % 60)} s"
