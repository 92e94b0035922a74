"""One cell: train or fetch the prior, personalise, relight every query of the subject with the clock on, score."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np

from ..data.capture import Capture, by_key, read
from ..errors import BadFrame, Changed, StorageError, Unsupported
from ..method import Avatar, Method, MethodInfo, PosedAvatar, Progress, RecordedAvatar
from ..recording import Recording
from ..results.laws import measured
from ..scene import Frame, Light, Observation, Prediction, Query, kind_of, leaves
from ..skips import tallied
from . import given
from .failure import Failure, failure
from .isolation import isolated
from .lending import Lender, answered, copied
from .plan import Cell
from .priors import Curve, Priors
from .protocol import Protocol, Selected
from .store import Store

_CHUNK = 16  # queries drawn, scored and dropped together: bounds memory, keeps metrics batched
_REPEATS = 4  # queries of each kind of frame that are drawn a second time, posed anew


class CaptureReader:
    """Reads a capture for methods and remembers its errors: damaged data is the user's to mend, no method's failure.

    Frames are looked up by their keys, and images are copies: what a method does to either reaches nobody else.
    Raises `InputError` for a capture with two frames of one key.
    """

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self._frames = by_key(capture.frames())
        self._error: BadFrame | None = None

    def __call__(self, frame: Frame) -> Observation:
        """The images of a frame. Raises `BadFrame`, whatever is wrong with them."""
        try:
            return copied(read(self._capture, self._frames.get(frame.key, frame)))
        except BadFrame as error:
            self._error = error
            raise

    def caused(self, error: BaseException) -> BadFrame | None:
        """The bad frame that an error comes from, also if a method or another process wrapped it."""
        bad = self._error
        link: BaseException | None = error
        while bad is not None and link is not None:
            if link is bad or str(link) == str(bad):
                return bad
            link = link.__cause__ or link.__context__
        return None


@dataclass(frozen=True)
class Bench:
    """What all cells of a run share. `metrics` maps a signature to a metric, `metrics_module` has `Pair`."""

    protocol: Protocol
    selected: Selected
    reader: CaptureReader
    store: Store
    priors: Priors
    metrics: dict[str, Any]
    metrics_module: ModuleType
    lender: Lender = field(default_factory=Lender)

    def scored(self, subject: str) -> list[tuple[str, Frame]]:
        """Column and frame of everything scored for a subject, equal poses side by side."""
        pairs = [(name, f) for name, frames in self.selected.scored.items() for f in frames if f.subject == subject]
        return sorted(pairs, key=lambda pair: (pair[1].key, pair[0]))

    def enrolment(self, subject: str, method: Method) -> Recording:
        return given.enrolment(self.selected, method.info, subject, self.reader)

    def training(self) -> Recording:
        return given.training(self.selected, self.reader)


def compute(bench: Bench, cell: Cell, method: Method, steps: Callable[[str], Progress]) -> dict[str, Any]:
    """Times, scores, failures, laws and skips of a cell as JSON values; its predictions are written to the store.

    Whatever the method raises, and a frame that cannot be read, becomes the reason of its scores. `StorageError` is
    raised: the disk is not its fault.
    """
    with isolated():
        lent = replace(bench, selected=bench.lender.lend(bench.selected, cell.method))
        found, laws = _compute(lent, cell, method, steps)
        start = time.perf_counter()
        found["laws"] = laws()
        found["times"]["laws_s"] = time.perf_counter() - start
    try:
        bench.lender.check()
    except Changed as error:
        found |= _failed(bench, bench.scored(cell.subject), failure(error))
    if not method.info.timed:
        found["times"] |= {"train_s": None, "personalise_s": None, "new_pose_ms": {}, "known_pose_ms": {}}
    return found


def _compute(
    bench: Bench, cell: Cell, method: Method, steps: Callable[[str], Progress]
) -> tuple[dict[str, Any], Callable[[], dict[str, Any]]]:
    """All that is timed or tallied, and a function that measures the laws, which are neither."""
    scored = bench.scored(cell.subject)
    label = f"{cell.method} {cell.subject} seed {cell.seed}"
    times: dict[str, Any] = {
        "train_s": None,
        "personalise_s": None,
        "new_pose_ms": {},
        "known_pose_ms": {},
        "relight_s": 0.0,
        "score_s": 0.0,
    }
    try:
        if refusal := given.refusal(bench.selected, method.info, cell.subject):
            raise Unsupported(refusal)
        training = steps(f"{cell.method} seed {cell.seed}: train")
        prior, times["train_s"] = bench.priors.get(
            cell.prior, method, bench.training, cell.seed, training, bench.lender.check
        )
        enrolment = bench.enrolment(cell.subject, method)
        curve = Curve(steps(f"{label}: personalise"))
        start = time.perf_counter()
        with bench.store.checkpoints(cell.key) as state:
            avatar = prior.personalise(enrolment, cell.seed, curve)
        times["personalise_s"] = time.perf_counter() - start + state.earlier_s
    except BaseException as error:
        return {"times": times, "skipped": {}, **_failed(bench, scored, blame(error, bench.reader))}, dict
    # Of drawing alone: what of a training falls to which cell depends on when a run was stopped.
    with tallied() as tally:
        result, laws = _relight(bench, cell, method.info, avatar, scored, times, steps(f"{label}: relight"))
    result["skipped"] = {what: asdict(saved) for what, saved in tally.lines().items()}
    return {**result, "curve": curve.points()}, laws


class _Drawing:
    """Draws the queries of an avatar with the clock on; those of one viewpoint share a posed avatar.

    new_pose_ms     by kind of frame, milliseconds of pose and relight together, for a viewpoint that nothing is kept of
    known_pose_ms   by kind of frame, milliseconds of relight, for a viewpoint that was drawn under another light
    seconds         of everything that was drawn
    """

    def __init__(self, reader: CaptureReader, ask: Callable[[Frame], Query], info: MethodInfo, avatar: Avatar) -> None:
        self._reader, self._ask, self._info, self._avatar = reader, ask, info, avatar
        self._key = ""
        self._posed: PosedAvatar | Failure
        self.new_pose_ms: dict[str, list[float]] = {}
        self.known_pose_ms: dict[str, list[float]] = {}
        self.seconds = 0.0

    def draw(self, frame: Frame) -> Prediction | Failure:
        """A frame's picture, or why there is none. What the last frame's viewpoint keeps is used for an equal one."""
        return self._checked(frame, self._recorded if isinstance(self._avatar, RecordedAvatar) else self._shared)

    def anew(self, frame: Frame) -> Prediction | Failure:
        """A frame's picture from a new posed avatar, which is dropped."""
        return self._checked(frame, self._recorded if isinstance(self._avatar, RecordedAvatar) else self._new)

    def _recorded(self, frame: Frame) -> Prediction:
        return self._avatar.relight(self._ask(frame))

    def _new(self, frame: Frame) -> Prediction:
        asked = self._ask(frame)
        start = time.perf_counter()
        prediction = self._avatar.pose(asked.viewpoint).relight(asked.light)
        self.new_pose_ms.setdefault(frame.kind, []).append((time.perf_counter() - start) * 1e3)
        return prediction

    def _shared(self, frame: Frame) -> Prediction | Failure:
        asked = self._ask(frame)
        start, times = time.perf_counter(), self.known_pose_ms
        if self._key != frame.viewpoint.key:
            self._key, times = frame.viewpoint.key, self.new_pose_ms
            try:
                self._posed = self._avatar.pose(asked.viewpoint)
            except BaseException as error:  # for all lights of the viewpoint
                self._posed = blame(error, self._reader)
        if isinstance(self._posed, Failure):
            return self._posed
        prediction = self._posed.relight(asked.light)
        times.setdefault(frame.kind, []).append((time.perf_counter() - start) * 1e3)
        return prediction

    def _checked(self, frame: Frame, draw: Callable[[Frame], Prediction | Failure]) -> Prediction | Failure:
        start = time.perf_counter()
        try:
            if refusal := light_refusal(self._info, self._ask(frame).light):
                raise Unsupported(refusal)
            answer = draw(frame)
            self.seconds += time.perf_counter() - start
            if isinstance(answer, Failure):
                return answer
            size, wanted = answer.alpha.shape, (frame.camera.height, frame.camera.width)
            if size != wanted:
                raise Unsupported(f"the picture is {size[1]}x{size[0]}, its camera says {wanted[1]}x{wanted[0]}")
        except BaseException as error:
            return blame(error, self._reader)
        return answered(answer)


