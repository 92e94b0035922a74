"""The results of run folders in SQL, through DuckDB: what `handbench query` asks.

    runs       one line a run folder: protocol, capture, commit, command
    methods    one line a method of a run
    cells      one line a finished cell: seconds, device, laws, error
    times      one line a kind of frame that a cell timed poses under
    scores     one line a value

Only cells of a run's plan are there: those of earlier plans that still lie in the folder are not. `run` is the folder
as it was named. Several folders share their finished cells by key, so the parts of a sharded run complete each other.
Columns are fields of the records, and have their types.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..scene import Array
from .fieldtypes import at, sql_at
from .reading import Run, completed
from .record import CellRecord, MethodRecord, RunRecord

# Columns of the views by name, each the way to it in a record.
_RUNS = {
    "protocol": "protocol.name",
    "version": "protocol.version",
    "digest": "protocol.digest",
    "title": "protocol.title",
    "capture": "capture.name",
    "capture_digest": "capture.digest",
    "handbench": "provenance.version",
    "commit": "provenance.git.commit",
    "dirty": "provenance.git.dirty",
    "command": "provenance.command",
    "started": "provenance.started",
}
_METHODS = {
    "method": "name",
    **{name: name for name in ("title", "fidelity", "enrolment", "preset", "universal", "linear", "truth", "config")},
}
_CELLS = {
    "method": "method.name",
    "subject": "subject",
    "seed": "seed",
    **{name: f"times.{name}" for name in ("train_s", "personalise_s", "score_s")},
    **{name: f"cost.{name}" for name in ("peak_mb", "train_peak_mb", "vram_mb", "energy_j", "parameters")},
    **{name: f"cost.{name}" for name in ("weights_bytes", "avatar_bytes")},
    **{name: f"device.{name}" for name in ("cpu", "cores", "threads", "gpus", "networks")},
    "nonlinearity": "laws.linearity",
    "same_pixels": "same_pixels",
    "error": "error",
    "key": "key",
}
_SPREAD = {"_ms": "median", "_min_ms": "min", "_max_ms": "max"}
_VIEWS = """
CREATE VIEW runs AS SELECT * FROM told_runs;
CREATE VIEW methods AS SELECT * FROM told_methods;
CREATE VIEW cells AS SELECT run, protocol, version, found.* EXCLUDE (run, number)
    REPLACE (array_to_string(gpus, ', ') AS gpus) FROM found JOIN told_runs USING (run);
CREATE VIEW times AS SELECT run, method, subject, seed, told_times.* EXCLUDE (number)
    FROM told_times JOIN found USING (number);
CREATE VIEW scores AS SELECT run, protocol, version, frame."column" AS "column", method, subject, seed,
    frame.query, frame.kind, coalesce(told_metrics.name, split_part(signature, '|', 1)) AS metric, signature,
    value, reason
    FROM told_values JOIN frame USING (frame) JOIN found USING (number) JOIN told_runs USING (run)
    LEFT JOIN told_metrics USING (run, signature);
