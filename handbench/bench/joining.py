"""What earlier commands planned in a run folder stays in its tables beside what a new one plans."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from ..results.record import CellRecord, MethodRecord, RunRecord


@dataclass(frozen=True)
class Joined:
    """The plan that run.json tells; `gone` names what leaves the table, and why. Its cells stay in the folder."""

    record: RunRecord
    gone: tuple[str, ...] = ()


def joined(
    now: RunRecord,
    before: RunRecord | None,
    cell: Callable[[str], CellRecord | None],
    today: Collection[str],
) -> Joined:
    """A new plan with the finished cells of an earlier one of the same protocol version and data.

    now, before   the plans
    cell          a finished cell by its key
    today         keys that cells of `now`'s methods with `before`'s seeds have today: others were made by other code or
                  with other settings, and leave the table
    """
    if before is None or set(before.cells) <= set(now.cells):
        return Joined(now)
    if why := _apart(now, before):
        return Joined(now, gone=tuple(f"{method.name} ({why})" for method in before.methods))
    names = {method.name for method in now.methods}
    found = {key: record for key in before.cells if key not in now.cells and (record := cell(key)) is not None}
    staying = {key: each for key, each in found.items() if each.method.name not in names or key in today}
    seeds: dict[str, set[int]] = {name: set(now.seeds) for name in names}
    for each in staying.values():
        seeds.setdefault(each.method.name, set()).add(each.seed)
    more = [method for method in before.methods if method.name not in names and method.name in seeds]
    others = {name: tuple(sorted(own)) for name, own in seeds.items() if own != set(now.seeds)}
    leaving = {f"{each.method.name} seed {each.seed}" for key, each in found.items() if key not in staying}
    gone = tuple(f"{each} (made by other code or settings)" for each in sorted(leaving))
    joined = replace(
        now,
        methods=_ordered(before, [*now.methods, *more]),
        cells=(*now.cells, *staying),
        seeds_of=others,
        subjects=tuple(dict.fromkeys((*now.subjects, *before.subjects))),
    )
    return Joined(joined, gone)


def kept(told: RunRecord, methods: Collection[str]) -> tuple[str, ...]:
    """The rows of a folder that a command with these methods did not ask for: "phong (seeds 0, 1)"."""
    return tuple(_label(method, told.seeds_for(method.name)) for method in told.methods if method.name not in methods)


def _apart(now: RunRecord, before: RunRecord) -> str:
    """Why two plans cannot share a table, "" if they can."""
    if now.protocol.digest != before.protocol.digest:
        return f"of {before.protocol.label}, another version or other settings of it"
    if now.capture.digest != before.capture.digest:
        return "of other data"
    signatures = [{metric.signature for metric in plan.protocol.metrics} for plan in (now, before)]
    return "by other metrics" if signatures[0] != signatures[1] else ""


def _ordered(before: RunRecord, methods: list[MethodRecord]) -> tuple[MethodRecord, ...]:
    """In the order of the earlier plan, with new ones after it."""
    places = {method.name: place for place, method in enumerate(before.methods)}
    return tuple(sorted(methods, key=lambda method: places.get(method.name, len(places))))


def _label(method: MethodRecord, seeds: Collection[int]) -> str:
    return f"{method.name} (seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, sorted(seeds)))})"
