"""Nothing depends on order: not a score on its image's company, not a table on the order of its shards."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...bench.store import Store
from .evidence import Evidence, scored_queries
from .records import verdict_on

_PAIRS = 12  # pictures that are scored in several orders
_Item = TypeVar("_Item")
_EQUAL = 1e-5  # what a score may change by if pictures are scored in batches


def images(evidence: Evidence) -> tuple[bool | None, str]:
    """Scores of pictures are the same one by one, all at once, and shuffled in parts."""
    rng = np.random.default_rng(31)
    kept = [(cell, key) for cell in evidence.cells if cell.predictions for key in scored_queries(cell)]
    chosen = [kept[i] for i in rng.permutation(len(kept))[:_PAIRS]]
    if len(chosen) < 2:
        return None, "there are no two kept pictures"
    pairs = [evidence.pair(evidence.frames[key], evidence.kept(cell, key)) for cell, key in chosen]
    trouble, worst = [], 0.0
    shuffled = rng.permutation(len(pairs))
    parts = np.array_split(shuffled, 3)
    for metric in evidence.metrics.values():
        alone = [metric([pair])[0] for pair in pairs]
        together = metric(pairs)
        mixed = {int(i): s for part in parts for i, s in zip(part, metric([pairs[i] for i in part]), strict=True)}
        for i, score in enumerate(alone):
            for other in (together[i], mixed[i]):
                if score.value is None or other.value is None:
                    same = score.value is other.value and score.reason == other.reason
                    apart = 0.0 if same else float("inf")
                else:
                    apart = abs(score.value - other.value)
                worst = max(worst, apart)
                if apart > _EQUAL:
                    trouble.append(f"{metric.title} of {chosen[i][1]} changes by {apart:.1e} with its company")
    scores = len(pairs) * len(evidence.metrics)
    return verdict_on(trouble, f"{scores} scores alone, together and shuffled differ by at most {worst:.1e}")


def shards(evidence: Evidence) -> tuple[bool, str]:
    """The table of the cells and of their scores in another order is the same table."""
    rng = np.random.default_rng(37)
    with tempfile.TemporaryDirectory() as place:
        shuffled = Store(Path(place))
        shuffled.write_run(replace(evidence.plan, cells=_shuffled(evidence.plan.cells, rng)))
        for cell in _shuffled(evidence.cells, rng):
            shuffled.write_cell(replace(cell, scores=_shuffled(cell.scores, rng)))
        other = evidence.tables(shuffled.folder)
    if other == evidence.table:
        return True, f"{len(evidence.cells)} cells and their scores shuffled give the same table"
    rows = [a.title for a, b in zip(evidence.table.rows, other.rows, strict=True) if a != b]
    return False, f"shuffled cells give another table, e.g. for {rows[0] if rows else 'its remarks'}"


def _shuffled(items: tuple[_Item, ...], rng: np.random.Generator) -> tuple[_Item, ...]:
    return tuple(items[i] for i in rng.permutation(len(items)))
