"""Trainings of a run: once per method and seed, kept in the run folder, used again by every subject."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from ..errors import InputError
from ..files import writing
from ..method import Method, Prior, Progress, Recording
from ..render.see.shadowstore import default_folder, kept_on_disk
from ..results.measured import CurvePoint
from .metering import metered
from .store import Store

_CURVE_POINTS = 500
_SHADOW_BYTES = 1 << 30


@dataclass(frozen=True)
class Training:
    """A training that is asked for; `check` is called before what it learned is kept, and raises if it must not be."""

    key: str
    method: Method
    seed: int
    recording: Callable[[], Recording]
    check: Callable[[], None]


class Priors:
    """Gives the prior of a key: from memory, from the run folder, or by training."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._key = ""
        self._last: tuple[Prior, float] | BaseException

    def get(self, asked: Training, progress: Progress) -> tuple[Prior, float]:
        """The prior and the seconds its training took. A training that failed is not tried again for the next subject.

        A prior is always read back from disk, also by the run that trained it, so that a resumed run and an
        uninterrupted one score the same thing.
        """
        if self._key != asked.key:
            try:
                self._last = self._find(asked, progress)
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                self._last = error
            self._key = asked.key
        if isinstance(self._last, BaseException):
            raise self._last
        return self._last

    def _find(self, asked: Training, progress: Progress) -> tuple[Prior, float]:
        key, method = asked.key, asked.method
        kept = self._store.prior(key)
        if kept is not None:
            try:
                return method.load(self._store.sound_state(key)), kept.train_s
            except InputError:  # its weights are damaged: trained again
                self._store.remove_prior(key)
        curve = CurveRecorder(progress)
        with self._store.writing_prior(key, method.info.name, asked.seed, method.config) as new:
            start = time.perf_counter()
            # shadows kept on disk are not for relighting: its times must not depend on them
            shadows = kept_on_disk(default_folder(), _SHADOW_BYTES)
            with shadows, self._store.checkpoints(key) as state, metered() as new.meter:
                prior = method.train(asked.recording(), asked.seed, curve)
            asked.check()
            new.train_s = time.perf_counter() - start + state.earlier_s
            new.curve = curve.points()
            with writing(new.state):
                prior.save(new.state)
        self._store.remove_checkpoints(key)
        return method.load(self._store.prior_state(key)), new.train_s


class CurveRecorder:
    """A progress that keeps what it is told, for the loss curves of a report."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._told: list[CurvePoint] = []

    def __call__(self, step: int, total: int, **values: float) -> None:
        if values:
            self._told.append(CurvePoint(step, {name: _json(value) for name, value in values.items()}))
        self._progress(step, total, **values)

    def points(self) -> tuple[CurvePoint, ...]:
        """At most `_CURVE_POINTS` of them, evenly spread, the last one included."""
        every = -(-len(self._told) // _CURVE_POINTS) or 1
        return tuple(self._told[::-1][::every][::-1])


def _json(value: float) -> float | None:
    value = float(value)
    return value if abs(value) < float("inf") else None
