"""The table as CSV and Markdown."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator

from .agreement import headline, sentence
from .conclusion import conclusion
from .cost import Footprint, MethodTimes, Span
from .model import Aggregate, MetricColumn, Row, Table
from .printed import (
    COST_TITLES,
    SUNK,
    UNEQUAL,
    UNEQUAL_NOTE,
    bounds,
    chance,
    cost_texts,
    costs_title,
    letter,
    marks,
    memory_table,
    number,
    signed,
)
from .safe import csv_cell, markdown
from .style import PLAIN, Style

CSV_METHOD = ("method", "title", "kind", "fidelity", "enrolment")
CSV_METRIC = ("column", "metric", "signature", "unit", "higher_is_better")
CSV_VALUE = ("value", "low", "high", "spread", "covered", "expected", "nonfinite")
CSV_MARKS = ("rank", "claimed", "below_floor", "unequal", "reasons")
CSV_DIFFERENCE = ("baseline", "difference", "difference_low", "difference_high", "p", "p_holm", "paired", "subjects")


def render_csv(table: Table) -> str:
    """The table as CSV: `lines`, of which a spreadsheet takes none for a formula."""
    out = io.StringIO()
    columns = (*CSV_METHOD, *CSV_METRIC, *CSV_VALUE, *CSV_MARKS, *(CSV_DIFFERENCE if table.baseline else ()))
    writer = csv.DictWriter(out, columns, lineterminator="\n")
    writer.writeheader()
    for line in lines(table):
        writer.writerow({name: csv_cell(value) for name, value in line.items()})
    return out.getvalue()


def as_json(table: Table) -> list[dict[str, object]]:
    """`lines` as JSON values: what is not there is left out, and so is infinity."""

    def told(value: object) -> bool:
        return value not in (None, "") and not (isinstance(value, float) and not math.isfinite(value))

    return [{name: value for name, value in line.items() if told(value)} for line in lines(table)]


def lines(table: Table) -> Iterator[dict[str, object]]:
    """One line a value, in full precision.

    Of a method alone are lines with the metrics train_s, personalise_s, new_pose_ms.KIND and known_pose_ms.KIND for
    each kind of frame, of memory, sizes and energy, and nonlinearity. Lines of kind "agreement" hold Kendall's tau of a
    column, with its inversions as reasons. With a baseline more columns hold the paired difference to it.
    """
    for row in table.rows:
        head = dict(zip(CSV_METHOD, (row.name, row.title, row.kind, row.fidelity, row.enrolment), strict=True))
        for column, cell in zip(table.columns, row.cells, strict=True):
            yield {**head, **_csv_column(column), **_csv_cell(row, cell, table)}
        for name, unit, span in (*_measured(row.times), *_taken(row.footprint)):
            values = {"value": span.median, "low": span.low, "high": span.high}
            yield {**head, "metric": name, "unit": unit, "higher_is_better": False, **values}
        if row.nonlinearity is not None:
            bend = {"metric": "nonlinearity", "higher_is_better": False, "value": row.nonlinearity}
            yield {**head, **bend}
    for agreement in table.agreements:
        column = agreement.column
        inverted = "; ".join(sentence(pair, column) for pair in agreement.inversions)
        place = {**_csv_column(column), "unit": "", "higher_is_better": True}
        yield {"kind": "agreement", **place, "value": agreement.tau, "reasons": inverted}


def _measured(times: MethodTimes) -> Iterator[tuple[str, str, Span]]:
    """Name, unit and value of the times that were measured."""
    for name in ("train_s", "personalise_s"):
        if (span := getattr(times, name)) is not None:
            yield name, "s", span
    for name in ("new_pose_ms", "known_pose_ms"):
        for kind, span in getattr(times, name).items():
            yield f"{name}.{kind}", "ms", span


def _taken(own: Footprint) -> Iterator[tuple[str, str, Span]]:
    """Name, unit and value of what is told of memory, sizes and energy."""
    for name, unit in (("memory_mb", "MiB"), ("train_memory_mb", "MiB"), ("vram_mb", "MiB"), ("avatar_mb", "MiB")):
        if (span := getattr(own, name)) is not None:
            yield name, unit, span
    for name, unit in (("weights_mb", "MiB"), ("parameters", "")):
        if (value := getattr(own, name)) is not None:
            yield name, unit, Span(value, value, value)
    if own.frame_j is not None:
        yield "frame_j", "J", own.frame_j


def _csv_column(column: MetricColumn) -> dict[str, object]:
    metric = column.metric
    about = (column.group.name, metric.name, metric.signature, metric.unit, metric.higher_is_better)
    return dict(zip(CSV_METRIC, about, strict=True))


def _csv_cell(row: Row, cell: Aggregate, table: Table) -> dict[str, object]:
    reasons = "; ".join(table.footnotes[note - 1] for note in cell.notes)
    counts = (cell.covered, cell.expected, cell.nonfinite) if row.kind != "published" else ("", "", "")
    values = (cell.value, cell.low, cell.high, cell.spread, *counts)
    marked = (cell.rank or "", cell.claimed if cell.rank else "", cell.sunk or "", cell.unequal or "", reasons)
    found: dict[str, object] = dict(zip((*CSV_VALUE, *CSV_MARKS), (*values, *marked), strict=True))
    if apart := cell.difference:
        told = (table.baseline, apart.value, apart.low, apart.high, apart.p, apart.adjusted, apart.paired)
        found |= dict(zip(CSV_DIFFERENCE, (*told, apart.subjects), strict=True))
    return found


def render_markdown(table: Table, style: Style = PLAIN) -> str:
    """One Markdown table a column group, then times and footnotes; intervals and times unless `style` says no."""
    return "\n".join(_markdown(style.rounded(table), style)) + "\n"


def _markdown(table: Table, style: Style) -> Iterator[str]:
    yield f"# {markdown(table.title)}"
    yield from (f"\n{markdown(sentence)}" for sentence in conclusion(table).sentences)
    for group in table.groups:
        indices = table.of_group(group)
        titles = [f"{table.columns[i].metric.title} {table.columns[i].metric.arrow}" for i in indices]
        yield f"\n## {markdown(group.title)}\n"
        yield f"{markdown(' '.join(filter(None, (f'{group.counted}.', group.about))))}\n"
        yield from _pipes(["Method", *titles])
        for row in table.rows_of(group):
            yield _line([_title(row), *(_markdown_cell(row.cells[i], table.columns[i], style) for i in indices)])
        if table.baseline:
            yield f"\nDifference to {markdown(table.baseline)}, **bold** where the interval excludes zero:\n"
            yield from _pipes(["Method", *titles])
            for row in table.compared:
                yield _line([_title(row), *(_difference(row.cells[i], table.columns[i]) for i in indices)])
    if style.times is not False:
        yield f"\n## {costs_title(table)}\n"
        yield from _pipes(["Method", *COST_TITLES])
        for row in table.computed:
            yield _line([_title(row), *cost_texts(row, table.timed_kind)])
    if style.times is not False and table.footprints:
        yield "\n## Memory, sizes and energy\n"
        heads, rows = memory_table(table)
        yield from _pipes(["Method", *heads])
        for row, told in rows:
            yield _line([_title(row), *told])
    if table.agreements:
        yield "\n## Order of methods beside the published one\n"
    for agreement in table.agreements:
        yield f"- {markdown(headline(agreement))}"
        yield from (f"  - {markdown(sentence(pair, agreement.column))}" for pair in agreement.inversions)
    yield "\nBest in **bold**, second in *italics*, shared by what cannot be told apart; rows with \\* are calibration."
    if table.unclaimed:
        yield "° after a mark: it holds for these hands and cannot be claimed for others (paired test over subjects)."
    if table.sunk:
        yield f"{SUNK}: not better than the floor, so never best."
    yield f"Brackets hold the 95 % interval, for {table.trainings}; after ± stands the standard deviation over seeds."
    remarks = (*table.remarks, *table.limits, *((UNEQUAL_NOTE,) if table.unequal else ()))
    yield from (f"\n{markdown(remark)}" for remark in remarks)
    if table.footnotes:
        yield ""
    for index, note in enumerate(table.footnotes, start=1):
        yield f"- <sup>{letter(index)}</sup> {markdown(note)}"
    yield "\nSignatures:\n"
    for metric in table.metrics:
        yield f"- {markdown(metric.title)}: `{metric.signature.replace('`', ' ')}`"


def _pipes(titles: list[str]) -> Iterator[str]:
    yield _line([markdown(title) for title in titles])
    yield "|" + " :-- |" + " --: |" * (len(titles) - 1)


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _title(row: Row) -> str:
    return markdown(row.title + row.suffix + (f" ({row.enrolment})" if row.enrolment else ""))


def _markdown_cell(cell: Aggregate, column: MetricColumn, style: Style) -> str:
    decimals = column.metric.decimals
    value = number(cell.value, decimals)
    text = {0: value, 1: f"**{value}**", 2: f"*{value}*"}[cell.rank] + "°" * (cell.rank > 0 and not cell.claimed)
    text += SUNK * cell.sunk + UNEQUAL * cell.unequal
    if cell.low is not None and style.intervals is not False:
        text += f" [{number(cell.low, decimals)}, {number(cell.high, decimals)}]"
    if cell.spread is not None and style.seeds is not False:
        text += f" ± {number(cell.spread, decimals)}"
    if not cell.complete:
        text += f" ({cell.covered}/{cell.expected})"
    return text + (f" <sup>{marks(cell)}</sup>" if cell.notes else "")


def _difference(cell: Aggregate, column: MetricColumn) -> str:
    apart, decimals = cell.difference, column.metric.decimals
    if apart is None:
        return "–"
    value = signed(apart.value, decimals)
    told = (f"**{value}**" if apart.separated else value) + UNEQUAL * cell.across
    return " ".join(filter(None, (told, bounds(apart, decimals), markdown(chance(apart)))))
