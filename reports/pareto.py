"""Time against score: which methods are worth their time, for each column, metric and kind of time.

A plot is laid out once, in units of its own box with y downwards, and drawn twice: as SVG in the page
(`templates/pareto.html`) and as PNG and PDF (`pareto_figures`). Better is always up and faster always left. The front
is made of the measured methods with complete coverage that no other one beats in both; its points are marked where
enrolment gave methods of the plot different things.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

from handbench.results.record import MetricRecord

from .model import ColumnGroup, Row, Table
from .places import Label, PlotBox, placed, width
from .printed import UNEQUAL, number

TIMES = {
    "known": "Known pose, new light, a frame",
    "new": "New pose, a frame",
    "training": "Training and one personalisation",
    "memory": "Greatest memory while drawing",
}
WIDTH, HEIGHT = 360, 240  # of a drawing
FRAME = PlotBox(46, 18, 332, 202)  # the plot in it; the text of the last time has room beside it
_MARGIN = 1.35  # how far the time axis goes beyond the points, as a factor
_NAMED = 8  # rows whose titles have room in a plot
_ROOM = 1.1  # of the widths of two times beside each other
_STEPS = ((1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8), (1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,))
Kind = Literal["front", "beaten", "gap", "calibration"]


@dataclass(frozen=True)
class ParetoPoint:
    """A row of the table with a time. kind "gap": its score misses frames, so it cannot be on the front.

    `low`, `high`: the 95 % interval of the score. `unequal`: it is on the front among methods to which enrolment gave
    something else. `number`: of its row, which stands for its title in a crowd; 0 where there is room for titles.
    """

    title: str
    seconds: float
    score: float
    kind: Kind
    enrolment: str = ""
    unequal: bool = False
    low: float | None = None
    high: float | None = None
    number: int = 0

    @property
    def label(self) -> str:
        """What stands beside the point: in a crowd only those on the front have their titles."""
        title = str(self.number) if self.number and self.kind != "front" else self.title
        return f"{title} {UNEQUAL}" if self.unequal else title

    @property
    def name(self) -> str:
        """The title with what enrolment gave."""
        title = f"{self.title} {UNEQUAL}" if self.unequal else self.title
        return f"{title} ({self.enrolment})" if self.enrolment else title


@dataclass(frozen=True)
class Plot:
    """`points` from fast to slow, `left_out`: what has no place in the plot, and why."""

    group: ColumnGroup
    metric: MetricRecord
    time: str
    points: tuple[ParetoPoint, ...]
    left_out: tuple[str, ...]

    @property
    def name(self) -> str:
        return f"{self.metric.name}-{self.time}-{self.group.name}"

    @property
    def upwards(self) -> str:
        """What the upright axis says."""
        unit = f" in {self.metric.unit}" if self.metric.unit else ""
        return f"{self.metric.title}{unit}, better is up"

    @property
    def front(self) -> tuple[ParetoPoint, ...]:
        return tuple(point for point in self.points if point.kind == "front")


@dataclass(frozen=True)
class PlotLayout:
    """A plot in its box: ticks with their texts, points with their labels, the corners of the front, and the ends of
    the points' intervals."""

    x_ticks: tuple[tuple[float, str], ...]
    y_ticks: tuple[tuple[float, str], ...]
    marks: tuple[tuple[ParetoPoint, float, float, Label], ...]
    front: tuple[tuple[float, float], ...]
    bars: Mapping[ParetoPoint, tuple[float, float]]


def plots(table: Table) -> tuple[Plot, ...]:
    """Metric by metric, time by time, column by column; without those in which no measured method has a time."""
    made = (_plot(table, metric, time, group) for metric in table.metrics for time in TIMES for group in table.groups)
    return tuple(plot for plot in made if any(point.kind != "calibration" for point in plot.points))


