"""What a stress run leaves: stress.json, and a table for a terminal that shows every failure in full."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import StorageError
from ...files import whole
from .case import Result

if TYPE_CHECKING:
    from rich.console import RenderableType

SCHEMA = 1
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


def write_record(folder: Path, results: Sequence[Result], seconds: float, provenance: dict[str, Any]) -> Path:
    """Write stress.json into a folder, which is made. Raises `StorageError` if that cannot be."""
    record = {
        "schema": SCHEMA,
        "provenance": provenance,
        "seconds": round(seconds, 1),
        "total": len(results),
        "failed": sum(not result.passed for result in results),
        "cases": [{**asdict(result), "milliseconds": round(result.milliseconds, 1)} for result in results],
    }
    path = folder / FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder} cannot be made ({error}); give another --out") from error
    with whole(path, "give another --out") as part:
        part.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


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
    told = [text for result in failures for text in _failure(result)]
    verdict = f"{len(failures)} of {len(results)} cases came out unexpected" if failures else "every case as expected"
    style = "bold red" if failures else "bold green"
    return Group(grid, *told, Text(f"{verdict} ({len(results)} cases, {seconds:.0f} s)", style=style))


def _failure(result: Result) -> tuple[Any, ...]:
    from rich.text import Text

    against = f" against {result.reference}" if result.reference else ""
    return (
        Text(f"FAIL {result.family}/{result.name}", style="red"),
        Text(f"     expected {result.expected}{against}; observed {result.observed}"),
    )
