"""The table as CSV and Markdown."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from .agreement import headline, sentence
from .model import COST_TITLES, Cell, Column, Row, Table, cost_texts, letter, marks, number

CSV_METHOD = ("method", "title", "kind", "fidelity")
CSV_METRIC = ("column", "metric", "signature", "unit", "higher_is_better")
CSV_VALUE = ("value", "low", "high", "spread", "covered", "expected", "rank", "reasons")


def render_csv(table: Table) -> str:
    """One line a value, in full precision.

    Of a method alone are lines with the metrics train_s, personalise_s, first_ms, relight_ms and nonlinearity. Lines of
    kind "agreement" hold Kendall's tau of a column, with its inversions as reasons.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow((*CSV_METHOD, *CSV_METRIC, *CSV_VALUE))
    for row in table.rows:
        head = (row.name, row.title, row.kind, row.fidelity)
        for column, cell in zip(table.columns, row.cells, strict=True):
            metric = column.metric
            reasons = "; ".join(table.footnotes[note - 1] for note in cell.notes)
            about = (metric.name, metric.signature, metric.unit, metric.higher_is_better)
            counts = (cell.covered, cell.expected) if row.kind != "published" else ("", "")
            numbers = (cell.value, cell.low, cell.high, cell.spread, *counts, cell.rank or "", reasons)
            writer.writerow((*head, column.group.name, *about, *numbers))
        for name, unit in (("train_s", "s"), ("personalise_s", "s"), ("first_ms", "ms"), ("relight_ms", "ms")):
            span = getattr(row.times, name)
            if span is not None:
                values = (span.median, span.low, span.high)
                writer.writerow((*head, "", name, "", unit, False, *values, "", "", "", "", ""))
        if row.nonlinearity is not None:
            writer.writerow((*head, "", "nonlinearity", "", "", False, row.nonlinearity, *[""] * 7))
    for agreement in table.agreements:
        column = agreement.column
        inverted = "; ".join(sentence(pair, column) for pair in agreement.inversions)
        place = (column.group.name, column.metric.name, column.metric.signature, "", True)
        writer.writerow(("", "", "agreement", "", *place, agreement.tau, *[""] * 6, inverted))
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
    yield "\n## Time and linearity in light\n"
    yield from _pipes(["Method", *COST_TITLES])
    for row in table.computed:
        yield _line([_title(row), *cost_texts(row)])
    if table.agreements:
        yield "\n## Order of methods beside the published one\n"
    for agreement in table.agreements:
        yield f"- {_safe(headline(agreement))}"
        yield from (f"  - {_safe(sentence(pair, agreement.column))}" for pair in agreement.inversions)
    yield "\nBest in **bold**, second in *italics*; rows with \\* are calibration."
    yield "Brackets hold the 95 % interval; after ± stands the standard deviation over seeds."
    yield from (f"\n{_safe(remark)}" for remark in table.remarks)
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
    return _safe(row.title + row.suffix)


def _markdown_cell(cell: Cell, column: Column) -> str:
    decimals = column.metric.decimals
    value = number(cell.value, decimals)
    text = {0: value, 1: f"**{value}**", 2: f"*{value}*"}[cell.rank]
    if cell.low is not None:
        text += f" [{number(cell.low, decimals)}, {number(cell.high, decimals)}]"
    if cell.spread is not None:
        text += f" ± {number(cell.spread, decimals)}"
    if not cell.complete:
        text += f" ({cell.covered}/{cell.expected})"
    return text + (f" <sup>{marks(cell)}</sup>" if cell.notes else "")


def _safe(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")
