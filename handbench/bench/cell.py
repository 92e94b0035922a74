"""One cell: train or fetch the prior, personalise, relight every query of the subject with the clock on, score."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np

from ..data.capture import Capture
from ..errors import HandbenchError, StorageError, Unsupported
from ..method import Avatar, Method, MethodInfo, Progress
from ..recording import Recording
from ..scene import Frame, Light, Mesh, Observation, Prediction, Query, kind_of, leaves
from ..skips import tallied
from . import given
from .failure import Failure, failure
from .laws import measured
from .plan import Cell
from .priors import Curve, Priors
from .protocol import Protocol, Selected
from .store import Store

_CHUNK = 16  # queries drawn, scored and dropped together: bounds memory, keeps metrics batched
_REPEATS = 12  # queries that are drawn a second time to time a known pose


class CaptureReader:
    """Reads a capture for methods and remembers its errors: damaged data is the user's to mend, no method's failure."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.error: HandbenchError | None = None

    def __call__(self, frame: Frame) -> Observation:
        try:
            return self._capture.observe(frame)
        except HandbenchError as error:
            self.error = error
            raise


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

    Whatever the method raises becomes the reason of its scores. What is not its fault is raised: `StorageError`
    for the disk, `InputError` for a damaged capture.
    """
    found, laws = _compute(bench, cell, method, steps)
    start = time.perf_counter()
    found["laws"] = laws()
    found["times"]["laws_s"] = time.perf_counter() - start
    if not method.info.timed:
        found["times"] |= dict.fromkeys(("train_s", "personalise_s", "first_ms", "relight_ms"))
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
        "first_ms": None,
        "relight_ms": None,
        "relight_s": 0.0,
        "score_s": 0.0,
    }
    try:
        training = steps(f"{cell.method} seed {cell.seed}: train")
        prior, times["train_s"] = bench.priors.get(cell.prior, method, bench.training, cell.seed, training)
        enrolment = bench.enrolment(cell.subject, method)
        curve = Curve(steps(f"{label}: personalise"))
        start = time.perf_counter()
        with bench.store.checkpoints(cell.key) as state:
            avatar = prior.personalise(enrolment, cell.seed, curve)
        times["personalise_s"] = time.perf_counter() - start + state.earlier_s
    except Exception as error:
        failed = blame(error, bench.reader)
        scores = [score for column, frame in scored for score in _missing(bench, column, frame, failed)]
        told = {"times": times, "scores": scores, "same_pixels": None, "predictions": None, "error": failed.trace}
        told["skipped"] = {}
        return told, dict
    asked = _Asked(bench.reader, method.info, avatar)
    # Of drawing alone: what of a training falls to which cell depends on when a run was stopped.
    with tallied() as tally:
        result, laws = _relight(bench, cell, asked, scored, times, steps(f"{label}: relight"))
    result["skipped"] = {what: asdict(saved) for what, saved in tally.lines().items()}
    return {**result, "curve": curve.points()}, laws


@dataclass(frozen=True)
class _Asked:
    """An avatar and what is known of its method."""

    reader: CaptureReader
    info: MethodInfo
    avatar: Avatar

    def relight(self, query: Query) -> tuple[Prediction | Failure, float]:
        """A prediction or why there is none, and the milliseconds the call took."""
        start = time.perf_counter()
        try:
            if refusal := light_refusal(self.info, query.light):
                raise Unsupported(refusal)
            prediction = self.avatar.relight(query)
            milliseconds = (time.perf_counter() - start) * 1e3
            size, wanted = prediction.alpha.shape, (query.camera.height, query.camera.width)
            if size != wanted:
                raise Unsupported(f"the picture is {size[1]}x{size[0]}, its camera says {wanted[1]}x{wanted[0]}")
        except Exception as error:
            return blame(error, self.reader), 0.0
        return prediction, milliseconds


def light_refusal(info: MethodInfo, light: Light) -> str | None:
    """Why a method is not asked to draw a light: it holds a kind that the method does not declare. None: it is."""
    for single in leaves(light):
        kind = kind_of(single)
        if kind not in info.lights:
            return f"{info.title} cannot draw {kind} lights"
    return None


def _relight(
    bench: Bench, cell: Cell, asked: _Asked, scored: list[tuple[str, Frame]], times: dict[str, Any], progress: Progress
) -> tuple[dict[str, Any], Callable[[], dict[str, Any]]]:
    """Draw and score in chunks. The picture that is timed first is the one that is scored."""
    frames = list({frame.key: frame for _, frame in scored}.values())
    repeated = {frames[i].key for i in np.linspace(0, len(frames) - 1, min(_REPEATS, len(frames))).round().astype(int)}
    first: list[float] = []
    again: list[float] = []
    same: bool | None = None
    kept: str | None = None
    scores: dict[str, list[dict[str, Any]]] = {}
    trace: str | None = None
    # Meshes of its own for the warm-up and for the cell: a cache that outlives a method (by the identity of a mesh)
    # must not make the next method look faster. The warm-up keeps what a first call loads or compiles off the clock.
    drawable = [frame for frame in frames if light_refusal(asked.info, frame.light) is None]
    for query in _own_meshes(drawable[:1]):
        times["relight_s"] += asked.relight(query)[1] / 1e3
    queries = _own_meshes(frames)
    for begin in range(0, len(frames), _CHUNK):
        chunk = frames[begin : begin + _CHUNK]
        drawn: list[tuple[Frame, Prediction]] = []
        for i, frame in enumerate(chunk):
            answer, milliseconds = asked.relight(queries[begin + i])
            progress(begin + i + 1, len(frames))
            if isinstance(answer, Failure):
                trace = trace or answer.trace
                scores[frame.key] = _missing(bench, "", frame, answer)
                continue
            first.append(milliseconds)
            drawn.append((frame, answer))
            if frame.key in repeated:
                second, milliseconds = asked.relight(queries[begin + i])
                if not isinstance(second, Failure):
                    again.append(milliseconds)
                    same = (same is not False) and _same(answer, second)
        start = time.perf_counter()
        scores |= _score(bench, drawn)
        times["score_s"] += time.perf_counter() - start
        kept = _keep(bench.store, cell.key, drawn) or kept
    times |= {"first_ms": _spread(first), "relight_ms": _spread(again)}
    times["relight_s"] += (sum(first) + sum(again)) / 1e3
    flat = [{**score, "column": column} for column, frame in scored for score in scores[frame.key]]
    found = {"times": times, "scores": flat, "same_pixels": same, "predictions": kept, "error": trace}
    if asked.info.truth or not drawable:
        return found, dict
    return found, partial(measured, asked.avatar, drawable, queries[-1])


def _keep(store: Store, key: str, drawn: Iterable[tuple[Frame, Prediction]]) -> str | None:
    """Keep the finite predictions; their folder, or None if there are none. Files are packed outside of Python."""

    def write(frame: Frame, prediction: Prediction) -> str | None:
        finite = np.isfinite(prediction.image).all() and np.isfinite(prediction.alpha).all()
        return store.write_prediction(key, frame.key, prediction) if finite else None

    with ThreadPoolExecutor() as pool:
        folders = list(pool.map(write, *zip(*drawn, strict=True)))
    return next(filter(None, folders), None)


def _own_meshes(frames: list[Frame]) -> list[Query]:
    """The queries of frames, with new meshes that queries of one pose share."""
    meshes = {frame.pose_key: Mesh(frame.mesh.vertices, frame.mesh.topology) for frame in frames}
    return [replace(frame.query, mesh=meshes[frame.pose_key]) for frame in frames]


def blame(error: Exception, reader: CaptureReader) -> Failure:
    """The failure of a method, unless the disk or the capture is at fault: then that error is raised."""
    if isinstance(error, StorageError):
        raise error
    if reader.error is not None:
        raise reader.error
    return failure(error)


def _score(bench: Bench, drawn: Iterable[tuple[Frame, Prediction]]) -> dict[str, list[dict[str, Any]]]:
    """The scores of each query by its key; a prediction with NaN or infinity gets none, and the reason."""
    scores: dict[str, list[dict[str, Any]]] = {}
    finite: list[tuple[Frame, Any]] = []
    for frame, prediction in drawn:
        bad = int(np.count_nonzero(~np.isfinite(prediction.image)) + np.count_nonzero(~np.isfinite(prediction.alpha)))
        if bad:
            trouble = Failure(f"non-finite: {bad} values of the prediction are NaN or infinite", None)
            scores[frame.key] = _missing(bench, "", frame, trouble)
        else:
            truth = bench.reader(frame)
            finite.append((frame, bench.metrics_module.Pair.of(prediction, truth, frame.mesh)))
            scores[frame.key] = []
    rows = bench.metrics_module.scores(list(bench.metrics.values()), [pair for _, pair in finite])
    for (frame, _), row in zip(finite, rows, strict=True):
        for signature, score in zip(bench.metrics, row, strict=True):
            scores[frame.key].append(_entry("", frame, signature, score.value, score.reason))
    return scores


def _missing(bench: Bench, column: str, frame: Frame, failed: Failure) -> list[dict[str, Any]]:
    return [_entry(column, frame, signature, None, failed.reason) for signature in bench.metrics]


def _entry(column: str, frame: Frame, signature: str, value: float | None, reason: str | None) -> dict[str, Any]:
    named = {"column": column, "query": frame.key, "kind": frame.kind}
    return {**named, "metric": signature, "value": value, "reason": reason}


def _same(one: Prediction, other: Prediction) -> bool:
    """Equal up to the rounding of sums in another order, relative to the brightest pixel."""
    scale = max(float(np.nanmax(np.abs(one.image), initial=0.0)), 1e-6)
    return bool(np.allclose(one.image, other.image, rtol=0, atol=1e-5 * scale, equal_nan=True))


def _spread(values: list[float]) -> dict[str, Any] | None:
    """Milliseconds of all repeats: the gate compares them one by one."""
    if not values:
        return None
    told = {"median": median(values), "min": min(values), "max": max(values), "n": len(values)}
    return {**told, "values": [round(value, 4) for value in values]}
