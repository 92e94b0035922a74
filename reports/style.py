"""How a table is written: what stands beside a value, how wide it may be, and what a paper calls it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from handbench.errors import InputError

from .model import MetricColumn, Table

ARTICLE = 4.79  # inches: the text of LaTeX's plain article class
BOTH_COLUMNS = 6.75  # of both columns of a two-column class
_LABEL = re.compile(r"[A-Za-z0-9:._/-]{1,80}")
_MOST_DECIMALS = 8


@dataclass(frozen=True)
class Style:
    """None leaves the choice to the format.

    intervals   whether a value has its 95 % interval beside it
    seeds       whether it has the standard deviation over seeds
    times       whether costs are shown
    decimals    of every metric, instead of each metric's own
    wide        a float over both columns of a two-column class
    width       inches that a table may be wide; columns that do not fit go below
    label       for references to the float
    caption     instead of the protocol's title
    """

    intervals: bool | None = None
    seeds: bool | None = None
    times: bool | None = None
    decimals: int | None = None
    wide: bool = False
    width: float | None = None
    label: str = ""
    caption: str = ""

    def __post_init__(self) -> None:
        if self.label and not _LABEL.fullmatch(self.label):
            raise InputError(f"label {self.label!r} cannot be one; use letters, digits and : . _ / -, as in tab:main")
        if self.decimals is not None and not 0 <= self.decimals <= _MOST_DECIMALS:
            raise InputError(f"decimals {self.decimals} cannot be printed; give 0 to {_MOST_DECIMALS}")
        if self.width is not None and not 1.0 <= self.width <= 100.0:
            raise InputError(f"width {self.width:g} in is no width of a table; give 1 to 100 inches")

    @property
    def inches(self) -> float:
        return self.width or (BOTH_COLUMNS if self.wide else ARTICLE)

    def rounded(self, table: Table) -> Table:
        """The table with the decimals that are asked for."""
        if self.decimals is None:
            return table
        columns = tuple(_rounded(column, self.decimals) for column in table.columns)
        return replace(table, columns=columns)


PLAIN = Style()


def _rounded(column: MetricColumn, decimals: int) -> MetricColumn:
    return replace(column, metric=replace(column.metric, decimals=decimals))
