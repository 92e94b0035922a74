"""The finished cells of a run with a line for each value, as tests look at them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from handbench.results.reading import read_run
from handbench.results.record import CellRecord
from handbench.results.schema import plain


def flat_cells(folder: Path) -> list[dict[str, Any]]:
    """In the order of the plan."""
    return [{**plain(cell), "scores": flat_scores(cell)} for cell in read_run(folder).cells]


def flat_scores(cell: CellRecord) -> list[dict[str, Any]]:
    return [
        {**place, "metric": signature, "value": value, "reason": reason}
        for frame, signature, value, reason in cell.each()
        for place in [{"column": frame.column, "query": frame.query, "kind": frame.kind}]
    ]
