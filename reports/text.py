"""The table as CSV and Markdown."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from .model import TIME_TITLES, Cell, Column, Row, Table, letter, marks, number, time_texts

CSV_METHOD = ("method", "title", "kind", "fidelity")
CSV_METRIC = ("column", "metric", "signature", "unit", "higher_is_better")
CSV_VALUE = ("value", "low", "high", "covered", "expected", "rank", "reasons")


def render_csv(table: Table) -> str:
    """One line a value, in full precision; times are lines with metric train_s, personalise_s, first_ms, relight_ms."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow((*CSV_METHOD, *CSV_METRIC, *CSV_VALUE))
    for row in table.rows:
        head = (row.name, row.title, row.kind, row.fidelity)
        for column, cell in zip(table.columns, row.cells, strict=True):
            metric = column.metric
            reasons = "; ".join(table.footnotes[note - 1] for note in cell.notes)
            about = (metric.name, metric.signature, metric.unit, metric.higher_is_better)
            numbers = (cell.value, cell.low, cell.high, cell.covered, cell.expected, cell.rank or "", reasons)
            writer.writerow((*head, column.group.name, *about, *numbers))
        for name, unit in (("train_s", "s"), ("personalise_s", "s"), ("first_ms", "ms"), ("relight_ms", "ms")):
            span = getattr(row.times, name)
            if span is not None:
                writer.writerow((*head, "", name, "", unit, False, span.median, span.low, span.high, "", "", "", ""))
    return out.getvalue()


def render_markdown(table: Table) -> str:
    """One Markdown table a column group, then times and footnotes."""
    return "\n".join(_markdown(table)) + "\n"


def _markdown(table: Table) -> Iterator[str]:
    yield f"# {table.title}"
    for group in table.groups:
        indices = table.of_group(group)
        titles = [f"{table.columns[i].metric.title} {table.columns[i].metric.arrow}" for i in indices]
        yield f"\n## {group.title}\n"
        yield from _pipes(["Method", *titles])
        for row in table.rows:
            yield _line([_title(row), *(_markdown_cell(row.cells[i], table.columns[i]) for i in indices)])
    yield "\n## Time\n"
    yield from _pipes(["Method", *TIME_TITLES])
    for row in table.rows:
        yield _line([_title(row), *time_texts(row.times)])
    yield "\nBest in **bold**, second in *italics*; brackets hold the 95 % interval; rows with * are calibration."
    if table.footnotes:
        yield ""
    for index, note in enumerate(table.footnotes, start=1):
        yield f"- <sup>{letter(index)}</sup> {_safe(note)}"
    yield "\nSignatures:\n"
    for metric in table.metrics:
        yield f"- {metric.title}: `{metric.signature}`"


def _pipes(titles: list[str]) -> Iterator[str]:
    yield _line([_safe(title) for title in titles])
    yield "|" + " :-- |" + " --: |" * (len(titles) - 1)


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _title(row: Row) -> str:
    return _safe(row.title) + {"method": "", "calibration": " \\*", "published": " †"}[row.kind]


def _markdown_cell(cell: Cell, column: Column) -> str:
    decimals = column.metric.decimals
    value = number(cell.value, decimals)
    text = {0: value, 1: f"**{value}**", 2: f"*{value}*"}[cell.rank]
    if cell.low is not None:
        text += f" [{number(cell.low, decimals)}, {number(cell.high, decimals)}]"
    if not cell.complete:
        text += f" ({cell.covered}/{cell.expected})"
    return text + (f" <sup>{marks(cell)}</sup>" if cell.notes else "")


def _safe(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")
