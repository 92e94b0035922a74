"""What was measured of a cell: parts of the records of `record`."""

from __future__ import annotations

from dataclasses import dataclass

from ..scene import FrameKind, TimedKind
from .rules import Amount, Count, Duration, Key, Value
from .schema import Misfit, told


@dataclass(frozen=True, slots=True)
class Spread:
    """Milliseconds of repeats."""

    median: Duration = told("the median")
    min: Duration = told("the least")
    max: Duration = told("the most")
    n: Count = told("how many there are")
    values: tuple[Duration, ...] = told("each of them", default=())


@dataclass(frozen=True, slots=True)
class CellTimes:
    """What a cell took; a method whose answers were made elsewhere tells no times of its own."""

    train_s: Duration | None = told("training, in seconds, earlier stopped tries included", default=None)
    personalise_s: Duration | None = told("personalising, in seconds", default=None)
    new_pose_ms: dict[TimedKind, Spread] = told(
        "pose and relight, nothing kept, by kind of light", default_factory=dict
    )
    known_pose_ms: dict[TimedKind, Spread] = told("relight alone, under another light", default_factory=dict)
    relight_s: Duration = told("all relighting, in seconds", default=0.0)
    score_s: Duration = told("all scoring, in seconds", default=0.0)
    laws_s: Duration = told("measuring the laws, in seconds", default=0.0)


@dataclass(frozen=True, slots=True)
class Cost:
    """What a cell took of the machine beside time; null where the machine does not tell."""

    peak_mb: Amount | None = told(
        "greatest resident memory of the process and its children while drawing, in MiB", default=None
    )
    train_peak_mb: Amount | None = told("the same of its training", default=None)
    vram_mb: Amount | None = told("greatest memory that torch held on GPUs while drawing, in MiB", default=None)
    train_vram_mb: Amount | None = told("the same of its training", default=None)
    energy_j: Amount | None = told("energy of the processors while drawing, in joules (RAPL)", default=None)
    train_energy_j: Amount | None = told("the same of its training", default=None)
    drawn: Count = told("frames that were drawn meanwhile, repeats included", default=0)
    parameters: Count | None = told("numbers in its trained state", default=None)
    weights_bytes: Count | None = told("size of its trained state on disk", default=None)
    avatar_bytes: Count | None = told("size of the arrays that its avatar holds", default=None)


@dataclass(frozen=True, slots=True)
class Laws:
    """How far light is from adding up, relative to the brightest pixel; null where nothing could be measured."""

    additivity: float | None = told("of two lights drawn together, from their sum", default=None)
    homogeneity: float | None = told("of a light made stronger, from the picture made stronger", default=None)
    linearity: float | None = told("of both at once", default=None)
    pairs: Count = told("pairs of lights it was measured with", default=0)
    reason: str | None = told("why a pair or a value is missing", default=None)


@dataclass(frozen=True, slots=True)
class SkippedShare:
    """What a skip left out."""

    total: Count = told("how much there was")
    skipped: Count = told("how much of it was left out")


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """What a training told at a step."""

    step: Count = told("the step")
    values: dict[str, float | None] = told("by name; null for what was not finite")


@dataclass(frozen=True, slots=True)
class ScoredFrame:
    """The values of one frame in one column."""

    column: str = told("the column")
    query: Key = told("the frame's key")
    kind: FrameKind = told("the kind of light")
    values: tuple[Value | None, ...] = told("in the order of the cell's metrics")
    reasons: tuple[str | None, ...] = told("why a value is missing; empty if none is", default=())

    def __post_init__(self) -> None:
        if None in self.values or self.reasons:
            if len(self.reasons) != len(self.values):
                raise Misfit(f"holds {len(self.reasons)} reasons for {len(self.values)} values", "reasons")
            for place, (value, reason) in enumerate(zip(self.values, self.reasons, strict=True)):
                if (value is None) == (reason is None):
                    raise Misfit("needs either a value or a reason", f"values[{place}]")

    @property
    def reason(self) -> str:
        """Why a value is missing, "" if none is."""
        return next(filter(None, self.reasons), "")
