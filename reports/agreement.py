"""Does a run order the methods as a paper does? Kendall's tau of each column, with every inversion by name."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

from handbench.results.statistics import differences
from handbench.results.values import Values

from .model import Agreement, MethodPair, MetricColumn, Row
from .printed import UNEQUAL, number

LEAST = 3  # methods whose order is compared: two agree or not by chance


def agreements(
    columns: Sequence[MetricColumn],
    rows: Sequence[Row],
    values: Sequence[dict[str, Values]],
    published: Sequence[Row],
) -> Iterator[Agreement]:
    """For each column whose order of at least `LEAST` methods is both published and measured on every frame.

    `values`: of each measured row by protocol column.
    """
    for index, column in enumerate(columns):
        known = {row.name: row.cells[index].value for row in published}
        both = [
            (row, values[position][column.group.name])
            for position, row in enumerate(rows)
            if row.kind == "method" and row.cells[index].complete and known.get(row.name) is not None
        ]
        if len(both) >= LEAST:
            metric = index - columns.index(next(c for c in columns if c.group == column.group))
            told = [float(known[row.name] or 0.0) for row, _ in both]
            found = [float(row.cells[index].value or 0.0) for row, _ in both]
            yield Agreement(
                column,
                tuple(row.title for row, _ in both),
                tau_b(told, found),
                tuple(_pairs(column, metric, both, told)),
            )


def tau_b(published: list[float], measured: list[float]) -> float | None:
    """Kendall's tau-b, which allows for ties; None if either side has no order at all."""
    from scipy.stats import kendalltau  # half a second, which a table without published rows does without

    tau = float(kendalltau(published, measured, variant="b").statistic)
    return None if math.isnan(tau) else tau


def headline(agreement: Agreement) -> str:
    """ "Unseen segment, PSNR: Kendall τ 0.64 over 11 methods, 3 of 55 pairs inverted"."""
    column, inverted = agreement.column, len(agreement.inversions)
    pairs = f"{inverted} of {len(agreement.pairs)} pairs inverted" if inverted else "no pair inverted"
    over = f"Kendall τ {number(agreement.tau, 2)} over {len(agreement.methods)} methods, {pairs}"
    if unequal := sum(pair.unequal for pair in agreement.pairs):
        over += f"; {unequal} pairs across unequal enrolment {UNEQUAL}"
    return f"{column.group.title}, {column.metric.title}: {over}"


def sentence(pair: MethodPair, column: MetricColumn) -> str:
    """What was published of two methods, what was measured, and whether that can be told from no difference."""
    metric = column.metric
    digits = metric.decimals

    def amount(value: float) -> str:
        return f"{number(abs(value), digits)} {metric.unit}".strip()

    both = f"{pair.first} over {pair.second}{f' {UNEQUAL}' if pair.unequal else ''}"
    text = f"{both}: published ahead by {amount(pair.published)}, "
    text += f"measured behind by {amount(pair.measured)}"
    if pair.low is None or pair.high is None:
        return text
    bounds = f"{number(-pair.high, digits)} to {number(-pair.low, digits)}"
    seeds = "" if pair.spread is None else f", ±{number(pair.spread, digits)} over seeds"
    return f"{text} ({bounds}{seeds}: {'separated' if pair.separated else 'not separated'})"


def as_json(agreement: Agreement) -> dict[str, Any]:
    """An agreement with all its pairs as JSON values."""
    column = agreement.column
    pairs = [{**vars(pair), "inverted": pair.inverted, "separated": pair.separated} for pair in agreement.pairs]
    return {
        "column": column.group.name,
        "metric": column.metric.signature,
        "methods": list(agreement.methods),
        "tau_b": agreement.tau,
        "pairs": pairs,
    }


def _pairs(
    column: MetricColumn, metric: int, both: list[tuple[Row, Values]], told: list[float]
) -> Iterator[MethodPair]:
    """All pairs, the one that is published as better first."""
    better = 1.0 if column.metric.higher_is_better else -1.0
    order = [(i, j) if better * (told[i] - told[j]) >= 0 else (j, i) for i, j in combinations(range(len(both)), 2)]
    scores = [better * values.values[metric] for _, values in both]
    pairs = [(scores[i], scores[j]) for i, j in order]
    for (i, j), apart in zip(
        order, differences(pairs, both[0][1].subjects, column.group.draws, tested=False), strict=True
    ):
        if apart:
            published = better * (told[i] - told[j])
            first, second = both[i][0], both[j][0]
            unequal = first.enrolment != second.enrolment
            found = (apart.value, apart.low, apart.high, apart.spread)
            yield MethodPair(first.title, second.title, published, *found, unequal)
