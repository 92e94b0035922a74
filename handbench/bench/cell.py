"""One cell: train or fetch the prior, personalise, draw every query of the subject with the clock on, score."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..errors import Changed, Unsupported
from ..method import Avatar, Method, MethodInfo, Progress
from ..recording import Recording
from ..results.laws import measured_laws
from ..results.measured import CellTimes, Cost, CurvePoint, Laws, ScoredFrame, SkippedShare
from ..scene import Frame, Prediction
from ..skips import tallied
from . import given
from .drawing import TimedRenderer, light_refusal, repeated, same_picture, spreads, timed_kind
from .failure import Failure, failure
from .isolation import isolated
from .lending import Lender
from .metering import Meter, held_bytes, kept_size, metered, parameters
from .plan import Cell
from .priors import CurveRecorder, Priors, Training
from .protocol import Protocol
from .reader import CaptureReader, blame
from .resolving import Selected
from .scoring import SHOWN, Scoring, failed
from .store import Store

if TYPE_CHECKING:
    from ..metrics import Metric

CHUNK = 16  # queries drawn, scored and dropped together: bounds memory, keeps metrics batched


@dataclass(frozen=True)
class Bench:
    """What all cells of a run share. `metrics` maps a signature to a metric."""

    protocol: Protocol
    selected: Selected
    reader: CaptureReader
    store: Store
    priors: Priors
    metrics: dict[str, Metric]
    lender: Lender = field(default_factory=Lender)

    def scored(self, subject: str) -> list[tuple[str, Frame]]:
        """Column and frame of everything scored for a subject, equal poses side by side."""
        pairs = [(name, f) for name, frames in self.selected.scored.items() for f in frames if f.subject == subject]
        return sorted(pairs, key=lambda pair: (pair[1].key, pair[0]))

    def enrolment(self, subject: str, method: Method) -> Recording:
        return given.enrolment(self.selected, method.info, subject, self.reader)

    def training(self) -> Recording:
        return given.training(self.selected, self.reader)


@dataclass(frozen=True)
class CellMeasurement:
    """What was measured of a cell: the fields of `CellRecord` that do not say which cell it is."""

    scores: tuple[ScoredFrame, ...]
    times: CellTimes
    predictions: dict[str, str] = field(default_factory=dict)
    same_pixels: bool | None = None
    error: str | None = None
    laws: Laws = field(default_factory=Laws)
    skipped: dict[str, SkippedShare] = field(default_factory=dict)
    curve: tuple[CurvePoint, ...] = ()
    remarks: tuple[str, ...] = ()
    cost: Cost = field(default_factory=Cost)


def compute(bench: Bench, cell: Cell, method: Method, steps: Callable[[str], Progress]) -> CellMeasurement:
    """Times, scores, failures, laws and skips of a cell; its predictions are written to the store.

    Whatever the method raises, and a frame that cannot be read, becomes the reason of its scores. `StorageError` is
    raised: the disk is not its fault.
    """
    with isolated():
        lent = replace(bench, selected=bench.lender.lend(bench.selected, cell.method))
        found, laws = _compute(lent, cell, method, steps)
        start = time.perf_counter()
        found = replace(found, laws=laws())
        found = replace(found, times=replace(found.times, laws_s=time.perf_counter() - start))
    try:
        bench.lender.check()
    except Changed as error:
        nothing = _failed(bench, bench.scored(cell.subject), failure(error), found.times)
        found = replace(nothing, skipped=found.skipped, curve=found.curve)
    if not method.info.timed:
        untold = replace(found.times, train_s=None, personalise_s=None, new_pose_ms={}, known_pose_ms={})
        found = replace(found, times=untold, cost=Cost())
    return found


def _compute(
    bench: Bench, cell: Cell, method: Method, steps: Callable[[str], Progress]
) -> tuple[CellMeasurement, Callable[[], Laws]]:
    """All that is timed or tallied, and a function that measures the laws, which are neither."""
    scored = bench.scored(cell.subject)
    label = f"{cell.method} {cell.subject} seed {cell.seed}"
    times = CellTimes()
    try:
        if refusal := given.refusal(bench.selected, method.info, cell.subject):
            raise Unsupported(refusal)
        training = Training(cell.prior, method, cell.seed, bench.training, bench.lender.check)
        prior, train_s = bench.priors.get(training, steps(f"{cell.method} seed {cell.seed}: train"))
        times = replace(times, train_s=train_s)
        enrolment = bench.enrolment(cell.subject, method)
        curve = CurveRecorder(steps(f"{label}: personalise"))
        start = time.perf_counter()
        with bench.store.checkpoints(cell.key) as state:
            avatar = prior.personalise(enrolment, cell.seed, curve)
        times = replace(times, personalise_s=time.perf_counter() - start + state.earlier_s)
    except BaseException as error:
        return _failed(bench, scored, blame(error, bench.reader), times), Laws
    # Of drawing alone: what of a training falls to which cell depends on when a run was stopped.
    with tallied() as tally, metered() as meter:
        found, laws = _relight(bench, cell, method.info, avatar, scored, times, steps(f"{label}: relight"))
    found = replace(found, cost=_cost(bench, cell.prior, meter, found.times, avatar))
    skipped = {what: SkippedShare(saved.total, saved.skipped) for what, saved in tally.lines().items()}
    return replace(found, skipped=skipped, curve=curve.points()), laws


def _cost(bench: Bench, prior: str, meter: Meter, times: CellTimes, avatar: Avatar) -> Cost:
    """What was measured while drawing and while training, and how large what is kept is."""
    from ..remote.method import RemoteAvatar, RemoteRecordedAvatar

    kept, state = bench.store.prior(prior), bench.store.prior_state(prior)
    training = (kept.peak_mb, kept.vram_mb, kept.energy_j) if kept else (None, None, None)
    drawn = sum(spread.n for by_kind in (times.new_pose_ms, times.known_pose_ms) for spread in by_kind.values())
    return Cost(
        peak_mb=meter.peak_mb,
        train_peak_mb=training[0],
        vram_mb=meter.vram_mb,
        train_vram_mb=training[1],
        energy_j=meter.energy_j,
        train_energy_j=training[2],
        drawn=drawn,
        parameters=parameters(state),
        weights_bytes=kept_size(state),
        # what another interpreter holds is not seen from here
        avatar_bytes=None if isinstance(avatar, RemoteAvatar | RemoteRecordedAvatar) else held_bytes(avatar),
    )


def _relight(
    bench: Bench,
    cell: Cell,
    info: MethodInfo,
    avatar: Avatar,
    scored: list[tuple[str, Frame]],
    times: CellTimes,
    progress: Progress,
) -> tuple[CellMeasurement, Callable[[], Laws]]:
    """Draw and score in chunks. The picture that is timed first is the one that is scored."""
    frames = list({frame.key: frame for _, frame in scored}.values())
    ask = partial(given.asked, bench.selected, info)
    shown = bench.selected.without_truth
    unseen = shown if info.truth else frozenset()  # who looks the truth up has nothing to look for
    drawable = [f for f in frames if f.key not in unseen and light_refusal(info, ask(f).light) is None]
    warming, drawing = (TimedRenderer(bench.reader, ask, info, avatar) for _ in range(2))
    # what a first call loads or compiles stays off the clock
    for frame in {timed_kind(frame, ask(frame)): frame for frame in drawable}.values():
        warming.anew(frame)
    twice = repeated(drawable, ask)
    same: bool | None = None
    kept: dict[str, str] = {}
    scoring = Scoring(bench.reader, bench.metrics, shown)
    for begin in range(0, len(frames), CHUNK):
        drawn: list[tuple[Frame, Prediction]] = []
        for i, frame in enumerate(frames[begin : begin + CHUNK], start=begin + 1):
            answer = Failure(SHOWN, None) if frame.key in unseen else drawing.draw(frame)
            progress(i, len(frames))
            if isinstance(answer, Failure):
                scoring.missing(frame, answer)
                continue
            drawn.append((frame, answer))
            if frame.key in twice:
                second = drawing.anew(frame)
                if not isinstance(second, Failure):
                    same = (same is not False) and same_picture(answer, second)
        scoring.score(drawn)
        kept |= _keep(bench.store, cell.key, drawn)
    times = replace(
        times,
        new_pose_ms=spreads(drawing.new_pose_ms),
        known_pose_ms=spreads(drawing.known_pose_ms),
        relight_s=warming.seconds + drawing.seconds,
        score_s=scoring.seconds,
    )
    told = scoring.frames(scored), times, kept, same, scoring.trace
    found = CellMeasurement(*told, remarks=scoring.remarks(cell.subject))
    lit = [frame for frame in drawable if frame.key not in bench.selected.as_enrolled]
    if info.truth or not lit:
        return found, Laws
    return found, partial(measured_laws, avatar, lit, ask(frames[-1]))


def _failed(bench: Bench, scored: Iterable[tuple[str, Frame]], why: Failure, times: CellTimes) -> CellMeasurement:
    """What a cell without any score tells."""
    return CellMeasurement(failed(bench.metrics, scored, why), times, error=why.trace)


def _keep(store: Store, key: str, drawn: Iterable[tuple[Frame, Prediction]]) -> dict[str, str]:
    """Keep the finite predictions; the digests of their files by query. Files are packed outside of Python."""

    def write(pair: tuple[Frame, Prediction]) -> tuple[str, str]:
        return pair[0].key, store.write_prediction(key, pair[0].key, pair[1])

    finite = [(f, p) for f, p in drawn if np.isfinite(p.image).all() and np.isfinite(p.alpha).all()]
    with ThreadPoolExecutor() as pool:
        return dict(pool.map(write, finite))
