"""The two calibration rows: nothing is above the oracle, and who is below the mean predictor is named."""

from __future__ import annotations

import math
from typing import Any

from .evidence import Evidence
from .records import verdict_on

_EXACT = 1e-9  # of a perfect value: metrics of equal pictures have no rounding to speak of


def oracle(evidence: Evidence) -> tuple[bool | None, str]:
    """Every score of a method that is given the truth is the metric's perfect value."""
    truths = {method.name for method in evidence.plan.methods if method.truth}
    if not truths:
        return None, "the run has no oracle; run it with the method oracle as well"
    trouble, count, without = [], 0, set()
    for cell in evidence.cells:
        if cell.method.name not in truths:
            continue
        for frame, signature, value, reason in cell.each():
            metric = evidence.metrics[signature]
            if metric.perfect is None:
                without.add(metric.title)
            elif value is None or not math.isclose(value, metric.perfect, rel_tol=_EXACT, abs_tol=_EXACT):
                got = reason if value is None else f"{value:g}"
                trouble.append(f"{cell.label}: {metric.title} of {frame.query} is {got}, perfect is {metric.perfect:g}")
            else:
                count += 1
    note = f"; without a perfect value: {', '.join(sorted(without))}" if without else ""
    return verdict_on(trouble, f"{count} scores, all perfect{note}")


def floor(evidence: Evidence) -> tuple[bool | None, str]:
    """The floor covers every query, some method is above it, and every method that is below it somewhere is named."""
    floors = {method.name for method in evidence.plan.methods if method.calibration and not method.truth}
    rows = [row for row in evidence.table.rows if row.kind != "published"]
    lowest = next((row for row in rows if row.name in floors), None)
    methods = [row for row in rows if row.kind == "method"]
    if lowest is None:
        return None, "the run has no mean predictor; run it with the method mean as well"
    columns = evidence.table.columns
    # a row that gives a picture and no more has no geometry to be scored
    scored = [i for i in range(len(columns)) if lowest.cells[i].covered]
    part = [columns[i] for i in scored if not lowest.cells[i].complete]
    if part or not scored:
        return False, f"{lowest.title} misses queries, e.g. in {_column(part[0]) if part else 'every column'}"
    below = {
        row.title: [columns[i] for i in scored if _worse(columns[i], row.cells[i], lowest.cells[i])] for row in methods
    }
    if methods and all(len(columns) == len(scored) for columns in below.values()):
        return False, f"no method is above {lowest.title} anywhere"
    told_below = [f"{title} in {_several(found)}" for title, found in below.items() if found]
    if not told_below:
        return True, f"{len(methods)} methods are above {lowest.title} in all {len(scored)} columns"
    return True, f"below {lowest.title}: {'; '.join(told_below)}"


def _worse(column: Any, cell: Any, lowest: Any) -> bool:
    if cell.value is None:
        return False
    return bool(cell.value < lowest.value if column.metric.higher_is_better else cell.value > lowest.value)


def _several(columns: list[Any]) -> str:
    first = ", ".join(_column(column) for column in columns[:3])
    return first + (f" and {len(columns) - 3} more" if len(columns) > 3 else "")


def _column(column: Any) -> str:
    return f"{column.group.name} ({column.metric.title})"
