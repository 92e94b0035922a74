"""Some of a run: its marks and means are made of what is shown, in the order that was asked for."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from handbench.errors import InputError
from handbench.reports import as_json, render_csv, render_markdown, table
from handbench.reports.comparison import compare
from handbench.reports.run import read_run
from handbench.reports.selection import ReportFilter
from handbench.reports.style import Style

sys.path.append(str(Path(__file__).parents[1] / "bench" / "fakes"))
from runfakes import write_run


def shown(run: Path, **names: tuple[str, ...]):
    return table(run, selection=ReportFilter(**names))


def test_rows_columns_and_metrics_are_those_asked_for_in_that_order(whole_run):
    found = shown(whole_run, methods=("urhand", "ph*"), columns=("environment",), metrics=("ssim", "psnr"))
    assert [row.name for row in found.rows] == ["urhand", "phong", "physical"]
    assert [(c.group.name, c.metric.name) for c in found.columns] == [("environment", "ssim"), ("environment", "psnr")]


def test_values_are_those_of_the_whole_table_and_marks_are_not(whole_run):
    whole, some = table(whole_run), shown(whole_run, methods=("mean", "physical", "phong"))
    by_name = {row.name: row for row in whole.rows}
    for row in some.rows:
        assert [cell.value for cell in row.cells] == [cell.value for cell in by_name[row.name].cells]
    physical = next(row for row in some.rows if row.name == "physical")
    assert {cell.rank for cell in by_name["physical"].cells} == {2} and {cell.rank for cell in physical.cells} == {1}


def test_parts_of_a_run_complete_each_other_in_a_selection(tmp_path):
    first = write_run(tmp_path / "first", methods=("oracle", "good"), subjects=2, frames=2)
    second = Path(shutil.copytree(first, tmp_path / "second"))
    for place, path in enumerate(sorted((first / "cells").iterdir())):
        (path if place % 2 else second / "cells" / path.name).unlink()
    (row,) = table(first, second, selection=ReportFilter(methods=("good",))).rows
    assert row.name == "good" and all(cell.complete for cell in row.cells)


def test_of_several_runs_each_gives_what_it_has_and_what_it_lacks_is_told(tmp_path):
    first = write_run(tmp_path / "first", methods=("oracle", "good"), subjects=2, frames=2)
    second = write_run(tmp_path / "second", methods=("oracle", "fair"), subjects=2, frames=2)
    found = table(first, second, selection=ReportFilter(methods=("fair", "good")))
    assert [row.name for row in found.rows] == ["good", "fair"]
    assert found.remarks[-2:] == (f"Not in {first}: fair.", f"Not in {second}: good.")
    alone = table(first, second, selection=ReportFilter(methods=("g*",)))
    assert [row.name for row in alone.rows] == ["good"], "a run that has none of them is left out"
    with pytest.raises(InputError, match="unknown method of these runs 'best'"):
        table(first, second, selection=ReportFilter(methods=("best", "good")))
    with pytest.raises(InputError, match=f"cannot be compared: Not in {second}: good"):
        compare(first, second, selection=ReportFilter(methods=("good",)))


def test_one_subject_is_its_own_mean(whole_run):
    found = shown(whole_run, subjects=("s02",), methods=("urhand",), metrics=("psnr",), columns=("environment",))
    values = [
        value
        for cell in read_run(whole_run).of_method("urhand")
        if cell.subject == "s02"
        for frame, signature, value, _ in cell.each()
        if frame.column == "environment" and signature.startswith("psnr|")
    ]
    (cell,) = found.rows[0].cells
    assert cell.value == pytest.approx(np.mean(values)) and cell.complete and cell.expected == len(values)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"methods": ("urhnad",)}, "unknown method of this run 'urhnad'; did you mean 'urhand'"),
        ({"columns": ("unseen-ligth",)}, "unknown column 'unseen-ligth'; did you mean 'unseen-light'"),
        ({"metrics": ("psrn",)}, "unknown metric 'psrn'; did you mean 'psnr'"),
        ({"subjects": ("s09",)}, "unknown subject of this run 's09'"),
    ],
)
def test_a_name_that_is_not_there_is_told_with_those_that_are(whole_run, wrong, message):
    with pytest.raises(InputError, match=message):
        shown(whole_run, **wrong)


def test_a_style_leaves_out_and_rounds(whole_run):
    found = table(whole_run)
    plain, bare = render_markdown(found), render_markdown(found, Style(intervals=False, times=False, decimals=1))
    assert "[" in plain.split("## Unseen segment")[1].split("##")[0] and "train s" in plain
    assert "[" not in bare.split("## Unseen segment")[1].split("##")[0] and "train s" not in bare
    assert "33.1" in bare and "33.12" not in bare


def test_json_and_csv_say_the_same(whole_run):
    import csv
    import io

    found = table(whole_run)
    for told, line in zip(as_json(found), csv.DictReader(io.StringIO(render_csv(found))), strict=True):
        assert {name: str(value) for name, value in told.items()} == {
            name: text for name, text in line.items() if text not in ("", "inf", "-inf")
        }