def light_refusal(info: MethodInfo, light: Light) -> str | None:
    """Why a method is not asked to draw a light: it holds a kind that the method does not declare. None: it is."""
    for single in leaves(light):
        kind = kind_of(single)
        if kind not in info.lights:
            return f"{info.title} cannot draw {kind} lights"
    return None


def _relight(
    bench: Bench,
    cell: Cell,
    info: MethodInfo,
    avatar: Avatar,
    scored: list[tuple[str, Frame]],
    times: dict[str, Any],
    progress: Progress,
) -> tuple[dict[str, Any], Callable[[], dict[str, Any]]]:
    """Draw and score in chunks. The picture that is timed first is the one that is scored."""
    frames = list({frame.key: frame for _, frame in scored}.values())
    ask = partial(given.asked, bench.selected, info)
    drawable = [frame for frame in frames if light_refusal(info, ask(frame).light) is None]
    warming, drawing = (_Drawing(bench.reader, ask, info, avatar) for _ in range(2))
    # what a first call loads or compiles stays off the clock
    for frame in {frame.kind: frame for frame in drawable}.values():
        warming.anew(frame)
    repeated = _repeated(drawable)
    same: bool | None = None
    kept: dict[str, str] = {}
    scores: dict[str, list[dict[str, Any]]] = {}
    trace: str | None = None
    for begin in range(0, len(frames), _CHUNK):
        chunk = frames[begin : begin + _CHUNK]
        drawn: list[tuple[Frame, Prediction]] = []
        for i, frame in enumerate(chunk):
            answer = drawing.draw(frame)
            progress(begin + i + 1, len(frames))
            if isinstance(answer, Failure):
                trace = trace or answer.trace
                scores[frame.key] = _missing(bench, "", frame, answer)
                continue
            drawn.append((frame, answer))
            if frame.key in repeated:
                second = drawing.anew(frame)
                if not isinstance(second, Failure):
                    same = (same is not False) and _same(answer, second)
        start = time.perf_counter()
        found, bad = _score(bench, drawn)
        scores, trace = scores | found, trace or bad
        times["score_s"] += time.perf_counter() - start
        kept |= _keep(bench.store, cell.key, drawn)
    times |= {
        "new_pose_ms": {kind: _spread(values) for kind, values in drawing.new_pose_ms.items()},
        "known_pose_ms": {kind: _spread(values) for kind, values in drawing.known_pose_ms.items()},
    }
    times["relight_s"] += warming.seconds + drawing.seconds
    flat = [{**score, "column": column} for column, frame in scored for score in scores[frame.key]]
    result = {"times": times, "scores": flat, "same_pixels": same, "predictions": kept, "error": trace}
    lit = [frame for frame in drawable if frame.key not in bench.selected.as_enrolled]
    if info.truth or not lit:
        return result, dict
    return result, partial(measured, avatar, lit, ask(frames[-1]))