def seconds(row: Row, time: str, kind: str) -> float | None:
    """A row's time, of poses under a kind of light, or its memory in MiB; None if it was not measured."""
    times = row.times
    if time == "memory":
        held = row.footprint.memory_mb
        found = None if held is None else held.median
    elif time == "training":
        parts = [span.median for span in (times.train_s, times.personalise_s) if span is not None]
        found = sum(parts) if parts else None
    else:
        span = (times.known_pose_ms if time == "known" else times.new_pose_ms).get(kind)
        found = None if span is None else span.median / 1e3
    return found or None


def draw(plot: Plot) -> PlotLayout:
    """The plot laid out in a box of `WIDTH` by `HEIGHT`, its frame at `FRAME`."""
    low, high = _span(plot)
    first, last = (math.log10(f(p.seconds for p in plot.points)) for f in (min, max))
    first, last = first - math.log10(_MARGIN), last + math.log10(_MARGIN)

    def x(value: float) -> float:
        return FRAME.left + (math.log10(value) - first) / (last - first) * (FRAME.right - FRAME.left)

    def y(value: float) -> float:
        share = (value - low) / (high - low)
        up = share if plot.metric.higher_is_better else 1 - share
        return FRAME.bottom - up * (FRAME.bottom - FRAME.top)

    spots = [(x(point.seconds), y(point.score)) for point in plot.points]
    corners = tuple(_corners([(x(point.seconds), y(point.score)) for point in plot.front]))
    labels = placed([point.label for point in plot.points], spots, corners, FRAME)
    marks = tuple((point, *spot, label) for point, spot, label in zip(plot.points, spots, labels, strict=True))
    x_ticks = tuple((x(value), shown(plot, value)) for value in _times(plot, 10**first, 10**last))
    y_ticks = tuple((y(value), text) for value, text in _ticks(low, high))
    bars = {
        point: (y(max(point.low, low)), y(min(point.high, high)))
        for point in plot.points
        if point.low is not None and point.high is not None
    }
    return PlotLayout(x_ticks, y_ticks, marks, corners, bars)


def in_words(plot: Plot) -> str:
    """The plot in words, from fast to slow: for those who do not see it."""
    parts = []
    for point in plot.points:
        score = f"{number(point.score, plot.metric.decimals)} {plot.metric.unit}".strip()
        parts.append(f"{point.name}: {shown(plot, point.seconds)}, {score}{_WORDS[point.kind]}")
    return "; ".join(parts) + "."


def enrolments(found: Sequence[Plot]) -> str:
    """What enrolment gave the methods of plots: "fully lit views (Phong, URHand); one picture (HARP)"."""
    titles: dict[str, dict[str, None]] = {}
    for point in (point for plot in found for point in plot.points if point.kind != "calibration"):
        titles.setdefault(point.enrolment or "not told", {})[point.title] = None
    return "; ".join(f"{enrolment} ({', '.join(each)})" for enrolment, each in titles.items())


def numbered(found: Sequence[Plot]) -> str:
    """What the numbers of points in a crowd stand for: "3 Phong, 4 Physical BRDF", or nothing."""
    points = (point for plot in found for point in plot.points)
    titles = {point.number: point.title for point in points if point.number and point.kind != "front"}
    return ", ".join(f"{each} {titles[each]}" for each in sorted(titles))


def shown(plot: Plot, value: float) -> str:
    """A value of the level axis with its unit."""
    return f"{value:.{3 if value < 1000 else 6}g} MiB" if plot.time == "memory" else clock(value)


def clock(value: float) -> str:
    """A time with its unit: "0.5 ms", "20 ms", "1.5 s", "1234 s"."""
    number_of, unit = (value, "s") if value >= 0.9995 else (value * 1e3, "ms")
    return f"{number_of:.{3 if number_of < 1000 else 6}g} {unit}"


_WORDS = {"front": ", on the front", "beaten": "", "gap": ", frames missing", "calibration": ", calibration"}


