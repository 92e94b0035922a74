"""What a method costs: times, and what it takes of the machine beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from handbench.results.measured import Cost, Spread
from handbench.results.record import CellRecord
from handbench.scene import TimedKind


@dataclass(frozen=True)
class Span:
    """A median with the least and the greatest of what was measured."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class MethodTimes:
    """What a method costs; None or without an entry where not measured.

    Seconds to train and to personalise one cell. By kind of frame, milliseconds of a new pose (pose and relight
    together, nothing kept) and of a known pose under a new light (relight alone).
    """

    train_s: Span | None
    personalise_s: Span | None
    new_pose_ms: Mapping[str, Span]
    known_pose_ms: Mapping[str, Span]


@dataclass(frozen=True)
class Footprint:
    """What a method takes of the machine beside time (`handbench.results.record.Cost`); None where it is not told.

    Over cells: the greatest resident memory while drawing and while training, and that of GPUs in either, the size of
    an avatar's arrays, all in MiB; the trained state's size in MiB and its numbers; joules for a drawn frame.
    """

    memory_mb: Span | None = None
    train_memory_mb: Span | None = None
    vram_mb: Span | None = None
    avatar_mb: Span | None = None
    weights_mb: float | None = None
    parameters: int | None = None
    frame_j: Span | None = None

    @property
    def told(self) -> bool:
        return any(value is not None for value in vars(self).values())


def times_of(cells: Sequence[CellRecord]) -> MethodTimes:
    """What the cells of a method took: medians, with the extremes of everything measured."""
    times = [cell.times for cell in cells]
    return MethodTimes(
        _span([each.train_s for each in times]),
        _span([each.personalise_s for each in times]),
        _milliseconds([each.new_pose_ms for each in times]),
        _milliseconds([each.known_pose_ms for each in times]),
    )


def _span(told: Sequence[float | None]) -> Span | None:
    values = [value for value in told if value is not None]
    return Span(median(values), min(values), max(values)) if values else None


def _milliseconds(told: Sequence[Mapping[TimedKind, Spread]]) -> dict[str, Span]:
    spreads: dict[str, list[Spread]] = {}
    for kind, spread in (item for by_kind in told for item in by_kind.items()):
        spreads.setdefault(kind, []).append(spread)
    return {
        kind: Span(median(s.median for s in each), min(s.min for s in each), max(s.max for s in each))
        for kind, each in spreads.items()
    }


def footprint_of(costs: Sequence[Cost]) -> Footprint:
    """What the cells of a method took: medians, with the extremes."""

    def span(values: Iterator[float | None], scale: float = 1.0) -> Span | None:
        return _span([None if value is None else value / scale for value in values])

    gpus = (max((own for own in (each.vram_mb, each.train_vram_mb) if own is not None), default=None) for each in costs)
    weights = span((each.weights_bytes for each in costs), 2**20)
    frames = (each.energy_j / each.drawn if each.energy_j is not None and each.drawn else None for each in costs)
    return Footprint(
        span(each.peak_mb for each in costs),
        span(each.train_peak_mb for each in costs),
        span(gpus),
        span((each.avatar_bytes for each in costs), 2**20),
        None if weights is None else weights.high,
        max((each.parameters for each in costs if each.parameters is not None), default=None),
        span(frames),
    )
