"""The page of a run: one HTML file that needs neither network nor other files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from handbench.results.laws import LINEAR
from handbench.studies.auditrecord import audit_told

from .aggregate import RESAMPLES
from .agreement import headline, sentence
from .conclusion import conclusion
from .cost import Span
from .curves import LossPlot
from .figures import ERROR_SCALE, Panel
from .frames import KINDS
from .model import LIGHT_TITLES, Aggregate, MetricColumn, Table
from .pareto import FRAME, HEIGHT, TIMES, WIDTH, Plot, draw, enrolments, in_words, numbered, shown
from .pictures import colour_stops, error_uri, image_uri, svg_uri
from .printed import (
    SUNK,
    UNEQUAL_NOTE,
    amount,
    between,
    bounds,
    chance,
    duration,
    letter,
    listed,
    marks,
    memory_table,
    moment,
    number,
    scientific,
    signed,
    three_digits,
)
from .run import Run, machine
from .scores import scores
from .speed import speed_section
from .stress import stress_section
from .template import environment
from .viewer import Viewer


@dataclass(frozen=True)
class PageContent:
    """What a page shows beside its tables."""

    panels: Sequence[Panel] = ()
    losses: Sequence[LossPlot] = ()
    plots: Sequence[Plot] = ()
    viewer: Viewer | None = None


def render_page(table: Table, run: Run, also: PageContent) -> str:
    """The HTML text of a run's page. Its only date is the run's, so the same run gives the same page."""
    page = environment(
        image_uri=image_uri,
        error_uri=error_uri,
        duration=duration,
        letter=letter,
        number=number,
        moment=moment,
        svg_uri=svg_uri,
        scientific=scientific,
        span=_span,
        seconds=_seconds,
    )
    page.globals.update(
        unequal_note=UNEQUAL_NOTE,
        sunk=SUNK,
        signed=signed,
        bounds=bounds,
        chance=chance,
        marks=marks,
        cell_text=_cell_text,
        interval=_interval,
        headline=headline,
        sentence=sentence,
    )
    page.globals.update(draw=draw, told=in_words, shown=shown, times=TIMES, frame=FRAME, width=WIDTH, height=HEIGHT)
    page.globals.update(enrolments=enrolments, numbered=numbered)
    studies = {"speed": speed_section(run.folder), "stress": stress_section(run.folder)}
    panels = groupby(also.panels, key=lambda panel: panel.kind)
    return page.get_template("page.html").render(
        table=table,
        plan=run.plan,
        conclusion=conclusion(table),
        audits=[_audit(part, several=bool(run.parts)) for part in run.parts or (run,)],
        scope=" ".join(_scope(table)),
        checks=_checks(table, run),
        contents=_contents(table, also, studies),
        figures=[(KINDS[kind], tuple(of_kind)) for kind, of_kind in panels],
        colour_stops=colour_stops(),
        error_scale=ERROR_SCALE,
        first_metric=table.metrics[0],
        skipped=_skipped(table, run),
        losses=also.losses,
        plots=also.plots,
        viewer=also.viewer,
        scores=scores(run, table),
        studies={name: section for name, section in studies.items() if section},
        linear_limit=LINEAR,
        memory=memory_table(table),
        light_titles=LIGHT_TITLES,
        resamples=RESAMPLES,
        machine_of=machine,
        plans=[part.plan for part in run.parts or (run,)],
        folders=[part.folder.resolve().name for part in run.parts or (run,)],
    )


def _scope(table: Table) -> Iterator[str]:
    """What the rows are, from the rows."""
    yield "Hand-relighting methods, each asked for the same frames and scored against the recorded ones."
    methods = [row for row in table.rows if row.kind == "method"]
    here = [row.title for row in methods if row.here]
    elsewhere = [row.title for row in methods if not row.here]
    if here and not elsewhere:
        yield "Every method was trained here, on this capture, with the budget of this protocol."
    elif here:
        yield f"Trained here, on this capture, with the budget of this protocol: {listed(here)}."
    if elsewhere:
        yield f"Scored here from pictures that were made elsewhere, by whatever training: {listed(elsewhere)}."
    if any("reimplementation" in row.fidelity for row in methods):
        yield (
            "A method named after a paper is a reimplementation of what the paper describes, not the authors' code or "
            "checkpoint, so these numbers say nothing about published ones."
        )


def _audit(run: Run, several: bool) -> str:
    """What the audit of a run found; of several runs with the folder's name."""
    return f"{run.folder.resolve().name}: {audit_told(run)}" if several else audit_told(run)


