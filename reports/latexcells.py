"""What stands in one cell, head or first column of a LaTeX table, and about how wide a text is there."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

from handbench.results.statistics import Difference

from .model import Aggregate, MetricColumn, Row
from .printed import UNEQUAL, between, bounds, marks, number, signed
from .safe import latex, latex_header
from .style import Style

CellText: TypeAlias = Callable[[Aggregate, MetricColumn], str]
TINY = 0.72  # of the width of \footnotesize
SUNK = r"{\tiny $\bigtriangledown$}"
_STARS = ((0.001, "***"), (0.01, "**"), (0.05, "*"))
_OPEN = r"$\circ$"
_NEQ = latex(UNEQUAL)
_SMALL = re.compile(r"\{\\tiny (.*?)\}|\\textsuperscript\{(.*?)\}")


def column_head(column: MetricColumn) -> str:
    """The metric's own header; what stands in brackets goes to a second line, to save width."""
    metric = column.metric
    head, bracket, rest = latex_header(metric.latex, f"{metric.title} {metric.arrow}").partition(" (")
    return f"\\shortstack[r]{{{head}\\\\({rest}}}" if bracket else head


def row_name(row: Row) -> str:
    """A row's title, with what enrolment gave it in small print."""
    title = latex(row.title + (row.suffix if row.kind == "published" else ""))
    return f"{title}\\,{{\\tiny {latex(row.enrolment)}}}" if row.enrolment else title


def value_text(style: Style) -> CellText:
    """A value with its rank and marks, as a style wants them."""

    def text(cell: Aggregate, column: MetricColumn) -> str:
        value = latex(number(cell.value, column.metric.decimals))
        value = {0: value, 1: f"\\textbf{{{value}}}", 2: f"\\underline{{{value}}}"}[cell.rank]
        value += _beside(_OPEN * (cell.rank > 0 and not cell.claimed) + SUNK * cell.sunk + _NEQ * cell.unequal)
        if style.seeds and cell.spread is not None:
            value += f"\\,{{\\tiny $\\pm$ {latex(number(cell.spread, column.metric.decimals))}}}"
        gap = "" if cell.complete else f"\\,{{\\tiny {cell.covered}/{cell.expected}}}"
        return value + gap + (f"\\textsuperscript{{{marks(cell)}}}" if cell.notes else "")

    return text


def interval_text(cell: Aggregate, column: MetricColumn) -> str:
    """The interval of a value."""
    return latex(between(cell, column.metric.decimals))


def starred_difference(cell: Aggregate, column: MetricColumn) -> str:
    """The difference with the stars of its corrected p-value."""
    apart = cell.difference
    if apart is None:
        return "--"
    return latex(signed(apart.value, column.metric.decimals)) + stars(apart) + _beside(_NEQ * cell.across)


def stars(apart: Difference) -> str:
    """The stars of a difference."""
    return _beside(next((each for p, each in _STARS if apart.adjusted is not None and apart.adjusted < p), ""))


def _beside(mark: str) -> str:
    """A mark that takes no width, so that values stay below each other."""
    return f"\\rlap{{\\textsuperscript{{{mark}}}}}" if mark else ""


def difference_bounds(cell: Aggregate, column: MetricColumn) -> str:
    """The interval of a difference, "" where there is none."""
    return "" if cell.difference is None else latex(bounds(cell.difference, column.metric.decimals))


def text_width(text: str) -> float:
    """About how wide in points a text of LaTeX is at \\footnotesize: its commands have no width of their own."""
    small = "".join(found for groups in _SMALL.findall(text) for found in groups)
    return _bare(_SMALL.sub("", text)) + TINY * _bare(small)


def _bare(text: str) -> float:
    shown = re.sub(r"\\hbletter\{(.*?)\}\{.*?\}", r"U+\1", text)
    shown = re.sub(r"\\[A-Za-z]+|[{}$\\]", "", shown)
    return sum(2.6 if sign in " .,;:'|!()[]ijlt" else 6.2 if sign.isupper() else 4.4 for sign in shown)
