"""What a run, a cell and a training tell on disk: one record each, versioned, sealed by a digest.

`RunRecord` is run.json, `CellRecord` a file of cells/, `PriorRecord` the train.json of a training. `recordfile` writes
and reads them as JSON, `results` gives them to SQL, and docs/records.md is made from them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..method import Role
from .measured import CellTimes, Cost, CurvePoint, Laws, ScoredFrame, SkippedShare
from .origin import Hardware, Provenance
from .rules import Amount, Decimals, Duration, Key, Name
from .schema import Json, Misfit, told

SCHEMA = 3
"""The version of the format. 1 had no digests, a line for each value, and times that did not say what they measured;
2 told no memory, and one list of seeds for all methods."""


UNEQUAL = "≠"
"""The mark of a comparison of rows to which enrolment gave different things."""


@dataclass(frozen=True, slots=True)
class MethodRecord:
    """A method as it was configured; the first fields are those of `handbench.method.MethodInfo`."""

    name: Name = told("its name, unique in a run")
    title: str = told("its name for readers")
    summary: str = told("one line for lists", default="")
    universal: bool = told("whether one training serves every subject", default=False)
    linear: bool = told("whether it declares to be linear in light", default=False)
    role: Role = told("whether it competes, or tells if the run is right", default="method")
    truth: bool = told("whether it is given the scored frames: a calibration row", default=False)
    needs: tuple[str, ...] = told("what enrolment must give it", default=())
    trains_on: tuple[str, ...] = told("what training frames must have for it", default=())
    enrolment: str = told("what enrolment gave it; empty in records of before it was told", default="")
    lights: tuple[str, ...] = told("the kinds of light it can draw", default=())
    fidelity: str = told("how a table must describe it", default="")
    timed: bool = told("whether its answers are computed when it is asked", default=True)
    preset: str = told("its preset", default="")
    config: Json = told("every setting that can change a result", default=None)

    @property
    def calibration(self) -> bool:
        """Whether its row tells if the run is right, and competes with none."""
        return self.role == "calibration"

    def enrolled_unlike(self, other: MethodRecord) -> bool:
        """Whether enrolment gave it something else than another; runs of before it was told leave that open."""
        return bool(self.enrolment and other.enrolment) and self.enrolment != other.enrolment


@dataclass(frozen=True, slots=True)
class CaptureRecord:
    """The data of a run."""

    name: str = told("the registered name of the capture")
    digest: str = told("of its content")
    size: str = told("its size", default="")


@dataclass(frozen=True, slots=True)
class MetricRecord:
    """A metric and how its values are printed."""

    name: Name = told("its name, unique in a run")
    title: str = told("its name for readers")
    signature: Key = told("everything that decides its value")
    higher_is_better: bool = told("which way is better")
    unit: str = told("its unit, empty for a ratio")
    latex: str = told("its column header in LaTeX")
    decimals: Decimals = told("how many decimals are printed")

    @property
    def arrow(self) -> str:
        """Which way is better, beside its title."""
        return "↑" if self.higher_is_better else "↓"


@dataclass(frozen=True, slots=True)
class ColumnRecord:
    """A group of scored frames that answers one question."""

    name: Name = told("its name, unique in a protocol")
    title: str = told("its name for readers")
    queries: tuple[Key, ...] = told("the keys of its frames: subject/pose/camera/light")
    subjects: str | tuple[str, ...] = told("trained, unseen, or names of subjects", default=())
    shares: tuple[str, ...] = told("what its frames have in common with training on purpose", default=())

    def __post_init__(self) -> None:
        for place, query in enumerate(self.queries):
            if query.count("/") < 3:
                raise Misfit(f"is {json.dumps(query)}, not subject/pose/camera/light", f"queries[{place}]")
        _unique("queries", self.queries)


@dataclass(frozen=True, slots=True)
class PublishedRecord:
    """What a paper prints for a method."""

    method: str = told("the method's name; it need not be registered")
    title: str = told("its name for readers")
    source: str = told("where it is printed")
    values: dict[str, tuple[float | None, ...]] = told("by column, in the order of the protocol's metrics")
    marker: str = told("the paper's own mark of the row", default="")


@dataclass(frozen=True, slots=True)
class ProtocolRecord:
    """The protocol of a run, with the frames it selected."""

    name: Name = told("its name")
    version: int = told("its version")
    title: str = told("its name for readers")
    digest: str = told("of everything in it that decides a score")
    columns: tuple[ColumnRecord, ...] = told("its columns, in order")
    metrics: tuple[MetricRecord, ...] = told("its metrics, in order")
    summary: str = told("what it asks", default="")
    trained: tuple[str, ...] = told("subjects that training sees", default=())
    unseen: tuple[str, ...] = told("subjects that training does not see", default=())
    aggregation: tuple[str, ...] = told("what values are averaged over, in order", default=())
    published: tuple[PublishedRecord, ...] = told("published rows", default=())
    published_note: str = told("what must be known of published rows", default="")

    def __post_init__(self) -> None:
        _unique("columns", [column.name for column in self.columns])
        _unique("metrics", [metric.name for metric in self.metrics])
        _unique("metrics", [metric.signature for metric in self.metrics])
        if not self.columns or not self.metrics:
            raise Misfit("is empty", "metrics" if self.columns else "columns")
        for place, row in enumerate(self.published):
            for column, values in row.values.items():
                if len(values) != len(self.metrics):
                    told = f"holds {len(values)} values, not one for each of {len(self.metrics)} metrics"
                    raise Misfit(told, f"published[{place}].values.{json.dumps(column)}")

    @property
    def label(self) -> str:
        """ "quick@1"."""
        return f"{self.name}@{self.version}"


@dataclass(frozen=True, slots=True)
class RunRecord:
    """run.json: what the last run into a folder planned."""

    protocol: ProtocolRecord = told("the protocol")
    methods: tuple[MethodRecord, ...] = told("the methods, in the order of the tables")
    seeds: tuple[int, ...] = told("the seeds")
    capture: CaptureRecord = told("the data")
    cells: tuple[Name, ...] = told("the keys of the planned cells")
    provenance: Provenance = told("where the run comes from")
    subjects: tuple[str, ...] = told("the subjects", default=())
    seeds_of: dict[str, tuple[int, ...]] = told("the seeds of methods that have others", default_factory=dict)
    schema: int = told("version of this format", default=SCHEMA)

    def __post_init__(self) -> None:
        _unique("methods", [method.name for method in self.methods])
        _unique("seeds", self.seeds)
        _unique("cells", self.cells)

    def seeds_for(self, method: str) -> tuple[int, ...]:
        return self.seeds_of.get(method, self.seeds)

    def method(self, name: str) -> MethodRecord:
        return next(method for method in self.methods if method.name == name)


@dataclass(frozen=True, slots=True)
class ProtocolVersion:
    """The protocol that a cell is of."""

    name: str = told("its name")
    version: int = told("its version")
    digest: str = told("of everything in it that decides a score")
    title: str = told("its name for readers", default="")


@dataclass(frozen=True, slots=True)
class CellRecord:
    """cells/KEY.json: what one method on one subject with one seed measured."""

    key: Name = told("the cell's key, which is its file's name")
    method: MethodRecord = told("the method")
    subject: str = told("the subject")
    seed: int = told("the seed")
    metrics: tuple[Key, ...] = told("signatures of the metrics, in the order of the values")
    scores: tuple[ScoredFrame, ...] = told("every scored frame, once for each of its columns")
    times: CellTimes = told("what it took")
    cost: Cost = told("what it took of the machine beside time", default=Cost())
    predictions: dict[str, str] = told("SHA-256 of each kept picture, by frame", default_factory=dict)
    same_pixels: bool | None = told("whether pictures drawn twice were equal", default=None)
    error: str | None = told("the traceback of a method that crashed: it is tried again", default=None)
    laws: Laws = told("measured laws of light", default=Laws())
    skipped: dict[str, SkippedShare] = told("what was left out, by what it is", default_factory=dict)
    curve: tuple[CurvePoint, ...] = told("losses of personalising", default=())
    remarks: tuple[str, ...] = told("what a reader must know of the frames it was scored with", default=())
    prior: Name | None = told("the key of its training", default=None)
    drawing: Name | None = told("the key of its pictures: cells of one key differ in metrics alone", default=None)
    protocol: ProtocolVersion | None = told("the protocol", default=None)
    capture: CaptureRecord | None = told("the data", default=None)
    device: Hardware | None = told("the machine", default=None)
    provenance: Provenance | None = told("where it comes from", default=None)
    schema: int = told("version of the format it was written in", default=SCHEMA)

    def __post_init__(self) -> None:
        _unique("metrics", self.metrics)
        for place, frame in enumerate(self.scores):
            if len(frame.values) != len(self.metrics):
                told = f"holds {len(frame.values)} values, not one for each of {len(self.metrics)} metrics"
                raise Misfit(told, f"scores[{place}].values")
        _unique("scores", [(frame.column, frame.query) for frame in self.scores])

    @property
    def label(self) -> str:
        return f"{self.method.name} {self.subject} seed {self.seed}"

    def each(self) -> Iterator[tuple[ScoredFrame, str, float | None, str | None]]:
        """Every value: its frame, the signature of its metric, the value, and why there is none."""
        for frame in self.scores:
            for place, (signature, value) in enumerate(zip(self.metrics, frame.values, strict=True)):
                yield frame, signature, value, None if value is not None else frame.reasons[place]


@dataclass(frozen=True, slots=True)
class PriorRecord:
    """priors/KEY/train.json: a kept training."""

    method: str = told("the method")
    seed: int = told("the seed")
    train_s: Duration = told("seconds it took, earlier stopped tries included")
    files: dict[str, str] = told("SHA-256 of each file of the trained state", default_factory=dict)
    curve: tuple[CurvePoint, ...] = told("losses", default=())
    peak_mb: Amount | None = told("greatest resident memory meanwhile, in MiB", default=None)
    vram_mb: Amount | None = told("greatest memory that torch held on GPUs meanwhile, in MiB", default=None)
    energy_j: Amount | None = told("energy of the processors meanwhile, in joules (RAPL)", default=None)
    config: Json = told("the method's settings", default=None)
    schema: int = told("version of the format it was written in", default=SCHEMA)


def _unique(name: str, values: Any) -> None:
    if len(set(values)) < len(values):
        twice = next(value for place, value in enumerate(values) if value in values[:place])
        raise Misfit(f"holds {json.dumps(twice)} twice", name)
