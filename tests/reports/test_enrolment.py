"""What enrolment gave is a label of every row, and unequal rows are never compared without a mark."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import pytest
from rich.console import Console

from handbench.reports import render_terminal
from handbench.reports.build import build
from handbench.reports.latex import render_latex
from handbench.reports.page import PageContent, render_page
from handbench.reports.pareto import draw, enrolments, in_words, plots
from handbench.reports.pareto_figures import pareto_figures
from handbench.reports.text import render_csv, render_markdown
from handbench.results.reading import read_run


@pytest.fixture
def enrolled(whole_run):
    """A function that gives the table of the made-up run with labels of its methods."""

    def enrolled(**labels: str):
        run = read_run(whole_run)
        methods = tuple(replace(m, enrolment=labels.get(m.name, "fully lit views")) for m in run.plan.methods)
        return build(replace(run, plan=replace(run.plan, methods=methods)), baseline="physical")

    return enrolled


def _printed(table) -> str:
    console = Console(file=io.StringIO(), width=200)
    console.print(render_terminal(table))
    return console.file.getvalue()


def test_every_row_of_every_table_is_labelled(enrolled):
    table = enrolled(urhand="one picture")
    for text in (_printed(table), render_markdown(table), render_latex(table)):
        assert "one picture" in text and text.count("fully lit views") >= 3
    rows = list(csv.DictReader(io.StringIO(render_csv(table))))
    assert {row["enrolment"] for row in rows if row["method"] == "urhand"} == {"one picture"}


def test_comparisons_across_unequal_enrolment_are_marked(enrolled):
    table = enrolled(urhand="one picture")
    best = next(row for row in table.rows if row.name == "urhand")
    assert all(cell.unequal == (cell.rank > 0) for row in table.rows for cell in row.cells)
    assert all(cell.across for cell in best.cells if cell.difference)
    assert not any(cell.across for row in table.rows if row.name == "phong" for cell in row.cells)
    assert "≠" in _printed(table) and "≠" in render_markdown(table) and r"\ensuremath{\neq}" in render_latex(table)


def test_equal_enrolment_has_no_mark(enrolled):
    table = enrolled(oracle="the truth")  # a calibration row competes with none
    assert not table.unequal or all(cell.across for cell in table.rows[0].cells)
    for row in table.rows[1:]:
        assert not any(cell.unequal or cell.across for cell in row.cells)


def test_fronts_are_marked_where_enrolment_differs(enrolled):
    for plot in plots(enrolled(urhand="one picture")):
        assert all(point.unequal == (point.kind == "front") for point in plot.points)
        assert "URHand ≠ (one picture)" in in_words(plot) or "URHand" not in {p.title for p in plot.front}
        assert "one picture (URHand)" in enrolments([plot]) and "Phong" in enrolments([plot])
        assert {mark.text for *_, mark in draw(plot).marks if "≠" in mark.text} == {f"{p.title} ≠" for p in plot.front}
    equal = plots(enrolled(oracle="the truth"))
    assert equal and not any(point.unequal for plot in equal for point in plot.points)


def test_a_figure_of_the_front_says_what_the_mark_means(enrolled):
    found = [plot for plot in plots(enrolled(urhand="one picture")) if plot.time == "known"]
    (_, files), *_ = pareto_figures(found)
    (_, plain), *_ = pareto_figures([plot for plot in plots(enrolled()) if plot.time == "known"])
    heights = [int.from_bytes(each["png"][20:24], "big") for each in (files, plain)]
    assert heights[0] > heights[1], "a line below the drawings"


def test_the_page_says_what_enrolment_gave_the_points(enrolled, whole_run):
    table = enrolled(urhand="one picture")
    page = render_page(table, read_run(whole_run), PageContent((), (), plots(table)))
    assert "URHand ≠ (one picture)" in page and "Enrolment gave: " in page
