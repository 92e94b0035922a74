"""The cells of one protocol column: what is averaged, its interval, what may win, and differences to a baseline."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handbench.results.oldrecord import NOT_FINITE
from handbench.results.statistics import (
    CONFIDENCE,
    RESAMPLES,
    aggregate,
    bootstrap,
    corrected,
    differences,
    holm,
    interval,
    p_values,
    seed_spread,
)
from handbench.results.values import Values
from handbench.scene import Array

from .model import Aggregate, MetricColumn

_COUNT = re.compile(r"(?<![\w.])\d{1,9}(?![\w.])")  # "3" in "3 values", nothing in "s01" and "0.5"
_NOTHING = re.compile(r"(?!)")

__all__ = ["RESAMPLES", "Footnotes", "column_cells", "with_differences"]


class Footnotes:
    """Why values are missing, numbered from 1. Reasons that differ in a number only share one, which tells its range.

    A method that diverges leaves another count of NaN in every image; that is one reason, not a hundred.
    """

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, ...], int] = {}
        self._ranges: dict[int, list[tuple[int, int]]] = {}

    def number(self, reason: str) -> int:
        counts = _COUNT if reason.startswith("non-finite") else _NOTHING
        words = tuple(counts.split(reason))
        found = [int(digits) for digits in counts.findall(reason)]
        note = self._numbers.setdefault(words, len(self._numbers) + 1)
        before = self._ranges.get(note, [(value, value) for value in found])
        ranges = [(min(low, value), max(high, value)) for (low, high), value in zip(before, found, strict=True)]
        self._ranges[note] = ranges
        return note

    def texts(self) -> tuple[str, ...]:
        return tuple(self._text(words, self._ranges[note]) for words, note in self._numbers.items())

    def _text(self, words: tuple[str, ...], ranges: list[tuple[int, int]]) -> str:
        told = [str(low) if low == high else f"{low} to {high}" for low, high in ranges]
        return "".join(part for pair in zip(words, (*told, ""), strict=True) for part in pair)


@dataclass(frozen=True)
class _Scored:
    """The bootstrap draws (metrics, seeds, RESAMPLES) of a row, over the frames it has."""

    values: Values
    draws: Array


def column_cells(
    rows: Sequence[Values],
    columns: Sequence[MetricColumn],
    competing: Sequence[bool],
    notes: Footnotes,
    floors: Sequence[int] = (),
) -> list[list[Aggregate]]:
    """The cells of each row in the columns of one group, ranked among the `competing` rows.

    `floors` are the positions of rows that a method must be better than: what is not, cannot win.
    """
    metrics, _, frames = rows[0].values.shape
    flat = [row.values.reshape(-1, frames) for row in rows]
    draws = np.split(
        bootstrap(np.concatenate(flat), rows[0].subjects, columns[0].group.draws),
        np.cumsum([len(each) for each in flat])[:-1],
    )
    scored = [_Scored(row, drawn.reshape(metrics, -1, RESAMPLES)) for row, drawn in zip(rows, draws, strict=True)]
    cells = [[_cell(each, i, columns[i], notes) for i in range(metrics)] for each in scored]
    for i, column in enumerate(columns):
        floor = [value for position in floors if (value := cells[position][i].value) is not None]
        for row, may_win in zip(cells, competing, strict=True):
            sunk = may_win and (value := row[i].value) is not None and any(not _better(value, f, column) for f in floor)
            row[i] = replace(row[i], sunk=sunk)
        order = _order([row[i] for row in cells], competing, column)
        ranks = _ranks(order, [row[i] for row in cells], [each.draws[i] for each in scored], rows[0].subjects, column)
        claimed = _claimed(order, ranks, [row.values[i] for row in rows], rows[0].subjects, column)
        for position, rank in ranks.items():
            cells[position][i] = replace(cells[position][i], rank=rank, claimed=rank in claimed)
    return cells


def _cell(scored: _Scored, metric: int, column: MetricColumn, notes: Footnotes) -> Aggregate:
    values, subjects = scored.values.values[metric], scored.values.subjects
    reasons = scored.values.reasons[metric]
    told = tuple(sorted({notes.number(reason) for reason in reasons}))
    nonfinite = sum(count for reason, count in reasons.items() if reason.startswith(("non-finite", NOT_FINITE)))
    present = np.isfinite(values)
    covered = int(present.sum())
    used = subjects[present.any(axis=0)]
    bounds = interval(scored.draws[metric], used, column.group.draws) if covered else None
    low, high = bounds or (None, None)
    return Aggregate(
        aggregate(values, subjects),
        low,
        high,
        covered,
        values.size,
        notes=told,
        spread=seed_spread(values, subjects),
        nonfinite=nonfinite,
    )


def _better(value: float, other: float, column: MetricColumn) -> bool:
    """Whether a value is better than another by what is printed."""
    decimals = column.metric.decimals
    apart = round(value, decimals) - round(other, decimals)
    return apart > 0 if column.metric.higher_is_better else apart < 0


def _order(cells: Sequence[Aggregate], competing: Sequence[bool], column: MetricColumn) -> list[int]:
    """The positions of what may win, best first: of complete coverage and above the floor."""
    values = {
        position: cell.value
        for position, (cell, may_win) in enumerate(zip(cells, competing, strict=True))
        if may_win and cell.complete and not cell.sunk and cell.value is not None
    }
    return sorted(values, key=lambda position: values[position], reverse=column.metric.higher_is_better)


def _ranks(
    order: Sequence[int], cells: Sequence[Aggregate], draws: Sequence[Array], subjects: Array, column: MetricColumn
) -> dict[int, int]:
    """The best (1) and the second (2) of rows by position, and whoever cannot be told from one of them.

    Going down from the best, rows share its mark as long as their values print alike or the interval of their paired
    difference includes zero; the second is the best of the others. What follows a row that is told apart shares none.
    """
    left = list(order)
    found: dict[int, int] = {}
    for rank in (1, 2):
        for position in left:
            bounds = interval(_between(draws[left[0]], draws[position]), subjects, column.group.draws)
            first, value = cells[left[0]].value, cells[position].value
            alike = first is not None and value is not None and not _better(first, value, column)
            if not (alike or (bounds is not None and bounds[0] <= 0 <= bounds[1])):
                break
            found[position] = rank
        left = [position for position in left if position not in found]
    return found


def _between(first: Array, second: Array) -> Array:
    """The draws of a paired difference, seed by seed; with unequal numbers of seeds that of the means."""
    if len(first) != len(second):
        first, second = (draws.mean(axis=0, keepdims=True) for draws in (first, second))
    return first - second


def _claimed(
    order: Sequence[int], ranks: dict[int, int], values: Sequence[Array], subjects: Array, column: MetricColumn
) -> set[int]:
    """The ranks that hold for other hands too: whoever comes after is told apart by the corrected paired test."""
    found = set()
    for rank in (1, 2):
        left = [position for position in order if ranks.get(position, 3) >= rank]
        later = [ranks.get(position, 3) > rank for position in left[1:]]
        if any(later):
            pairs = [(values[left[0]], values[position]) for position in left[1:]]
            adjusted = holm(p_values(pairs, subjects, column.group.draws))
            if all(p <= 1 - CONFIDENCE + 1e-9 for p, after in zip(adjusted, later, strict=True) if after):
                found.add(rank)
    return found


def with_differences(
    cells: list[list[Aggregate]],
    rows: Sequence[Values],
    baseline: int,
    columns: Sequence[MetricColumn],
    family: Sequence[bool],
) -> list[list[Aggregate]]:
    """The cells with their paired differences to the row `baseline`, p-values corrected over the `family`."""
    found = [list(row) for row in cells]
    others = [position for position in range(len(rows)) if position != baseline]
    for i, column in enumerate(columns):
        pairs = [(rows[position].values[i], rows[baseline].values[i]) for position in others]
        apart = differences(pairs, rows[baseline].subjects, column.group.draws)
        for position, each in zip(others, corrected(apart, [family[position] for position in others]), strict=True):
            found[position][i] = replace(found[position][i], difference=each)
    return found
