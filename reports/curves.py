"""Loss curves: one small figure a method, with every training of a run in it."""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from handbench.results.record import CurvePoint

from .run import Run

DPI = 130
_SUM = "loss"  # what a training calls the sum of its terms
COLOURS = ("#b3471d", "#2f6db0", "#1f8a70", "#8a5a00", "#77736c", "#7b4fa3", "#c2477f")


@dataclass(frozen=True)
class Curve:
    """A training: (step, value) points of each named loss; values that were not finite are left out."""

    seed: int
    subject: str  # "" for a prior, which all subjects share
    terms: Mapping[str, Sequence[tuple[int, float]]]


def curves(run: Run) -> dict[str, tuple[Curve, ...]]:
    """The trainings of each method by its name: priors and personalisations; methods without any are not there."""
    found: dict[str, dict[str, Curve]] = defaultdict(dict)
    for cell in run.cells:
        of_method = found[cell.method.name]
        if cell.prior is not None and cell.prior not in of_method:
            prior = run.read_prior(cell.prior)
            if prior is not None and (terms := _terms(prior.curve)):
                of_method[cell.prior] = Curve(cell.seed, "", terms)
        if terms := _terms(cell.curve):
            of_method[cell.key] = Curve(cell.seed, cell.subject, terms)
    return {name: tuple(trainings.values()) for name, trainings in found.items() if trainings}


def loss_figures(run: Run) -> Iterator[tuple[str, str, bytes]]:
    """(method's name, its title, PNG) in the order of the run's methods."""
    trainings = curves(run)
    for method in run.plan.methods:
        if method.name in trainings:
            yield method.name, method.title, curve_png(method.title, trainings[method.name])


def curve_png(title: str, trainings: Sequence[Curve]) -> bytes:
    """Losses by step. Those that are always positive have a logarithmic axis, others a linear one beside it."""
    names = list(dict.fromkeys(name for curve in trainings for name in curve.terms))
    points = {name: [curve.terms[name] for curve in trainings if name in curve.terms] for name in names}
    signed = [name for name in names if any(value <= 0.0 for line in points[name] for _, value in line)]
    panels = [part for part in ([name for name in names if name not in signed], signed) if part]
    with rc_context({"font.size": 8, "font.family": "DejaVu Sans"}):
        wide, tall = 4.5 * len(panels), 2.5
        figure = Figure(figsize=(wide, tall), dpi=DPI)
        FigureCanvasAgg(figure)
        figure.suptitle(_caption(title, trainings), fontsize=8, parse_math=False, y=0.97)
        for i, part in enumerate(panels):  # places in inches: matplotlib's own layout takes most of the time
            axes = figure.add_axes(((4.5 * i + 0.8) / wide, 0.45 / tall, 2.1 / wide, 1.7 / tall))
            if part is not signed:
                axes.set_yscale("log")
            for name in part:
                _draw(axes, name, points[name], COLOURS[names.index(name) % len(COLOURS)])
            axes.set_xlabel("step")
            axes.grid(alpha=0.25, linewidth=0.5)
            axes.spines[["top", "right"]].set_visible(False)
            axes.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
        out = io.BytesIO()
        figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _draw(axes: Axes, name: str, lines: Sequence[Sequence[tuple[int, float]]], colour: str) -> None:
    width, strength = (2.5, 0.4) if name == _SUM else (1.0, 0.8)  # often one term is nearly all of the sum
    for i, line in enumerate(lines):
        steps, values = zip(*line, strict=True)
        marker = "o" if len(line) == 1 else ""
        label = "" if i else name
        axes.plot(steps, values, color=colour, linewidth=width, alpha=strength, marker=marker, label=label)


def _caption(title: str, trainings: Sequence[Curve]) -> str:
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
