"""The one table model that every report is made from: plain frozen values; `printed` says how they are written."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Literal

from handbench.results.record import MetricRecord
from handbench.results.statistics import Difference

from .cost import Footprint, MethodTimes

LIGHT_TITLES = {  # of what is timed, from the light that costs most to the one that costs least
    "environment": "an environment",
    "full": "the full stage",
    "group": "a group of lights",
    "olat": "a single light",
    "unknown": "the light as enrolled",
}
Kind = Literal["method", "calibration", "published"]


@dataclass(frozen=True)
class ColumnGroup:
    """A protocol column: a set of scored frames that answers one question. All metrics are shown under it.

    about   what it asks, and what its frames have in common with training, in a sentence
    """

    name: str
    title: str
    frames: int = 0
    subjects: int = 0
    about: str = ""

    @property
    def counted(self) -> str:
        """ "2 subjects, 28 frames"."""
        return f"{counted(self.subjects, 'subject')}, {counted(self.frames, 'frame')}"

    @property
    def draws(self) -> int:
        """The seed of the bootstrap: every method and metric gets the same draws."""
        return zlib.crc32(self.name.encode())


@dataclass(frozen=True)
class MetricColumn:
    group: ColumnGroup
    metric: MetricRecord


@dataclass(frozen=True)
class Aggregate:
    """One aggregate: `covered` of `expected` values are finite, and `value` is made of those alone.

    A published value has neither count, interval nor rank.
    spread      standard deviation of the values of single seeds; None with fewer than two seeds
    low, high   95 % interval; None with fewer than two frames
    rank        1 best, 2 second, 0 neither; shared by what cannot be told apart; never set with incomplete coverage
    claimed     its rank holds for other hands: the corrected paired test tells all that come after from it
    sunk        it is not better than the floor (the mean predictor), so it cannot win
    notes       numbers (from 1) of the table's footnotes that say why values are missing
    nonfinite   how many of the missing values were NaN or infinite
    unequal     its rank is won against rows to which enrolment gave something else
    across      its difference is to such a row
    difference  this value minus the baseline's, paired; None without a baseline, in its row, and where nothing pairs
    """

    value: float | None
    low: float | None
    high: float | None
    covered: int
    expected: int
    rank: int = 0
    notes: tuple[int, ...] = ()
    spread: float | None = None
    nonfinite: int = 0
    difference: Difference | None = None
    unequal: bool = False
    across: bool = False
    claimed: bool = False
    sunk: bool = False

    @property
    def complete(self) -> bool:
        return self.covered == self.expected


@dataclass(frozen=True)
class Row:
    """A method's line. Only kind "method" can be best: calibration and published rows are there for comparison.

    enrolment       what enrolment gave it (`handbench.bench.given.Enrolled`), "" where a run does not tell
    here            whether its answers were computed in the run, not read from a folder
    floor           a calibration row that every method must be better than
    footprint       what it takes of the machine beside time
    marker          how a paper marks the row, "" if not
    nonlinearity    greatest deviation from linearity in light (`handbench.results.laws`) in any cell; None if unknown
    """

    name: str
    title: str
    kind: Kind
    fidelity: str
    cells: tuple[Aggregate, ...]
    times: MethodTimes
    marker: str = ""
    nonlinearity: float | None = None
    enrolment: str = ""
    here: bool = True
    floor: bool = False
    footprint: Footprint = field(default_factory=Footprint)

    @property
    def suffix(self) -> str:
        """What tells in text that a row is no measured method."""
        if self.kind == "published":
            return f"{' ' * bool(self.marker)}{self.marker} (published)"
        return " *" if self.kind == "calibration" else ""


@dataclass(frozen=True)
class MethodPair:
    """Two methods whose order a paper published, named in that order, and their order here.

    Differences are how far `first` is ahead of `second`, whichever way the metric is better; low and high are the
    95 % interval of the measured one over subjects and frames, paired by frame and seed, None with fewer than two
    frames; spread is its standard deviation over seeds, None with fewer than two. unequal: enrolment gave the two, as
    they were measured, different things.
    """

    first: str
    second: str
    published: float
    measured: float
    low: float | None
    high: float | None
    spread: float | None
    unequal: bool = False

    @property
    def inverted(self) -> bool:
        """A tie on either side is no inversion."""
        return self.published > 0 > self.measured

    @property
    def separated(self) -> bool:
        """Whether the measured difference is told from none."""
        return self.low is not None and self.high is not None and (self.low > 0 or self.high < 0)


@dataclass(frozen=True)
class Agreement:
    """How a column's order of methods agrees with the published one: Kendall's tau-b, None if either side all ties."""

    column: MetricColumn
    methods: tuple[str, ...]
    tau: float | None
    pairs: tuple[MethodPair, ...]

    @property
    def inversions(self) -> tuple[MethodPair, ...]:
        return tuple(pair for pair in self.pairs if pair.inverted)


@dataclass(frozen=True)
class Table:
    """Rows of methods over columns (group by group); `row.cells` are in the order of `columns`.

    footnotes     why values are missing, by the numbers in `Aggregate.notes`
    remarks       what must be known of published rows, times and recorded pictures
    agreements    one for each column whose order is published
    baseline      title of the row that `Aggregate.difference` is against; "" if none was asked for
    limits        how those differences are made and what they cannot tell
    seeds         the seeds that values are averaged over
    """

    title: str
    columns: tuple[MetricColumn, ...]
    rows: tuple[Row, ...]
    footnotes: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    agreements: tuple[Agreement, ...] = ()
    baseline: str = ""
    limits: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)

    @property
    def trainings(self) -> str:
        """What intervals tell of: "these weights (one seed)", "3 seeds"."""
        return counted(len(self.seeds), "seed") if len(self.seeds) > 1 else "these weights (one seed)"

    @property
    def unclaimed(self) -> bool:
        """Whether something is marked that cannot be claimed for other hands."""
        return any(cell.rank and not cell.claimed for row in self.rows for cell in row.cells)

    @property
    def sunk(self) -> bool:
        """Whether some value is not better than the floor."""
        return any(cell.sunk for row in self.rows for cell in row.cells)

    @property
    def unequal(self) -> bool:
        """Whether something is compared across unequal enrolment."""
        pairs = (pair for agreement in self.agreements for pair in agreement.pairs)
        cells = (cell for row in self.rows for cell in row.cells)
        return any(pair.unequal for pair in pairs) or any(cell.unequal or cell.across for cell in cells)

    @property
    def compared(self) -> tuple[Row, ...]:
        """The rows that are compared with the baseline: all but the truth, which tells nothing of methods."""
        told = (row for row in self.rows if row.kind != "calibration" or row.floor)
        return tuple(row for row in told if any(cell.difference for cell in row.cells))

    @property
    def computed(self) -> tuple[Row, ...]:
        """The rows that this run made."""
        return tuple(row for row in self.rows if row.kind != "published")

    @property
    def timed_kind(self) -> str:
        """The kind of light whose times tables show: the first of `LIGHT_TITLES` that any row was timed under."""
        timed = {kind for row in self.computed for kind in (*row.times.new_pose_ms, *row.times.known_pose_ms)}
        return next((kind for kind in LIGHT_TITLES if kind in timed), "environment")

    @property
    def footprints(self) -> tuple[Row, ...]:
        """The rows whose memory, sizes or energy are told."""
        return tuple(row for row in self.computed if row.footprint.told)

    @property
    def groups(self) -> tuple[ColumnGroup, ...]:
        return tuple(dict.fromkeys(column.group for column in self.columns))

    @property
    def metrics(self) -> tuple[MetricRecord, ...]:
        return tuple(dict.fromkeys(column.metric for column in self.columns))

    def rows_of(self, group: ColumnGroup) -> tuple[Row, ...]:
        """The rows of a group's table: published ones that tell nothing of it are left out."""
        return tuple(row for row in self.rows if self.tells(row, group))

    def tells(self, row: Row, of: ColumnGroup | MetricRecord) -> bool:
        """Whether a row belongs into a table of a group or a metric: of published ones those with a value there."""
        there = (i for i, column in enumerate(self.columns) if of in (column.group, column.metric))
        return row.kind != "published" or any(row.cells[i].value is not None for i in there)

    def of_group(self, group: ColumnGroup) -> tuple[int, ...]:
        """The positions of a group's columns."""
        return tuple(i for i, column in enumerate(self.columns) if column.group == group)


def counted(count: int, noun: str) -> str:
    """ "1 frame", "28 frames"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}".replace(",", " ")
