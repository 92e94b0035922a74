"""The table for a terminal: a grid for each column, beside each other as far as there is room, then costs and notes.

Whatever a terminal can draw, what is best is told by signs too: text that is piped or read aloud has no bold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from rich.columns import Columns
from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

from handbench.results.record import MetricRecord
from handbench.results.statistics import Difference

from .agreement import headline, sentence
from .conclusion import conclusion
from .model import Aggregate, ColumnGroup, MetricColumn, Row, Table
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
from .style import PLAIN, Style

STYLES = {0: "", 1: "bold green", 2: "underline"}
OPEN_STYLES = {1: "bold dim", 2: "underline dim"}  # of marks that hold for these hands alone
SIGNS = {0: "", 1: "¹", 2: "²"}
OPEN = "°"
_BETWEEN = 3  # characters between two grids


def render_terminal(table: Table, style: Style = PLAIN) -> RenderableType:
    """A rich renderable: print it with a `rich.console.Console`. Unless `style` says, it has intervals and deviations
    where they have room on a line."""
    return _Printed(style.rounded(table), style)


@dataclass(frozen=True)
class _Printed:
    table: Table
    style: Style

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        table, style = self.table, self.style
        yield Text(table.title, style="bold")
        full = replace(
            style,
            intervals=True if style.intervals is None else style.intervals,
            seeds=True if style.seeds is None else style.seeds,
        )
        grids = list(_grids(table, full))
        if _widest(console, options, grids) > options.max_width:
            grids = list(_grids(table, style))
        if console.is_terminal and 2 * _widest(console, options, grids) + _BETWEEN <= options.max_width:
            yield Columns(grids, padding=(0, _BETWEEN))
        else:
            yield from grids
        yield from _costs(table, style)
        yield from () if style.times is False else _footprints(table)
        yield from _agreements(table)
        yield from (Text(f"{letter(index)}  {note}") for index, note in enumerate(table.footnotes, start=1))
        yield from (Text(text, style="dim") for text in (*table.remarks, *table.limits, *_legend(table)))
        yield from map(Text, conclusion(table).sentences)


def _grids(table: Table, style: Style) -> Iterator[RichTable]:
    for group in table.groups:
        yield _grid(table, group, style)
        yield from _differences(table, group)


def _widest(console: Console, options: ConsoleOptions, grids: Sequence[RichTable]) -> int:
    """The characters that the widest grid asks for."""
    endless = options.update(width=10_000)
    return max(Measurement.get(console, endless, grid).maximum for grid in grids)


def _legend(table: Table) -> Iterator[str]:
    """What the signs mean."""
    yield (
        f"{SIGNS[1]} best, {SIGNS[2]} second, with all that cannot be told from them"
        + (f" ({OPEN} holds for these hands, not claimable for others)" if table.unclaimed else "")
        + "; calibration (*), published rows, values that miss frames and what is not above the floor "
        + f"({SUNK}) cannot win{'; bold differences: the interval excludes zero' if table.baseline else ''}"
    )
    if table.unequal:
        yield UNEQUAL_NOTE


def _agreements(table: Table) -> Iterator[Text]:
    if table.agreements:
        yield Text("Order of methods beside the published one", style="bold")
    for agreement in table.agreements:
        yield Text(headline(agreement))
        for pair in agreement.inversions:
            yield Text(f"  {sentence(pair, agreement.column)}")


def _grid(table: Table, group: ColumnGroup, style: Style) -> RichTable:
    indices = table.of_group(group)
    grid = _empty(f"{group.title}: {group.counted}", table.rows)
    for index in indices:
        metric = table.columns[index].metric
        grid.add_column(Text(f"{metric.title} {metric.arrow}"), justify="right", overflow="fold")
    room = [max(len(_signs(row.cells[index])) for row in table.rows) for index in indices]
    for row in table.rows_of(group):
        cells = zip(indices, room, strict=True)
        grid.add_row(*_head(row), *(_cell(row.cells[i], table.columns[i], style, wide) for i, wide in cells))
    return grid


def _differences(table: Table, group: ColumnGroup) -> Iterator[RichTable]:
    if not table.baseline:
        return
    grid = _empty(f"{group.title}: difference to {table.baseline}", table.compared)
    for index in table.of_group(group):
        metric = table.columns[index].metric
        grid.add_column(Text(f"{metric.title} {metric.arrow}"), justify="right", overflow="fold")
    for row in table.compared:
        cells = (_difference(row.cells[i], table.columns[i]) for i in table.of_group(group))
        grid.add_row(*_head(row), *cells)
    yield grid


def _difference(cell: Aggregate, column: MetricColumn) -> Text:
    text = difference_text(cell.difference, column.metric)
    return text.append(UNEQUAL) if cell.across else text


def difference_text(apart: Difference | None, metric: MetricRecord) -> Text:
    """A difference, its interval and its p-value on a line each; bold if the interval excludes zero."""
    if apart is None:
        return Text("–")
    text = Text(signed(apart.value, metric.decimals), style="bold" if apart.separated else "")
    for line in filter(None, (bounds(apart, metric.decimals), chance(apart))):
        text.append(f"\n{line}", style="not bold dim")
    return text


def _costs(table: Table, style: Style) -> Iterator[RichTable]:
    if style.times is False:
        return
    grid = _empty(costs_title(table), table.computed, enrolment=False)
    for title in COST_TITLES:
        grid.add_column(title.replace(" ", "\n").replace("non-", "non-\n"), justify="right", overflow="fold")
    for row in table.computed:
        grid.add_row(_name(row), *cost_texts(row, table.timed_kind))
    yield grid


def _footprints(table: Table) -> Iterator[RichTable]:
    if not table.footprints:
        return
    titles, rows = memory_table(table)
    grid = _empty("Memory, sizes and energy", table.footprints, enrolment=False)
    for title in titles:
        grid.add_column(title.replace(" ", "\n", 1), justify="right", overflow="fold")
    for row, texts in rows:
        grid.add_row(_name(row), *texts)
    yield grid


def _empty(title: str, rows: tuple[Row, ...], enrolment: bool = True) -> RichTable:
    """A grid whose first columns hold the rows' names, wide enough for all of them, and what enrolment gave."""
    grid = RichTable(
        title=Text(title, "bold"), title_justify="left", header_style="dim", box=None, padding=(0, 2, 0, 0)
    )
    grid.add_column("", no_wrap=True, min_width=max((len(_name(row)) for row in rows), default=0))
    if enrolment:
        grid.add_column("enrolment", style="dim", overflow="fold")
    return grid


