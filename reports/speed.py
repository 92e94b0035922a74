"""The report of a speed study: figures, tables for the terminal, and one HTML page that needs no other file."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from rich.console import Group as Lines
from rich.console import RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from handbench.files import whole, writing
from handbench.studies.speed.equal_error import TimeAt
from handbench.studies.speed.record import (
    MITSUBA,
    RESULT,
    Implicit,
    ImplicitPart,
    MethodStudy,
    PartTrial,
    Scaling,
    SceneStudy,
    SpeedRecord,
    read,
)

from .run import machine
from .template import environment

POSES = {"new": "new pose", "known": "known pose, new light"}
FOLDER = "report"


def write_speed_report(folder: Path) -> Path:
    """`report/index.html` and `report/figures/*.png, *.pdf` from the `speed.json` in a folder; returns the page.

    Raises `InputError` without a readable study and `StorageError` if a file cannot be written.
    """
    from .speed_figures import figures

    found = read(folder)
    drawn = list(figures(found))
    place = folder / FOLDER
    with writing(place):
        (place / "figures").mkdir(parents=True, exist_ok=True)
        for name, _, images in drawn:
            for kind, content in images.items():
                with whole(place / "figures" / f"{name}.{kind}") as part:
                    part.write_bytes(content)
        with whole(place / "index.html") as part:
            part.write_text(_template("speed.html", found, drawn), encoding="utf-8")
    return place / "index.html"


def speed_section(run_folder: Path) -> str | None:
    """The body of the page as an HTML fragment for another one, or None if the folder has no `speed.json`."""
    if not (run_folder / RESULT).exists():
        return None
    from .speed_figures import figures

    found = read(run_folder)
    return _template("speed_section.html", found, list(figures(found, ("png",))))


def _template(name: str, found: SpeedRecord, drawn: list[tuple[str, str, dict[str, bytes]]]) -> str:
    page = environment(percent=percent, duration=duration, cell=cell_text, least=least)
    shown = {name: (caption, base64.b64encode(images["png"]).decode()) for name, caption, images in drawn}
    return page.get_template(name).render(
        found=found,
        figures=shown,
        machine=_machine(found),
        goals=[*goals(found), *implicit_goals(found.implicit)],
        implicit=found.implicit,
        median=median,
        learning=learning,
        poses=POSES,
    )


def _machine(found: SpeedRecord) -> str:
    return machine(found.provenance.device)


def render_speed(found: SpeedRecord) -> RenderableType:
    """A rich renderable of the tables."""
    parts: list[RenderableType] = [Text(f"Times on {_machine(found)}", style="dim")]
    for scene in found.scenes:
        parts.append(_equal_error(scene))
        parts.append(Text(_about(scene), style="dim"))
    told = [*goals(found), *implicit_goals(found.implicit)]
    parts += [Text(line, style="green" if fine else "red") for fine, line in told]
    parts.append(_scaling(found.scaling))
    parts.append(_methods(found.methods))
    if found.implicit is not None:
        parts += _implicit(found.implicit)
    return Lines(*parts)


def _equal_error(scene: SceneStudy) -> RichTable:
    rows = scene.equal_error
    grid = _grid(f"{scene.title}: time to a relative RMSE, and how many times faster handbench is")
    for title in ("pose", "renderer", *(percent(c.error) for c in rows[0].cells)):
        grid.add_column(title, justify="left" if title in ("pose", "renderer") else "right")
    for row in rows:
        grid.add_row(POSES[row.pose], row.renderer, *(cell_text(cell) for cell in row.cells))
    return grid


def _about(scene: SceneStudy) -> str:
    text = f"reference: {scene.truth.pixels} pixels, noise {percent(scene.truth.noise)}"
    if scene.mitsuba_residual:
        residual = scene.mitsuba_residual
        text += f"; Mitsuba converges to within {percent(residual.error)} of it"
        text += f" (of which noise {percent(residual.noise)})"
    return "; ".join([text, learning(scene), *scene.notes])


def learning(scene: SceneStudy) -> str:
    """What it takes to know a pose."""
    seconds = [kept.seconds for kept in scene.learn]
    if not seconds:
        return "no pose was kept"
    return f"to keep a pose took handbench {duration(min(seconds))} to {duration(max(seconds))}, off the clock"


def goals(found: SpeedRecord) -> list[tuple[bool, str]]:
    """For each goal, competitor and pose: whether it is met, and a sentence."""
    sentences = []
    for goal in found.goals:
        scene = next((s for s in found.scenes if s.name == goal.scene), None)
        for row in scene.equal_error if scene else []:
            if row.renderer not in MITSUBA.values():
                continue
            cell = next(c for c in row.cells if c.error == goal.error)
            wanted, times = goal.new if row.pose == "new" else goal.known, cell.speed_up
            fine = times is not None and times >= wanted and cell.sign != "<="
            measured = speed_up_text(cell)
            told = f"{POSES[row.pose]} against {row.renderer} at {percent(goal.error)}: "
            sentences.append((fine, f"{told}{measured}, goal {wanted:g} times"))
    return sentences


def implicit_goals(found: Implicit | None) -> list[tuple[bool, str]]:
    """For each goal of a skip of implicit hands: whether it is met, and a sentence."""
    if found is None:
        return []
    fast = found.skips[0].seconds
    return [
        (
            one.seconds >= one.goal * fast,
            f"implicit hand, {one.label}: {_digits(one.seconds / fast, 2)} times the time of all skips, "
            f"goal {one.goal:g} times; pictures {percent(one.error)} apart",
        )
        for one in found.skips
        if one.goal is not None
    ]


def least(part: ImplicitPart) -> PartTrial:
    """The last point of a part of an implicit hand, which has the least error that was asked for."""
    return part.points[-1]


def _implicit(found: Implicit) -> list[RenderableType]:
    skips = _grid("Implicit hands: skips of a frame")
    for title in ("skips", "CPU", "times all skips", "apart from all skips"):
        skips.add_column(title, justify="left" if title == "skips" else "right")
    for one in found.skips:
        times = _digits(one.seconds / found.skips[0].seconds, 2)
        skips.add_row(one.label, duration(one.seconds), times, percent(one.error))
    parts = [skips]
    kinds = (
        ("Implicit hands: encodings, mean error of a learned distance", found.encodings, "{:.2g} mm"),
        ("Implicit hands: directions of light, relative RMSE", found.directions, "{:.2%}"),
    )
    for title, several, form in kinds:
        grid = _grid(title)
        for name in ("part", "errors", "CPU for the last", "error grows as the power"):
            grid.add_column(name, justify="left" if name in ("part", "errors") else "right")
        for part in several:
            errors = "; ".join(f"{p.label} {form.format(p.error)}" for p in part.points)
            power = "" if part.power is None else f"{part.power:.1f}"
            grid.add_row(part.name, errors, duration(least(part).seconds), power)
        parts.append(grid)
    return [*parts, _scaling(found.scaling, "Implicit hands: growth")]


def _scaling(found: Sequence[Scaling], name: str = "Growth") -> RichTable:
    grid = _grid(name)
    for title in ("time against", "sizes", "time at the least", "time at the most", "exponent"):
        grid.add_column(title, justify="left" if title == "time against" else "right")
    for one in found:
        middles = [median(repeats) for repeats in one.seconds]
        sizes = f"{one.sizes[0]} … {one.sizes[-1]}"
        exponent = f"{one.fit.exponent:.2f} ± {one.fit.error:.2f}"
        grid.add_row(one.title, sizes, duration(middles[0]), duration(middles[-1]), exponent)
    return grid


def _methods(found: Sequence[MethodStudy]) -> RichTable:
    grid = _grid("Methods: error to their own full picture, time of a picture")
    for title in ("method", "setting", "error", "new pose", "known pose, new light"):
        grid.add_column(title, justify="left" if title in ("method", "setting") else "right")
    for method in found:
        if not method.curves:
            grid.add_row(method.title, method.reason)
            continue
        new, known = (curve.points for curve in method.curves)
        for first, second in zip(new, known, strict=True):
            times = (duration(median(point.seconds)) for point in (first, second))
            grid.add_row(method.title, first.label, percent(first.error), *times)
    return grid


def _grid(title: str) -> RichTable:
    return RichTable(
        title=title, title_justify="left", title_style="bold", header_style="dim", box=None, padding=(0, 2, 0, 0)
    )


def cell_text(cell: TimeAt) -> str:
    """A cell of the equal-error table: time, and for a competitor how many times faster handbench is."""
    if cell.seconds is None:
        return "not reached"
    text = ("≤ " if cell.bound else "") + duration(cell.seconds)
    return f"{text} ({speed_up_text(cell)})" if cell.compared else text


def speed_up_text(cell: TimeAt) -> str:
    if cell.speed_up is None:
        return cell.reason
    sign = {"=": "", ">=": "≥ ", "<=": "≤ "}[cell.sign]
    return f"{sign}{_digits(cell.speed_up, 3)}×"


def percent(share: float) -> str:
    return "exact" if share == 0 else f"{_digits(100 * share, 2)} %"


def _digits(value: float, digits: int) -> str:
    """A positive number with so many significant digits, never as a power of ten: "0.14", "4.21", "6,280"."""
    text = f"{value:.{digits}g}"
    return f"{float(text):,.0f}" if "e+" in text else text


def duration(seconds: float) -> str:
    """A short time: 940 µs, 12.3 ms, 1.25 s."""
    for scale, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"
