"""What is told on disk of a plan, a protocol, a method and a cell: the JSON values of run.json and of cell files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ..method import Method
from .plan import Cell, Plan
from .protocol import Protocol, Published, Selected
from .provenance import device
from .store import SCHEMA


def about_run(
    plan: Plan,
    methods: Mapping[str, Method],
    metrics: Mapping[str, Any],
    selected: Selected,
    origin: dict[str, Any],
) -> dict[str, Any]:
    """The content of run.json; `metrics` are by signature, `origin` is the provenance of the run."""
    names = ("name", "title", "signature", "higher_is_better", "unit", "latex", "decimals")
    protocol = about_protocol(plan.protocol)
    protocol["metrics"] = [{name: getattr(metric, name) for name in names} for metric in metrics.values()]
    for column in protocol["columns"]:
        column["queries"] = [frame.key for frame in selected.scored[column["name"]]]
    firsts = {cell.method: cell for cell in reversed(plan.cells)}
    return {
        "schema": SCHEMA,
        "protocol": protocol,
        "methods": [_about_method(firsts[name], methods[name]) for name in plan.methods],
        "seeds": list(plan.seeds),
        "subjects": list(plan.protocol.subjects),
        "capture": _about_capture(plan),
        "cells": [cell.key for cell in plan.cells],
        "provenance": origin,
        "command": origin["command"],
    }


def about_cell(plan: Plan, cell: Cell, method: Method, origin: dict[str, Any]) -> dict[str, Any]:
    """What a cell's file says beside its results."""
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
        "provenance": origin,
    }


def about_protocol(protocol: Protocol) -> dict[str, Any]:
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


def _about_capture(plan: Plan) -> dict[str, Any]:
    """The registered name and size, with which a report can open the capture again, and what it then must be."""
    return {"name": plan.protocol.capture, "size": plan.protocol.size, "digest": plan.capture_digest}


def _about_method(cell: Cell, method: Method) -> dict[str, Any]:
    info = {**asdict(method.info), "name": cell.method, "lights": sorted(method.info.lights)}
    return {**info, "preset": cell.preset, "config": method.config}
