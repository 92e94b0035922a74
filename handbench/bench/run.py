"""Run a protocol: every cell that is not in the run folder yet."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from ..data.capture import Capture
from ..errors import InputError
from ..method import Method
from ..registry import CAPTURES, METHODS, METRICS, PROTOCOLS
from .plan import Cell, Plan, make_plan
from .progress import Steps, steps
from .protocol import Protocol, Published, Selected
from .store import SCHEMA, Store


@dataclass(frozen=True)
class Outcome:
    """What a run did: `computed` and `reused` count cells, `crashed` names those whose method crashed, and why."""

    folder: Path
    computed: int
    reused: int
    crashed: tuple[str, ...]


def find_protocol(name: str) -> Protocol:
    """A registered protocol, or the one in a TOML file. Raises `InputError` for an unknown name or a bad file."""
    if name.endswith(".toml"):
        return importlib.import_module(PROTOCOLS.package).load(Path(name))
    return PROTOCOLS.load(name)


def run(
    protocol: Protocol,
    methods: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    preset: str | None = None,
    out: Path | None = None,
    data: Path | None = None,
    command: Iterable[str] = (),
) -> Outcome:
    """Compute the missing cells of a protocol into `out` (default: runs/<protocol>) and say what was done.

    A finished cell is never computed again while nothing that decides it changed; a cell whose method crashed is
    tried again. A method's failure becomes the reason of its scores and stops no other cell. Raises `InputError`
    for what the user can mend and `StorageError` when the run folder cannot be written; finished cells stay.
    """
    methods = None if methods is None else tuple(methods)
    store = Store(out or Path("runs") / protocol.name)
    # What is mistyped is told before a capture is generated; what this folder has run before is not loaded to know.
    presets = {name: preset or protocol.preset_of(name) for name in methods or protocol.methods}
    for name in presets:
        METHODS.entry(name)
    tools = None if _known(store, protocol, presets) else _make_tools(protocol, presets)
    store.prepare()
    with steps() as told:
        source = CAPTURES.load(protocol.capture)
        capture = source(size=protocol.size, folder=data, progress=told(f"capture {protocol.capture} {protocol.size}"))
        plan = make_plan(protocol, capture.digest, methods, seeds, preset)
        missing = [cell for cell in plan.cells if not _finished(store.cell(cell.key))]
        if missing or not _refresh(store, plan):
            tools = tools or _make_tools(protocol, presets)
            _compute(plan, missing, tools, capture, store, list(command) or sys.argv, told)
    crashed = tuple(_crash(store.cell(cell.key), cell) for cell in plan.cells if not _finished(store.cell(cell.key)))
    return Outcome(store.folder, len(missing), len(plan.cells) - len(missing), crashed)


@dataclass(frozen=True)
class _Tools:
    """Methods by name and metrics by signature, made."""

    methods: dict[str, Method]
    metrics: dict[str, Any]
    metrics_module: ModuleType


def _make_tools(protocol: Protocol, presets: dict[str, str]) -> _Tools:
    module = importlib.import_module(METRICS.package)
    metrics = {metric.signature: metric for metric in map(module.metric, protocol.metrics)}
    if len(metrics) < len(protocol.metrics):
        raise InputError(f"protocol {protocol.label}: two metrics have one signature; keep one of them")
    methods = {name: METHODS.load(name)(preset=preset) for name, preset in presets.items()}
    return _Tools(methods, metrics, module)


def _known(store: Store, protocol: Protocol, presets: dict[str, str]) -> bool:
    """Whether the folder's last run had the same metrics, methods and presets."""
    told = store.run()
    if told is None or told["protocol"]["digest"] != protocol.digest:
        return False
    return presets.items() <= {method["name"]: method["preset"] for method in told["methods"]}.items()


def _finished(cell: dict[str, Any] | None) -> bool:
    return cell is not None and cell["error"] is None


def _crash(cell: dict[str, Any] | None, planned: Cell) -> str:
    reasons = [score["reason"] for score in cell["scores"] if score["reason"]] if cell else ["not computed"]
    return f"{planned.method} {planned.subject} seed {planned.seed}: {reasons[0]}"


def _refresh(store: Store, plan: Plan) -> bool:
    """Whether run.json already tells this plan; a changed title is brought up to date without loading anything."""
    told = store.run()
    if told is None or told["cells"] != [cell.key for cell in plan.cells]:
        return False
    now = {**_about_protocol(plan.protocol), "metrics": told["protocol"]["metrics"]}
    for column, before in zip(now["columns"], told["protocol"]["columns"], strict=True):
        column["queries"] = before["queries"]
    if now != told["protocol"]:
        store.write_run({**told, "protocol": now})
    return True


