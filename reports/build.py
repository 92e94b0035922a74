"""Run folders as one `Table`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from handbench.bench.protocol import AXES
from handbench.errors import unknown_name
from handbench.results.reading import Run, completed, merged, read_run
from handbench.results.record import (
    CellRecord,
    ColumnRecord,
    MethodRecord,
    ProtocolRecord,
    PublishedRecord,
)
from handbench.results.statistics import CONFIDENCE, least_p
from handbench.results.values import Values, values_of

from .aggregate import Footnotes, column_cells, with_differences
from .agreement import agreements
from .cost import MethodTimes, footprint_of, times_of
from .model import Aggregate, ColumnGroup, Kind, MetricColumn, Row, Table
from .printed import listed
from .selection import ALL, ReportFilter


def table(*run_folders: Path, baseline: str | None = None, selection: ReportFilter = ALL) -> Table:
    """The results of one run, or of several of one protocol version and capture, as one table, or some of it; see
    `build`."""
    runs = completed([read_run(folder) for folder in run_folders])
    found = build(*selection.among(runs), baseline=baseline)
    return replace(found, remarks=(*found.remarks, *selection.gaps(runs)))


def build(*runs: Run, baseline: str | None = None) -> Table:
    """One row a method, one column for each protocol column and metric.

    Runs are merged: a method that several runs hold with the same cells (the same keys, so the same source, preset,
    data and seeds) is one row, and one that differs is a row of its own, marked with the folder of the later run.
    `baseline` names the method whose paired differences the other rows show. Raises `InputError` for runs that cannot
    stand in one table and for an unknown baseline.
    """
    run = merged(runs)
    protocol = run.plan.protocol
    metrics = protocol.metrics
    groups = tuple(map(_group, protocol.columns))
    columns = tuple(MetricColumn(group, metric) for group in groups for metric in metrics)
    sources = tuple(_sources(run))
    against = _position(sources, baseline) if baseline else None
    notes = Footnotes()
    kinds: list[Kind] = [source.method.role for source in sources]
    measured = [kind == "method" for kind in kinds]
    floors = [place for place, source in enumerate(sources) if _is_floor(source.method)]
    cells: list[list[Aggregate]] = [[] for _ in sources]
    for start, group in enumerate(groups):
        values = [source.values[group.name] for source in sources]
        of_group = columns[start * len(metrics) : (start + 1) * len(metrics)]
        found = column_cells(values, of_group, measured, notes, floors)
        if against is not None:
            found = with_differences(found, values, against, of_group, measured)
        for row, more in zip(cells, found, strict=True):
            row += more
    rows = tuple(_row(source, kind, tuple(row)) for source, kind, row in zip(sources, kinds, cells, strict=True))
    rows = _marked(rows, against)
    published = tuple(_published(told, columns, len(metrics)) for told in protocol.published)
    order = tuple(agreements(columns, rows, [source.values for source in sources], published))
    title = f"{protocol.title} ({protocol.label})"
    named = "" if against is None else sources[against].title
    of_frames = dict.fromkeys(remark for cell in run.cells for remark in cell.remarks)
    remarks = (*_remarks(protocol), *_old_times(runs), *of_frames)
    limits = tuple(_limits(rows, named))
    seeds = tuple(sorted({seed for method in run.plan.methods for seed in run.plan.seeds_for(method.name)}))
    return Table(title, columns, (*rows, *published), notes.texts(), remarks, order, named, limits, seeds)


def _group(column: ColumnRecord) -> ColumnGroup:
    subjects = {query.partition("/")[0] for query in column.queries}
    return ColumnGroup(column.name, column.title, len(column.queries), len(subjects), "".join(_about(column)))


def _about(column: ColumnRecord) -> Iterator[str]:
    """What a column asks; nothing for a record of before this was told."""
    if not column.subjects:
        return
    known = {"trained": "Hands that training saw", "unseen": "Hands that training never saw"}
    hands = known.get(column.subjects, "Chosen hands") if isinstance(column.subjects, str) else "Chosen hands"
    new = [f"new {axis}s" for axis in AXES if axis not in (*column.shares, "subject")]
    shared = [f"{axis}s" for axis in AXES if axis in column.shares]
    yield hands + (f", {listed(new)}" if new else "")
    yield f". In training too: {listed(shared)}." if shared else ". Nothing of it is in training."


def _is_floor(method: MethodRecord) -> bool:
    """Whether every method must be better: a calibration row that is not the truth."""
    return method.calibration and not method.truth


@dataclass(frozen=True)
class _Source:
    """Where a row comes from: a method of a run, its values by protocol column, its cells without their scores."""

    name: str
    title: str
    method: MethodRecord
    values: dict[str, Values]
    cells: list[CellRecord]


def _sources(run: Run) -> Iterator[_Source]:
    """The methods of a run."""
    values, cells = values_of(run), run.in_order
    for method in run.plan.methods:
        columns = {column: found for (owner, column), found in values.items() if owner == method.name}
        of_method = [cell for cell in cells if cell.method.name == method.name]
        yield _Source(method.name, method.title, method, columns, of_method)


def _position(sources: Sequence[_Source], baseline: str) -> int:
    names = [source.name for source in sources]
    if baseline not in names:
        raise unknown_name("baseline", baseline, names)
    return names.index(baseline)


def _published(told: PublishedRecord, columns: tuple[MetricColumn, ...], metrics: int) -> Row:
    """A paper's row; a run tells its values by column, in the order of the metrics."""
    cells = []
    for index, column in enumerate(columns):
        values = told.values.get(column.group.name, (None,) * metrics)
        cells.append(Aggregate(values[index % metrics], None, None, 0, 0))
    return Row(
        name=told.method,
        title=told.title,
        kind="published",
        fidelity=told.source,
        cells=tuple(cells),
        times=MethodTimes(None, None, {}, {}),
        marker=told.marker,
    )


