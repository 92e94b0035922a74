"""Figures that a paper asks for: chosen frames, methods and columns, as wide as its columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import groupby
from pathlib import Path

from handbench.errors import InputError, unknown_name
from handbench.files import check_folder, whole
from handbench.results.record import MetricRecord

from .build import build
from .figures import Panel, Square, panels
from .pareto import plots
from .pareto_figures import pareto_figures
from .pictures import Sheet, grid
from .run import Run, read_run
from .selection import ReportFilter

_MOST = 12  # frames that a pattern may fit: each is a line of pictures


@dataclass(frozen=True)
class Figures:
    """What is drawn, and how large.

    frames      keys of frames, or patterns of them; empty takes typical ones
    width       inches; None as wide as the pictures ask for
    dpi         of PNG files; None as reports have it
    crop        the detail: left, top and side in pixels of the recorded picture; None for no detail, () for the place
                where the methods are most wrong
    """

    frames: tuple[str, ...] = ()
    width: float | None = None
    dpi: int | None = None
    crop: Square | tuple[()] | None = ()

    @property
    def sheet(self) -> Sheet:
        return Sheet(width=self.width, dpi=self.dpi, detail=self.crop is not None)


def write_figures(run_folder: Path, selection: ReportFilter, figures: Figures, out: Path) -> Iterator[Path]:
    """Write figures as PNG and PDF into a folder, and tell each file: the frames that are asked for, or else typical
    ones, and score against time.

    Raises `InputError` for a frame that the run does not have, and for a run without the truth of it.
    """
    whole_run = read_run(run_folder)
    run = selection.of(whole_run)
    queries = chosen(run, figures.frames)
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    shown = tuple(panels(run, queries or None, figures.crop or None, whole_run))
    if not shown:
        raise InputError(f"{run_folder} keeps no truth of these frames; run it with the method oracle")
    metric = run.plan.protocol.metrics[0]
    made = [*_pictures(shown, metric, figures.sheet, bool(queries))]
    made += pareto_figures(plots(build(run)), figures.width, figures.dpi) if not queries else []
    for name, files in made:
        for kind, content in files.items():
            path = out / f"{name}.{kind}"
            with whole(path) as part:
                part.write_bytes(content)
            yield path


def chosen(run: Run, wanted: Sequence[str]) -> list[str]:
    """The scored frames that keys and patterns name, in the order of both.

    Raises `InputError` for one that names none, and for more than a figure can show.
    """
    known = list(dict.fromkeys(query for column in run.plan.protocol.columns for query in column.queries))
    found: dict[str, None] = {}
    for pattern in wanted:
        fitting = [query for query in known if fnmatchcase(query, pattern)]
        if not fitting:
            raise unknown_name("frame", pattern, known[:200])
        found |= dict.fromkeys(fitting)
    if len(found) > _MOST:
        raise InputError(f"{len(found)} frames fit --frame, a figure shows {_MOST} at most; name fewer")
    return list(found)


def _pictures(
    shown: Sequence[Panel], metric: MetricRecord, sheet: Sheet, one: bool
) -> Iterator[tuple[str, dict[str, bytes]]]:
    """One figure of all frames that were asked for, or one a kind of light."""
    if one:
        yield "frames", grid(shown, metric, sheet)
        return
    for kind, of_kind in groupby(shown, key=lambda panel: panel.kind):
        yield kind, grid(tuple(of_kind), metric, sheet)
