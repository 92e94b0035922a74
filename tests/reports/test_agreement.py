"""Published rows and the order of methods beside them, on tables worked out by hand."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from handbench.reports import render_csv, render_latex, render_markdown, render_terminal, table, write_reports
from handbench.reports.agreement import headline, sentence, tau_b
from handbench.reports.build import build
from handbench.reports.model import Agreement, Table
from handbench.results.reading import read_run

SetScores = Callable[..., None]
NOTE = "The paper does not say which network its LPIPS uses."


def _row(method: str, psnr: float, lpips: float | None = None, title: str = "", marker: str = "†") -> dict:
    values = {"unseen-light": [psnr, None, lpips]}
    return {
        "method": method,
        "title": title or method.title(),
        "marker": marker,
        "source": "A paper, Table 1",
        "values": values,
    }


def _publish(run: Path, *rows: dict) -> Path:
    path = run / "run.json"
    plan = json.loads(path.read_text())
    plan["protocol"] |= {"published": list(rows), "published_note": NOTE}
    path.write_text(json.dumps(plan))
    return run


@pytest.mark.parametrize(
    ("published", "measured", "tau"),
    [
        ([1, 2, 3, 4], [10, 20, 30, 40], 1.0),
        ([1, 2, 3, 4], [4, 3, 2, 1], -1.0),
        ([1, 2, 3, 4], [1, 2, 4, 3], 4 / 6),  # 5 pairs agree, 1 does not
        ([1, 1, 2, 3], [1, 2, 3, 4], 5 / (5 * 6) ** 0.5),  # tau-b: one pair tied on one side
        ([1, 1, 2], [3, 3, 5], 1.0),  # tied on both sides
        ([1, 1, 1], [1, 2, 3], None),
    ],
)
def test_kendalls_tau_with_ties(published: list[float], measured: list[float], tau: float | None) -> None:
    assert tau_b(published, measured) == (None if tau is None else pytest.approx(tau))


@pytest.fixture
def three(run_folder: Path, set_scores: SetScores) -> Path:
    """Published: urhand > physical > phong. Measured: phong, its gaps filled from physical, between the others."""
    path = run_folder / "run.json"
    plan = json.loads(path.read_text())
    plan["methods"][0]["truth"] = False  # no pictures: the pages here are about numbers
    path.write_text(json.dumps(plan))
    cells = [json.loads(file.read_text()) for file in (run_folder / "cells").glob("*.json")]
    (missing,) = set(plan["cells"]) - {cell["key"] for cell in cells}
    keys = {cell["subject"]: cell["key"] for cell in cells if cell["method"]["name"] == "phong"}
    for cell in cells:
        if cell["method"]["name"] == "physical":
            method = {**cell["method"], "name": "phong"}
            key = keys.get(cell["subject"], missing)
            (run_folder / "cells" / f"{key}.json").write_text(json.dumps({**cell, "key": key, "method": method}))
    set_scores(run_folder, "urhand", psnr=30.0, **{"lpips-alex": 0.10})
    set_scores(run_folder, "physical", psnr=20.0, **{"lpips-alex": 0.30})
    set_scores(run_folder, "phong", psnr=21.0, **{"lpips-alex": 0.20})
    return _publish(
        run_folder,
        _row("urhand", 27.77, 0.12),
        _row("physical", 25.0, 0.13, title="Physical"),
        _row("phong", 23.5, 0.14, marker="*"),
        _row("handy", 16.65, title="Handy & GGX", marker="*"),
    )


def _agreement(result: Table, metric: str) -> Agreement:
    (found,) = (each for each in result.agreements if each.column.metric.name == metric)
    return found


def test_inversions_are_named_with_both_differences(three: Path) -> None:
    result = table(three)
    assert [(a.column.group.name, a.column.metric.name) for a in result.agreements] == [
        ("unseen-light", "psnr"),
        ("unseen-light", "lpips-alex"),
    ], "only where a paper printed numbers of at least three of our methods"
    found = _agreement(result, "psnr")
    assert found.methods == ("Phong", "Physical_BRDF & fit", "URHand") and found.tau == pytest.approx(1 / 3)
    (pair,) = found.inversions
    assert (pair.first, pair.second) == ("Physical_BRDF & fit", "Phong")
    assert (pair.published, pair.measured) == (pytest.approx(1.5), pytest.approx(-1.0))
    assert (pair.low, pair.high, pair.separated, pair.spread) == (-1.0, -1.0, True, None)
    assert headline(found) == "Unseen light, PSNR: Kendall τ 0.33 over 3 methods, 1 of 3 pairs inverted"
    text = sentence(pair, found.column)
    assert text.startswith("Physical_BRDF & fit over Phong: published ahead by 1.50 dB, measured behind by 1.00 dB")
    assert text.endswith("(1.00 to 1.00: separated)")


def test_a_metric_where_less_is_better_is_turned_round(three: Path) -> None:
    found = _agreement(table(three), "lpips-alex")
    assert found.tau == pytest.approx(1 / 3)
    (pair,) = found.inversions
    assert (pair.first, pair.second) == ("Physical_BRDF & fit", "Phong")
    assert (pair.published, pair.measured) == (pytest.approx(0.01), pytest.approx(-0.1))


def test_a_difference_smaller_than_its_noise_is_not_separated(three: Path) -> None:
    for path in (three / "cells").glob("*.json"):
        cell = json.loads(path.read_text())
        if cell["method"]["name"] == "phong":
            psnr = [s for s in cell["scores"] if s["metric"].startswith("psnr")]
            for i, score in enumerate(psnr):
                score["value"] = 20.1 + (5.0 if i % 2 else -5.0)
            path.write_text(json.dumps(cell))
    found = _agreement(table(three), "psnr")
    (pair,) = found.inversions
    assert pair.measured == pytest.approx(-0.1) and not pair.separated
    assert sentence(pair, found.column).endswith(": not separated)")


def test_ties_are_no_inversions(three: Path, set_scores: SetScores) -> None:
    set_scores(three, "phong", psnr=20.0)
    found = _agreement(table(three), "psnr")
    assert found.inversions == () and found.tau == pytest.approx(2 / (3 * 2) ** 0.5)
    for method in ("urhand", "physical"):
        set_scores(three, method, psnr=20.0)
    assert _agreement(table(three), "psnr").tau is None
    assert "Kendall τ – over 3 methods" in headline(_agreement(table(three), "psnr"))


def test_a_method_that_misses_frames_is_not_compared(three: Path) -> None:
    lost = next(p for p in (three / "cells").glob("*.json") if json.loads(p.read_text())["method"]["name"] == "phong")
    lost.unlink()
    assert table(three).agreements == ()


def test_published_rows_stand_in_every_format_and_win_nowhere(three: Path) -> None:
    result = table(three)
    rows = [row for row in result.rows if row.kind == "published"]
    assert [row.name for row in rows] == ["urhand", "physical", "phong", "handy"]
    assert [row.name for row in result.computed] == ["oracle", "mean", "phong", "physical", "urhand"]
    cells = [cell for row in rows for cell in row.cells]
    assert all((cell.rank, cell.covered, cell.expected, cell.low) == (0, 0, 0, None) for cell in cells)
    assert [cell.value for cell in rows[0].cells] == [None, None, None, 27.77, None, 0.12, None, None, None]
    assert [result.tells(rows[0], each) for each in result.metrics] == [True, False, True], "no line of dashes"
    out = io.StringIO()
    Console(file=out, width=200).print(render_terminal(result))
    page = write_reports(three)["index.html"].read_text()
    texts = {"terminal": out.getvalue(), "markdown": render_markdown(result), "latex": render_latex(result)}
    for name, text in texts.items():
        assert "(published)" in text and NOTE in text and "16.65" in text, name
        assert "not ranked with them" in " ".join(text.split()) and "A paper, Table 1" in text, name
    assert r"Urhand {\textdagger} (published) & " in texts["latex"] and r"\textbf{27.77}" not in texts["latex"]
    assert "Urhand † (published)" in texts["terminal"] and "Handy & GGX * (published)" in texts["terminal"]
    assert "Urhand † (published)" in texts["markdown"] and r"Handy & GGX \* (published)" in texts["markdown"]
    assert '<tr class="published">' in page and "Urhand †<small>published</small>" in page and NOTE in page
    assert "<b>27.77</b>" not in page and "1 of 3 pairs inverted" in page and "measured behind by 1.00 dB" in page
    lines = [line for line in csv.DictReader(io.StringIO(render_csv(result))) if line["kind"] == "published"]
    assert lines[3]["value"] == "27.77" and lines[3]["fidelity"] == "A paper, Table 1"
    assert {(line["covered"], line["expected"], line["rank"]) for line in lines} == {("", "", "")}


def test_the_order_is_told_in_text_and_kept_as_data(three: Path) -> None:
    files = write_reports(three)
    result = table(three)
    for text in (render_markdown(result), files["table.md"].read_text()):
        assert "- Unseen light, PSNR: Kendall τ 0.33 over 3 methods, 1 of 3 pairs inverted" in text
        assert "  - Physical_BRDF & fit over Phong: published ahead by 1.50 dB" in text
    (psnr, _) = json.loads(files["agreement.json"].read_text())
    assert psnr["column"] == "unseen-light" and psnr["tau_b"] == pytest.approx(1 / 3)
    assert len(psnr["pairs"]) == 3 and sum(pair["inverted"] for pair in psnr["pairs"]) == 1
    (line, _) = (x for x in csv.DictReader(io.StringIO(render_csv(result))) if x["kind"] == "agreement")
    assert float(line["value"]) == pytest.approx(1 / 3) and "Physical_BRDF & fit over Phong" in line["reasons"]


def test_a_run_without_published_numbers_says_nothing_of_them(small_run: Path) -> None:
    result = table(small_run)
    assert result.remarks == () and result.agreements == ()
    assert "published" not in render_latex(result)
    assert "agreement.json" not in write_reports(small_run)


def test_pairs_across_unequal_enrolment_are_marked(three: Path) -> None:
    run = read_run(three)
    methods = tuple(
        replace(method, enrolment="one picture" if method.name == "urhand" else "single lights")
        for method in run.plan.methods
    )
    made = build(replace(run, plan=replace(run.plan, methods=methods)))
    agreement = made.agreements[0]
    marked = [{pair.first, pair.second} for pair in agreement.pairs if pair.unequal]
    assert len(marked) == 2 and all("URHand" in pair for pair in marked)
    assert headline(agreement).endswith("; 2 pairs across unequal enrolment ≠") and made.unequal
    assert all(("≠" in sentence(pair, agreement.column)) == pair.unequal for pair in agreement.pairs)
    assert {row.enrolment for row in made.rows if row.kind == "published"} == {""}
    assert not any("≠" in headline(each) for each in table(three).agreements)
