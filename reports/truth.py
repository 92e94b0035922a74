"""What a run keeps of its images; the oracle's answers are the truth, so a report needs no capture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from handbench.data.exr import read_exr, stack
from handbench.errors import InputError
from handbench.scene import Array

from .run import Run

Truth: TypeAlias = Callable[[str], tuple[Array, Array] | None]


def prediction(run: Run, cell: dict[str, Any], query: str) -> tuple[Array, Array]:
    """A stored answer: image (H, W, 3), linear, and alpha (H, W). Raises `InputError` if missing or damaged."""
    path = run.folder / cell["predictions"] / f"{query.replace('/', '__')}.exr"
    channels = read_exr(path)
    return stack(channels, ("R", "G", "B"), path), stack(channels, ("A",), path)[..., 0]


def truth_of(run: Run) -> Truth:
    """A function from a query's key to its true image and alpha, or to None if the run has no oracle's answer to it.

    An answer that is lost or damaged is none: a report is about what there is.
    """
    truths = [info["name"] for info in run.plan["methods"] if info["truth"]]
    cells = {
        score["query"]: cell
        for name in truths
        for cell in run.of_method(name)
        for score in cell["scores"]
        if score["value"] is not None
    }

    def truth(query: str) -> tuple[Array, Array] | None:
        if query not in cells or cells[query]["predictions"] is None:
            return None
        try:
            return prediction(run, cells[query], query)
        except InputError:
            return None

    return truth