def _compute(
    plan: Plan, missing: list[Cell], tools: _Tools, capture: Capture, store: Store, command: list[str], told: Steps
) -> None:
    from .cell import Bench, CaptureReader, compute
    from .priors import Priors
    from .protocol import resolve
    from .provenance import provenance

    selected = resolve(plan.protocol, capture.frames())
    origin = provenance(command)
    store.write_run(_about_run(plan, tools, selected, origin))
    reader, priors = CaptureReader(capture), Priors(store)
    bench = Bench(plan.protocol, selected, reader, store, priors, tools.metrics, tools.metrics_module)
    overall = told("all cells")
    for i, cell in enumerate(missing):
        if not _finished(store.cell(cell.key)):  # another process may have been here
            method = tools.methods[cell.method]
            result = compute(bench, cell, method, told)
            store.write_cell({**_about_cell(plan, cell, method), "provenance": origin, **result})
            store.remove_checkpoints(cell.key)
        overall(i + 1, len(missing))


def _about_cell(plan: Plan, cell: Cell, method: Method) -> dict[str, Any]:
    from .provenance import device

    protocol = plan.protocol
    return {
        "schema": SCHEMA,
        "key": cell.key,
        "protocol": {
            "name": protocol.name,
            "version": protocol.version,
            "digest": protocol.digest,
            "title": protocol.title,
        },
        "method": _about_method(cell, method),
        "subject": cell.subject,
        "seed": cell.seed,
        "capture": _about_capture(plan),
        "prior": cell.prior,
        "device": device(),
    }


def _about_capture(plan: Plan) -> dict[str, Any]:
    """The registered name and size, with which a report can open the capture again, and what it then must be."""
    return {"name": plan.protocol.capture, "size": plan.protocol.size, "digest": plan.capture_digest}


def _about_method(cell: Cell, method: Method) -> dict[str, Any]:
    info = {**asdict(method.info), "name": cell.method, "lights": sorted(method.info.lights)}
    return {**info, "preset": cell.preset, "config": method.config}


def _about_protocol(protocol: Protocol) -> dict[str, Any]:
    columns = [
        {
            "name": c.name,
            "title": c.title,
            "subjects": c.subjects if isinstance(c.subjects, str) else list(c.subjects),
            "shares": list(c.shares),
        }
        for c in protocol.columns
    ]
    return {
        "name": protocol.name,
        "version": protocol.version,
        "title": protocol.title,
        "summary": protocol.summary,
        "digest": protocol.digest,
        "trained": list(protocol.trained),
        "unseen": list(protocol.unseen),
        "aggregation": list(protocol.aggregation),
        "columns": columns,
        "published": [_about_published(protocol, row) for row in protocol.published],
        "published_note": protocol.published_note,
    }


def _about_published(protocol: Protocol, row: Published) -> dict[str, Any]:
    """A published row; a column's values stand in the order of the protocol's metrics, None where there is none."""
    values: dict[str, list[float | None]] = {}
    for column, metric, value in row.values:
        of_column = values.setdefault(column, [None] * len(protocol.metrics))
        of_column[protocol.metrics.index(metric)] = value
    return {
        "method": row.method,
        "title": row.title,
        "marker": row.marker,
        "source": row.source,
        "values": values,
    }


def _about_run(plan: Plan, tools: _Tools, selected: Selected, origin: dict[str, Any]) -> dict[str, Any]:
    names = ("name", "title", "signature", "higher_is_better", "unit", "latex", "decimals")
    protocol = _about_protocol(plan.protocol)
    protocol["metrics"] = [{name: getattr(metric, name) for name in names} for metric in tools.metrics.values()]
    for column in protocol["columns"]:
        column["queries"] = [frame.key for frame in selected.scored[column["name"]]]
    firsts = {cell.method: cell for cell in reversed(plan.cells)}
    return {
        "schema": SCHEMA,
        "protocol": protocol,
        "methods": [_about_method(firsts[name], tools.methods[name]) for name in plan.methods],
        "seeds": list(plan.seeds),
        "subjects": list(plan.protocol.subjects),
        "capture": _about_capture(plan),
        "cells": [cell.key for cell in plan.cells],
        "provenance": origin,
        "command": origin["command"],
    }
