"""Figures of a speed study: error against time, and time against size; each as PNG and PDF bytes."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from statistics import median
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from handbench.studies.speed.equal_error import TARGETS, pareto
from handbench.studies.speed.measure import Trial
from handbench.studies.speed.record import Implicit, MethodStudy, Scaling, SceneStudy, SpeedRecord

COLOURS = {
    "handbench": "#b3471d",
    "naive torch": "#77736c",
    "Mitsuba direct": "#2f6db0",
    "Mitsuba direct, tuned": "#1f8a70",
}
MARKERS = {"lights": "o", "texture": "s", "grid": "D", "supersampling": "v", "shadows": "X", "precision": "P"}
MARKERS |= {"skips": "*", "samples": "o", "environment": "D", "default": "o"}
POSES = {"new": "New pose", "known": "Known pose, new light"}
_FLOOR = 1e-6
"""Errors are drawn no lower than this: an exact picture has none."""

_STYLE: Any = {"font.size": 9, "font.family": "DejaVu Sans", "pdf.fonttype": 42}
Images = dict[str, bytes]


def figures(found: SpeedRecord, kinds: Sequence[str] = ("png", "pdf")) -> Iterator[tuple[str, str, Images]]:
    """(name, caption, {"png": …, "pdf": …}) of every figure of a study, in the kinds that are wanted."""
    from matplotlib import rc_context

    with rc_context(_STYLE):
        for scene in found.scenes:
            caption = f"{scene.title}: error against time, every setting that was measured, and the front they form."
            yield f"error-time-{scene.name}", caption, _images(_scene(scene), kinds)
        if found.scaling:
            caption = "Time against size, with the exponent fitted where time grows."
            yield "scaling", caption, _images(_scaling(found.scaling), kinds)
        drawn = [method for method in found.methods if method.curves]
        if drawn:
            caption = "Methods: error against their own full picture, against time."
            yield "methods", caption, _images(_methods(drawn), kinds)
        if found.implicit is not None:
            caption = "Implicit hands: error of encodings against time, and of gathered light against directions."
            yield "implicit", caption, _images(_implicit(found.implicit), kinds)


def _implicit(found: Implicit) -> Figure:
    figure = Figure(figsize=(8.6, 4.4), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, 2))
    for axes, parts, title in zip(panels, (found.encodings, found.directions), _IMPLICIT, strict=True):
        for number, part in enumerate(parts):
            across = [point.seconds if axes is panels[0] else point.size for point in part.points]
            turn, which = divmod(number, len(_SERIES))
            look: Any = {"color": _SERIES[which], "marker": "os^Dv*"[which], "ls": ("-", "--")[turn % 2]}
            axes.plot(across, [point.error for point in part.points], label=part.name, lw=1.4, ms=4.2, **look)
        axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
        axes.set_xscale("log")
        axes.set_yscale("log")
        _frame(axes)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False, fontsize=7, ncols=1)
    panels[0].set_xlabel("CPU of training")
    panels[0].set_ylabel("Mean error of a distance, mm")
    panels[0].xaxis.set_major_locator(LogLocator(10, subs=(1.0, 2.0, 5.0)))
    panels[0].xaxis.set_major_formatter(FuncFormatter(lambda value, _: duration(value)))
    panels[0].yaxis.set_major_locator(LogLocator(10, subs=(1.0, 3.0)))
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panels[1].set_xlabel("Directions or lights")
    panels[1].set_ylabel("Relative RMSE of colours")
    panels[1].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:.6g} %"))
    panels[1].set_xticks(*_counts(found))
    panels[1].xaxis.set_minor_locator(NullLocator())
    for axes in panels:
        axes.yaxis.set_minor_formatter(NullFormatter())
    panels[0].xaxis.set_minor_formatter(NullFormatter())
    return figure


_IMPLICIT = ("Encodings", "Light that is gathered")
_SERIES = ("#b3471d", "#2f6db0", "#1f8a70", "#7a4fa3", "#c28a1c", "#77736c")


def _counts(found: Implicit) -> tuple[list[float], list[str]]:
    sizes = sorted({point.size for part in found.directions for point in part.points if len(part.points) > 1})
    return sizes, [f"{size:g}" for size in sizes]


def _images(figure: Figure, kinds: Sequence[str]) -> Images:
    found = {}
    for kind in kinds:
        out = io.BytesIO()
        dated = {"CreationDate": None} if kind == "pdf" else {"Software": None}
        figure.savefig(out, format=kind, dpi=200, metadata=dated, bbox_inches="tight", pad_inches=0.05)
        figure.set_layout_engine("none")  # it is laid out: another kind has the same places
        found[kind] = out.getvalue()
    return found


def _scene(scene: SceneStudy) -> Figure:
    figure = Figure(figsize=(8.6, 3.9), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, 2, sharey=True))
    knobs: dict[str, None] = {}
    for axes, (pose, title) in zip(panels, POSES.items(), strict=True):
        for curve in scene.curves:
            if curve.pose != pose:
                continue
            points, colour = curve.points, COLOURS[curve.renderer]
            ours = curve.renderer == "handbench"
            for point in points:
                knobs |= {point.knob: None} if ours else {}
                _mark(axes, point, colour, MARKERS[point.knob] if ours else "o", alpha=0.5)
            front = pareto(points)
            axes.plot([p.time for p in front], [p.error for p in front], color=colour, lw=1.8, zorder=3)
        for target in TARGETS:
            axes.axhline(target, color="#d5d0c7", lw=0.7, zorder=0)
        axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
        axes.set_xlabel("Time of a picture")
        _time_axis(axes)
    panels[0].set_ylabel("Relative RMSE")
    _error_axis(panels[0])
    handles = [
        _handle(panels[0], name, colour=colour, lw=1.8)
        for name, colour in COLOURS.items()
        if any(curve.renderer == name for curve in scene.curves)
    ]
    handles += [_handle(panels[0], knob, colour=COLOURS["handbench"], marker=MARKERS[knob], lw=0) for knob in knobs]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    return figure


def _mark(axes: Axes, point: Trial, colour: str, marker: str, alpha: float = 1.0, fill: bool = True) -> None:
    low, high = point.spread
    error = max(point.error, _FLOOR)
    axes.plot([low, high], [error, error], color=colour, lw=0.9, alpha=0.7, zorder=2)
    face = colour if fill else "white"
    axes.plot(point.time, error, marker, ms=4.2, color=colour, mfc=face, mew=0.9, alpha=alpha, zorder=4)


def _handle(axes: Axes, label: str, colour: str, lw: float, marker: str = "") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, lw=lw, marker=marker or None, ms=4.5, label=label)


def _time_axis(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(10))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: duration(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    _frame(axes)


def _error_axis(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(10, subs=(1.0, 3.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:.6g} %"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _frame(axes: Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(which="both", color="#8a857c")


def duration(seconds: float) -> str:
    """A short time: 1 ms, 0.25 s."""
    return (
        f"{1e6 * seconds:.3g} µs"
        if seconds < 1e-3
        else f"{1e3 * seconds:.3g} ms"
        if seconds < 1
        else f"{seconds:.3g} s"
    )


def _scaling(found: Sequence[Scaling]) -> Figure:
    figure = Figure(figsize=(8.6, 5.6), layout="constrained")
    for axes, one in zip(np.ravel(figure.subplots(2, 2)), found, strict=False):
        sizes, middles = one.sizes, [median(repeats) for repeats in one.seconds]
        for size, repeats in zip(sizes, one.seconds, strict=True):
            axes.plot([size, size], [min(repeats), max(repeats)], color=COLOURS["handbench"], lw=1)
        axes.plot(sizes, middles, "o", color=COLOURS["handbench"], ms=4.5)
        fit = one.fit
        used = np.array(sizes[-fit.used :], float)
        axes.plot(used, fit.scale * used**fit.exponent, color="#1d1c1a", lw=1.1, zorder=1)
        text = f"exponent {fit.exponent:.2f} ± {fit.error:.2f}"
        axes.text(0.04, 0.9, text, transform=axes.transAxes, fontsize=8.5)
        axes.set_title(one.title, loc="left", fontsize=9.5, fontweight="bold")
        axes.set_xscale("log", base=2 if one.axis in ("subjects", "texels") else 4)
        axes.set_xticks(sizes, [_side(size) if one.axis == "texels" else str(size) for size in sizes])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlabel({"texels": "texels", "lights": "lights"}.get(one.axis, one.axis))
        axes.set_yscale("log")
        axes.set_ylim(min(middles) / 2, max(middles) * 4)
        axes.yaxis.set_major_locator(LogLocator(10, subs=(1.0, 3.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: duration(value)))
        axes.yaxis.set_minor_formatter(NullFormatter())
        _frame(axes)
    return figure


def _side(texels: int) -> str:
    return f"{round(texels**0.5)}²"


def _methods(found: Sequence[MethodStudy]) -> Figure:
    columns = min(3, len(found))
    rows = -(-len(found) // columns)
    figure = Figure(figsize=(2.9 * columns, 2.5 * rows + 0.5), layout="constrained")
    grid = np.ravel(figure.subplots(rows, columns, squeeze=False, sharey=True))
    knobs: dict[str, None] = {}
    for axes, method in zip(grid, found, strict=False):
        for curve in method.curves:
            for point in curve.points:
                knobs[point.knob] = None
                fill = curve.pose == "known"
                _mark(axes, point, _KNOB_COLOURS.get(point.knob, "#555"), MARKERS[point.knob], fill=fill)
        axes.set_title(method.title, loc="left", fontsize=9.5, fontweight="bold")
        axes.set_xlabel("Time of a picture")
        _time_axis(axes)
        _error_axis(axes)
        axes.yaxis.set_major_locator(LogLocator(10, numticks=9))
        axes.set_ylim(_FLOOR / 2, 2)
    for axes in grid[len(found) :]:
        axes.set_visible(False)
    for axes in grid[::columns]:
        axes.set_ylabel("Relative RMSE to own\nfull picture")
    handles = [
        _handle(grid[0], knob, colour=_KNOB_COLOURS.get(knob, "#555"), marker=MARKERS[knob], lw=0) for knob in knobs
    ]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=6,
        frameon=False,
        fontsize=8,
        title="filled: known pose under a new light, hollow: new pose; errors below 0.0001 % are drawn there",
        title_fontsize=8,
    )
    return figure


_KNOB_COLOURS = {
    "default": "#b3471d",
    "skips": "#77736c",
    "lights": "#2f6db0",
    "texture": "#1f8a70",
    "environment": "#7a4fa3",
}
