"""Loss curves: one small figure a method, with every training of a run in it."""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from handbench.results.measured import CurvePoint

from .run import Run

DPI = 130
WIDE, TALL = 4.5, 2.5  # inches of a panel
LEAST = 3  # points that make a line
INK = "#1d1c1a"
STYLE: Any = {
    "font.size": 8,
    "font.family": "DejaVu Sans",
    "svg.fonttype": "none",
    "svg.hashsalt": "losses",
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
}
_SCHEMES = (
    f"<style>:root {{ color: {INK} }} @media (prefers-color-scheme: dark) {{ :root {{ color: #ebe7e0 }} }}</style>"
).encode()
_SUM = "loss"  # what a training calls the sum of its terms
COLOURS = ("#b3471d", "#2f6db0", "#1f8a70", "#8a5a00", "#77736c", "#7b4fa3", "#c2477f")
DASHES = ("-", "--", ":")  # of losses beyond as many as there are colours

Points: TypeAlias = Sequence[tuple[int, float]]  # steps with values
Terms: TypeAlias = Mapping[str, Points]


@dataclass(frozen=True)
class LossCurve:
    """A training: (step, value) points of each named loss; values that were not finite are left out."""

    seed: int
    subject: str  # "" for a prior, which all subjects share
    terms: Terms


def curves(run: Run) -> dict[str, tuple[LossCurve, ...]]:
    """The trainings of each method by its name: priors and personalisations; methods without any are not there."""
    found: dict[str, dict[str, LossCurve]] = defaultdict(dict)
    for cell in run.cells:
        of_method = found[cell.method.name]
        if cell.prior is not None and cell.prior not in of_method:
            prior = run.read_prior(cell.prior)
            if prior is not None and (terms := _terms(prior.curve)):
                of_method[cell.prior] = LossCurve(cell.seed, "", terms)
        if terms := _terms(cell.curve):
            of_method[cell.key] = LossCurve(cell.seed, cell.subject, terms)
    return {name: tuple(trainings.values()) for name, trainings in found.items() if trainings}


def loss_figures(run: Run) -> Iterator[LossPlot]:
    """The losses of each method in the order of the run's methods; a line of one or two points is none."""
    trainings = curves(run)
    for method in run.plan.methods:
        long = (replace(each, terms=_lines(each.terms)) for each in trainings.get(method.name, ()))
        if drawn := tuple(each for each in long if each.terms):
            yield LossPlot(method.name, method.title, drawn)


def _lines(terms: Terms) -> Terms:
    return {name: points for name, points in terms.items() if len(points) >= LEAST}


@dataclass(frozen=True)
class LossPlot:
    """All trainings of a method in one drawing: losses that are always positive on a logarithmic axis, others on a
    linear one beside it."""

    name: str
    title: str
    trainings: tuple[LossCurve, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the SVG in pixels of a page."""
        return round(96 * WIDE * len(self._panels)), round(96 * TALL)

    @cached_property
    def png(self) -> bytes:
        return self._saved("png", dpi=DPI, metadata={"Software": None})

    @cached_property
    def svg(self) -> bytes:
        """On no ground, in the ink of the scheme that a browser shows."""
        drawn = self._saved("svg", transparent=True, metadata={"Date": None, "Creator": None})
        text = drawn[drawn.index(b"<svg") :].replace(INK.encode(), b"currentColor")
        return text.replace(b">", b">" + _SCHEMES, 1)

    @cached_property
    def _points(self) -> dict[str, list[Points]]:
        names = dict.fromkeys(name for curve in self.trainings for name in curve.terms)
        return {name: [curve.terms[name] for curve in self.trainings if name in curve.terms] for name in names}

    @property
    def _panels(self) -> list[list[str]]:
        signed = [name for name, lines in self._points.items() if any(v <= 0.0 for line in lines for _, v in line)]
        return [part for part in ([name for name in self._points if name not in signed], signed) if part]

    def _saved(self, kind: str, **how: Any) -> bytes:
        panels, names = self._panels, list(self._points)
        wide = WIDE * len(panels)
        with rc_context(STYLE):
            figure = Figure(figsize=(wide, TALL), dpi=DPI)
            FigureCanvasAgg(figure)
            figure.suptitle(_caption(self.title, self.trainings), fontsize=8, parse_math=False, y=0.97)
            for i, part in enumerate(panels):  # places in inches: matplotlib's own layout takes most of the time
                axes = figure.add_axes(((WIDE * i + 0.8) / wide, 0.45 / TALL, 2.1 / wide, 1.7 / TALL))
                if all(value > 0.0 for name in part for line in self._points[name] for _, value in line):
                    axes.set_yscale("log")
                for name in part:
                    round_, place = divmod(names.index(name), len(COLOURS))
                    _draw(axes, name, self._points[name], COLOURS[place], DASHES[round_ % len(DASHES)])
                axes.set_xlabel("step")
                axes.grid(alpha=0.25, linewidth=0.5)
                axes.spines[["top", "right"]].set_visible(False)
                axes.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
            out = io.BytesIO()
            figure.savefig(out, format=kind, **how)
        return out.getvalue()


def _draw(axes: Axes, name: str, lines: Sequence[Points], colour: str, dashes: str) -> None:
    width, strength = (2.5, 0.4) if name == _SUM else (1.0, 0.8)  # often one term is nearly all of the sum
    for i, line in enumerate(lines):
        steps, values = zip(*line, strict=True)
        label = "" if i else name
        axes.plot(steps, values, color=colour, linestyle=dashes, linewidth=width, alpha=strength, label=label)


def _caption(title: str, trainings: Sequence[LossCurve]) -> str:
    seeds = ", ".join(map(str, sorted({curve.seed for curve in trainings})))
    subjects = len({curve.subject for curve in trainings} - {""})
    return f"{title}: seed {seeds}" + (f", {subjects} subjects" if subjects else "")


def _terms(told: Sequence[CurvePoint]) -> dict[str, list[tuple[int, float]]]:
    terms: dict[str, list[tuple[int, float]]] = defaultdict(list)
    for point in told:
        for name, value in point.values.items():
            if value is not None:
                terms[name].append((point.step, value))
    return dict(terms)
