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
from handbench.reports.build import build
from handbench.reports.model import Table
from handbench.reports.printed import number
from handbench.reports.run import Run
from handbench.reports.scores import scores
from handbench.reports.style import PLAIN, Style
from handbench.results.values import values_of

NASTY = r"50% of_{all} & #1 $x$ ~^ \ <a|b>"


@pytest.fixture(scope="module")
def result(whole_run: Path) -> Table:
    return table(whole_run)


@pytest.fixture(scope="module")
def compared(whole_run: Path) -> Table:
    return table(whole_run, baseline="urhand")


def _nasty(result: Table) -> Table:
    rows = (replace(result.rows[0], title=NASTY), *result.rows[1:])
    named = NASTY if result.baseline else ""
    return replace(result, title=NASTY, baseline=named, rows=rows, footnotes=tuple(NASTY for _ in result.footnotes))


def _printed(result: Table, width: int, style: Style = PLAIN, terminal: bool = False) -> str:
    out = io.StringIO()
    Console(file=out, width=width, force_terminal=terminal, color_system=None).print(render_terminal(result, style))
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


def test_latex_is_balanced_and_escaped(result: Table, compared: Table) -> None:
    """What a compiler would stumble on, as there may be none here: braces, maths, environments, bare characters."""
    for each in (_nasty(result), _nasty(compared)):
        text = "\n".join(line for line in render_latex(each).splitlines() if not line.startswith("%"))
        bare = re.sub(r"\\[\\{}$&#%_]", "", text)
        depth = 0
        for character in bare:
            depth += {"{": 1, "}": -1}.get(character, 0)
            assert depth >= 0
        assert depth == 0 and bare.count("$") % 2 == 0
        assert not re.search(r"[^\x00-\x7f]", text) and not re.search(r"[#%_~^|]", bare)
        open_environments = []
        for kind, name in re.findall(r"\\(begin|end)\{(\w+)\}", text):
            if kind == "begin":
                open_environments.append(name)
            else:
                assert open_environments.pop() == name
        assert not open_environments
        assert text.count(r"\begin{tabular}") == text.count(r"\toprule") == text.count(r"\bottomrule")
        assert r"\\[" not in text, "a row that starts with a bracket would be read as a length"


def test_latex_uses_booktabs_and_the_kernel_alone(compared: Table) -> None:
    known = "begin end toprule midrule bottomrule cmidrule multicolumn shortstack caption centering footnotesize tiny"
    known += " setlength tabcolsep medskip par smallskip textbf underline textsuperscript uparrow downarrow"
    known += " addtocounter parbox linewidth raggedright rlap circ bigtriangledown"
    known += " textbackslash textasciitilde textasciicircum textless textgreater textbar usepackage"
    assert set(re.findall(r"\\([a-zA-Z]+)", render_latex(_nasty(compared)))) <= set(known.split())
    assert render_latex(compared).startswith("% needs \\usepackage{booktabs}\n")


def test_latex_says_how_much_a_value_covers(result: Table) -> None:
    text = render_latex(result, Style(width=20))
    (line,) = (line for line in text.splitlines() if line.strip().startswith("Phong"))
    assert line.count(r"{\tiny 16/24}") == 6 and line.count(r"{\tiny 15/24}") == 3
    assert r"\textsuperscript{a,b}" in line or r"\textsuperscript{a}" in line


def test_latex_marks_best_and_second(result: Table) -> None:
    text = render_latex(result, Style(width=20))
    lines = {line.split(" & ")[0].strip(): line for line in text.splitlines() if line.endswith(r"\\")}
    assert lines["URHand"].count(r"\textbf{") == 9 and r"\underline" not in lines["URHand"]
    assert lines[r"Physical\_BRDF \& fit"].count(r"\underline{") == 9
    assert r"\textbf" not in lines["Oracle"] + lines["Mean"] + lines["Phong"]


def test_latex_folds_a_wide_table_at_groups(result: Table) -> None:
    columns = tuple(column for column in result.columns for _ in range(2))
    rows = tuple(replace(row, cells=tuple(cell for cell in row.cells for _ in range(2))) for row in result.rows)
    text = render_latex(replace(result, columns=columns, rows=rows), Style(wide=True))
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
        "new_pose_ms.group",
        "known_pose_ms.group",
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


