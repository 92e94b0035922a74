"""The table for a terminal: one grid a column group, then times and footnotes."""

from __future__ import annotations

from rich.console import Group as Lines
from rich.console import RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from .model import TIME_TITLES, Cell, Column, Group, Row, Table, letter, marks, number, time_texts

STYLES = {0: "", 1: "bold green", 2: "underline"}
MARKS = {"method": "", "calibration": " *", "published": " †"}


def render_terminal(table: Table) -> RenderableType:
    """A rich renderable: print it with a `rich.console.Console`."""
    notes = [Text(f"{letter(index)}  {note}") for index, note in enumerate(table.footnotes, start=1)]
    legend = Text("bold: best, underlined: second; calibration rows (*) and incomplete columns cannot win", style="dim")
    grids = [_grid(table, group) for group in table.groups]
    return Lines(Text(table.title, style="bold"), *grids, _times(table), *notes, legend)


def _grid(table: Table, group: Group) -> RichTable:
    indices = table.of_group(group)
    grid = _empty(group.title, table)
    for index in indices:
        metric = table.columns[index].metric
        grid.add_column(f"{metric.title} {metric.arrow}", justify="right", overflow="fold")
    for row in table.rows:
        grid.add_row(_name(row), *(_cell(row.cells[index], table.columns[index]) for index in indices))
    return grid


def _times(table: Table) -> RichTable:
    grid = _empty("Time", table)
    for title in TIME_TITLES:
        grid.add_column(title, justify="right", overflow="fold")
    for row in table.rows:
        grid.add_row(_name(row), *time_texts(row.times))
    return grid


def _empty(title: str, table: Table) -> RichTable:
    """A grid whose first column holds the methods, equally wide in every grid of a table."""
    grid = RichTable(
        title=title, title_justify="left", title_style="bold", header_style="dim", box=None, padding=(0, 2, 0, 0)
    )
    grid.add_column("", no_wrap=True, min_width=max((len(_name(row)) for row in table.rows), default=0))
    return grid


def _name(row: Row) -> Text:
    return Text(row.title + MARKS[row.kind])


def _cell(cell: Cell, column: Column) -> Text:
    text = Text(number(cell.value, column.metric.decimals), style=STYLES[cell.rank])
    if not cell.complete:
        text.append(f" {cell.covered}/{cell.expected}{f' {marks(cell)}' if cell.notes else ''}", style="yellow")
    return text
