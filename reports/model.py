"""The one table model that every report is made from: plain frozen values, no formatting but numbers to text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

TIME_TITLES = ("train s", "personalise s", "new pose ms", "known pose ms", "min–max")
Kind = Literal["method", "calibration", "published"]


@dataclass(frozen=True)
class Metric:
    """A metric as a run declares it; `latex` is its column header, `decimals` how many to print."""

    name: str
    title: str
    signature: str
    higher_is_better: bool
    latex: str
    unit: str
    decimals: int

    @property
    def arrow(self) -> str:
        return "↑" if self.higher_is_better else "↓"


@dataclass(frozen=True)
class Group:
    """A protocol column: a set of scored frames that answers one question. All metrics are shown under it."""

    name: str
    title: str


@dataclass(frozen=True)
class Column:
    group: Group
    metric: Metric


@dataclass(frozen=True)
class Cell:
    """One aggregate: `covered` of `expected` values are finite, and `value` is made of those alone.

    low, high   95 % interval; None with fewer than two frames
    rank        1 best, 2 second, 0 neither; never set with incomplete coverage
    notes       numbers (from 1) of the table's footnotes that say why values are missing
    """

    value: float | None
    low: float | None
    high: float | None
    covered: int
    expected: int
    rank: int = 0
    notes: tuple[int, ...] = ()

    @property
    def complete(self) -> bool:
        return self.expected > 0 and self.covered == self.expected


@dataclass(frozen=True)
class Span:
    """A median with the least and the greatest of what was measured."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Times:
    """What a method costs; None where not measured.

    Seconds to train and to personalise one cell; milliseconds of the first frame of a pose, and of a frame
    asked for again, when the pose is known.
    """

    train_s: Span | None
    personalise_s: Span | None
    first_ms: Span | None
    relight_ms: Span | None


@dataclass(frozen=True)
class Row:
    """A method's line. Only kind "method" can be best: calibration and published rows are there for comparison."""

    name: str
    title: str
    kind: Kind
    fidelity: str
    cells: tuple[Cell, ...]
    times: Times


@dataclass(frozen=True)
class Table:
    """Rows of methods over columns (group by group); `row.cells` are in the order of `columns`."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    footnotes: tuple[str, ...]

    @property
    def groups(self) -> tuple[Group, ...]:
        return tuple(dict.fromkeys(column.group for column in self.columns))

    @property
    def metrics(self) -> tuple[Metric, ...]:
        return tuple(dict.fromkeys(column.metric for column in self.columns))

    def of_group(self, group: Group) -> tuple[int, ...]:
        """The positions of a group's columns."""
        return tuple(i for i, column in enumerate(self.columns) if column.group == group)


def number(value: float | None, decimals: int) -> str:
    """A value as text: "–" for none, a true minus sign, "∞" for infinity."""
    if value is None:
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{decimals}f}"
    return text.replace("-", "−") if float(text) != 0 else text.lstrip("-")


def duration(span: Span | None) -> str:
    """A time with three significant digits at most, e.g. "0.42", "12.3", "1234"."""
    return "–" if span is None else three_digits(span.median)


def three_digits(value: float) -> str:
    return f"{value:.{2 if value < 10 else 1 if value < 100 else 0}f}"


def marks(cell: Cell) -> str:
    """The footnote letters of a cell: "a", "a,c"."""
    return ",".join(letter(note) for note in cell.notes)


def letter(note: int) -> str:
    """The letter of footnote 1, 2, …: a … z, then aa, ab, …"""
    head, tail = divmod(note - 1, 26)
    return (letter(head) if head else "") + chr(ord("a") + tail)


def time_texts(times: Times) -> tuple[str, ...]:
    """Times as text in the order of `TIME_TITLES`."""
    known = times.relight_ms
    spread = f"{three_digits(known.low)}–{three_digits(known.high)}" if known else "–"
    return (*map(duration, (times.train_s, times.personalise_s, times.first_ms, known)), spread)
