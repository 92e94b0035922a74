"""Records of format version 1: a line for each value, pictures without digests, brought to today's form."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from .record import CellRecord, PriorRecord, RunRecord
from .schema import Misfit, shown

NOT_FINITE = "the value is not finite"
_TEXTS = ("column", "query", "kind", "metric")


def _old_cell(content: dict[str, Any]) -> dict[str, Any]:
    """A cell of version 1: a line for each value, pictures without digests."""
    given = content.get("scores")
    if not isinstance(given, list):
        raise Misfit("is no list", "scores")
    metrics, scores = table(given)
    own = content.get("predictions") == f"predictions/{content.get('key')}"
    pictures = {frame["query"]: "" for frame in scores} if own else {}
    told = {"metrics": metrics, "scores": scores, "predictions": pictures, "method": _old_method(content.get("method"))}
    return {**content, **told, **_old_curve(content)}


def _old_run(content: dict[str, Any]) -> dict[str, Any]:
    methods = content.get("methods")
    return {**content, "methods": [_old_method(each) for each in methods]} if isinstance(methods, list) else content


def _old_method(method: Any) -> Any:
    """A method, whose role was told by other fields before there was one."""
    if not isinstance(method, dict) or "role" in method:
        return method
    calibrates = method.get("truth") is True or str(method.get("fidelity")).startswith("calibration")
    return {**method, "role": "calibration" if calibrates else "method"}


def table(given: list[Any]) -> tuple[list[str], list[dict[str, Any]]]:
    """Lines of one value each as the metrics and scored frames of a cell, as JSON values."""
    metrics: dict[str, int] = {}
    frames: dict[tuple[str, str], tuple[str, dict[int, tuple[float | None, str | None]]]] = {}
    for place, each in enumerate(given):
        try:
            column, query, kind, metric = _texts(each)
            number = metrics.setdefault(metric, len(metrics))
            _, values = frames.setdefault((column, query), (kind, {}))
            if number in values:
                raise Misfit("is there twice")
            values[number] = _value(each.get("value"), each.get("reason"))
        except Misfit as misfit:
            raise misfit.within(place).within("scores") from None
    lost = (None, "not in the record")
    rows = []
    for (column, query), (kind, values) in frames.items():
        pairs = [values.get(number, lost) for number in range(len(metrics))]
        reasons = [reason for _, reason in pairs]
        row = {"column": column, "query": query, "kind": kind, "values": [value for value, _ in pairs]}
        rows.append({**row, "reasons": reasons if any(reasons) else []})
    return list(metrics), rows


def _texts(score: Any) -> list[str]:
    if not isinstance(score, dict):
        raise Misfit(f"is {shown(score)}, not an object")
    for name in _TEXTS:
        if type(score.get(name)) is not str:
            raise Misfit(f"is {shown(score.get(name))}, not a text", name)
    return [score[name] for name in _TEXTS]


def _value(value: Any, reason: Any) -> tuple[float | None, str | None]:
    """A value or a reason, never both: what is not finite is no value."""
    if value is not None and type(value) not in (int, float):
        raise Misfit(f"is {shown(value)}, not a number", "value")
    if reason is not None and type(reason) is not str:
        raise Misfit(f"is {shown(reason)}, not a text", "reason")
    if value is None and reason is None:
        raise Misfit("needs either a value or a reason")
    if type(value) is float and not math.isfinite(value):
        return None, reason or NOT_FINITE
    return value, reason if value is None else None


def _old_prior(content: dict[str, Any]) -> dict[str, Any]:
    return {**content, **_old_curve(content)}


def _old_curve(content: dict[str, Any]) -> dict[str, Any]:
    """A training's losses with their names apart from the step."""
    points = content.get("curve", [])
    if not isinstance(points, list):
        return {}
    apart = [
        {"step": point.get("step"), "values": {name: value for name, value in point.items() if name != "step"}}
        if isinstance(point, dict)
        else point
        for point in points
    ]
    return {"curve": apart}


UPGRADES: dict[type, Callable[[dict[str, Any]], dict[str, Any]]] = {
    RunRecord: _old_run,
    CellRecord: _old_cell,
    PriorRecord: _old_prior,
}