"""


@dataclass(frozen=True)
class ResultSet:
    """The result of a query: names of columns, and rows."""

    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


class ResultsDatabase:
    """Run folders as DuckDB views. Use it in a `with` block.

    Raises `InputError` as `Run.cells` does.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        import duckdb

        # Nothing is fetched from a network, whatever a query asks for; and so little data is read faster by one thread.
        self._connection = duckdb.connect(config={"autoinstall_known_extensions": False, "threads": 1})
        self._load(completed(runs))
        self._connection.execute("SET enable_external_access = false; SET lock_configuration = true")

    def __enter__(self) -> ResultsDatabase:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def query(self, sql: str) -> ResultSet:
        """The answer to one SELECT. Raises `InputError` for anything else, and for what DuckDB cannot answer."""
        import duckdb

        try:
            statements = self._connection.extract_statements(sql)
            if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
                raise InputError("a query is one SELECT; results are only read")
            cursor = self._connection.execute(statements[0])
            return ResultSet(tuple(name for name, *_ in cursor.description), cursor.fetchall())
        except InputError:
            raise
        except Exception as error:  # DuckDB's own, and Python's for values that it has no type for
            raise InputError(f"the query cannot be answered: {_sentence(str(error))}") from error

    def _load(self, runs: Sequence[Run]) -> None:
        """The tables behind the views."""
        told = [(str(run.folder), run) for run in runs]
        cells = [(name, cell) for name, run in told for cell in run.in_order]
        metrics = [(name, metric) for name, run in told for metric in run.plan.protocol.metrics]
        methods = [(name, method) for name, run in told for method in run.plan.methods]
        plans = [(name, run.plan) for name, run in told]
        self._put("told_runs", _types(RunRecord, _RUNS), _columns(plans, _RUNS))
        self._put("told_methods", _types(MethodRecord, _METHODS), _columns(methods, _METHODS, config=json.dumps))
        types = {"run": "VARCHAR", "signature": "VARCHAR", "name": "VARCHAR"}
        named = [(run, metric.signature, metric.name) for run, metric in metrics]
        self._put("told_metrics", types, zip(*named, strict=True))
        numbers = np.arange(len(cells))
        self._put("found", {**_types(CellRecord, _CELLS), "number": "BIGINT"}, [*_columns(cells, _CELLS), numbers])
        self._put_times([cell for _, cell in cells])
        self._put_scores([cell for _, cell in cells])
        self._connection.execute(_VIEWS)

    def _put_times(self, cells: Sequence[CellRecord]) -> None:
        """A line for each kind of frame that a cell timed poses under."""
        lines: list[tuple[Any, ...]] = []
        for number, cell in enumerate(cells):
            new, known = cell.times.new_pose_ms, cell.times.known_pose_ms
            for kind in dict.fromkeys((*new, *known)):
                spreads = (new.get(kind), known.get(kind))
                lines.append((number, kind, *(at(spread, name) for spread in spreads for name in _SPREAD.values())))
        names = (f"{pose}{name}" for pose in ("new_pose", "known_pose") for name in _SPREAD)
        types = {"number": "BIGINT", "kind": "VARCHAR", **dict.fromkeys(names, "DOUBLE")}
        self._put("told_times", types, zip(*lines, strict=True))

    def _put_scores(self, cells: Sequence[CellRecord]) -> None:
        """A line a frame, and a line a value that names its frame."""
        frames = [(number, frame) for number, cell in enumerate(cells) for frame in cell.scores]
        sizes = np.array([len(frame.values) for _, frame in frames], dtype=int)
        counts = np.array([cell_number for cell_number, _ in frames], dtype=int)
        types = {"frame": "BIGINT", "column": "VARCHAR", "query": "VARCHAR", "kind": "VARCHAR"}
        names = ([getattr(frame, name) for _, frame in frames] for name in ("column", "query", "kind"))
        self._put("frame", types, [np.arange(len(frames)), *names])
        types = {"frame": "BIGINT", "number": "BIGINT", "signature": "VARCHAR", "value": "DOUBLE", "reason": "VARCHAR"}
        signatures = [signature for cell in cells for _ in cell.scores for signature in cell.metrics]
        values = [value for _, frame in frames for value in frame.values]
        reasons = [reason for _, frame in frames for reason in frame.reasons or (None,) * len(frame.values)]
        indices = [np.repeat(np.arange(len(frames)), sizes), np.repeat(counts, sizes)]
        self._put("told_values", types, [*indices, signatures, values, reasons])

    def _put(self, table: str, types: Mapping[str, str], columns: Iterable[Sequence[Any] | Array]) -> None:
        """A new table; DuckDB takes a column whole."""
        names = ", ".join(f'"{name}" {kind}' for name, kind in types.items())
        self._connection.execute(f"CREATE TABLE {table} ({names})")
        arrays = {name: _array(column) for name, column in zip(types, columns, strict=False)}
        if arrays and len(next(iter(arrays.values()))):
            self._connection.register("given", arrays)
            self._connection.execute(f"INSERT INTO {table} SELECT * FROM given")
            self._connection.unregister("given")


def _types(kind: type, ways: Mapping[str, str]) -> dict[str, str]:
    return {"run": "VARCHAR", **{name: sql_at(kind, way) for name, way in ways.items()}}


def _columns(records: Sequence[tuple[str, Any]], ways: Mapping[str, str], **change: Any) -> list[list[Any]]:
    """The folders, then what lies at the end of each way, column by column; `change` is applied to columns by name."""
    same = lambda value: value  # noqa: E731
    columns = [[change.get(name, same)(at(record, way)) for _, record in records] for name, way in ways.items()]
    return [[run for run, _ in records], *columns]


def _array(column: Sequence[Any] | Array) -> Array:
    if isinstance(column, np.ndarray):
        return column
    found = np.empty(len(column), dtype=object)
    found[:] = [list(value) if isinstance(value, tuple) else value for value in column]
    return found


def _sentence(text: str) -> str:
    """DuckDB's message on one line, without the picture of where in the query it is."""
    if "'pytz'" in text:
        return "a time with a zone has no Python type here; write CAST(… AS VARCHAR)"
    said = " ".join(text.partition("\nLINE ")[0].split())
    return said + ('; it is a word of SQL, so write "column" with its quotes' if 'near "column"' in said else "")
