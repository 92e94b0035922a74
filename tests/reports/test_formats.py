"""The formats say what the table says, whatever characters it holds."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from handbench.reports import render_csv, render_latex, render_markdown, render_terminal, table
from handbench.reports.model import Table

NASTY = r"50% of_{all} & #1 $x$ ~^ \ <a|b>"


@pytest.fixture(scope="module")
def result(whole_run: Path) -> Table:
    return table(whole_run)


def _nasty(result: Table) -> Table:
    rows = (replace(result.rows[0], title=NASTY), *result.rows[1:])
    return replace(result, title=NASTY, rows=rows, footnotes=tuple(NASTY for _ in result.footnotes))


def _printed(result: Table, width: int) -> str:
    out = io.StringIO()
    Console(file=out, width=width).print(render_terminal(result))
    return out.getvalue()


def test_latex_rows_have_as_many_cells_as_their_tabular_has_columns(result: Table) -> None:
    text = render_latex(_nasty(result))
    tabulars = re.findall(r"\\begin\{tabular\}\{(\w+)\}(.*?)\\end\{tabular\}", text, re.DOTALL)
    assert tabulars
    for columns, body in tabulars:
        for line in body.splitlines():
            if line.endswith(r"\\"):
                spanned = sum(int(n) - 1 for n in re.findall(r"\\multicolumn\{(\d+)\}", line))
                assert len(re.findall(r"(?<!\\)&", line)) + 1 + spanned == len(columns), line


def test_latex_is_balanced_and_escaped(result: Table) -> None:
    text = "\n".join(line for line in render_latex(_nasty(result)).splitlines() if not line.startswith("%"))
    bare = re.sub(r"\\[\\{}$&#%_]", "", text)
    assert bare.count("{") == bare.count("}")
    assert bare.count("$") % 2 == 0
    assert not re.search(r"[#%_~^|<>–∞−]", bare.replace("_", "") if "_" not in NASTY else bare)
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == text.count(r"\toprule")


def test_latex_marks_best_and_second(result: Table) -> None:
    lines = {line.split(" & ")[0].strip(): line for line in render_latex(result).splitlines() if line.endswith(r"\\")}
    assert lines["URHand"].count(r"\textbf{") == 9 and r"\underline" not in lines["URHand"]
    assert lines[r"Physical\_BRDF \& fit"].count(r"\underline{") == 9
    assert r"\textbf" not in lines["Oracle"] + lines["Mean"] + lines["Phong"]


def test_latex_folds_a_wide_table_at_groups(result: Table) -> None:
    columns = tuple(column for column in result.columns for _ in range(2))
    rows = tuple(replace(row, cells=tuple(cell for cell in row.cells for _ in range(2))) for row in result.rows)
    text = render_latex(replace(result, columns=columns, rows=rows))
    assert re.findall(r"\\begin\{tabular\}\{(\w+)\}", text) == ["l" + "r" * 6] * 3


def test_csv_holds_every_value_in_full(result: Table) -> None:
    lines = list(csv.DictReader(io.StringIO(render_csv(_nasty(result)))))
    values = [line for line in lines if line["column"]]
    assert len(values) == len(result.rows) * len(result.columns)
    for line, (row, index) in zip(values, ((row, i) for row in result.rows for i in range(9)), strict=True):
        cell = row.cells[index]
        assert line["value"] == ("" if cell.value is None else repr(cell.value))
        assert (int(line["covered"]), int(line["expected"])) == (cell.covered, cell.expected)
        assert line["signature"] == result.columns[index].metric.signature
    assert {line["metric"] for line in lines if not line["column"]} == {
        "train_s",
        "personalise_s",
        "first_ms",
        "relight_ms",
    }
    assert lines[0]["title"] == NASTY


def test_markdown_tables_are_rectangular(result: Table) -> None:
    text = render_markdown(_nasty(result))
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}) == 1
    assert "**33.12**" in text and "(16/24)" in text


def test_terminal_shows_every_value_at_any_width(result: Table) -> None:
    wide = _printed(result, 100)
    assert "33.12" in wide and "16/24 a" in wide and "non-finite: 3 pixels" in wide
    assert "…" not in wide
    assert "33.12" in _printed(result, 60) and "…" not in _printed(result, 60)


def test_a_calibration_row_is_marked(result: Table) -> None:
    assert "| Oracle \\* |" in render_markdown(result) and "Oracle * " in _printed(result, 100)


def test_non_linearity_stands_beside_the_times(result: Table) -> None:
    values = (None, None, None, 0.0, 2.1e-7)
    rows = tuple(replace(row, nonlinearity=value) for row, value in zip(result.rows, values, strict=True))
    measured = replace(result, rows=rows)
    assert re.search(r"^\| Physical.* \| 0 \|$", render_markdown(measured), re.MULTILINE)
    assert re.search(r"^\| URHand \|.* \| 2.1e-07 \|$", render_markdown(measured), re.MULTILINE)
    assert "2.1e-07" in _printed(measured, 100)
    lines = csv.DictReader(io.StringIO(render_csv(measured)))
    found = {line["method"]: float(line["value"]) for line in lines if line["metric"] == "nonlinearity"}
    assert found == {"physical": 0.0, "urhand": 2.1e-7}
