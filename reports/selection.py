"""What of runs is shown: some methods, columns, metrics or subjects. Marks and intervals are made of what is shown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

from handbench.errors import InputError, unknown_name
from handbench.results.reading import Run
from handbench.results.record import ColumnRecord, ProtocolRecord, PublishedRecord, RunRecord


@dataclass(frozen=True)
class ReportFilter:
    """Names or patterns ("urhand*"), in the order in which they are to be shown; empty takes all."""

    methods: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()

    def among(self, runs: Sequence[Run]) -> tuple[Run, ...]:
        """Several runs, each with what it has of the methods; those that measured none of them are left out.

        Raises `InputError` for a method that is in none of them, and as `of` does.
        """
        if len(runs) == 1 or not self.methods:
            return tuple(map(self.of, runs))
        _chosen("method of these runs", self.methods, [name for run in runs for name in _methods(run.plan)])
        kept = []
        for run in runs:
            there = [p for p in self.methods if any(fnmatchcase(name, p) for name in _methods(run.plan))]
            if any(fnmatchcase(name, p) for name in _names(run.plan) for p in there):
                kept.append(replace(self, methods=tuple(there)).of(run))
        if not kept:
            raise InputError(f"none of {', '.join(self.methods)} was measured in any of these runs; name one that was")
        return tuple(kept)

    def gaps(self, runs: Sequence[Run]) -> tuple[str, ...]:
        """Of several runs, which lack what of the methods that are asked for, a sentence each."""
        lacking = {
            str(run.folder): [p for p in self.methods if not any(fnmatchcase(name, p) for name in _methods(run.plan))]
            for run in runs
        }
        return tuple(f"Not in {folder}: {', '.join(names)}." for folder, names in lacking.items() if names)

    def of(self, run: Run) -> Run:
        """The run with less in its plan. Raises `InputError` for a name that is not in it."""
        if self == ALL:
            return run
        plan = run.plan
        published = [row.method for row in plan.protocol.published]
        methods = _chosen("method of this run", self.methods, _methods(plan))
        subjects = set(_chosen("subject of this run", self.subjects, plan.subjects or _subjects(plan)))
        shown = tuple(plan.method(name) for name in methods if name not in set(published) - _names(plan))
        if not shown:
            raise InputError(f"none of {', '.join(self.methods)} was measured in {run.folder}; name one that was")
        protocol = self._protocol(plan.protocol, methods, subjects)
        seen = {method.name for method in shown}
        cells = tuple(cell for cell in run.cells if cell.method.name in seen and cell.subject in subjects)
        keys = tuple(cell.key for cell in cells)
        return replace(run, plan=replace(plan, methods=shown, protocol=protocol, cells=keys), given=cells)

    def _protocol(self, told: ProtocolRecord, methods: Sequence[str], subjects: set[str]) -> ProtocolRecord:
        names = _chosen("column", self.columns, [column.name for column in told.columns])
        metrics = _chosen("metric", self.metrics, [metric.name for metric in told.metrics])
        by_name = {column.name: column for column in told.columns}
        columns = tuple(column for name in names if (column := _of_subjects(by_name[name], subjects)).queries)
        if not columns:
            raise InputError(f"no column of {', '.join(names)} has a frame of {', '.join(sorted(subjects))}")
        places = [[metric.name for metric in told.metrics].index(name) for name in metrics]
        published = tuple(_of_metrics(row, places, names) for row in told.published if row.method in methods)
        shown = tuple(told.metrics[place] for place in places)
        return replace(told, columns=columns, metrics=shown, published=published)


ALL = ReportFilter()


def _methods(plan: RunRecord) -> list[str]:
    """What can be a row: measured methods, then published ones."""
    return [*(method.name for method in plan.methods), *(row.method for row in plan.protocol.published)]


def _names(plan: RunRecord) -> set[str]:
    return {method.name for method in plan.methods}


def _subjects(plan: RunRecord) -> list[str]:
    """The subjects of a run of before its plan told them."""
    queries = (query for column in plan.protocol.columns for query in column.queries)
    return list(dict.fromkeys(query.partition("/")[0] for query in queries))


def _chosen(kind: str, wanted: Sequence[str], known: Iterable[str]) -> list[str]:
    """The known names that are wanted, each once, in the order of what is wanted."""
    names = list(dict.fromkeys(known))
    found: dict[str, None] = {}
    for pattern in wanted or ("*",):
        fitting = [name for name in names if fnmatchcase(name, pattern)]
        if not fitting:
            raise unknown_name(kind, pattern, names)
        found |= dict.fromkeys(fitting)
    return list(found)


def _of_subjects(column: ColumnRecord, subjects: set[str]) -> ColumnRecord:
    return replace(column, queries=tuple(query for query in column.queries if query.partition("/")[0] in subjects))


def _of_metrics(row: PublishedRecord, places: Sequence[int], columns: Sequence[str]) -> PublishedRecord:
    values = {name: tuple(each[place] for place in places) for name, each in row.values.items() if name in columns}
    return replace(row, values=values)
