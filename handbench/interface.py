"""handbench from Python: run a protocol, or open run folders, and have tables, scores and pictures as plain values.

import handbench

results = handbench.run("smoke", methods=["oracle", "mean", "phong"])
results.rows()[0]                            # {"method": "oracle", "column": …, "metric": "psnr", "value": 100.0, …}
results.mean("psnr", "unseen-subject")       # {"oracle": 100.0, "mean": 15.7, "phong": 24.8}
results.picture("phong", results.frames[0])  # (H, W, 3) linear
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError, unknown_name
from .scene import Array
from .settings import Setting

if TYPE_CHECKING:
    from .bench.run import RunSummary
    from .reports.model import Table
    from .results.reading import Run


def run(
    protocol: str | Path,
    methods: Sequence[str] | None = None,
    *,
    seeds: Sequence[int] | None = None,
    preset: str | None = None,
    settings: Mapping[str, object] | None = None,
    subjects: Sequence[str] | None = None,
    limit: int | None = None,
    out: str | Path | None = None,
    data: str | Path | None = None,
    device: str = "cpu",
    reuse: Sequence[str | Path] = (),
) -> Results:
    """Run a protocol and give its results: what `handbench run` does, without its report.

    protocol    a registered name, or a TOML file
    methods     names, patterns ("urhand*") and files ("./mine.py"); None takes the protocol's
    seeds       instead of the protocol's
    preset      one preset for all methods
    settings    changed settings of the methods that have them: {"steps": 500} or {"urhand:steps": 500}
    subjects    score these alone; training stays as it is
    limit       score so many frames of each column at most
    out         the run folder (default: runs/PROTOCOL, and what was changed); finished cells in it are computed no more
    data        where captures are kept
    device      where networks run: "cpu", "cuda", …
    reuse       other run folders whose finished cells are taken

    Raises `InputError` for what cannot be used, in one sentence that says what helps. A method that crashes raises
    nothing: its values are missing, with the reason, and `outcome.crashed` names it.
    """
    from .bench.naming import named_methods
    from .bench.narrowing import narrowed
    from .bench.run import find_protocol
    from .bench.run import run as run_protocol
    from .device import on_device

    chosen = narrowed(find_protocol(str(protocol)), subjects, limit)
    names, extra = (None, ()) if methods is None else named_methods(methods)
    changes = [Setting.parse(f"{name}={_text(value)}") for name, value in (settings or {}).items()]
    places = (None if out is None else Path(out), None if data is None else Path(data))
    folders = tuple(map(Path, reuse))
    with on_device(device):
        outcome = run_protocol(
            chosen, names, seeds, preset, *places, ("handbench.run",), extra=extra, settings=changes, reuse=folders
        )
    return Results((outcome.folder,), outcome)


def load(*folders: str | Path) -> Results:
    """The results of run folders, several of one protocol together. Raises `InputError` if one holds no run."""
    if not folders:
        raise InputError("there is nothing to load; give the folder of a run")
    found = Results(tuple(map(Path, folders)))
    assert found.runs
    return found


@dataclass(frozen=True)
class Results:
    """What runs measured and drew, read from their folders when it is asked for.

    `outcome` says what was computed, if these are the results of `run`.
    """

    folders: tuple[Path, ...]
    outcome: RunSummary | None = None

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """The runs, as they lie on disk."""
        from .results.reading import read_run

        return tuple(map(read_run, self.folders))

    def table(self, baseline: str | None = None) -> Table:
        """The table that reports show: rows of methods over columns, with intervals, marks and reasons."""
        from .reports import table

        return table(*self.folders, baseline=baseline)

    def rows(self, baseline: str | None = None) -> list[dict[str, object]]:
        """The table as plain dictionaries, one a value: ready for `pandas.DataFrame`."""
        from .reports import as_json

        return as_json(self.table(baseline))

    def mean(self, metric: str, column: str) -> dict[str, float | None]:
        """The table's value of each method, by name: over frames, then subjects, then seeds."""
        table = self.table()
        places = {(each.group.name, each.metric.name): i for i, each in enumerate(table.columns)}
        self._check(metric, column)
        return {row.name: row.cells[places[column, metric]].value for row in table.rows}

    @cached_property
    def scores(self) -> dict[str, Array]:
        """Every value, as arrays of one length: method, subject, seed, column, frame, kind, metric, value, reason.

        A value that is missing is NaN, and its reason says why; other reasons are empty.
        """
        names = ("method", "subject", "seed", "column", "query", "kind", "metric", "value", "reason")
        asked = ", ".join(f'"{name}"' for name in names)
        rows = self.query(f"SELECT {asked} FROM scores")
        columns = zip(*rows, strict=True) if rows else [()] * len(names)
        found = dict(zip(names, map(list, columns), strict=True))
        found["frame"] = found.pop("query")
        found["reason"] = [reason or "" for reason in found["reason"]]
        value = np.array([np.nan if value is None else value for value in found.pop("value")], dtype=float)
        return {**{name: np.array(of_name) for name, of_name in found.items()}, "value": value}

    @property
    def frames(self) -> tuple[str, ...]:
        """The scored frames: subject/pose/camera/light."""
        protocol = self.runs[0].plan.protocol
        return tuple(dict.fromkeys(query for column in protocol.columns for query in column.queries))

    @property
    def methods(self) -> tuple[str, ...]:
        """The names of the methods, in the order of the tables."""
        return tuple(dict.fromkeys(method.name for run in self.runs for method in run.plan.methods))

    def picture(self, method: str, frame: str, seed: int | None = None) -> Array:
        """What a method drew of a frame: (H, W, 3) linear, premultiplied, in half floats; of the first seed, or of one.

        Raises `InputError` for an unknown method or frame, and for a picture that was not kept.
        """
        return self._prediction(method, frame, seed).image

    def alpha(self, method: str, frame: str, seed: int | None = None) -> Array:
        """How much of each pixel is hand in what a method drew: (H, W) in [0, 1]; raises as `picture` does."""
        return self._prediction(method, frame, seed).alpha

    def truth(self, frame: str) -> Array:
        """The recorded picture (H, W, 3), as the method `oracle` hands it on. Raises `InputError` without it."""
        for run in self.runs:
            for method in run.plan.methods:
                if method.truth:
                    return self.picture(method.name, frame)
        raise InputError("the truth is kept by the method 'oracle', which is in none of these runs; run it too")

    def query(self, sql: str) -> list[tuple[Any, ...]]:
        """The answer to a SELECT over the views runs, methods, cells, times and scores, as `handbench query` gives."""
        from .results.query import ResultsDatabase as Views

        with Views(list(self.runs)) as views:
            return views.query(sql).rows

    def report(self) -> Path:
        """Write the reports of one run and give its page, report/index.html."""
        from .reports import write_reports

        if len(self.folders) > 1:
            raise InputError("a page is written into one run's folder; load one run")
        return write_reports(self.folders[0])["index.html"]

    def _repr_markdown_(self) -> str:
        """The table, where a notebook shows these results."""
        from .reports import render_markdown

        return render_markdown(self.table())

    def _prediction(self, method: str, frame: str, seed: int | None) -> Any:
        if method not in self.methods:
            raise unknown_name("method", method, self.methods)
        if frame not in self.frames:
            raise unknown_name("frame", frame, self.frames)
        for run in self.runs:
            for cell in run.of_method(method):
                if frame in cell.predictions and seed in (None, cell.seed):
                    return run.read_prediction(cell, frame)
        of_seed = "" if seed is None else f" with seed {seed}"
        raise InputError(f"no picture of {frame} by {method}{of_seed} is kept in {', '.join(map(str, self.folders))}")

    def _check(self, metric: str, column: str) -> None:
        protocol = self.runs[0].plan.protocol
        for kind, name, known in (("metric", metric, protocol.metrics), ("column", column, protocol.columns)):
            if name not in (names := [each.name for each in known]):
                raise unknown_name(kind, name, names)


def _text(value: object) -> str:
    """A value as a setting takes it."""
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
