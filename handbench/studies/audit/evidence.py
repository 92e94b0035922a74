"""What an audit looks at: a run folder, and the protocol, capture, methods and metrics that it names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from ...bench.cell import Bench
from ...bench.opening import select
from ...bench.plan import Plan, make_plan
from ...bench.priors import Priors
from ...bench.progress import steps
from ...bench.protocol import Protocol
from ...bench.reader import CaptureReader
from ...bench.reopening import capture_of, changes_of, protocol_of
from ...bench.resolving import Selected
from ...bench.store import Store
from ...data.capture import Capture
from ...registry import METHODS
from ...results.reading import read_run
from ...results.record import CellRecord, MethodRecord, RunRecord
from ...scene import Frame, Prediction

if TYPE_CHECKING:
    from ...metrics import Metric, Pair

Tables: TypeAlias = Callable[[Path], Any]


@dataclass(frozen=True)
class Evidence:
    """A run as it lies on disk (`plan` is run.json, `cells` those of the plan that are there), and what it names."""

    store: Store
    plan: RunRecord
    cells: tuple[CellRecord, ...]
    protocol: Protocol
    capture: Capture
    tables: Tables

    @cached_property
    def frames(self) -> dict[str, Frame]:
        """Every frame of the capture by its key."""
        return {frame.key: frame for frame in self.capture.frames()}

    @cached_property
    def selected(self) -> Selected:
        """The protocol applied to the capture. Raises `InputError` as `resolve` does."""
        return select(self.protocol, self.capture)

    @cached_property
    def foreign(self) -> set[str]:
        """Methods that are not registered here: prediction folders, and plug-ins that are not installed."""
        return {method.name for method in self.plan.methods} - set(METHODS.entries())

    @cached_property
    def planned(self) -> dict[str, Plan]:
        """What this version of handbench would plan, by method: the same protocol, capture, preset, seeds, settings."""

        def plan(each: MethodRecord) -> Plan:
            seeds, changes = self.plan.seeds_for(each.name), changes_of(each)
            digest = self.capture.digest
            return make_plan(self.protocol, digest, [each.name], seeds, each.preset, changes=changes)

        return {each.name: plan(each) for each in self.plan.methods if each.name not in self.foreign}

    @cached_property
    def metrics(self) -> dict[str, Metric]:
        """The run's metrics by signature, made from the signature alone. Raises `InputError` for an unknown one."""
        from ...metrics import from_signature

        named = [metric.signature for metric in self.plan.protocol.metrics]
        return {signature: from_signature(signature) for signature in named}

    @cached_property
    def bench(self) -> Bench:
        """What the run's cells were computed with; its reader and its trainings are the audit's own."""
        reader = CaptureReader(self.capture)
        return Bench(self.protocol, self.selected, reader, self.store, Priors(self.store), self.metrics)

    @cached_property
    def table(self) -> Any:
        return self.tables(self.store.folder)

    def info(self, method: str) -> MethodRecord:
        return self.plan.method(method)

    def kept(self, cell: CellRecord, query: str) -> Prediction:
        """The picture that a cell kept of a query, in half floats. Raises `InputError` if it is missing or damaged."""
        return self.store.read_prediction(cell, query)

    def pair(self, frame: Frame, picture: Prediction) -> Pair:
        """A picture and the truth of its frame, for metrics."""
        from ...metrics import Pair

        return Pair.of(picture, self.bench.reader(frame), frame.mesh)


Check: TypeAlias = Callable[[Evidence], tuple[bool | None, str]]
"""Whether what is claimed holds (None: it cannot be told here), and what was found."""


def scored_queries(cell: CellRecord) -> list[str]:
    """The queries of a cell that have a value, so a kept picture, in the order of their keys."""
    return sorted({frame.query for frame in cell.scores if any(value is not None for value in frame.values)})


def gather(folder: Path, tables: Tables, protocol: str | None, data: Path | None) -> Evidence:
    """The evidence of a run; see `audit` for what is raised."""
    run = read_run(folder)
    found = protocol_of(run, protocol)
    with steps() as progress:
        capture = capture_of(run, found, data, progress)
    return Evidence(run.store, run.plan, run.cells, found, capture, tables)
