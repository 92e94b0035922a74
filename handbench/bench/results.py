"""The results of run folders, through DuckDB: what `handbench query`, the reports and the gate read.

    runs       one line a run folder: protocol, capture, commit, command
    methods    one line a method of a run
    cells      one line a finished cell: times, device, laws, error
    scores     one line a value

Only cells of a run's plan are there: those of earlier plans that still lie in the folder are not. `run` is the folder
as it was named. Several folders share their finished cells by key, so the parts of a sharded run complete each other.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..scene import Array
from .reading import Run
from .store import SCHEMA, Store

if TYPE_CHECKING:
    import duckdb

NOT_COMPUTED = "not computed: the run was stopped or the cell failed"
NOT_FINITE = "the value is not finite"

_SPREAD = "STRUCT(median DOUBLE, min DOUBLE, max DOUBLE, n BIGINT, values DOUBLE[])"
_CELL = {
    "schema": "BIGINT",
    "key": "VARCHAR",
    "method": "STRUCT(name VARCHAR)",
    "subject": "VARCHAR",
    "seed": "BIGINT",
    "device": "STRUCT(cpu VARCHAR, cores BIGINT, threads BIGINT, gpus VARCHAR[], networks VARCHAR)",
    "times": "STRUCT(train_s DOUBLE, personalise_s DOUBLE, score_s DOUBLE, "
    f"new_pose_ms MAP(VARCHAR, {_SPREAD}), known_pose_ms MAP(VARCHAR, {_SPREAD}))",
    "laws": "STRUCT(linearity DOUBLE)",
    "same_pixels": "BOOLEAN",
    "error": "VARCHAR",
    "scores": 'STRUCT("column" VARCHAR, query VARCHAR, kind VARCHAR, metric VARCHAR, value DOUBLE, reason VARCHAR)[]',
}
_VIEWS = f"""
CREATE VIEW runs AS SELECT * FROM told_runs;
CREATE VIEW methods AS SELECT * FROM told_methods;
CREATE VIEW cells AS SELECT run, protocol, version, method.name AS method, subject, seed,
    times.train_s, times.personalise_s, times.score_s,
    device.cpu, device.cores, device.threads,
    array_to_string(device.gpus, ', ') AS gpus, device.networks, laws.linearity AS nonlinearity, same_pixels, error, key
    FROM found JOIN told_runs USING (run);
CREATE VIEW times AS SELECT run, method, subject, seed, kind, new_pose.median AS new_pose_ms,
    new_pose.min AS new_pose_min_ms, new_pose.max AS new_pose_max_ms, known_pose.median AS known_pose_ms,
    known_pose.min AS known_pose_min_ms, known_pose.max AS known_pose_max_ms
    FROM (SELECT *, times.new_pose_ms[kind] AS new_pose, times.known_pose_ms[kind] AS known_pose
        FROM (SELECT run, method.name AS method, subject, seed, times, unnest(list_distinct(
            list_concat(map_keys(times.new_pose_ms), map_keys(times.known_pose_ms)))) AS kind FROM found));
CREATE VIEW scores AS SELECT run, protocol, version, score."column" AS "column", found.method, subject, seed,
    score.query, score.kind, coalesce(told_metrics.name, split_part(score.metric, '|', 1)) AS metric,
    score.metric AS signature, CASE WHEN isfinite(score.value) THEN score.value END AS value,
    CASE WHEN score.value IS NULL OR NOT isfinite(score.value) THEN coalesce(score.reason, '{NOT_FINITE}') END AS reason
    FROM (SELECT run, method.name AS method, subject, seed, unnest(scores) AS score FROM found) AS found
    JOIN told_runs USING (run) LEFT JOIN told_metrics ON run = told_metrics.of_run AND score.metric = signature;