def _plot(table: Table, metric: MetricRecord, time: str, group: ColumnGroup) -> Plot:
    index = next(i for i in table.of_group(group) if table.columns[i].metric == metric)
    better = 1.0 if metric.higher_is_better else -1.0
    points: list[ParetoPoint] = []
    left_out: list[str] = []
    crowded = len(table.computed) > _NAMED
    for place, row in enumerate(table.computed, start=1):
        cell, cost = row.cells[index], seconds(row, time, table.timed_kind)
        if cell.value is None or not math.isfinite(cell.value):
            left_out.append(f"{row.title}: no value")
        elif cost is None:
            left_out.append(f"{row.title}: {'not told' if time == 'memory' else 'no time'}")
        else:
            kind: Kind = "calibration" if row.kind == "calibration" else "beaten" if cell.complete else "gap"
            known = ParetoPoint(row.title, cost, cell.value, kind, row.enrolment, number=place * crowded)
            points.append(replace(known, low=cell.low, high=cell.high))
    points, far = _in_sight(points)
    empty = Plot(group, metric, time, (), ())
    for point in far:
        score = f"{number(point.score, metric.decimals)} {metric.unit}".strip()
        left_out.append(f"{point.title}: off the scale at {shown(empty, point.seconds)}, {score}")
    mixed = len({point.enrolment for point in points if point.kind != "calibration"}) > 1
    ordered: list[ParetoPoint] = []
    best = -math.inf
    for point in sorted(points, key=lambda p: (p.seconds, -better * p.score, p.title)):
        if point.kind == "beaten" and better * point.score > best:
            best = better * point.score
            point = replace(point, kind="front", unequal=mixed)
        ordered.append(point)
    return Plot(group, metric, time, tuple(ordered), tuple(left_out))


def _in_sight(points: Sequence[ParetoPoint]) -> tuple[list[ParetoPoint], list[ParetoPoint]]:
    """Calibration rows may double the span of the methods either way; those further away would squeeze the methods."""
    methods = [point for point in points if point.kind != "calibration"]
    if not methods:
        return list(points), []
    scores, times = [p.score for p in methods], [math.log10(p.seconds) for p in methods]

    def near(value: float, of_methods: Sequence[float], least: float = 0.0) -> bool:
        reach = max(max(of_methods) - min(of_methods), least)
        return min(of_methods) - reach <= value <= max(of_methods) + reach

    found = [p for p in points if near(p.score, scores) and near(math.log10(p.seconds), times, least=0.5)]
    return found, [point for point in points if point not in found]


def _span(plot: Plot) -> tuple[float, float]:
    """The scores at the two ends of the axis, which holds the intervals of methods."""
    ends = [end for point in plot.points if point.kind != "calibration" for end in (point.low, point.high)]
    scores = [*(point.score for point in plot.points), *(end for end in ends if end is not None)]
    margin = 0.1 * (max(scores) - min(scores)) or 2 * 10.0**-plot.metric.decimals
    return min(scores) - margin, max(scores) + margin


def _corners(front: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """A stair: the best score that can be had within a time, up to the right edge."""
    for i, (x, y) in enumerate(front):
        if i:
            yield x, front[i - 1][1]
        yield x, y
    if front:
        yield FRAME.right, front[-1][1]


def _ticks(low: float, high: float) -> Iterator[tuple[float, str]]:
    """Three to seven round scores between two, with the decimals they need."""
    rough = (high - low) / 7
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next(decade * factor for factor in (1, 2, 5, 10) if decade * factor >= rough * (1 - 1e-9))
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    for i in range(math.ceil(low / step), math.floor(high / step) + 1):
        yield i * step, number(i * step, decimals)


def _times(plot: Plot, low: float, high: float) -> tuple[float, ...]:
    """Round times between two: as many as have room beside each other."""
    scale = (FRAME.right - FRAME.left) / math.log10(high / low)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for every, steps in (*((1, steps) for steps in _STEPS), (2, (1,)), (3, (1,))):
        values = (step * 10.0**power for power in powers[::every] for step in steps)
        found = tuple(value for value in values if low <= value <= high)
        wide = [_ROOM * width(shown(plot, value)) for value in found]
        if all(
            scale * math.log10(later / earlier) >= (one + other) / 2
            for (earlier, later), (one, other) in zip(pairwise(found), pairwise(wide), strict=True)
        ):
            return found
    return found
