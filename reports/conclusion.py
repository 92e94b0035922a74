"""What a table says in a few sentences: who is best, by how much, for whom that holds, and at what cost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from handbench.results.record import MetricRecord
from handbench.results.statistics import CONFIDENCE, least_p

from .cost import Span
from .model import LIGHT_TITLES, MetricColumn, Row, Table, counted
from .printed import duration, listed, number

_COLUMNS_TOLD = 4  # of a shared lead, by name


@dataclass(frozen=True)
class Conclusion:
    """`best`: who wins by the first metric, and by how much. `claim`: for whom that holds. `cost`: what it takes.
    `warnings`: what a reader must know before any of it. Each a sentence or more, "" where there is nothing to say."""

    best: str
    claim: str = ""
    cost: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        return tuple(filter(None, (self.best, self.claim, self.cost, *self.warnings)))


def conclusion(table: Table) -> Conclusion:
    """What the rows say, by the first metric of the protocol; the others are counted beside it."""
    methods = [row for row in table.rows if row.kind == "method"]
    warnings = tuple(_warnings(table, methods))
    if not methods:
        return Conclusion(
            "No method was run beside the calibration rows, so there is nothing to compare.", "", "", warnings
        )
    first = _first(table)
    leaders = _leaders(table)
    metric = table.metrics[0].title
    if not leaders:
        return Conclusion(
            f"No method can be called best by {metric}: none is above the floor on every frame.", "", "", warnings
        )
    if len(methods) == 1:
        return Conclusion(
            f"{methods[0].title} stands alone: there is no method to compare it with.", _scope(table), "", warnings
        )
    found = _wins(table, leaders[0])
    where = f"{_of(len(found), len(first))} by {metric}"
    if len(leaders) > 1:
        names = listed([row.title for row in leaders])
        shared = f"{names} share the lead: each is best, alone or with others, in {where}."
        return Conclusion(f"{shared}{_highest(table, methods)}", _scope(table), _costs(table, leaders), warnings)
    (leader,) = leaders
    best = f"{leader.title} is best in {where}{_ahead(table, methods, leader, found)}"
    return Conclusion(
        f"{best}.{_others(table, leader)}",
        _claim(table, methods, leader, found),
        _cost(table, methods, leader, found[0]),
        warnings,
    )


def leader(table: Table) -> Row | None:
    """The method that the conclusion is about, which pages show first: of several that are best equally often by the
    first metric the one that is best more often by all, then the first. None where no method is best anywhere."""
    leaders = _leaders(table)
    return max(leaders, key=lambda row: sum(cell.rank == 1 for cell in row.cells), default=None)


def _first(table: Table) -> list[int]:
    """The positions of the first metric's columns."""
    return [table.of_group(group)[0] for group in table.groups]


def _wins(table: Table, row: Row) -> list[int]:
    """The columns of the first metric in which a row is best, alone or with others."""
    return [i for i in _first(table) if row.cells[i].rank == 1]


def _leaders(table: Table) -> list[Row]:
    """The methods that are best in most columns by the first metric; none where nothing is best."""
    methods = [row for row in table.rows if row.kind == "method"]
    most = max((len(_wins(table, row)) for row in methods), default=0)
    return [row for row in methods if most and len(_wins(table, row)) == most]


def _of(count: int, all_of: int) -> str:
    """ "all 4 columns", "both columns", "3 of 4 columns", "the one column"."""
    if all_of == 1:
        return "the one column"
    return (
        {2: "both columns"}.get(all_of, f"all {all_of} columns") if count == all_of else f"{count} of {all_of} columns"
    )


def _next(methods: Sequence[Row], leader: Row | None, index: int, column: MetricColumn) -> Row | None:
    """The best of the other methods in a column."""
    sign = 1.0 if column.metric.higher_is_better else -1.0
    others = [row for row in methods if row is not leader and row.cells[index].complete]
    return max(others, key=lambda row: sign * (row.cells[index].value or 0.0), default=None)