"""


@dataclass(frozen=True)
class Values:
    """The values of one method in one protocol column.

    values      (metrics, seeds, frames), NaN where there is none, in the order of the plan
    subjects    (frames,) whole numbers
    reasons     of each metric: why values are missing, and how many
    """

    values: Array
    subjects: Array
    reasons: tuple[dict[str, int], ...]


@dataclass(frozen=True)
class Answer:
    """The result of a query: names of columns, and rows."""

    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


class Results:
    """Run folders as DuckDB views. Use it in a `with` block.

    Raises `InputError` for a cell that a newer version wrote; a damaged one is left out, as if it were not there.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        import duckdb

        self.runs = tuple(runs)
        # Nothing is fetched from a network, whatever a query asks for; and so little data is read faster by one thread.
        self._connection = duckdb.connect(config={"autoinstall_known_extensions": False, "threads": 1})
        self._load()
        self._connection.execute("SET enable_external_access = false; SET lock_configuration = true")

    def __enter__(self) -> Results:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def query(self, sql: str) -> Answer:
        """The answer to one SELECT. Raises `InputError` for anything else, and for what DuckDB cannot answer."""
        import duckdb

        try:
            statements = self._connection.extract_statements(sql)
            if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
                raise InputError("a query is one SELECT; results are only read")
            cursor = self._connection.execute(statements[0])
            return Answer(tuple(name for name, *_ in cursor.description), cursor.fetchall())
        except InputError:
            raise
        except Exception as error:  # DuckDB's own, and Python's for values that it has no type for
            raise InputError(f"the query cannot be answered: {_sentence(str(error))}") from error

    def cells(self, run: Run) -> list[dict[str, Any]]:
        """The finished cells of a run without their scores, by seed and subject."""
        cursor = self._connection.execute(
            "SELECT method.name AS method, key, subject, seed, times, device, laws.linearity AS nonlinearity, error "
            "FROM found WHERE run = ? ORDER BY seed, subject",
            [str(run.folder)],
        )
        names = [name for name, *_ in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]

    def values(self, run: Run) -> dict[tuple[str, str], Values]:
        """All values of a run by (method, column)."""
        protocol = run.plan["protocol"]
        metrics = {metric["signature"]: i for i, metric in enumerate(protocol["metrics"])}
        seeds = {seed: i for i, seed in enumerate(run.plan["seeds"])}
        found: dict[tuple[str, str], Values] = {}
        frames: dict[str, dict[str, int]] = {}
        for column in protocol["columns"]:
            queries = frames[column["name"]] = {query: i for i, query in enumerate(column["queries"])}
            owners = [query.partition("/")[0] for query in queries]
            subjects = np.unique(owners, return_inverse=True)[1]
            for info in run.plan["methods"]:
                values = np.full((len(metrics), len(seeds), len(queries)), np.nan)
                found[info["name"], column["name"]] = Values(values, subjects, tuple(Counter() for _ in metrics))
        seen = {key: np.zeros(values.values.shape, dtype=bool) for key, values in found.items()}
        for method, name, metric, seed, query, value, reason in self._scores(run):
            if (method, name) in found and metric in metrics and seed in seeds and query in frames[name]:
                place = metrics[metric], seeds[seed], frames[name][query]
                seen[method, name][place] = True
                if value is None:
                    found[method, name].reasons[place[0]][reason] += 1
                else:
                    found[method, name].values[place] = value
        for key, there in seen.items():
            for reasons, count in zip(found[key].reasons, (~there).sum(axis=(1, 2)).tolist(), strict=True):
                if count:
                    reasons[NOT_COMPUTED] = count
        return found

    def _scores(self, run: Run) -> Iterator[tuple[Any, ...]]:
        cursor = self._connection.execute(
            'SELECT method, "column", signature, seed, query, value, reason FROM scores WHERE run = ? '
            "ORDER BY seed, subject, query",
            [str(run.folder)],
        )
        while rows := cursor.fetchmany(10_000):
            yield from rows

    def _load(self) -> None:
        """The tables behind the views."""
        execute = self._connection.execute
        execute(
            "CREATE TABLE told_runs (run VARCHAR, protocol VARCHAR, version BIGINT, digest VARCHAR, title VARCHAR, "
            "capture VARCHAR, capture_digest VARCHAR, handbench VARCHAR, commit VARCHAR, dirty BOOLEAN, "
            "command VARCHAR, started VARCHAR)"
        )
        execute(
            "CREATE TABLE told_methods (run VARCHAR, method VARCHAR, title VARCHAR, fidelity VARCHAR, preset VARCHAR, "
            "universal BOOLEAN, linear BOOLEAN, truth BOOLEAN, config JSON)"
        )
        execute("CREATE TABLE told_metrics (of_run VARCHAR, signature VARCHAR, name VARCHAR)")
        execute(f"CREATE TABLE found (run VARCHAR, {', '.join(f'{name} {kind}' for name, kind in _CELL.items())})")
        for run in self.runs:
            _insert(self._connection, "told_runs", [_about_run(run)])
            _insert(self._connection, "told_methods", [_about_method(run, info) for info in run.plan["methods"]])
            metrics = run.plan["protocol"]["metrics"]
            _insert(self._connection, "told_metrics", [(str(run.folder), m["signature"], m["name"]) for m in metrics])
            self._load_cells(run)
        execute(_VIEWS)

    def _load_cells(self, run: Run) -> None:
        import duckdb

        paths = [path for path in map(self._path(run), run.plan["cells"]) if path]
        try:
            self._read(run, paths)
        except duckdb.Error:  # a damaged file: DuckDB refuses all, so the good ones are written anew and read
            with tempfile.TemporaryDirectory() as folder:
                self._read(run, [_plain(path, Path(folder)) for path in paths])

    def _path(self, run: Run) -> Any:
        """Where the finished cell of a key is: in the run's own folder, else in one of the others."""
        folders = [run.folder, *(other.folder for other in self.runs if other is not run)]

        def path(key: str) -> Path | None:
            places = (folder / "cells" / f"{key}.json" for folder in folders)
            return next((place for place in places if place.is_file()), None)

        return path

    def _read(self, run: Run, paths: Sequence[Path]) -> None:
        if not paths:
            return
        columns = ", ".join(f"{name}: '{kind}'" for name, kind in _CELL.items())
        largest = max(path.stat().st_size for path in paths)
        source = f"read_json($paths, columns = {{{columns}}}, format = 'unstructured', filename = true, "
        source += f"maximum_object_size = {2 * largest + (1 << 20)})"
        names = ", ".join(_CELL)
        self._connection.execute(
            f"INSERT INTO found SELECT $run, {names} FROM {source} "
            f"WHERE schema >= {SCHEMA} AND key = parse_filename(filename, true)",
            {"run": str(run.folder), "paths": [str(path) for path in paths]},
        )
        newer = self._connection.execute(f"SELECT key FROM found WHERE schema > {SCHEMA}").fetchone()
        if newer:
            path = self._path(run)(newer[0])
            Store(path.parents[1]).cell(newer[0])  # raises, and says so in the store's words


