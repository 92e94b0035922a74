"""Does a run order the methods as a paper does? Kendall's tau of each column, with every inversion by name."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from typing import Any, TypeAlias

from scipy.stats import kendalltau

from .aggregate import interval, seed_spread
from .model import Agreement, Column, Pair, Row, number
from .run import Run

LEAST = 3  # methods whose order is compared: two agree or not by chance
Scores: TypeAlias = dict[tuple[int, str, str], float]  # (seed, subject, query) to value


def agreements(run: Run, columns: tuple[Column, ...], rows: tuple[Row, ...]) -> Iterator[Agreement]:
    """For each column whose order of at least `LEAST` methods is both published and measured on every frame."""
    for index, column in enumerate(columns):
        published = {r.name: r.cells[index].value for r in rows if r.kind == "published"}
        both = [
            row
            for row in rows
            if row.kind == "method" and row.cells[index].complete and published.get(row.name) is not None
        ]
        if len(both) >= LEAST:
            told = [float(published[row.name] or 0.0) for row in both]
            found = [float(row.cells[index].value or 0.0) for row in both]
            scores = [_scores(run, row.name, column) for row in both]
            pairs = (_pair(column, i, j, both, told, found, scores) for i, j in combinations(range(len(both)), 2))
            yield Agreement(column, tuple(row.title for row in both), tau_b(told, found), tuple(pairs))


def tau_b(published: list[float], measured: list[float]) -> float | None:
    """Kendall's tau-b, which allows for ties; None if either side has no order at all."""
    tau = float(kendalltau(published, measured, variant="b").statistic)
    return None if math.isnan(tau) else tau


def headline(agreement: Agreement) -> str:
    """ "Unseen segment, PSNR: Kendall τ 0.64 over 11 methods, 3 of 55 pairs inverted"."""
    column, inverted = agreement.column, len(agreement.inversions)
    pairs = f"{inverted} of {len(agreement.pairs)} pairs inverted" if inverted else "no pair inverted"
    over = f"Kendall τ {number(agreement.tau, 2)} over {len(agreement.methods)} methods, {pairs}"
    return f"{column.group.title}, {column.metric.title}: {over}"


def sentence(pair: Pair, column: Column) -> str:
    """What was published of two methods, what was measured, and whether that can be told from no difference."""
    metric = column.metric
    digits = metric.decimals

    def amount(value: float) -> str:
        return f"{number(abs(value), digits)} {metric.unit}".strip()

    text = f"{pair.first} over {pair.second}: published ahead by {amount(pair.published)}, "
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


def _scores(run: Run, method: str, column: Column) -> Scores:
    return {
        (cell["seed"], cell["subject"], score["query"]): score["value"]
        for cell in run.of_method(method)
        for score in cell["scores"]
        if (score["column"], score["metric"]) == (column.group.name, column.metric.signature)
    }


def _pair(
    column: Column, i: int, j: int, rows: list[Row], told: list[float], found: list[float], scores: list[Scores]
) -> Pair:
    better = 1.0 if column.metric.higher_is_better else -1.0
    if better * (told[i] - told[j]) < 0:
        i, j = j, i
    ahead: dict[int, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for seed, subject, query in sorted(scores[i]):
        ahead[seed][subject].append(better * (scores[i][seed, subject, query] - scores[j][seed, subject, query]))
    low, high = interval(ahead, column.draws) or (None, None)
    published, measured = (better * (values[i] - values[j]) for values in (told, found))
    return Pair(rows[i].title, rows[j].title, published, measured, low, high, seed_spread(ahead))
