"""handbench report, compare and query: the results of runs as tables, pages, figures, differences and answers."""

from __future__ import annotations

import argparse
import csv
import math
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..terminal import say, show
from .shared import count, examples, json_option, names, tell

if TYPE_CHECKING:
    from rich.table import Table

    from ..reports.selection import ReportFilter
    from ..reports.style import Style
    from ..results.query import ResultSet

_FORMATS = ("terminal", "latex", "csv", "markdown", "json", "html", "figures")
_VIEWS = 'Views: runs, methods, cells, times, scores (one line a value; write "column" with its quotes).'
_INCH = re.compile(r"(\d{1,4}(?:\.\d{1,6})?)\s*(in|cm|mm|pt)?", re.ASCII)
_UNITS = {"in": 1.0, "cm": 2.54, "mm": 25.4, "pt": 72.27}


def add(verbs: Any) -> None:
    report = verbs.add_parser("report", help="the table of a run or several in any format, the page, or figures")
    report.add_argument("run", type=Path, nargs="+", help="the folder of a run; several of one protocol are one table")
    report.add_argument("--format", choices=_FORMATS, default="terminal", help="html: the page; figures: PNG and PDF")
    json_option(report)
    report.add_argument("--baseline", metavar="METHOD", help="show paired differences to this method")
    for name, what in (("methods", "rows"), ("columns", "columns"), ("metrics", "metrics"), ("subjects", "subjects")):
        told = f"only these {what}, in this order: names or patterns" if name != "subjects" else "only their frames"
        report.add_argument(f"--{name}", type=names, default=(), metavar="A,B", help=told)
    table = report.add_argument_group("tables")
    for name, what in (
        ("intervals", "95 %% intervals"),
        ("seeds", "the deviation over seeds, after ±"),
        ("times", "what methods cost"),
    ):
        table.add_argument(f"--{name}", action=argparse.BooleanOptionalAction, help=f"show {what}")
    table.add_argument("--decimals", type=int, metavar="N", help="of every metric, instead of its own")
    table.add_argument("--wide", action="store_true", help="LaTeX: a float over both columns of a two-column class")
    table.add_argument("--label", default="", metavar="TAB:X", help="LaTeX: for \\ref")
    table.add_argument("--caption", default="", metavar="TEXT", help="LaTeX: instead of the protocol's title")
    figures = report.add_argument_group("figures")
    figures.add_argument(
        "--frame",
        action="append",
        default=[],
        metavar="SUBJECT/POSE/CAMERA/LIGHT",
        help="draw this frame, once or more; a pattern is each frame that fits ('s01/*/dorsal/env-*')",
    )
    figures.add_argument(
        "--width", type=_inches, metavar="3.3in", help="of figures, and of tables in LaTeX: in, cm, pt"
    )
    figures.add_argument(
        "--crop",
        type=_square,
        default=argparse.SUPPRESS,
        metavar="X,Y,SIDE",
        help="the detail, in pixels of the recorded picture, or none (default: where methods are most wrong)",
    )
    figures.add_argument("--dpi", type=count, metavar="N", help="of PNG files (default: 160)")
    figures.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="where they go, and a page of several runs (default: RUN/figures, RUN/compared)",
    )
    examples(
        report,
        "report runs/quick  # the table",
        "report runs/quick runs/mine --baseline urhand  # two runs in one table, with differences",
        "report runs/quick --format latex --metrics psnr,lpips-alex --wide --intervals --label tab:main",
        "report runs/quick --format figures --frame s05/pose-4/dorsal/group-2 --methods physical,urhand --width 3.3in",
        "report runs/quick --format csv --subjects s05  # one subject",
        "report runs/quick --format html  # the page",
    )
    report.set_defaults(verb=_report)

    compare = verbs.add_parser("compare", help="compare runs with the first one, method by method and frame by frame")
    compare.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of two runs or more")
    compare.add_argument("--methods", type=names, default=(), metavar="A,B", help="only these: names or patterns")
    compare.add_argument("--metrics", type=names, default=(), metavar="A,B", help="only these: names or patterns")
    compare.add_argument("--format", choices=("terminal", "markdown", "json"), default="terminal", help="of the answer")
    json_option(compare)
    examples(
        compare,
        "compare runs/main runs/new",
        "compare runs/main runs/new --format markdown >> summary.md",
        "compare runs/main runs/new --methods urhand --metrics psnr --json",
    )
    compare.set_defaults(verb=_compare)

    query = verbs.add_parser("query", help="ask the results of runs in SQL")
    query.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of runs")
    query.add_argument("sql", metavar="SELECT", help="one SELECT in the SQL of DuckDB")
    query.add_argument("--format", choices=("table", "csv", "json"), default="table", help="of the answer")
    json_option(query)
    examples(
        query,
        "query runs/quick \"SELECT method, avg(value) FROM scores WHERE metric = 'psnr' GROUP BY ALL\"",
        'query runs/quick "SELECT * FROM scores" --format csv > scores.csv',
        'query runs/quick "DESCRIBE scores"',
        below=_VIEWS,
    )
    query.set_defaults(verb=_query)


