"""The table for a terminal: one grid a column group, then times and footnotes."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group as Lines
from rich.console import RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from handbench.results.statistics import Difference

from .agreement import headline, sentence
from .model import Aggregate, Column, Group, Metric, Row, Table
from .printed import (
    COST_TITLES,
    MEMORY_TITLES,
    SUNK,
    UNEQUAL,
    UNEQUAL_NOTE,
    bounds,
    chance,
    cost_texts,
    costs_title,
    letter,
    marks,
    memory_texts,
    number,
    signed,
)
from .style import PLAIN, Style
from .verdict import answer

STYLES = {0: "", 1: "bold green", 2: "underline"}
OPEN_STYLES = {1: "bold dim", 2: "underline dim"}  # of marks that hold for these hands alone


def render_terminal(table: Table, style: Style = PLAIN) -> RenderableType:
    """A rich renderable: print it with a `rich.console.Console`. Intervals and deviations only if `style` asks."""
    table = style.rounded(table)
    notes = [Text(f"{letter(index)}  {note}") for index, note in enumerate(table.footnotes, start=1)]
    legend = "bold: best, underlined: second, with all that cannot be told from them (dim: not claimable for other "
    legend += "hands); calibration (*), published rows, values that miss frames and what is not above the floor "
    legend += f"({SUNK}) cannot win{'; bold differences: the interval excludes zero' if table.baseline else ''}"
    told = (*table.remarks, *table.limits, legend, *((UNEQUAL_NOTE,) if table.unequal else ()))
    remarks = [*(Text(text, style="dim") for text in told), *map(Text, answer(table).sentences)]
    grids = [grid for group in table.groups for grid in (_grid(table, group, style), *_differences(table, group))]
    costs = (*_costs(table, style), *(() if style.times is False else _footprints(table)))
    return Lines(Text(table.title, style="bold"), *grids, *costs, *_agreements(table), *notes, *remarks)


def _agreements(table: Table) -> Iterator[Text]:
    if table.agreements:
        yield Text("Order of methods beside the published one", style="bold")
    for agreement in table.agreements:
        yield Text(headline(agreement))
        for pair in agreement.inversions:
            yield Text(f"  {sentence(pair, agreement.column)}")


def _grid(table: Table, group: Group, style: Style) -> RichTable:
    indices = table.of_group(group)
    grid = _empty(f"{group.title}: {group.counted}", table.rows)
    for index in indices:
        metric = table.columns[index].metric
        grid.add_column(Text(f"{metric.title} {metric.arrow}"), justify="right", overflow="fold")
    for row in table.rows:
        grid.add_row(*_head(row), *(_cell(row.cells[index], table.columns[index], style) for index in indices))
    return grid


def _differences(table: Table, group: Group) -> Iterator[RichTable]:
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


def _difference(cell: Aggregate, column: Column) -> Text:
    text = difference_text(cell.difference, column.metric)
    return text.append(UNEQUAL) if cell.across else text


def difference_text(apart: Difference | None, metric: Metric) -> Text:
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
    grid = _empty(costs_title(table), table.computed)
    for title in COST_TITLES:
        grid.add_column(title.replace(" ", "\n").replace("non-", "non-\n"), justify="right", overflow="fold")
    for row in table.computed:
        grid.add_row(*_head(row), *cost_texts(row, table.timed_kind))
    yield grid


def _footprints(table: Table) -> Iterator[RichTable]:
    if not table.footprints:
        return
    texts = [memory_texts(row) for row in table.footprints]
    told = [i for i in range(len(MEMORY_TITLES)) if any(text[i] != "–" for text in texts)]
    grid = _empty("Memory, sizes and energy", table.footprints)
    for i in told:
        grid.add_column(MEMORY_TITLES[i].replace(" ", "\n", 1), justify="right", overflow="fold")
    for row, text in zip(table.footprints, texts, strict=True):
        grid.add_row(*_head(row), *(text[i] for i in told))
    yield grid


def _empty(title: str, rows: tuple[Row, ...]) -> RichTable:
    """A grid whose first columns hold the rows' names, wide enough for all of them, and what enrolment gave."""
    grid = RichTable(
        title=Text(title, "bold"), title_justify="left", header_style="dim", box=None, padding=(0, 2, 0, 0)
    )
    grid.add_column("", no_wrap=True, min_width=max((len(_name(row)) for row in rows), default=0))
    grid.add_column("enrolment", style="dim", overflow="fold")
    return grid


def _head(row: Row) -> tuple[Text, Text]:
    return _name(row), Text(row.enrolment)


def _name(row: Row) -> Text:
    return Text(row.title + row.suffix)


def _cell(cell: Aggregate, column: Column, wanted: Style) -> Text:
    style = STYLES[cell.rank] if cell.claimed or not cell.rank else OPEN_STYLES[cell.rank]
    text = Text(number(cell.value, column.metric.decimals) + SUNK * cell.sunk, style=style)
    if cell.unequal:
        text.append(UNEQUAL, style="not bold not underline dim")
    if not cell.complete:
        text.append(f" {cell.covered}/{cell.expected}{f' {marks(cell)}' if cell.notes else ''}", style="yellow")
    decimals = column.metric.decimals
    if wanted.seeds and cell.spread is not None:
        text.append(f" ± {number(cell.spread, decimals)}", style="not bold not underline dim")
    if wanted.intervals and cell.low is not None:
        between = f" [{number(cell.low, decimals)}, {number(cell.high, decimals)}]"
        text.append(between, style="not bold not underline dim")
    return text
