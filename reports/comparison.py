"""Runs beside a first one: the same methods, frame by frame, and whether their values differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Group as Lines
from rich.console import RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from handbench.errors import InputError
from handbench.results.reading import Run, mismatch, read_run
from handbench.results.statistics import CONFIDENCE, Difference, aggregate, corrected, differences, least_p
from handbench.results.values import Values, values_of

from .build import shown_metric
from .model import UNEQUAL, UNEQUAL_NOTE, Group, Metric, letter, number
from .terminal import difference_text


@dataclass(frozen=True)
class Line:
    """A method in one column and metric: the first run's value, and each other run's value and difference to it.

    None: the run has no value, or no frame in common. `across` marks the runs whose enrolment gave it something else
    than the first run's, which is `enrolment`.
    """

    method: str
    group: Group
    metric: Metric
    value: float | None
    others: tuple[tuple[float | None, Difference | None], ...]
    enrolment: str = ""
    across: tuple[bool, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Runs of one protocol version and capture; `alone` names methods that only some of them have."""

    title: str
    runs: tuple[str, ...]
    lines: tuple[Line, ...]
    alone: tuple[str, ...]


def compare(*folders: Path) -> Comparison:
    """All methods that the first run shares with another, paired by frame and seed.

    p-values are corrected over the methods of a column, metric and run (Holm). Raises `InputError` for a folder
    without a readable run, for runs that cannot be compared, and if no method is in two of them.
    """
    runs = [read_run(folder) for folder in folders]
    for other in runs[1:]:
        if why := mismatch(runs[0], other):
            raise InputError(f"these runs cannot be compared: {why}")
    names = [[method.name for method in run.plan.methods] for run in runs]
    shared = [name for name in names[0] if any(name in others for others in names[1:])]
    if not shared:
        raise InputError(f"no method is in {folders[0]} and in another of these runs; 'report' shows them in one table")
    # Each run by itself: what another folder computed must not stand in for what this one lacks.
    values = [values_of(run) for run in runs]
    lines = tuple(_lines(runs, shared, values))
    everywhere = set.intersection(*map(set, names))
    alone = tuple(dict.fromkeys(name for of_run in names for name in of_run if name not in everywhere))
    title = f"{runs[0].plan.protocol.title} ({runs[0].protocol})"
    return Comparison(title, tuple(str(run.folder) for run in runs), lines, alone)


def _lines(
    runs: Sequence[Run], shared: Sequence[str], values: Sequence[dict[tuple[str, str], Values]]
) -> Iterator[Line]:
    protocol = runs[0].plan.protocol
    first, *others_of = ({method.name: method for method in run.plan.methods} for run in runs)
    across = {
        name: tuple(name in of_run and of_run[name].enrolled_unlike(first[name]) for of_run in others_of)
        for name in shared
    }
    for group in (Group(column.name, column.title) for column in protocol.columns):
        for place, metric in enumerate(map(shown_metric, protocol.metrics)):
            mine = {name: values[0][name, group.name] for name in shared}
            others = [_beside(mine, of_run, group, place) for of_run in values[1:]]
            for name, of_first in mine.items():
                value = aggregate(of_first.values[place], of_first.subjects)
                told = first[name].enrolment, across[name]
                yield Line(first[name].title, group, metric, value, tuple(found[name] for found in others), *told)


def _beside(
    mine: dict[str, Values], theirs: dict[tuple[str, str], Values], group: Group, place: int
) -> dict[str, tuple[float | None, Difference | None]]:
    """Of each method another run's value, and its difference to the first run's."""
    found: dict[str, tuple[float | None, Difference | None]] = dict.fromkeys(mine, (None, None))
    both = {
        name: (theirs[name, group.name], of_first) for name, of_first in mine.items() if (name, group.name) in theirs
    }
    if both:
        pairs = [(new.values[place], old.values[place]) for new, old in both.values()]
        subjects = next(iter(mine.values())).subjects
        apart = corrected(differences(pairs, subjects, group.draws))
        for (name, (new, _)), each in zip(both.items(), apart, strict=True):
            found[name] = aggregate(new.values[place], subjects), each
    return found


def render_comparison(comparison: Comparison) -> RenderableType:
    """A rich renderable: one grid a column and metric, and what the numbers mean."""
    named = [Text(f"{letter(i).upper()}  {run}") for i, run in enumerate(comparison.runs, start=1)]
    places = dict.fromkeys((line.group, line.metric) for line in comparison.lines)
    grids = [
        _grid(group, metric, [line for line in comparison.lines if (line.group, line.metric) == (group, metric)])
        for group, metric in places
    ]
    remarks = [Text(text, style="dim") for text in _remarks(comparison)]
    return Lines(Text(comparison.title, style="bold"), *named, *grids, *remarks)


def _grid(group: Group, metric: Metric, lines: Sequence[Line]) -> RichTable:
    grid = RichTable(
        title=f"{group.title}, {metric.title} {metric.arrow}",
        title_justify="left",
        title_style="bold",
        header_style="dim",
        box=None,
        padding=(0, 2, 0, 0),
    )
    grid.add_column("", no_wrap=True)
    grid.add_column("enrolment", style="dim", overflow="fold")
    grid.add_column("A", justify="right")
    for i in range(len(lines[0].others)):
        name = letter(i + 2).upper()
        grid.add_column(name, justify="right")
        grid.add_column(f"{name} − A", justify="right", overflow="fold")
    for line in lines:
        cells = [Text(number(line.value, metric.decimals))]
        for (value, apart), across in zip(line.others, line.across, strict=True):
            told = difference_text(apart, metric)
            cells += [Text(number(value, metric.decimals)), told.append(UNEQUAL) if across and apart else told]
        grid.add_row(Text(line.method), Text(line.enrolment), *cells)
    return grid


def _remarks(comparison: Comparison) -> Iterator[str]:
    yield (
        "Differences are paired by frame and seed; 95 % interval of a bootstrap over subjects and their frames (bold: "
        "it excludes zero); p by sign flips over subjects, corrected over methods (Holm)."
    )
    apart = [each for line in comparison.lines for _, each in line.others if each]
    subjects = min((each.subjects for each in apart), default=0)
    if subjects and least_p(subjects) > 1 - CONFIDENCE:
        yield (
            f"Too few subjects to claim a difference for other hands: with {subjects} p cannot fall below "
            f"{least_p(subjects):.2g}; intervals there tell of these hands and their frames."
        )
    if any(any(line.across) for line in comparison.lines):
        yield UNEQUAL_NOTE
    if comparison.alone:
        yield f"Not in every run: {', '.join(comparison.alone)}."