def _inches(text: str) -> float:
    found = _INCH.fullmatch(text.strip())
    if not found or not 0.5 <= (inches := float(found[1]) / _UNITS[found[2] or "in"]) <= 60:
        raise argparse.ArgumentTypeError(f"{text!r} is no width from 0.5 to 60 inches; write 3.3in, 8.4cm or 240pt")
    return inches


def _square(text: str) -> tuple[int, int, int] | None:
    if text == "none":
        return None
    parts = text.split(",")
    if len(parts) != 3 or not all(part.isascii() and part.isdigit() and len(part) < 6 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is no square; give X,Y,SIDE in pixels, or none")
    left, top, side = map(int, parts)
    if side < 2:
        raise argparse.ArgumentTypeError(f"a detail of {side} pixels shows nothing; give a side of 2 or more")
    return left, top, side


def _report(arguments: argparse.Namespace) -> int:
    from .. import reports

    form = "json" if arguments.json else arguments.format
    if form == "figures" and _drawn(arguments):
        return _figures(arguments)
    if form in ("html", "figures"):
        if form == "figures":
            _check_page(arguments)
        also = {"others": arguments.run[1:], "baseline": arguments.baseline, "out": arguments.out}
        files = reports.write_reports(arguments.run[0], figures=form == "figures", **also)
        say(files["index.html"] if form == "html" else arguments.run[0] / "report" / "figures")
        return 0
    table = reports.table(*arguments.run, baseline=arguments.baseline, selection=_selection(arguments))
    style = _style(arguments)
    if form == "terminal":
        show(reports.render_terminal(table, style))
    elif form == "csv":
        say(reports.render_csv(table), end="")
    elif form == "json":
        tell(reports.as_json(table))
    else:
        say(getattr(reports, f"render_{form}")(table, style), end="")
    return 0


def _selection(arguments: argparse.Namespace) -> ReportFilter:
    from ..reports.selection import ReportFilter

    return ReportFilter(arguments.methods, arguments.columns, arguments.metrics, arguments.subjects)


def _style(arguments: argparse.Namespace) -> Style:
    from ..reports.style import Style

    shown = (arguments.intervals, arguments.seeds, arguments.times, arguments.decimals)
    return Style(*shown, arguments.wide, arguments.width, arguments.label, arguments.caption)


def _drawn(arguments: argparse.Namespace) -> bool:
    """Whether figures are asked for that are not those of every report."""
    chosen = (arguments.frame, arguments.width, arguments.dpi, arguments.out)
    selected = (arguments.methods, arguments.columns, arguments.metrics, arguments.subjects)
    return any((*chosen, *selected)) or hasattr(arguments, "crop")


def _figures(arguments: argparse.Namespace) -> int:
    from ..reports.drawn import Figures, write_figures

    if len(arguments.run) > 1 or arguments.baseline:
        _check_page(arguments)
    run = arguments.run[0]
    crop = getattr(arguments, "crop", ())
    wanted = Figures(tuple(arguments.frame), arguments.width, arguments.dpi, crop)
    for path in write_figures(run, _selection(arguments), wanted, arguments.out or run / "figures"):
        say(path)
    return 0


def _check_page(arguments: argparse.Namespace) -> None:
    from ..errors import InputError

    if len(arguments.run) > 1 or arguments.baseline:
        raise InputError(
            f"--format {arguments.format} shows one run without a baseline; tables and the page take several runs and "
            "--baseline"
        )


def _compare(arguments: argparse.Namespace) -> int:
    from ..errors import InputError

    if len(arguments.runs) < 2:
        raise InputError(f"there is nothing to compare {arguments.runs[0]} with; give two runs or more")
    from ..reports import comparison
    from ..reports.selection import ReportFilter

    chosen = ReportFilter(methods=arguments.methods, metrics=arguments.metrics)
    found = comparison.compare(*arguments.runs, selection=chosen)
    if arguments.json or arguments.format == "json":
        tell(comparison.as_json(found))
    elif arguments.format == "markdown":
        say(comparison.render_markdown(found), end="")
    else:
        show(comparison.render_comparison(found))
    return 0


def _query(arguments: argparse.Namespace) -> int:
    from ..results.query import ResultsDatabase
    from ..results.reading import read_run

    with ResultsDatabase([read_run(folder) for folder in arguments.runs]) as results:
        answer = results.query(arguments.sql)
    form = "json" if arguments.json else arguments.format
    if form == "csv":
        writer = csv.writer(sys.stdout, lineterminator="\n")
        from ..reports.safe import csv_cell

        writer.writerows([map(csv_cell, row) for row in (answer.columns, *answer.rows)])
    elif form == "json":
        tell([dict(zip(answer.columns, map(_plain, row), strict=True)) for row in answer.rows])
    else:
        show(_grid(answer))
    return 0


def _plain(value: object) -> object:
    """A value of SQL as one of JSON, which has no NaN, no infinity and no dates."""
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _grid(answer: ResultSet) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for name in answer.columns:
        table.add_column(Text(name), overflow="fold")
    for row in answer.rows:
        table.add_row(*(Text(_text(value)) for value in row))
    return table


def _text(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
