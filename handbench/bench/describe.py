"""What is told on disk of a plan, a protocol, a method and a cell: their records."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..method import Method
from ..results.origin import Provenance
from ..results.record import (
    CaptureRecord,
    CellRecord,
    ColumnRecord,
    MethodRecord,
    MetricRecord,
    ProtocolRecord,
    ProtocolVersion,
    PublishedRecord,
    RunRecord,
)
from ..results.schema import plain, read
from .given import enrolled_with
from .plan import Cell, Plan
from .protocol import Protocol, Published
from .provenance import device
from .resolving import Selected

if TYPE_CHECKING:
    from .cell import CellMeasurement


def run_record(
    plan: Plan, methods: Mapping[str, Method], metrics: Mapping[str, Any], selected: Selected, origin: Provenance
) -> RunRecord:
    """run.json of a plan; `metrics` are by signature."""
    queries = {name: tuple(frame.key for frame in frames) for name, frames in selected.scored.items()}
    firsts = {cell.method: cell for cell in reversed(plan.cells)}
    return RunRecord(
        protocol_record(plan.protocol, tuple(map(_metric, metrics.values())), queries),
        tuple(
            method_record(firsts[name], methods[name], enrolled_with(selected, methods[name].info))
            for name in plan.methods
        ),
        plan.seeds,
        _capture(plan),
        tuple(cell.key for cell in plan.cells),
        origin,
        plan.protocol.subjects,
    )


def cell_record(
    plan: Plan,
    cell: Cell,
    method: Method,
    selected: Selected,
    metrics: Iterable[str],
    origin: Provenance,
    measured: CellMeasurement,
) -> CellRecord:
    """The file of a cell; `metrics` are signatures."""
    protocol = plan.protocol
    record = CellRecord(
        key=cell.key,
        method=method_record(cell, method, enrolled_with(selected, method.info, cell.subject)),
        subject=cell.subject,
        seed=cell.seed,
        metrics=tuple(metrics),
        prior=cell.prior,
        drawing=cell.drawing or None,
        protocol=ProtocolVersion(protocol.name, protocol.version, protocol.digest, protocol.title),
        capture=_capture(plan),
        device=device(),
        provenance=origin,
        **vars(measured),
    )
    return read(CellRecord, json.loads(json.dumps(plain(record), allow_nan=False)))  # checked, as it will be read


def protocol_record(
    protocol: Protocol, metrics: tuple[MetricRecord, ...], queries: Mapping[str, tuple[str, ...]]
) -> ProtocolRecord:
    """A protocol with its metrics and the queries of its columns."""
    return ProtocolRecord(
        protocol.name,
        protocol.version,
        protocol.title,
        protocol.digest,
        tuple(ColumnRecord(c.name, c.title, queries[c.name], c.subjects, tuple(c.shares)) for c in protocol.columns),
        metrics,
        protocol.summary,
        protocol.trained,
        protocol.unseen,
        protocol.aggregation,
        tuple(_published(protocol, row) for row in protocol.published),
        protocol.published_note,
    )


def method_record(cell: Cell, method: Method, enrolment: str = "") -> MethodRecord:
    """A method as a cell has it, with what enrolment gave it; its title tells changed settings."""
    changed = ", ".join(f"{name}={value}" for name, value in cell.changes)
    title = f"{method.info.title} ({changed})" if changed else method.info.title
    info = {**method.info.said, "name": cell.method, "title": title, "enrolment": enrolment}
    return read(MethodRecord, plain({**info, "preset": cell.preset, "config": method.config}))


def _metric(metric: Any) -> MetricRecord:
    about = (metric.name, metric.title, metric.signature, metric.higher_is_better)
    return MetricRecord(*about, metric.unit, metric.latex, metric.decimals)


def _published(protocol: Protocol, row: Published) -> PublishedRecord:
    """A published row; a column's values stand in the order of the protocol's metrics, None where there is none."""
    values: dict[str, list[float | None]] = {}
    for column, metric, value in row.values:
        of_column = values.setdefault(column, [None] * len(protocol.metrics))
        of_column[protocol.metrics.index(metric)] = value
    told = {column: tuple(of_column) for column, of_column in values.items()}
    return PublishedRecord(row.method, row.title, row.source, told, row.marker)


def _capture(plan: Plan) -> CaptureRecord:
    """The registered name and size, with which a report can open the capture again, and what it then must be."""
    return CaptureRecord(plan.protocol.capture, plan.capture_digest, plan.protocol.size)
