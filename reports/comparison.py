"""Runs beside a first one: the same methods, frame by frame, and whether their values differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Group as Lines
from rich.console import RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from handbench.errors import InputError
from handbench.results.reading import Run, mismatch, read_run
from handbench.results.record import MetricRecord
from handbench.results.statistics import CONFIDENCE, Difference, aggregate, corrected, differences, least_p
from handbench.results.values import Values, values_of

from .model import ColumnGroup
from .printed import UNEQUAL, UNEQUAL_NOTE, bounds, chance, letter, number, signed
from .safe import markdown
from .selection import ALL, ReportFilter
from .terminal import difference_text


@dataclass(frozen=True)
class ComparisonLine:
    """A method in one column and metric: the first run's value, and each other run's value and difference to it.

    None: the run has no value, or no frame in common. `across` marks the runs whose enrolment gave it something else
    than the first run's, which is `enrolment`.
    """

    method: str
    group: ColumnGroup
    metric: MetricRecord
    value: float | None
    others: tuple[tuple[float | None, Difference | None], ...]
    enrolment: str = ""
    across: tuple[bool, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Runs of one protocol version and capture; `alone` names methods that only some of them have."""

    title: str
    runs: tuple[str, ...]
    lines: tuple[ComparisonLine, ...]
    alone: tuple[str, ...]


def compare(*folders: Path, selection: ReportFilter = ALL) -> Comparison:
    """All measured methods that the first run shares with another, paired by frame and seed.

    `selection` leaves some of their methods, columns or metrics. p-values are corrected over the methods of a column,
    metric and run (Holm). Raises `InputError` for a folder without a readable run, for runs that cannot be compared,
    and if no method is in two of them.
    """
    every = [read_run(folder) for folder in folders]
    runs = selection.among(every)
    if len(runs) < len(every):
        raise InputError(f"these runs cannot be compared: {' '.join(selection.gaps(every))}")
    for other in runs[1:]:
        if why := mismatch(runs[0], other):
            raise InputError(f"these runs cannot be compared: {why}")
    names = [[method.name for method in run.plan.methods] for run in runs]
    rivals = [method.name for method in runs[0].plan.methods if not method.calibration]
    shared = [name for name in rivals if any(name in others for others in names[1:])]
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
) -> Iterator[ComparisonLine]:
    protocol = runs[0].plan.protocol
    first, *others_of = ({method.name: method for method in run.plan.methods} for run in runs)
    across = {
        name: tuple(name in of_run and of_run[name].enrolled_unlike(first[name]) for of_run in others_of)
        for name in shared
    }
    for group in (ColumnGroup(column.name, column.title) for column in protocol.columns):
        for place, metric in enumerate(protocol.metrics):
            mine = {name: values[0][name, group.name] for name in shared}
            others = [_beside(mine, of_run, group, place) for of_run in values[1:]]
            for name, of_first in mine.items():
                value = aggregate(of_first.values[place], of_first.subjects)
                told = first[name].enrolment, across[name]
                yield ComparisonLine(
                    first[name].title, group, metric, value, tuple(found[name] for found in others), *told
                )


def _beside(
    mine: dict[str, Values], theirs: dict[tuple[str, str], Values], group: ColumnGroup, place: int
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
    remarks = [Text(sentence(comparison)), *(Text(text, style="dim") for text in _remarks(comparison))]
    return Lines(Text(comparison.title, style="bold"), *named, *grids, *remarks)


def _grid(group: ColumnGroup, metric: MetricRecord, lines: Sequence[ComparisonLine]) -> RichTable:
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


def render_markdown(comparison: Comparison) -> str:
    """One Markdown table a column: a line for each method and metric, then what the numbers mean."""
    return "\n".join(_markdown(comparison)) + "\n"


def _markdown(comparison: Comparison) -> Iterator[str]:
    yield f"# {markdown(comparison.title)}\n"
    letters = [letter(i).upper() for i, _ in enumerate(comparison.runs, start=1)]
    yield from (f"- {name}: {markdown(run)}" for name, run in zip(letters, comparison.runs, strict=True))
    heads = ["method", "metric", "A", *(head for name in letters[1:] for head in (name, f"{name} − A"))]
    for group in dict.fromkeys(line.group for line in comparison.lines):
        yield f"\n## {markdown(group.title)}\n"
        yield "| " + " | ".join(heads) + " |"
        yield "| :-- | :-- |" + " --: |" * (len(heads) - 2)
        for line in (line for line in comparison.lines if line.group == group):
            yield "| " + " | ".join(_markdown_cells(line)) + " |"
    yield ""
    yield from (f"{markdown(remark)}\n" for remark in (sentence(comparison), *_remarks(comparison)))


def _markdown_cells(line: ComparisonLine) -> Iterator[str]:
    decimals = line.metric.decimals
    yield markdown(line.method)
    yield f"{markdown(line.metric.title)} {line.metric.arrow}"
    yield number(line.value, decimals)
    for (value, apart), across in zip(line.others, line.across, strict=True):
        yield number(value, decimals)
        if apart is None:
            yield "–"
            continue
        told = signed(apart.value, decimals) + UNEQUAL * across
        told = f"**{told}**" if apart.separated else told
        yield " ".join(filter(None, (told, bounds(apart, decimals), markdown(chance(apart)))))


def sentence(comparison: Comparison) -> str:
    """How often the other runs are better or worse than the first, where the interval of the difference tells."""
    better = worse = level = 0
    for line in comparison.lines:
        for _, apart in line.others:
            if apart is None:
                continue
            ahead = (apart.value > 0) == line.metric.higher_is_better
            better, worse, level = (
                better + (apart.separated and ahead),
                worse + (apart.separated and not ahead),
                level + (not apart.separated),
            )
    return f"Of {better + worse + level} values, {better} are better than in A, {worse} worse, {level} not told apart."


def as_json(comparison: Comparison) -> dict[str, object]:
    """The comparison as JSON values."""
    lines = []
    for line in comparison.lines:
        about = {"method": line.method, "column": line.group.name, "metric": line.metric.name, "value": line.value}
        others = [{"value": value, "difference": apart and asdict(apart)} for value, apart in line.others]
        lines.append({**about, "others": others})
    told = {"title": comparison.title, "runs": list(comparison.runs), "alone": list(comparison.alone)}
    return {**told, "sentence": sentence(comparison), "lines": lines}
