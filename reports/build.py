"""Run folders as one `Table`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from handbench.bench.reading import Run, mismatch, read_run, role_of
from handbench.bench.results import Results, Values
from handbench.bench.statistics import CONFIDENCE, least_p
from handbench.errors import InputError, unknown_name

from .aggregate import Footnotes, column_cells, with_differences
from .agreement import agreements
from .model import Cell, Column, Group, Kind, Metric, Row, Span, Table, Times


def table(*run_folders: Path, baseline: str | None = None) -> Table:
    """The results of one run, or of several of one protocol version and capture, as one table; see `build`."""
    return build(*(read_run(folder) for folder in run_folders), baseline=baseline)


def build(*runs: Run, baseline: str | None = None) -> Table:
    """One row a method, one column for each protocol column and metric.

    Runs are merged: a method that several runs hold with the same cells (the same keys, so the same source, preset,
    data and seeds) is one row, and one that differs is a row of its own, marked with the folder of the later run.
    `baseline` names the method whose paired differences the other rows show. Raises `InputError` for runs that cannot
    stand in one table and for an unknown baseline.
    """
    for other in runs[1:]:
        if why := mismatch(runs[0], other):
            raise InputError(f"these runs cannot share a table: {why}")
    protocol = runs[0].plan["protocol"]
    metrics = tuple(Metric(**metric) for metric in protocol["metrics"])
    groups = tuple(Group(group["name"], group["title"]) for group in protocol["columns"])
    columns = tuple(Column(group, metric) for group in groups for metric in metrics)
    with Results(runs) as results:
        sources = tuple(_sources(results))
    against = _position(sources, baseline) if baseline else None
    notes = Footnotes()
    kinds: list[Kind] = [role_of(source.info) for source in sources]
    measured = [kind == "method" for kind in kinds]
    cells: list[list[Cell]] = [[] for _ in sources]
    for start, group in enumerate(groups):
        values = [source.values[group.name] for source in sources]
        of_group = columns[start * len(metrics) : (start + 1) * len(metrics)]
        found = column_cells(values, of_group, measured, notes)
        if against is not None:
            found = with_differences(found, values, against, of_group, measured)
        for row, more in zip(cells, found, strict=True):
            row += more
    rows = tuple(_row(source, kind, tuple(row)) for source, kind, row in zip(sources, kinds, cells, strict=True))
    published = tuple(_published(told, columns, len(metrics)) for told in protocol.get("published", ()))
    order = tuple(agreements(columns, rows, [source.values for source in sources], published))
    title = f"{protocol['title']} ({protocol['name']}@{protocol['version']})"
    named = "" if against is None else sources[against].title
    remarks, limits = tuple(_remarks(protocol)), tuple(_limits(rows, named))
    return Table(title, columns, (*rows, *published), notes.texts(), remarks, order, named, limits)


@dataclass(frozen=True)
class _Source:
    """Where a row comes from: a method of a run, its values by protocol column, its cells without their scores."""

    name: str
    title: str
    info: dict[str, Any]
    values: dict[str, Values]
    cells: list[dict[str, Any]]


def _sources(results: Results) -> Iterator[_Source]:
    """The methods of all runs, each once."""
    labels = _labels(results.runs)
    seen: dict[str, list[set[str]]] = {}
    for run, label in zip(results.runs, labels, strict=True):
        values, cells = results.values(run), results.cells(run)
        for info in run.plan["methods"]:
            name = info["name"]
            of_method = [cell for cell in cells if cell["method"] == name]
            keys = {cell["key"] for cell in of_method}
            before = seen.setdefault(name, [])
            if keys not in before:
                mark = f" ({label})" if before else ""
                columns = {column: found for (method, column), found in values.items() if method == name}
                yield _Source(f"{name}{mark}", f"{info['title']}{mark}", info, columns, of_method)
                before.append(keys)


def _labels(runs: Sequence[Run]) -> list[str]:
    """The names of the folders, or their paths where names are alike."""
    names = [run.folder.resolve().name for run in runs]
    return names if len(set(names)) == len(names) else [str(run.folder) for run in runs]


def _position(sources: Sequence[_Source], baseline: str) -> int:
    names = [source.name for source in sources]
    if baseline not in names:
        raise unknown_name("baseline", baseline, names)
    return names.index(baseline)


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
        times=Times(None, None, {}, {}),
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


def _limits(rows: Sequence[Row], baseline: str) -> Iterator[str]:
    """What differences to a baseline mean, and what too few subjects cannot tell."""
    if not baseline:
        return
    yield (
        f"Differences are to {baseline}, paired by frame and seed, with the 95 % interval of a bootstrap over subjects "
        "and their frames; p by sign flips over subjects, corrected over the methods of a column (Holm)."
    )
    measured = [row for row in rows if row.kind == "method"]
    short = set()
    for cells in zip(*(row.cells for row in measured), strict=True):
        counts = [cell.difference.subjects for cell in cells if cell.difference]
        if counts and least_p(max(counts)) * len(counts) > 1 - CONFIDENCE:
            short.add((max(counts), len(counts)))
    if short:
        count, methods = min(short)
        plural = "s" if count > 1 else ""
        over = f" (corrected over {methods} methods {min(1.0, least_p(count) * methods):.2g})" if methods > 1 else ""
        yield (
            f"Too few subjects to claim a difference for other hands: with {count} subject{plural} p cannot fall below "
            f"{least_p(count):.2g}{over}; intervals there tell of these hands and their frames."
        )


def _row(source: _Source, kind: Kind, cells: tuple[Cell, ...]) -> Row:
    bends = [cell["nonlinearity"] for cell in source.cells if cell["nonlinearity"] is not None]
    times = _times(source.cells)
    fidelity = source.info["fidelity"]
    return Row(source.name, source.title, kind, fidelity, cells, times, nonlinearity=max(bends, default=None))


def _times(cells: Sequence[dict[str, Any]]) -> Times:
    """Medians over cells, with the extremes of everything measured."""

    def measured(name: str) -> list[Any]:
        return [cell["times"][name] for cell in cells if cell["times"] and cell["times"].get(name) is not None]

    def seconds(name: str) -> Span | None:
        values = measured(name)
        return Span(median(values), min(values), max(values)) if values else None

    def milliseconds(name: str) -> dict[str, Span]:
        found: dict[str, list[Any]] = {}
        for by_kind in measured(name):
            for kind, spread in by_kind.items():
                found.setdefault(kind, []).append(spread)
        return {
            kind: Span(median(s["median"] for s in each), min(s["min"] for s in each), max(s["max"] for s in each))
            for kind, each in found.items()
        }

    return Times(
        seconds("train_s"), seconds("personalise_s"), milliseconds("new_pose_ms"), milliseconds("known_pose_ms")
    )