def _head(row: Row) -> tuple[Text, Text]:
    return _name(row), Text(row.enrolment)


def _name(row: Row) -> Text:
    return Text(row.title + row.suffix)


def _signs(cell: Aggregate) -> str:
    """What stands behind a value: its rank, and what is to be known of it."""
    return SIGNS[cell.rank] + OPEN * (cell.rank > 0 and not cell.claimed) + SUNK * cell.sunk + UNEQUAL * cell.unequal


def _cell(cell: Aggregate, column: MetricColumn, wanted: Style, room: int) -> Text:
    """A value with its signs in `room` characters, so that digits stand below digits."""
    style = STYLES[cell.rank] if cell.claimed or not cell.rank else OPEN_STYLES[cell.rank]
    text = Text(number(cell.value, column.metric.decimals), style=style)
    text.append(_signs(cell).ljust(room), style="not bold not underline dim")
    if not cell.complete:
        text.append(f" {cell.covered}/{cell.expected}{f' {marks(cell)}' if cell.notes else ''}", style="yellow")
    decimals = column.metric.decimals
    if wanted.seeds and cell.spread is not None:
        text.append(f" ± {number(cell.spread, decimals)}", style="not bold not underline dim")
    if wanted.intervals and cell.low is not None:
        between = f" [{number(cell.low, decimals)}, {number(cell.high, decimals)}]"
        text.append(between, style="not bold not underline dim")
    return text