def _insert(connection: duckdb.DuckDBPyConnection, table: str, rows: Sequence[tuple[Any, ...]]) -> None:
    if rows:
        connection.executemany(f"INSERT INTO {table} VALUES ({', '.join('?' * len(rows[0]))})", rows)


def _about_run(run: Run) -> tuple[Any, ...]:
    protocol, origin = run.plan["protocol"], run.plan["provenance"]
    git = origin.get("git") or {}
    return (
        *(str(run.folder), protocol["name"], protocol["version"], protocol["digest"], protocol["title"]),
        *(run.plan["capture"]["name"], run.plan["capture"]["digest"], origin["version"], git.get("commit")),
        *(git.get("dirty"), origin["command"], origin.get("started")),
    )


def _about_method(run: Run, info: dict[str, Any]) -> tuple[Any, ...]:
    fields = (info.get(name) for name in ("title", "fidelity", "preset", "universal", "linear", "truth"))
    return (str(run.folder), info["name"], *fields, json.dumps(info.get("config")))


def _plain(path: Path, folder: Path) -> Path:
    """A copy of a cell's file that is sound JSON: empty for a damaged cell, null for values that are not finite."""
    cell = Store(path.parents[1]).cell(path.stem)
    for score in cell["scores"] if cell else ():
        if score["value"] is not None and not math.isfinite(score["value"]):
            score["value"] = None
    copy = folder / path.name
    copy.write_text(json.dumps(cell or {}))
    return copy


def _sentence(text: str) -> str:
    """DuckDB's message on one line, without the picture of where in the query it is."""
    if "'pytz'" in text:
        return "a time with a zone has no Python type here; write CAST(… AS VARCHAR)"
    said = " ".join(text.partition("\nLINE ")[0].split())
    return said + ('; it is a word of SQL, so write "column" with its quotes' if 'near "column"' in said else "")
