"""The values of a run as arrays: one array for each method and column, with why values are missing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ..scene import Array
from .reading import Run

NOT_COMPUTED = "not computed: the run was stopped or the cell failed"


@dataclass(frozen=True)
class Values:
    """The values of one method in one protocol column.

    values      (metrics, seeds, frames), NaN where there is none, in the order of the plan
    subjects    (frames,) whole numbers
    reasons     of each metric: why values are missing, and how many
    """

    values: Array
    subjects: Array
    reasons: tuple[dict[str, int], ...]


def values_of(run: Run) -> dict[tuple[str, str], Values]:
    """All values of a run by (method, column)."""
    protocol = run.plan.protocol
    metrics = {metric.signature: i for i, metric in enumerate(protocol.metrics)}
    seeds = {m.name: {seed: i for i, seed in enumerate(run.plan.seeds_for(m.name))} for m in run.plan.methods}
    found: dict[tuple[str, str], Values] = {}
    frames: dict[str, dict[str, int]] = {}
    for column in protocol.columns:
        queries = frames[column.name] = {query: i for i, query in enumerate(column.queries)}
        owners = [query.partition("/")[0] for query in queries]
        subjects = np.unique(owners, return_inverse=True)[1]
        for method in run.plan.methods:
            values = np.full((len(metrics), len(seeds[method.name]), len(queries)), np.nan)
            found[method.name, column.name] = Values(values, subjects, tuple(Counter() for _ in metrics))
    seen = {key: np.zeros(values.values.shape, dtype=bool) for key, values in found.items()}
    for cell in run.in_order:
        seed = seeds.get(cell.method.name, {}).get(cell.seed)
        places = [(i, metrics[signature]) for i, signature in enumerate(cell.metrics) if signature in metrics]
        for frame in sorted(cell.scores, key=lambda frame: frame.query):
            key = cell.method.name, frame.column
            query = frames.get(frame.column, {}).get(frame.query)
            if seed is None or query is None or key not in found:
                continue
            for i, metric in places:
                seen[key][metric, seed, query] = True
                value = frame.values[i]
                if value is None:
                    found[key].reasons[metric][frame.reasons[i] or ""] += 1
                else:
                    found[key].values[metric, seed, query] = value
    for key, there in seen.items():
        for reasons, count in zip(found[key].reasons, (~there).sum(axis=(1, 2)).tolist(), strict=True):
            if count:
                reasons[NOT_COMPUTED] = count
    return found