def _ahead(table: Table, methods: Sequence[Row], leader: Row, found: Sequence[int]) -> str:
    """ ", by 1.52 to 3.30 dB over the next", and in how many columns the mark is shared."""
    gaps = []
    for index in found:
        if (other := _next(methods, leader, index, table.columns[index])) is not None:
            sign = 1.0 if table.columns[index].metric.higher_is_better else -1.0
            gaps.append(sign * ((leader.cells[index].value or 0.0) - (other.cells[index].value or 0.0)))
    shared = len(_shared(methods, leader, found))
    told = _range_of(gaps, table.columns[found[0]].metric) if gaps else ""
    return told + (f"; in {shared} of them another method cannot be told from it" if shared else "")


def _range_of(gaps: Sequence[float], metric: MetricRecord) -> str:
    """How far ahead: a method that shares its mark may have the lower value of the two."""
    low, high = (f"{number(abs(bound), metric.decimals)} {metric.unit}".rstrip() for bound in (min(gaps), max(gaps)))
    if min(gaps) >= 0:
        least = number(min(gaps), metric.decimals)
        return f", by {high if low == high else f'{least} to {high}'} over the next"
    if max(gaps) <= 0:
        return f", {low if low == high else f'up to {low}'} behind the highest value"
    return f", from {low} behind to {high} ahead of the best of the others"


def _shared(methods: Sequence[Row], leader: Row, found: Sequence[int]) -> list[int]:
    """The columns in which another method is best too."""
    return [i for i in found if any(row.cells[i].rank == 1 for row in methods if row is not leader)]


def _highest(table: Table, methods: Sequence[Row]) -> str:
    """Whose value is ahead in each column, where that answers more than marks that several methods share."""
    parts = []
    for index in _first(table):
        column = table.columns[index]
        able = [row for row in methods if row.cells[index].complete and not row.cells[index].sunk]
        if (front := _next(able, None, index, column)) is None:
            continue
        other = _next(able, front, index, column)
        gap = None if other is None else abs((front.cells[index].value or 0.0) - (other.cells[index].value or 0.0))
        by = number(gap, column.metric.decimals)
        if other is None:
            ahead = front.title
        elif float(by) == 0.0:
            ahead = f"{front.title} and {other.title} level"
        else:
            ahead = f"{front.title} by {by} {column.metric.unit}".rstrip() + f" over {other.title}"
        parts.append(f"{ahead} in {column.group.title}")
    return f" Ahead: {'; '.join(parts)}." if 0 < len(parts) <= _COLUMNS_TOLD else ""


def _others(table: Table, leader: Row) -> str:
    """How it fares by the other metrics."""
    rest = [i for i, column in enumerate(table.columns) if column.metric != table.metrics[0]]
    if not rest:
        return ""
    won = [i for i in rest if leader.cells[i].rank == 1]
    shared = len(_shared([row for row in table.rows if row.kind == "method"], leader, won))
    beside = f", {shared} of them with others" if shared else ""
    return f" By the other metrics it is best in {len(won)} of {counted(len(rest), 'value')}{beside}."


def _scope(table: Table) -> str:
    """On what it was measured: "2 to 4 subjects and 28 frames a column, one seed: it tells of these weights."."""
    subjects, frames = ([getattr(group, name) for group in table.groups] for name in ("subjects", "frames"))
    seeds = "one seed: it tells of these weights" if len(table.seeds) == 1 else f"{len(table.seeds)} seeds"
    return f"Measured on {_range(subjects, 'subject')} and {_range(frames, 'frame')} a column, {seeds}."


def _range(counts: Sequence[int], noun: str) -> str:
    low, high = min(counts), max(counts)
    return counted(low, noun) if low == high else f"{low} to {counted(high, noun)}"


