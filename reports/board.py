"""A leaderboard of many runs as static files: their pages, who stands where, and how values went from run to run."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from handbench.errors import InputError
from handbench.files import whole, writing

from .build import build
from .model import Aggregate, MetricColumn, Row, Table
from .printed import number
from .run import Run, read_run
from .template import environment
from .write import write_reports

WIDTH, HEIGHT = 420, 190  # of a history
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 300, 14, 150  # of its plot; labels stand right of it
_COLOURS = 8  # classes of lines in the style
_REMEDY = "give another folder"


@dataclass(frozen=True)
class BoardRun:
    """A run on the board; `name` is its folder's and its page's."""

    name: str
    run: Run
    table: Table

    @property
    def started(self) -> str:
        return self.run.plan.provenance.started

    @property
    def commit(self) -> str:
        """Twelve digits, with "+" if there were uncommitted changes; "" for an installed copy."""
        git = self.run.plan.provenance.git
        return "" if git is None or git.commit is None else git.commit[:12] + "+" * git.dirty


@dataclass(frozen=True)
class BoardCurve:
    """A method's values in a column, run by run: points (x, y) in the plot, and where its title stands."""

    title: str
    points: tuple[tuple[float, float, str], ...]
    label: float


@dataclass(frozen=True)
class History:
    """How the first metric went in a column, from the earliest run to the latest."""

    column: MetricColumn
    lines: tuple[BoardCurve, ...]
    ticks: tuple[tuple[float, str], ...]
    places: tuple[float, ...]  # of the runs, from left to right


@dataclass(frozen=True)
class Section:
    """Runs of one protocol version on the same data, the earliest first."""

    entries: tuple[BoardRun, ...]

    @property
    def plan(self) -> str:
        protocol, capture = self.entries[0].run.plan.protocol, self.entries[0].run.plan.capture
        return f"{protocol.title} ({protocol.label}) on {' '.join(filter(None, (capture.name, capture.size)))}"

    @property
    def columns(self) -> list[tuple[int, MetricColumn]]:
        """The first metric of each column, with its place in a table's."""
        table = self.entries[0].table
        places = [table.of_group(group)[0] for group in table.groups]
        return [(place, table.columns[place]) for place in places]

    @property
    def standing(self) -> list[tuple[BoardRun, Row]]:
        """Every measured row, newest runs first."""
        return [(e, row) for e in reversed(self.entries) for row in e.table.rows if row.kind == "method"]

    @property
    def histories(self) -> Iterator[History]:
        """One for each column, where some method is in two runs or more."""
        for place, column in self.columns:
            values: dict[str, list[tuple[int, Aggregate]]] = {}
            for number_of, entry in enumerate(self.entries):
                for row in entry.table.rows:
                    if row.kind == "method" and row.cells[place].value is not None:
                        values.setdefault(row.title, []).append((number_of, row.cells[place]))
            values = {title: found for title, found in values.items() if len(found) > 1}
            if values:
                yield _history(column, values, self.entries)


def write_board(folder: Path, runs: Sequence[Path]) -> Path:
    """Write index.html and a page for each run into a folder, which can be published as it is; returns index.html.

    Runs of one protocol version and data stand together, in the order in which they were started. Raises `InputError`
    for a folder without a readable run, for two runs of one name and for a folder that is one of the runs,
    `StorageError` if a file cannot be written.
    """
    if folder.resolve() in [path.resolve() for path in runs]:
        raise InputError(f"{folder} is one of the runs, which are only read; {_REMEDY}")
    names = [path.resolve().name for path in runs]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"two runs are named {twice[0]!r}, which is the name of their page; rename one of the folders")
    entries = [BoardRun(name, run, build(run)) for name, run in zip(names, map(read_run, runs), strict=True)]
    sections: dict[tuple[str, str], list[BoardRun]] = {}
    for entry in sorted(entries, key=lambda each: (each.started, each.name)):
        plan = entry.run.plan
        sections.setdefault((plan.protocol.digest, plan.capture.digest), []).append(entry)
    page = environment(number=number).get_template("board.html")
    text = page.render(
        sections=[Section(tuple(of_plan)) for of_plan in sections.values()],
        colours=_COLOURS,
        width=WIDTH,
        height=HEIGHT,
        left=_LEFT,
        right=_RIGHT,
        top=_TOP,
        bottom=_BOTTOM,
    )
    with writing(folder, _REMEDY):
        for entry in entries:
            place = folder / "runs" / entry.name
            place.mkdir(parents=True, exist_ok=True)
            with whole(place / "index.html", _REMEDY) as part:
                shutil.copyfile(write_reports(entry.run.folder, table=entry.table)["index.html"], part)
        with whole(folder / "index.html", _REMEDY) as part:
            part.write_text(text, encoding="utf-8")
    return folder / "index.html"


def _history(
    column: MetricColumn, values: dict[str, list[tuple[int, Aggregate]]], entries: Sequence[BoardRun]
) -> History:
    every = [cell.value or 0.0 for found in values.values() for _, cell in found]
    margin = 0.08 * (max(every) - min(every)) or 10.0**-column.metric.decimals
    low, high = min(every) - margin, max(every) + margin

    def x(place: int) -> float:
        return _LEFT + (_RIGHT - _LEFT) * (place + 0.5) / len(entries)

    def y(value: float) -> float:
        up = (value - low) / (high - low)
        return _BOTTOM - (up if column.metric.higher_is_better else 1 - up) * (_BOTTOM - _TOP)

    lines = []
    for title, found in values.items():
        points = tuple(
            (
                x(place),
                y(cell.value or 0.0),
                f"{title}, {entries[place].name}: {number(cell.value, column.metric.decimals)}",
            )
            for place, cell in found
        )
        lines.append(BoardCurve(title, points, points[-1][1]))
    ticks = tuple((y(value), number(value, column.metric.decimals)) for value in (min(every), max(every)))
    return History(column, tuple(_apart(lines)), ticks, tuple(map(x, range(len(entries)))))


def _apart(lines: Sequence[BoardCurve]) -> Iterator[BoardCurve]:
    """The lines with labels that do not cover each other, from the top down."""
    last = -100.0
    for line in sorted(lines, key=lambda each: each.label):
        last = max(line.label, last + 12)
        yield BoardCurve(line.title, line.points, last)
