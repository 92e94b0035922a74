"""The Pareto plots of the first metric as figures for papers: one a kind of time, a panel for each column."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from textwrap import wrap
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from .pareto import FRAME, HEIGHT, TIMES, WIDTH, Plot, draw, enrolments, numbered
from .pictures import DPI, STYLE, saved
from .printed import UNEQUAL_NOTE

_SCALE = 105.0  # units of a drawing in an inch
_COLUMNS = 4
_INK, _SOFT, _LINE, _FRONT = "#1d1c1a", "#6a665f", "#dcd7cf", "#9a4a22"
_HALO = withStroke(linewidth=2.0, foreground="white")  # a name stays readable over the bar of an interval
_TITLE, _HEAD = 22, -11  # the space above a drawing, and the middle of the line in it
_LINE_HEIGHT, _LETTER = 13, 5.6  # of the note below all drawings
_MARKS: dict[str, Any] = {
    "front": {"marker": "o", "mfc": _FRONT, "mec": _FRONT},
    "beaten": {"marker": "o", "mfc": "white", "mec": _INK},
    "gap": {"marker": "X", "mfc": "white", "mec": _INK},
    "calibration": {"marker": "D", "mfc": _SOFT, "mec": _SOFT, "ms": 4.2},
}


def pareto_figures(
    found: Sequence[Plot], inches: float | None = None, dpi: int | None = None
) -> Iterator[tuple[str, dict[str, bytes]]]:
    """(name, {"png": …, "pdf": …}), e.g. "pareto-psnr-known"; as many panels beside each other as `inches` hold."""
    of_metric = [plot for plot in found if plot.metric == found[0].metric]
    for time, group in groupby(of_metric, key=lambda plot: plot.time):
        yield f"pareto-{found[0].metric.name}-{time}", _figure(tuple(group), inches, dpi or DPI)


def _figure(found: Sequence[Plot], inches: float | None, dpi: int) -> dict[str, bytes]:
    beside = _COLUMNS if inches is None else max(1, round(inches * _SCALE / WIDTH))
    columns = min(beside, len(found))
    rows = -(-len(found) // columns)
    width, note = columns * WIDTH, _note(found)
    lines = wrap(note, int(width / _LETTER))
    height = rows * (HEIGHT + _TITLE) + (len(lines) + 1) * _LINE_HEIGHT * bool(lines)
    with rc_context(STYLE):
        scale = _SCALE if inches is None else width / inches  # the panels fill the width that is asked for
        figure = Figure(figsize=(width / scale, height / scale))
        for index, plot in enumerate(found):
            row, column = divmod(index, columns)
            panel = (HEIGHT + _TITLE) / height
            _panel(figure.add_axes((column / columns, 1 - (row + 1) * panel, 1 / columns, panel)), plot)
        for line, text in enumerate(reversed(lines)):
            place = (FRAME.left / width, (line * _LINE_HEIGHT + 4) / height)
            figure.text(*place, text, color=_SOFT, parse_math=False)
        return saved(figure, dpi)


def _note(found: Sequence[Plot]) -> str:
    """What numbers stand for, and the mark of unequal enrolment, where a plot has them."""
    unequal = any(point.unequal for plot in found for point in plot.points)
    return ". ".join(filter(None, (numbered(found), f"{UNEQUAL_NOTE}: {enrolments(found)}" if unequal else "")))


def _panel(axes: Axes, plot: Plot) -> None:
    axes.set_axis_off()
    axes.set(xlim=(0, WIDTH), ylim=(HEIGHT, -_TITLE))
    drawing = draw(plot)
    rules = [((x, x), (FRAME.top, FRAME.bottom)) for x, _ in drawing.x_ticks]
    rules += [((FRAME.left, FRAME.right), (y, y)) for y, _ in drawing.y_ticks]
    axes.add_collection(
        LineCollection([list(zip(*rule, strict=True)) for rule in rules], colors=_LINE, lw=0.6, zorder=1)
    )
    for x, text in drawing.x_ticks:
        axes.text(x, FRAME.bottom + 13, text, ha="center", color=_SOFT)
    for y, text in drawing.y_ticks:
        axes.text(FRAME.left - 5, y + 3, text, ha="right", color=_SOFT)
    if drawing.front:
        axes.plot(*zip(*drawing.front, strict=True), color=_FRONT, lw=1.3, zorder=2)
    for point, x, _, _ in drawing.marks:
        if (bar := drawing.bars.get(point)) is not None:
            axes.plot([x, x], bar, color=_SOFT, lw=0.8, zorder=2)
    for point, x, y, label in drawing.marks:
        if label.leader:
            axes.plot([x, label.leader[0]], [y, label.leader[1]], color=_SOFT, lw=0.5, zorder=2)
        axes.plot([x], [y], ls="", **{"ms": 5.0, "mew": 0.9, "zorder": 3, **_MARKS[point.kind]})
        align = {"start": "left", "middle": "center", "end": "right"}[label.anchor]
        colour = _SOFT if point.kind == "calibration" else _INK
        axes.text(
            label.x, label.y, label.text, ha=align, color=colour, zorder=4, parse_math=False, path_effects=[_HALO]
        )
    axes.text(FRAME.left, _HEAD, plot.group.title, size=9, va="center", parse_math=False)
    axes.text(FRAME.left, 9, plot.upwards, color=_SOFT, parse_math=False)
    axes.text((FRAME.left + FRAME.right) / 2, FRAME.bottom + 30, TIMES[plot.time], ha="center")
