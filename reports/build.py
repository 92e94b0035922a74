"""A run folder as a `Table`."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from .aggregate import aggregate, interval, seed_spread
from .agreement import agreements
from .model import Cell, Column, Group, Kind, Metric, Row, Span, Table, Times
from .run import Run, read_run


def table(run_folder: Path) -> Table:
    """The results of a run. Raises `InputError` for a folder that holds no readable run."""
    return build(read_run(run_folder))


def build(run: Run) -> Table:
    """One row a method, one column for each protocol column and metric."""
    protocol = run.plan["protocol"]
    columns = tuple(
        Column(Group(group["name"], group["title"]), Metric(**metric))
        for group in protocol["columns"]
        for metric in protocol["metrics"]
    )
    owed = {
        group["name"]: {(query, seed) for query in group["queries"] for seed in run.plan["seeds"]}
        for group in protocol["columns"]
    }
    reasons: dict[str, int] = {}
    rows = tuple(_row(run, info, columns, owed, reasons) for info in run.plan["methods"])
    rows += tuple(_published(told, columns, len(protocol["metrics"])) for told in protocol.get("published", ()))
    title = f"{protocol['title']} ({protocol['name']}@{protocol['version']})"
    order = tuple(agreements(run, columns, rows))
    return _ranked(Table(title, columns, rows, tuple(reasons), tuple(_remarks(protocol)), order))


def _published(told: dict[str, Any], columns: tuple[Column, ...], metrics: int) -> Row:
    """A paper's row; a run tells its values by column, in the order of the metrics."""
    cells = []
    for index, column in enumerate(columns):
        values = told["values"].get(column.group.name, [None] * metrics)
        cells.append(Cell(values[index % metrics], None, None, 0, 0))
    return Row(
        name=told["method"],
        title=told["title"],
        kind="published",
        fidelity=told["source"],
        cells=tuple(cells),
        times=Times(None, None, None, None),
        marker=told["marker"],
    )


def _remarks(protocol: dict[str, Any]) -> Iterator[str]:
    if rows := protocol.get("published"):
        yield (
            "Published rows hold what their authors measured on their own data, with metric settings they did not "
            "publish: not comparable with measured values, so not ranked with them."
        )
        if protocol["published_note"]:
            yield protocol["published_note"]
        yield from dict.fromkeys(f"{row['marker'] or 'Published'}: {row['source']}." for row in rows)


def _row(
    run: Run,
    info: dict[str, Any],
    columns: tuple[Column, ...],
    owed: dict[str, set[tuple[str, int]]],
    reasons: dict[str, int],
) -> Row:
    cells = run.of_method(info["name"])
    scores: dict[tuple[str, str], list[tuple[str, int, dict[str, Any]]]] = defaultdict(list)
    for cell in cells:
        for score in cell["scores"]:
            scores[score["column"], score["metric"]].append((cell["subject"], cell["seed"], score))
    aggregates = tuple(
        _aggregate(column, scores[column.group.name, column.metric.signature], owed[column.group.name], reasons)
        for column in columns
    )
    laws = [cell["laws"]["linearity"] for cell in cells if cell.get("laws")]
    worst = max((value for value in laws if value is not None), default=None)
    times = _times(cells)
    return Row(info["name"], info["title"], _kind(info), info["fidelity"], aggregates, times, nonlinearity=worst)


def _kind(info: dict[str, Any]) -> Kind:
    return "calibration" if info["truth"] or info["fidelity"].startswith("calibration") else "method"


def _aggregate(
    column: Column,
    scores: list[tuple[str, int, dict[str, Any]]],
    owed: set[tuple[str, int]],
    reasons: dict[str, int],
) -> Cell:
    """One cell of the table. `owed`: the (query, seed) pairs that should have a value."""
    values: dict[int, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    notes: set[int] = set()
    missing = set(owed)
    for subject, seed, score in sorted(scores, key=lambda s: (s[1], s[0], s[2]["query"])):
        value = score["value"]
        missing.discard((score["query"], seed))
        if value is not None and math.isfinite(value):
            values[seed][subject].append(value)
        else:
            notes.add(_note(score["reason"] or "the value is not finite", reasons))
    if missing:
        notes.add(_note("not computed: the run was stopped or the cell failed", reasons))
    covered = sum(len(queries) for subjects in values.values() for queries in subjects.values())
    if not covered:
        return Cell(None, None, None, 0, len(owed), notes=tuple(sorted(notes)))
    low, high = interval(values, column.draws) or (None, None)
    return Cell(
        aggregate(values), low, high, covered, len(owed), notes=tuple(sorted(notes)), spread=seed_spread(values)
    )


def _note(reason: str, reasons: dict[str, int]) -> int:
    return reasons.setdefault(reason, len(reasons) + 1)


def _times(cells: tuple[dict[str, Any], ...]) -> Times:
    """Medians over cells, with the extremes of everything measured."""

    def seconds(name: str) -> Span | None:
        values = [cell["times"][name] for cell in cells if cell["times"][name] is not None]
        return Span(median(values), min(values), max(values)) if values else None

    def milliseconds(name: str) -> Span | None:
        spans = [cell["times"][name] for cell in cells if cell["times"][name] is not None]
        if not spans:
            return None
        return Span(median(s["median"] for s in spans), min(s["min"] for s in spans), max(s["max"] for s in spans))

    return Times(seconds("train_s"), seconds("personalise_s"), milliseconds("first_ms"), milliseconds("relight_ms"))


def _ranked(table: Table) -> Table:
    """Mark the best and the second of each column among measured methods with complete coverage.

    Values that print alike share their rank.
    """
    rows = [list(row.cells) for row in table.rows]
    for index, column in enumerate(table.columns):
        eligible: dict[float, list[int]] = defaultdict(list)
        for position, row in enumerate(table.rows):
            cell = row.cells[index]
            if row.kind == "method" and cell.complete and cell.value is not None:
                eligible[round(cell.value, column.metric.decimals)].append(position)
        order = sorted(eligible, reverse=column.metric.higher_is_better)
        for rank, value in enumerate(order[:2], start=1):
            for position in eligible[value]:
                rows[position][index] = replace(rows[position][index], rank=rank)
    ranked = tuple(replace(row, cells=tuple(cells)) for row, cells in zip(table.rows, rows, strict=True))
    return replace(table, rows=ranked)
