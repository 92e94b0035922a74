"""What a stress run leaves: stress.json, and a table for a terminal that shows every failure in full."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...results.origin import Provenance
from ...results.schema import told
from ..record import read_study, write_study
from .case import Result

if TYPE_CHECKING:
    from rich.console import RenderableType

FILE = "stress.json"


@dataclass(frozen=True)
class Summary:
    """One family: how many cases, how many failed, the worst relative error that was measured, and the time taken."""

    family: str
    cases: int
    failed: int
    worst: float | None
    seconds: float


def summaries(results: Sequence[Result]) -> tuple[Summary, ...]:
    """One a family, in the order in which they first come."""
    families = dict.fromkeys(result.family for result in results)
    return tuple(_summary(family, [r for r in results if r.family == family]) for family in families)


def _summary(family: str, results: list[Result]) -> Summary:
    errors = [result.error for result in results if result.error is not None]
    failed = sum(not result.passed for result in results)
    seconds = sum(result.milliseconds for result in results) / 1e3
    return Summary(family, len(results), failed, max(errors, default=None), seconds)


@dataclass(frozen=True)
class StressRecord:
    """stress.json: hard cases and what came of them."""

    provenance: Provenance = told("where it comes from")
    seconds: float = told("what all of them took")
    total: int = told("how many cases there are")
    failed: int = told("how many did not come out as expected")
    cases: tuple[Result, ...] = told("the cases, in order")

    @staticmethod
    def of(results: Sequence[Result], seconds: float, about: Provenance) -> StressRecord:
        cases = tuple(replace(result, milliseconds=round(result.milliseconds, 1)) for result in results)
        return StressRecord(about, round(seconds, 1), len(cases), sum(not case.passed for case in cases), cases)


def write_record(folder: Path, results: Sequence[Result], seconds: float, about: Provenance) -> Path:
    """Write stress.json into a folder, which is made. Raises `StorageError` if that cannot be."""
    return write_study(folder / FILE, StressRecord.of(results, seconds, about))


def read_record(folder: Path) -> StressRecord:
    """What `write_record` wrote. Raises `InputError` where there is none, or none that this version reads."""
    return read_study(StressRecord, folder / FILE, "stress")


def render(results: Sequence[Result], seconds: float) -> RenderableType:
    """A rich renderable: a line a family, then every failure with what was expected and observed."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    grid.add_column("family")
    for title in ("cases", "failed", "worst error", "seconds"):
        grid.add_column(title, justify="right")
    for line in summaries(results):
        worst = "–" if line.worst is None else f"{line.worst:.1e}"
        failed = Text(str(line.failed), style="bold red" if line.failed else "")
        grid.add_row(line.family, str(line.cases), failed, worst, f"{line.seconds:.1f}")
    failures = [result for result in results if not result.passed]
    lines = [text for result in failures for text in _failure(result)]
    verdict = f"{len(failures)} of {len(results)} cases came out unexpected" if failures else "every case as expected"
    style = "bold red" if failures else "bold green"
    return Group(grid, *lines, Text(f"{verdict} ({len(results)} cases, {seconds:.0f} s)", style=style))


def _failure(result: Result) -> tuple[Any, ...]:
    from rich.text import Text

    against = f" against {result.reference}" if result.reference else ""
    return (
        Text(f"FAIL {result.family}/{result.name}", style="red"),
        Text(f"     expected {result.expected}{against}; observed {result.observed}"),
    )
