"""The page of a run: one HTML file that needs neither network nor other files."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from .aggregate import RESAMPLES
from .figures import ERROR_SCALE, KIND_TITLES, Panel
from .model import Cell, Column, Span, Table, duration, letter, marks, number, three_digits
from .pictures import colour_stops, error_uri, image_uri
from .run import Run


def render_page(table: Table, run: Run, panels: Iterable[Panel]) -> str:
    """The HTML text of a run's table and panels. It holds no date, so the same run gives the same page."""
    page = Environment(
        loader=PackageLoader("handbench.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters.update(
        image_uri=image_uri,
        error_uri=error_uri,
        duration=duration,
        letter=letter,
        number=number,
        span=_span,
        seconds=_seconds,
    )
    page.globals.update(marks=marks, cell_text=_cell_text, interval=_interval)
    return page.get_template("page.html").render(
        table=table,
        plan=run.plan,
        checks=_checks(table, run),
        figures=[
            (KIND_TITLES[kind], tuple(of_kind)) for kind, of_kind in groupby(panels, key=lambda panel: panel.kind)
        ],
        colour_stops=colour_stops(),
        error_scale=ERROR_SCALE,
        first_metric=table.metrics[0],
        resamples=RESAMPLES,
        machine=_machine(run.plan["provenance"]),
    )


def _checks(table: Table, run: Run) -> list[tuple[bool, str]]:
    """What a reader wants to know before reading the numbers: (fine?, sentence)."""
    planned, finished = len(run.plan["cells"]), len(run.cells)
    gaps = sum(not cell.complete for row in table.rows for cell in row.cells)
    unequal = dict.fromkeys(cell["method"]["title"] for cell in run.cells if cell["same_pixels"] is False)
    git = run.plan["provenance"]["git"]
    origin = "source code had uncommitted changes" if git and git["dirty"] else "source code as committed"
    return [
        (finished == planned, f"{finished} of {planned} cells computed"),
        (gaps == 0, "every value covers all frames" if gaps == 0 else f"{gaps} values miss frames, see the notes"),
        *([(False, f"timed and scored images of {', '.join(unequal)} differ")] if unequal else []),
        (git is not None and not git["dirty"], origin if git else "installed copy, commit unknown"),
    ]


def _cell_text(cell: Cell, column: Column) -> str:
    return number(cell.value, column.metric.decimals)


def _interval(cell: Cell, column: Column) -> str:
    if cell.low is None or cell.high is None:
        return ""
    return f"{number(cell.low, column.metric.decimals)}–{number(cell.high, column.metric.decimals)}"


def _span(span: Span | None) -> str:
    """ "3.5–6.1", or nothing where all measured values print alike."""
    low, high = (three_digits(span.low), three_digits(span.high)) if span else ("", "")
    return f"{low}–{high}" if low != high else ""


def _seconds(span: Span | None) -> str:
    """The value a table is sorted by; nothing where there is none."""
    return repr(span.median) if span else ""


def _machine(provenance: dict[str, Any]) -> str:
    """The device in one line: "AMD EPYC 7B13, 2 cores, 2 threads, 24 GB"."""
    device = provenance["device"]
    parts = [device["cpu"], f"{device['cores']} cores", f"{device['threads']} threads"]
    memory = [f"{device['memory_gb']:.0f} GB"] if device["memory_gb"] else []
    return ", ".join([*parts, *memory, *device["gpus"]])
