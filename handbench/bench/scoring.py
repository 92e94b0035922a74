"""Pictures beside the truth: the values of a cell's frames, or why there are none."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data.inspection import SKIN, median_of_hand
from ..errors import BadFrame, InputError
from ..results.measured import ScoredFrame
from ..results.oldrecord import NOT_FINITE
from ..scene import Frame, Prediction
from .failure import Failure, failure
from .reader import CaptureReader

if TYPE_CHECKING:
    from ..metrics import Metric, Pair

SHOWN = "there is no picture of the truth under this map: shown, not scored"
"""Why frames under maps of the user's have no values."""


class Scoring:
    """Scores pictures, a few at a time; those whose keys are in `shown` have no truth, so they are not scored.

    trace       the traceback of the first failure that is to be mended, None if there is none
    seconds     of everything that was scored
    """

    def __init__(
        self, reader: CaptureReader, metrics: Mapping[str, Metric], shown: frozenset[str] = frozenset()
    ) -> None:
        from ..metrics import Recent

        self._reader, self._metrics, self._shown = reader, metrics, shown
        self._with_mesh = any("truth_mesh" in metric.needs for metric in metrics.values())
        self._found: dict[str, list[tuple[float | None, str | None]]] = {}
        self._medians: dict[str, float] = {}
        self._recent = Recent()
        self.trace: str | None = None
        self.seconds = 0.0

    def missing(self, frame: Frame, failed: Failure) -> None:
        """A frame without a picture."""
        self.trace = self.trace or failed.trace
        self._found[frame.key] = [(None, failed.reason)] * len(self._metrics)

    def score(self, drawn: Iterable[tuple[Frame, Prediction]]) -> None:
        """Score pictures. One with NaN or infinity, and a frame that cannot be read, get no value, and the reason."""
        from ..metrics import scores

        start = time.perf_counter()
        sound = [(frame, pair) for frame, picture in drawn if (pair := self._pair(frame, picture)) is not None]
        rows = scores(list(self._metrics.values()), [pair for _, pair in sound], self._recent)
        for (frame, _), row in zip(sound, rows, strict=True):
            self._found[frame.key] = [_value(score.value, score.reason) for score in row]
            self.trace = self.trace or next((score.trace for score in row if score.trace), None)
        self.seconds += time.perf_counter() - start

    def _pair(self, frame: Frame, picture: Prediction) -> Pair | None:
        """Picture and truth for metrics; None if there is nothing to score."""
        from ..metrics import Pair

        bad = int(np.count_nonzero(~np.isfinite(picture.image)) + np.count_nonzero(~np.isfinite(picture.alpha)))
        if bad:
            self.missing(frame, Failure(f"non-finite: {bad} values of the prediction are NaN or infinite", None))
            return None
        if frame.key in self._shown:
            self.missing(frame, Failure(SHOWN, None))
            return None
        try:
            truth = self._reader(frame)
            if truth.alpha is None:
                raise BadFrame(f"{frame.key}: it has no alpha, so no mask to score in")
        except BadFrame as error:
            self.missing(frame, failure(error))
            return None
        if (median := median_of_hand(truth)) is not None:
            self._medians[frame.key] = median
        mesh = self._reader.surface(frame) if self._with_mesh else None  # the true one may have to be worked out
        try:
            return Pair.of(picture, truth, mesh)
        except InputError as error:  # of a picture that does not fit its truth, which is its method's fault
            self.missing(frame, failure(error))
            return None

    def frames(self, scored: Sequence[tuple[str, Frame]]) -> tuple[ScoredFrame, ...]:
        """The frames of columns with their values; each was scored, or is missing."""
        return tuple(_scored(column, frame, self._found[frame.key]) for column, frame in scored)

    def remarks(self, subject: str) -> tuple[str, ...]:
        """What a reader must know of the truths that were scored with."""
        bright = {key: median for key, median in self._medians.items() if median > SKIN}
        if not bright:
            return ()
        key = max(bright, key=lambda each: bright[each])
        return (
            f"{len(bright)} of {len(self._medians)} recorded pictures of {subject} are too bright for skin: in {key} "
            f"the median of the hand is {bright[key]:.3g}; is it radiance, or codes up to 255?",
        )


def failed(metrics: Mapping[str, Metric], scored: Iterable[tuple[str, Frame]], why: Failure) -> tuple[ScoredFrame, ...]:
    """The frames of columns without any value."""
    return tuple(_scored(column, frame, [(None, why.reason)] * len(metrics)) for column, frame in scored)


def _scored(column: str, frame: Frame, found: Sequence[tuple[float | None, str | None]]) -> ScoredFrame:
    reasons = tuple(reason for _, reason in found)
    values = tuple(value for value, _ in found)
    return ScoredFrame(column, frame.key, frame.kind, values, reasons if any(reasons) else ())


def _value(value: Any, reason: str | None) -> tuple[float | None, str | None]:
    """A value or a reason, never both: what is not finite is no value."""
    if value is None:
        return None, reason
    return (float(value), None) if math.isfinite(value) else (None, reason or NOT_FINITE)
