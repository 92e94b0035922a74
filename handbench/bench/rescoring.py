"""Cells whose pictures are kept already, of a plan that asked for other metrics: scored, nothing trained or drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ..errors import HandbenchError
from ..results.record import CellRecord
from ..scene import Frame, Prediction
from .cell import CHUNK, Bench, CellMeasurement
from .failure import Failure
from .plan import Cell
from .scoring import Scoring

REMARK = "After a change of metrics, kept pictures (half floats) were scored again."


def rescored(bench: Bench, cell: Cell, kept: CellRecord) -> CellMeasurement | None:
    """The cell's scores by the pictures that an earlier cell kept of the same frames, with what that one measured.

    None where they are not whole: the cell is computed.
    """
    scored = bench.scored(cell.subject)
    frames = list({frame.key: frame for _, frame in scored}.values())
    scoring = Scoring(bench.reader, bench.metrics, bench.selected.without_truth)
    reasons = {frame.query: next(filter(None, frame.reasons), None) for frame in kept.scores}
    for frame in frames:
        if frame.key not in kept.predictions:
            if (reason := reasons.get(frame.key)) is None:
                return None
            scoring.missing(frame, Failure(reason, None))
    try:
        drawn = [frame for frame in frames if frame.key in kept.predictions]
        for begin in range(0, len(drawn), CHUNK):
            scoring.score(list(_pictures(bench, kept, drawn[begin : begin + CHUNK])))
        bench.store.share_pictures(kept, cell.key)
    except (HandbenchError, OSError):  # damaged or gone
        return None
    return CellMeasurement(
        scores=scoring.frames(scored),
        times=replace(kept.times, score_s=scoring.seconds),
        predictions=kept.predictions,
        same_pixels=kept.same_pixels,
        error=scoring.trace,
        laws=kept.laws,
        skipped=kept.skipped,
        curve=kept.curve,
        remarks=(*scoring.remarks(cell.subject), REMARK),
        cost=kept.cost,
    )


def _pictures(bench: Bench, kept: CellRecord, frames: Sequence[Frame]) -> Iterator[tuple[Frame, Prediction]]:
    for frame in frames:
        yield frame, bench.store.read_prediction(kept, frame.key)
