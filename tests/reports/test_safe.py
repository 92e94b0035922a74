"""Texts of others are texts in every format: no command, formula, link or line of their own."""

from __future__ import annotations

from dataclasses import replace

import pytest

from handbench.reports.cost import MethodTimes
from handbench.reports.latex import render_latex
from handbench.reports.model import Aggregate, ColumnGroup, MetricColumn, Row, Table
from handbench.reports.safe import csv_cell, latex_header
from handbench.reports.text import render_csv, render_markdown
from handbench.results.record import MetricRecord

METRIC = MetricRecord("psnr", "PSNR", "psnr|v1", True, "dB", "PSNR$\\uparrow$", 2)
HOSTILE = '=HYPERLINK("x")\n\n\\input{/etc/passwd} [here](http://example.org) `code` \x1b[2J'


def table(title: str, latex: str = METRIC.latex) -> Table:
    column = MetricColumn(ColumnGroup("light", title), replace(METRIC, title=title, latex=latex))
    row = Row("m", title, "method", "for tests", (Aggregate(30.0, None, None, 1, 1),), MethodTimes(None, None, {}, {}))
    return Table(title, (column,), (row,), (title,), (title,))


def test_no_format_obeys_a_title() -> None:
    made = table(HOSTILE)
    tex, markdown, csv = render_latex(made), render_markdown(made), render_csv(made)
    tex = "\n".join(line for line in tex.splitlines() if not line.startswith("%"))
    assert "\\input" not in tex and len(tex.split("\n\n")) == len(render_latex(table("Title")).split("\n\n"))
    assert "](http" not in markdown.replace("\\](", "") and "`code`" not in markdown.replace("\\`", "")
    assert "\x1b" not in tex + markdown
    assert all(not line.startswith("=") for line in csv.splitlines()) and "'=HYPER" in csv


@pytest.mark.parametrize(
    "given",
    [
        "\\input{x}",
        "\\write18{rm}",
        "^^5cinput{x}",
        "$x",
        "}{",
        "a & b",
        "a \\\\ b",
        "100 %",
        "\\csname input\\endcsname",
        "\\",
    ],
)
def test_a_header_with_commands_gives_way_to_the_title(given: str) -> None:
    assert latex_header(given, "A & B") == "A \\& B"


@pytest.mark.parametrize(
    "given", ["PSNR$\\uparrow$", "LPIPS (Alex)$\\downarrow$", "$\\Delta E_{ab}^2$", "F$_{5\\mathrm{mm}}$"]
)
def test_a_formula_stays(given: str) -> None:
    assert latex_header(given, "title") == given


def test_numbers_are_no_formulas() -> None:
    assert [csv_cell(value) for value in (-1.5, "-1", "@x", "a=b", None)] == [-1.5, "'-1", "'@x", "a=b", None]
