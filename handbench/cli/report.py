"""handbench report, compare and query: the results of runs as tables, pages, differences and answers."""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..terminal import say, show

if TYPE_CHECKING:
    from rich.table import Table

    from ..results.query import Answer

_FORMATS = ("terminal", "latex", "csv", "markdown", "html", "figures")
_QUERY = """\
views: runs, methods, cells, times, scores (one line a value; write "column" with its quotes). For example:
  handbench query runs/quick "SELECT method, avg(value) FROM scores WHERE metric = 'psnr' GROUP BY ALL"
  handbench query runs/quick "DESCRIBE scores"
"""


def add(verbs: Any) -> None:
    report = verbs.add_parser("report", help="print the table of a run or several, or write the page or figures of one")
    report.add_argument("run", type=Path, nargs="+", help="the folder of a run; several of one protocol are one table")
    report.add_argument("--format", choices=_FORMATS, default="terminal", help="html: the page; figures: PNG and PDF")
    report.add_argument("--baseline", metavar="METHOD", help="show paired differences to this method")
    report.set_defaults(verb=_report)

    compare = verbs.add_parser("compare", help="compare runs with the first one, method by method and frame by frame")
    compare.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of two runs or more")
    compare.set_defaults(verb=_compare)

    raw = argparse.RawDescriptionHelpFormatter
    query = verbs.add_parser("query", help="ask the results of runs in SQL", epilog=_QUERY, formatter_class=raw)
    query.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of runs")
    query.add_argument("sql", metavar="SELECT", help="one SELECT in the SQL of DuckDB")
    query.add_argument("--format", choices=("table", "csv", "json"), default="table")
    query.set_defaults(verb=_query)


def _report(arguments: argparse.Namespace) -> int:
    from .. import reports

    if arguments.format in ("html", "figures"):
        _check_page(arguments)
        files = reports.write_reports(arguments.run[0], figures=arguments.format == "figures")
        say(files["index.html"] if arguments.format == "html" else arguments.run[0] / "report" / "figures")
        return 0
    table = reports.table(*arguments.run, baseline=arguments.baseline)
    if arguments.format == "terminal":
        show(reports.render_terminal(table))
    else:
        say(getattr(reports, f"render_{arguments.format}")(table), end="")
    return 0


def _check_page(arguments: argparse.Namespace) -> None:
    from ..errors import InputError

    if len(arguments.run) > 1 or arguments.baseline:
        raise InputError(
            f"--format {arguments.format} shows one run without a baseline; tables take several runs and --baseline"
        )


def _compare(arguments: argparse.Namespace) -> int:
    from ..errors import InputError

    if len(arguments.runs) < 2:
        raise InputError(f"there is nothing to compare {arguments.runs[0]} with; give two runs or more")
    from ..reports.comparison import compare, render_comparison

    show(render_comparison(compare(*arguments.runs)))
    return 0


def _query(arguments: argparse.Namespace) -> int:
    from ..results.query import Results
    from ..results.reading import read_run

    with Results([read_run(folder) for folder in arguments.runs]) as results:
        answer = results.query(arguments.sql)
    if arguments.format == "csv":
        writer = csv.writer(sys.stdout, lineterminator="\n")
        from ..reports.safe import csv_cell

        writer.writerows([map(csv_cell, row) for row in (answer.columns, *answer.rows)])
    elif arguments.format == "json":
        rows = [dict(zip(answer.columns, map(_plain, row), strict=True)) for row in answer.rows]
        say(json.dumps(rows, indent=1, allow_nan=False))
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


def _grid(answer: Answer) -> Table:
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