def _contents(table: Table, shown: PageContent, studies: Mapping[str, str | None]) -> list[tuple[str, str]]:
    """The sections that are there: (anchor, title)."""
    places = (
        ("results", "Results", True),
        ("agreement", "Order", table.agreements),
        ("methods", "Cost", True),
        ("breakdown", "Breakdown", True),
        ("pareto", "Score against time", shown.plots),
        ("viewer", "Compare", shown.viewer),
        ("figures", "Images", True),
        ("losses", "Training", shown.losses),
        *((f"{name}-study", name.capitalize(), section) for name, section in studies.items()),
        ("signatures", "Signatures", True),
        ("origin", "Origin", True),
    )
    return [(anchor, title) for anchor, title, there in places if there]


def _checks(table: Table, run: Run) -> list[tuple[bool, str]]:
    """What a reader wants to know before reading the numbers: (fine?, sentence)."""
    planned, finished = len(run.plan.cells), len({cell.key for cell in run.cells})
    gaps = sum(not cell.complete for row in table.rows for cell in row.cells)
    titles = {method.name: method.title for method in run.plan.methods}
    unequal = dict.fromkeys(titles[cell.method.name] for cell in run.cells if cell.same_pixels is False)
    linear = {method.name for method in run.plan.methods if method.linear}
    bent = [row.title for row in table.rows if row.name in linear and (row.nonlinearity or 0.0) > LINEAR]
    origins = [part.plan.provenance.git for part in run.parts or (run,)]
    git = next((each for each in origins if each is None or each.dirty), origins[0])
    origin = "source code had uncommitted changes" if git and git.dirty else "source code as committed"
    return [
        (
            finished == planned,
            f"{finished} of {planned} cells computed (a cell: one method on one subject with one seed)",
        ),
        (gaps == 0, "every value covers all frames" if gaps == 0 else f"{gaps} values miss frames, see the notes"),
        *([(False, f"declared linear in light, but not: {', '.join(bent)}")] if bent else []),
        *([(False, f"timed and scored images of {', '.join(unequal)} differ")] if unequal else []),
        (git is not None and not git.dirty, origin if git else "installed copy, commit unknown"),
    ]


def _skipped(table: Table, run: Run) -> list[tuple[str, str]]:
    """For each measured method what its cells left out: "shadow rays 71 % of 12 million, …"; runs may have none."""
    lines = []
    for row in table.computed:
        sums: dict[str, list[int]] = {}
        for cell in run.of_method(row.name):
            for what, saved in cell.skipped.items():
                totals = sums.setdefault(what, [0, 0])
                totals[0] += saved.total
                totals[1] += saved.skipped
        parts = [f"{what} {_share(*totals)} of {amount(totals[0])}" for what, totals in sums.items() if totals[1]]
        if parts:
            lines.append((row.title, ", ".join(parts)))
    return lines


def _share(total: int, skipped: int) -> str:
    percent = 100.0 * skipped / total
    return f"{percent:.0f} %" if percent >= 1.0 else "under 1 %"


def _cell_text(cell: Aggregate, column: MetricColumn) -> str:
    return number(cell.value, column.metric.decimals)


def _interval(cell: Aggregate, column: MetricColumn) -> str:
    return between(cell, column.metric.decimals)


def _span(span: Span | None) -> str:
    """ "3.5–6.1", or nothing where all measured values print alike."""
    low, high = (three_digits(span.low), three_digits(span.high)) if span else ("", "")
    return f"{low}–{high}" if low != high else ""


def _seconds(span: Span | None) -> str:
    """The value a table is sorted by; nothing where there is none."""
    return repr(span.median) if span else ""
