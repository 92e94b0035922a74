"""Tables in LaTeX, compiled: what a name holds stops no compiler and vanishes from no page, and nothing sticks out."""

from __future__ import annotations

import random
import re
import shutil
import subprocess
import unicodedata
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from handbench.reports import render_latex, table
from handbench.reports.build import build
from handbench.reports.model import Table
from handbench.reports.safe import latex
from handbench.reports.style import Style
from handbench.reports.texletters import _BLOCKS, _SIGNS, GUARD

ENGINES = [
    pytest.param(
        name,
        marks=pytest.mark.skipif(not shutil.which(name), reason=f"{name} is not installed (Debian: texlive-luatex)"),
    )
    for name in ("pdflatex", "lualatex")
]
NASTY = r"50% of_{all} & #1 $x$ ~^ \ <a|b> [c] 手の再照明 α–β Łódź Đại «ą» “q” ≥ † 🖐"
OVERFULL = re.compile(r"Overfull \\hbox \(([\d.]+)pt too wide\)")


def compiled(text: str, engine: str, folder: Path, options: str = "", head: str = "") -> str:
    """The log of a document with this body."""
    lines = [f"\\documentclass[{options}]{{article}}", r"\usepackage{booktabs}", head, r"\begin{document}", text]
    (folder / "a.tex").write_text("\n".join([*lines, r"\end{document}"]), encoding="utf-8")
    command = [engine, "-interaction=nonstopmode", "-halt-on-error", "a.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, timeout=120, check=False)
    log = (folder / "a.log").read_text(encoding="utf-8", errors="replace")
    assert done.returncode == 0, re.findall(r"^! .*(?:\n.*){4}", log, re.MULTILINE)
    return log


def printed(folder: Path) -> str:
    """The text of the PDF."""
    return subprocess.run(
        ["pdftotext", "-layout", "a.pdf", "-"], cwd=folder, capture_output=True, check=True
    ).stdout.decode()


def letters() -> Iterator[str]:
    """Every letter that passes as it is, and some that do not."""
    yield from (chr(code) for low, high in _BLOCKS for code in range(low, high + 1) if unicodedata.name(chr(code), ""))
    yield from _SIGNS
    rng = random.Random(7)
    for low, high in (
        (0x400, 0x4FF),
        (0x5D0, 0x5EA),
        (0x3041, 0x30FF),
        (0x4E00, 0x9FFF),
        (0xAC00, 0xD7A3),
        (0x1F590, 0x1F64F),
    ):
        yield from (chr(rng.randint(low, high)) for _ in range(12))


@pytest.mark.parametrize("engine", ENGINES)
def test_every_letter_compiles_and_none_vanishes(engine, tmp_path):
    log = compiled(GUARD + "\n" + " ".join(map(latex, letters())) + "\n\n" + latex(NASTY), engine, tmp_path)
    assert "Missing character" not in log
    if shutil.which("pdftotext"):
        text = printed(tmp_path)
        assert "U+624B" in text and "50%" in text and "“q”" in text


@pytest.fixture(scope="module")
def compared(whole_run: Path) -> Table:
    return table(whole_run, baseline="urhand")


@pytest.mark.parametrize("engine", ENGINES)
def test_tables_of_every_style_compile(engine, compared, tmp_path):
    rows = (replace(compared.rows[0], title=NASTY), *compared.rows[1:])
    nasty = replace(compared, title=NASTY, baseline=NASTY, rows=rows)
    styles = (Style(), Style(intervals=True, seeds=True, times=True, decimals=1, label="tab:a", caption=NASTY))
    text = "\n".join(render_latex(each, style) for each in (compared, nasty) for style in styles)
    log = compiled(text + r"\ref{tab:a}", engine, tmp_path)
    assert "Missing character" not in log


@pytest.mark.parametrize(
    ("style", "options"),
    [(Style(), ""), (Style(wide=True, intervals=True), "twocolumn"), (Style(width=3.3), "twocolumn")],
    ids=["article", "both columns", "one column"],
)
@pytest.mark.parametrize("engine", ENGINES[:1])
def test_tables_stay_within_their_column(engine, compared, style, options, tmp_path):
    """Within a class of 6.75 inches of text, as CVPR's and ACM's are, and of a plain article."""
    twocolumn = r"\setlength{\textwidth}{6.875in}\setlength{\columnsep}{0.3125in}\setlength{\oddsidemargin}{-0.2in}"
    log = compiled(render_latex(compared, style), engine, tmp_path, options, twocolumn if options else "")
    assert [float(points) for points in OVERFULL.findall(log) if float(points) > 1] == []
    assert "Float too large" not in log


@pytest.mark.parametrize("engine", ENGINES[:1])
def test_tables_that_no_page_holds_go_on_in_a_float_of_the_same_number(engine, many, tmp_path):
    text = render_latex(build(many), Style(label="tab:a"))
    log = compiled(text + r" Table \ref{tab:a}.", engine, tmp_path)
    assert "Float too large" not in log and text.count(r"\begin{table}") > 1
    assert text.count(r"\label{") == 1 and text.count("(continued)") == text.count(r"\begin{table}") - 1
    if shutil.which("pdftotext"):
        assert len(set(re.findall(r"Table (\d+):", printed(tmp_path)))) == 1


def test_an_option_that_cannot_be_is_refused():
    from handbench.errors import InputError

    for wrong in ({"label": "a b"}, {"label": "}"}, {"decimals": -1}, {"decimals": 40}, {"width": 0.1}):
        with pytest.raises(InputError, match=r"give|use"):
            Style(**wrong)