def _claim(table: Table, methods: Sequence[Row], leader: Row, found: Sequence[int]) -> str:
    """Whether the lead can be claimed for other hands: the answer of the corrected paired test."""
    claimed = [i for i in found if leader.cells[i].claimed]
    alone = len(claimed) == len(found)
    if claimed:
        where = "in each of them" if alone else f"in {len(claimed)} of these {len(found)}"
        over = " over those that come after" if _shared(methods, leader, found) else ""
        test = "paired test over subjects, p ≤ 0.05 after correction"
        told = f"The lead{over} holds for other hands too {where} ({test})."
    else:
        rivals = {i: sum(row.cells[i].complete and not row.cells[i].sunk for row in methods) - 1 for i in found}
        tested = [(table.columns[i].group.subjects, count) for i, count in rivals.items() if count]
        least, subjects = min(((min(least_p(n) * count, 1.0), n) for n, count in tested), default=(0.0, 0))
        why = "p is above 0.05" if tested else "no other method is above the floor on every frame"
        if least > 1 - CONFIDENCE + 1e-9:
            why = f"with {counted(subjects, 'subject')} p cannot fall below {least:.2g}"
        told = (
            f"It holds for these hands; it cannot be claimed for others (paired test over subjects, corrected: {why})."
        )
    return f"{_scope(table)} {told}"


def _cost(table: Table, methods: Sequence[Row], leader: Row, index: int) -> str:
    """What it takes: time of a frame beside the next best, training, memory."""
    kind = table.timed_kind
    own = leader.times.new_pose_ms.get(kind)
    parts = []
    if own is not None:
        parts.append(f"{duration(own)} ms for a new pose under {LIGHT_TITLES[kind]}")
        other = _next(methods, leader, index, table.columns[index])
        theirs = other.times.new_pose_ms.get(kind) if other else None
        if other is not None and theirs is not None and theirs.median > 0:
            parts[-1] += f", {_times(own.median / theirs.median)} {other.title}"
    if (train := leader.times.train_s) is not None:
        parts.append(f"{_clock(train)} of training")
    if (memory := leader.footprint.memory_mb) is not None:
        parts.append(f"{memory.median / 1024:.1f} GiB of memory while drawing")
    return f"It takes {listed(parts)}." if parts else ""


def _costs(table: Table, rows: Sequence[Row]) -> str:
    """What each of several takes: "A new pose under an environment, and training: PALM-Net 651 ms, 21.1 min; …"."""
    kind = table.timed_kind
    costs = ((row.title, row.times.new_pose_ms.get(kind), row.times.train_s) for row in rows)
    parts = [f"{title} {duration(own)} ms, {_clock(train)}" for title, own, train in costs if own and train]
    return f"A new pose under {LIGHT_TITLES[kind]}, and training: {'; '.join(parts)}." if parts else ""


def _times(ratio: float) -> str:
    if 0.95 <= ratio <= 1.05:
        return "as long as"
    return f"{ratio:.2g} × as long as" if ratio > 1 else f"{1 / ratio:.2g} × as fast as"


def _clock(span: Span) -> str:
    seconds = span.median
    if seconds < 90:
        return f"{duration(span)} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _warnings(table: Table, methods: Sequence[Row]) -> Iterator[str]:
    floors = listed([row.title for row in table.rows if row.floor]) if any(row.floor for row in table.rows) else ""
    sunk = {row.title: sum(cell.sunk for cell in row.cells) for row in methods}
    if told := [f"{title} in {count}" for title, count in sunk.items() if count]:
        of_all = counted(len(table.columns), "value")
        yield f"Not better than the floor ({floors}), of {of_all}: {listed(told)}. Such a value is never best."
    if elsewhere := [row.title for row in methods if not row.here]:
        yield f"Not trained or drawn here, only scored: {listed(elsewhere)}."
    gaps = [row.title for row in methods if any(not cell.complete for cell in row.cells)]
    if gaps:
        yield f"Without a value for some frames, so never best there: {listed(gaps)}."
