"""The data of the page's breakdown: every scored frame's values by row, means over seeds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from handbench.results.values import values_of
from handbench.scene import Array

from .conclusion import leader
from .frames import KINDS
from .model import Table
from .run import Run


def scores(run: Run, table: Table) -> dict[str, Any]:
    """As the page's script reads it: `values[row][metric]` of each column are in the order of its frames.

    A frame is (query, kind of light); None is a missing value. `best` is the row that the conclusion is about, or the
    last. Published rows have no frames.
    """
    values, kinds, rows = values_of(run), _kinds(run), table.computed
    queries = list(dict.fromkeys(query for column in run.plan.protocol.columns for query in column.queries))
    places = {query: place for place, query in enumerate(queries)}
    best = leader(table)
    return {
        "metrics": [
            {"name": m.name, "title": m.title, "unit": m.unit, "higher": m.higher_is_better, "decimals": m.decimals}
            for m in table.metrics
        ],
        "rows": [{"name": row.name, "title": row.title, "kind": row.kind} for row in rows],
        "best": rows.index(best) if best in rows else len(rows) - 1,
        "kinds": KINDS,
        "frames": [[query, kinds.get(query, "")] for query in queries],
        "columns": [
            {
                "name": column.name,
                "title": column.title,
                "frames": [places[query] for query in column.queries],
                "values": [list(_rounded(values[row.name, column.name].values, table)) for row in rows],
            }
            for column in run.plan.protocol.columns
        ],
    }


def _kinds(run: Run) -> dict[str, str]:
    return {frame.query: frame.kind for cell in run.cells for frame in cell.scores}


def _rounded(values: Array, table: Table) -> Iterator[list[float | None]]:
    """(metrics, seeds, frames) to a list for each metric: means over the seeds that have a value."""
    there = np.isfinite(values)
    count = there.sum(axis=1)
    sums = np.where(there, values, 0.0).sum(axis=1)
    for metric, total, number in zip(table.metrics, sums, count, strict=True):
        means = (t / n if n else None for t, n in zip(total.tolist(), number.tolist(), strict=True))
        yield [None if mean is None else _short(mean, metric.decimals) for mean in means]


def _short(mean: float, decimals: int) -> float:
    """With a digit more than is printed, so that differences are right; whole where that is a 5, not to round twice."""
    short = round(mean, decimals + 1)
    return mean if f"{short:.{decimals + 1}f}".endswith("5") else short
