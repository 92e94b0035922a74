"""What a run keeps of its images; the oracle's answers are the truth, so a report needs no capture."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from handbench.errors import Damaged, InputError
from handbench.scene import Array

from .run import Run

Truth: TypeAlias = Callable[[str], tuple[Array, Array] | None]


def truth_of(run: Run) -> Truth:
    """A function from a query's key to its true image and alpha, or to None if the run has no oracle's answer to it.

    An answer that is lost or no picture is none: a report is about what there is. The function raises `Damaged` for one
    that is not what was written.
    """
    truths = [method.name for method in run.plan.methods if method.truth]
    cells = {query: cell for name in truths for cell in run.of_method(name) for query in cell.predictions}

    def truth(query: str) -> tuple[Array, Array] | None:
        if query not in cells:
            return None
        try:
            picture = run.read_prediction(cells[query], query)
        except Damaged:
            raise
        except InputError:
            return None
        return picture.image, picture.alpha

    return truth