def _remarks(protocol: ProtocolRecord) -> Iterator[str]:
    if rows := protocol.published:
        yield (
            "Published rows hold what their authors measured on their own data, with metric settings they did not "
            "publish: not comparable with measured values, so not ranked with them."
        )
        if protocol.published_note:
            yield protocol.published_note
        titles: dict[tuple[str, str], list[str]] = {}
        for row in rows:
            titles.setdefault((row.marker, row.source), []).append(row.title)
        yield from (f"{marker or listed(named)}: {source}." for (marker, source), named in titles.items())


def _old_times(runs: Sequence[Run]) -> Iterator[str]:
    """That times of frames are left out, where a run was timed before their names said what they measure."""
    for run in runs:
        cells = [cell for cell in run.cells if cell.schema == 1 and cell.method.timed]
        if cells and not any(cell.times.new_pose_ms for cell in cells):
            yield (
                f"Times of a frame are not shown for {run.folder}: they were measured by a version that did not tell "
                "new poses from known ones."
            )


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
        least = min(1.0, least_p(count) * methods)
        over = f", after correction over {methods} methods below {least:.2g}" if methods > 1 else ""
        yield (
            f"Too few subjects to claim a difference for other hands: with {count} subject{plural} p cannot fall below "
            f"{least_p(count):.2g}{over}; intervals there tell of these hands and their frames."
        )


def _row(source: _Source, kind: Kind, cells: tuple[Aggregate, ...]) -> Row:
    bends = [cell.laws.linearity for cell in source.cells if cell.laws.linearity is not None]
    times = times_of(source.cells)
    return Row(
        source.name,
        source.title,
        kind,
        source.method.fidelity,
        cells,
        times,
        nonlinearity=max(bends, default=None),
        enrolment=source.method.enrolment,
        here=source.method.timed,
        floor=_is_floor(source.method),
        footprint=footprint_of([cell.cost for cell in source.cells]),
    )


def _marked(rows: tuple[Row, ...], baseline: int | None) -> tuple[Row, ...]:
    """The rows with a mark wherever they are compared with one to which enrolment gave something else."""
    mixed = len({row.enrolment for row in rows if row.kind == "method"}) > 1
    other = None if baseline is None else rows[baseline].enrolment

    def marked(row: Row, cell: Aggregate) -> Aggregate:
        across = cell.difference is not None and row.enrolment != other
        return replace(cell, unequal=mixed and cell.rank > 0, across=across)

    return tuple(replace(row, cells=tuple(marked(row, cell) for cell in row.cells)) for row in rows)