def _repeated(frames: Sequence[Frame]) -> set[str]:
    """Keys of at most `_REPEATS` frames of each kind, evenly spread: they are drawn a second time, posed anew."""
    kinds: dict[str, list[str]] = {}
    for frame in frames:
        kinds.setdefault(frame.kind, []).append(frame.key)
    return {
        keys[i]
        for keys in kinds.values()
        for i in np.linspace(0, len(keys) - 1, min(_REPEATS, len(keys))).round().astype(int)
    }


def _keep(store: Store, key: str, drawn: Iterable[tuple[Frame, Prediction]]) -> dict[str, str]:
    """Keep the finite predictions; the digests of their files by query. Files are packed outside of Python."""

    def write(pair: tuple[Frame, Prediction]) -> tuple[str, str]:
        return pair[0].key, store.write_prediction(key, pair[0].key, pair[1])

    finite = [(f, p) for f, p in drawn if np.isfinite(p.image).all() and np.isfinite(p.alpha).all()]
    with ThreadPoolExecutor() as pool:
        return dict(pool.map(write, finite))


def blame(error: BaseException, reader: CaptureReader) -> Failure:
    """What went wrong in a method, or in a frame that it read. Raises again what the disk or the user caused."""
    if isinstance(error, StorageError):
        raise error
    return failure(reader.caused(error) or error)