def test_text_without_bold_says_what_is_best_and_what_can_be_claimed(result: Table) -> None:
    text = _printed(result, 100).partition(result.groups[1].title)[0]
    lines = {line.split("  ")[0]: line for line in text.splitlines()}
    assert "33.12¹°" in lines["URHand"] and "²°" in lines["Physical_BRDF & fit"]
    assert not set("¹²°") & set(lines["Oracle *"] + lines["Mean *"])
    assert "¹ best, ² second" in _printed(result, 200) and "° holds for these hands" in _printed(result, 200)


def test_a_wide_terminal_has_intervals_and_tables_beside_each_other(result: Table) -> None:
    interval = f"[{result.rows[-1].cells[0].low:.2f}, {result.rows[-1].cells[0].high:.2f}]"
    assert interval in _printed(result, 150) and interval not in _printed(result, 70)
    assert interval not in _printed(result, 150, Style(intervals=False))
    heads = [group.title for group in result.groups[:2]]
    beside = [all(head in line for head in heads) for line in _printed(result, 360, terminal=True).splitlines()]
    assert any(beside) and not any(all(h in line for h in heads) for line in _printed(result, 360).splitlines())


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


def test_differences_are_in_every_format(compared: Table) -> None:
    row = next(row for row in compared.rows if row.name == "physical")
    apart = row.cells[0].difference
    assert apart is not None and apart.low is not None and apart.high is not None
    value, low, high = (f"{abs(x):.2f}" for x in (apart.value, apart.low, apart.high))
    text = f"**−{value}** [−{low}, −{high}] p 0.5"
    assert f"| Physical\\_BRDF & fit | {text} |".replace("\\_", "_") in render_markdown(compared)
    printed = _printed(compared, 120)
    assert f"−{value}" in printed and f"[−{low}, −{high}]" in printed and "difference to URHand" in printed
    apart_alone = render_latex(compared, Style(intervals=True)).split("differences to URHand")[1]
    assert f"& $-${value} &" in apart_alone and f"{{\\tiny {{[}}$-${low}, $-${high}{{]}}}}" in apart_alone
    assert "Oracle" not in apart_alone and "Mean" not in apart_alone and r"\end{table}" in apart_alone
    lines = csv.DictReader(io.StringIO(render_csv(compared)))
    (line,) = (x for x in lines if (x["method"], x["column"], x["metric"]) == ("physical", "unseen-segment", "psnr"))
    assert line["baseline"] == "URHand" and float(line["difference"]) == apart.value
    assert (float(line["p"]), float(line["p_holm"]), line["paired"], line["subjects"]) == (0.25, 0.5, "24", "3")
    for text in (render_markdown(compared), printed, render_latex(compared)):
        assert "Too few subjects to claim a difference" in " ".join(text.split())


def test_values_that_are_not_finite_are_counted(result: Table) -> None:
    lines = list(csv.DictReader(io.StringIO(render_csv(result))))
    found = {line["nonfinite"] for line in lines if line["method"] == "phong" and line["column"] == "unseen-light"}
    assert found == {"1"}
    assert {line["nonfinite"] for line in lines if line["method"] == "urhand" and line["column"]} == {"0"}


def test_the_breakdown_prints_a_frame_as_the_rest_of_the_page_does(many: Run) -> None:
    """A value that is rounded twice may print with another last digit: 24.3449 as 24.345 as 24.35."""
    told, values = scores(many, build(many)), values_of(many)
    apart = 0
    for column in told["columns"]:
        for row, of_row in zip(told["rows"], column["values"], strict=True):
            means = values[row["name"], column["name"]].values.mean(axis=1)
            for metric, kept, right in zip(told["metrics"], of_row, means.tolist(), strict=True):
                texts = ([number(value, metric["decimals"]) for value in each] for each in (kept, right))
                apart += sum(one != other for one, other in zip(*texts, strict=True))
    assert apart == 0