def _score(
    bench: Bench, drawn: Iterable[tuple[Frame, Prediction]]
) -> tuple[dict[str, list[dict[str, Any]]], str | None]:
    """The scores of each query by its key, and the traceback of a frame that is to be mended.

    A prediction with NaN or infinity, and a frame that cannot be read, get none, and the reason.
    """
    trace: str | None = None
    scores: dict[str, list[dict[str, Any]]] = {}
    finite: list[tuple[Frame, Any]] = []
    for frame, prediction in drawn:
        bad = int(np.count_nonzero(~np.isfinite(prediction.image)) + np.count_nonzero(~np.isfinite(prediction.alpha)))
        if bad:
            trouble = Failure(f"non-finite: {bad} values of the prediction are NaN or infinite", None)
            scores[frame.key] = _missing(bench, "", frame, trouble)
        else:
            try:
                truth = bench.reader(frame)
                if truth.alpha is None:
                    raise BadFrame(f"{frame.key}: it has no alpha, so no mask to score in")
            except BadFrame as error:
                trouble = failure(error)
                trace, scores[frame.key] = trouble.trace, _missing(bench, "", frame, trouble)
                continue
            finite.append((frame, bench.metrics_module.Pair.of(prediction, truth, frame.mesh)))
            scores[frame.key] = []
    rows = bench.metrics_module.scores(list(bench.metrics.values()), [pair for _, pair in finite])
    for (frame, _), row in zip(finite, rows, strict=True):
        for signature, score in zip(bench.metrics, row, strict=True):
            scores[frame.key].append(_entry("", frame, signature, score.value, score.reason))
    return scores, trace


def _failed(bench: Bench, scored: list[tuple[str, Frame]], failed: Failure) -> dict[str, Any]:
    """What a cell without any score tells."""
    scores = [score for column, frame in scored for score in _missing(bench, column, frame, failed)]
    return {"scores": scores, "same_pixels": None, "predictions": {}, "error": failed.trace, "laws": {}}


def _missing(bench: Bench, column: str, frame: Frame, failed: Failure) -> list[dict[str, Any]]:
    return [_entry(column, frame, signature, None, failed.reason) for signature in bench.metrics]


def _entry(column: str, frame: Frame, signature: str, value: float | None, reason: str | None) -> dict[str, Any]:
    named = {"column": column, "query": frame.key, "kind": frame.kind}
    return {**named, "metric": signature, "value": value, "reason": reason}


def _same(one: Prediction, other: Prediction) -> bool:
    """Equal up to the rounding of sums in another order, relative to the brightest pixel."""
    scale = max(float(np.nanmax(np.abs(one.image), initial=0.0)), 1e-6)
    return bool(np.allclose(one.image, other.image, rtol=0, atol=1e-5 * scale, equal_nan=True))


def _spread(values: list[float]) -> dict[str, Any]:
    """Milliseconds of all draws: the gate compares them one by one."""
    told = {"median": median(values), "min": min(values), "max": max(values), "n": len(values)}
    return {**told, "values": [round(value, 4) for value in values]}
