"""The answer in words: who is best, for whom that holds, what is below the floor."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from handbench.reports import render_csv, render_markdown, table, write_reports
from handbench.reports.conclusion import conclusion, leader
from handbench.reports.cost import Footprint, Span
from handbench.reports.model import Row, Table
from handbench.results.reading import read_run, titled_apart
from handbench.studies.auditrecord import Found, audit_told, keep_audit

sys.path.append(str(Path(__file__).parents[1] / "bench" / "fakes"))
from runfakes import plain, write_run


def _apart(gain: float, noise: float = 0.0) -> Callable[[str, str, int, int, int], float]:
    """`good` is better than `fair` by a gain that differs from subject to subject."""

    def value(method: str, metric: str, subject: int, seed: int, frame: int) -> float:
        better = gain + noise * (-1) ** subject if method == "good" else 0.0
        return plain(method, metric, subject, seed, frame) + (better if metric == "psnr" else -0.01 * better)

    return value


def _rows(result: Table) -> dict[str, tuple[int, bool]]:
    return {row.name: (row.cells[0].rank, row.cells[0].claimed) for row in result.rows}


def test_a_lead_is_claimed_where_the_test_allows_it_and_only_there(tmp_path: Path) -> None:
    many = table(write_run(tmp_path / "many", _apart(0.5), subjects=6))
    assert _rows(many) == {"oracle": (0, False), "good": (1, True), "fair": (2, False)}, "nothing is told from the last"
    assert conclusion(many).sentences == (
        "Good is best in both columns by PSNR, by 0.50 dB over the next. By the other metrics it is best in 2 of "
        "2 values.",
        "Measured on 6 subjects and 48 frames a column, one seed: it tells of these weights. The lead holds for other "
        "hands too in each of them (paired test over subjects, p ≤ 0.05 after correction).",
        "It takes 4.20 ms for a new pose under a single light, as long as Fair and 10.0 s of training.",
    )
    held = replace(many.rows[1], footprint=Footprint(memory_mb=Span(2048.0, 2000.0, 2100.0)))
    with_memory = conclusion(replace(many, rows=(many.rows[0], held, *many.rows[2:])))
    assert with_memory.cost.endswith("10.0 s of training and 2.0 GiB of memory while drawing.")
    few = table(write_run(tmp_path / "few", _apart(0.5), subjects=5))
    assert _rows(few)["good"] == (1, False), "p of five subjects cannot fall below 0.0625"
    assert "cannot be claimed for others" in conclusion(few).claim
    assert "with 5 subjects p cannot fall below 0.062" in conclusion(few).claim
    alone = table(write_run(tmp_path / "alone", _apart(0.5), subjects=1))
    assert "with 1 subject p cannot fall below 1)" in conclusion(alone).claim
    assert "°" in render_markdown(few) and "°" not in render_markdown(many).replace("°: ", "").partition("## ")[0]
    assert few.unclaimed and ",1,False," in render_csv(few) and ",1,True," in render_csv(many)


def test_a_method_that_shares_its_mark_is_not_told_as_ahead(tmp_path: Path) -> None:
    """In one of two columns the other method has the higher value, too little to tell: no lead is made of it."""
    result = table(write_run(tmp_path / "many", _apart(0.5), subjects=6))
    good, fair = result.rows[1:]
    place = next(i for i, column in enumerate(result.columns) if i and column.metric == result.metrics[0])

    def with_cell(row: Row, **changes: object) -> Row:
        cells = (replace(cell, **changes) if i == place else cell for i, cell in enumerate(row.cells))  # type: ignore[arg-type]
        return replace(row, cells=tuple(cells))

    ahead = good.cells[place].value + 0.25  # type: ignore[operator]
    rows = (result.rows[0], with_cell(good, claimed=False), with_cell(fair, rank=1, value=ahead))
    found = conclusion(replace(result, rows=rows))
    assert found.best.startswith(
        "Good is best in both columns by PSNR, from 0.25 dB behind to 0.50 dB ahead of the best of the others; in 1 of "
        "them another method cannot be told from it."
    )
    assert "The lead over those that come after holds for other hands too in 1 of these 2" in found.claim
    equal = replace(fair, cells=tuple(replace(cell, rank=1) for cell in fair.cells))
    told = conclusion(
        replace(result, rows=(result.rows[0], good, replace(equal, cells=(fair.cells[0], *equal.cells[1:]))))
    )
    assert told.best.endswith("By the other metrics it is best in 2 of 2 values, 2 of them with others.")
    behind = replace(result, rows=(result.rows[0], good, with_cell(fair, rank=1, value=ahead)))
    assert leader(behind) == good, "the page shows first what the conclusion is about"


def test_what_cannot_win_is_no_rival_of_a_claim(tmp_path: Path) -> None:
    """Holm corrects over those that may win: a method without some frames, or below the floor, is none of them."""
    many = table(write_run(tmp_path / "many", _apart(0.5), ("oracle", "good", "fair", "third"), subjects=6))
    assert "with 6 subjects p cannot fall below 0.062" in conclusion(many).claim
    gaps = [replace(cell, covered=cell.covered - 1, rank=0) for cell in many.rows[-1].cells]
    two = replace(many, rows=(*many.rows[:-1], replace(many.rows[-1], cells=tuple(gaps))))
    assert "corrected: p is above 0.05" in conclusion(two).claim
    sunk = [replace(cell, sunk=True, rank=0) for cell in many.rows[-2].cells]
    alone = replace(two, rows=(*two.rows[:-2], replace(two.rows[-2], cells=tuple(sunk)), two.rows[-1]))
    assert "corrected: no other method is above the floor on every frame" in conclusion(alone).claim


def test_nothing_below_the_floor_is_best(run_folder: Path, set_scores: Callable[..., None]) -> None:
    set_scores(run_folder, "urhand", psnr=15.0)  # the mean predictor has about 23
    set_scores(run_folder, "physical", psnr=14.0)
    result = table(run_folder)
    cells = {row.name: row.cells[0] for row in result.rows}
    assert [cells[name].rank for name in ("mean", "phong", "physical", "urhand")] == [0, 0, 0, 0]
    assert [cells[name].sunk for name in ("mean", "phong", "physical", "urhand")] == [False, False, True, True]
    found = conclusion(result)
    assert found.best == "No method can be called best by PSNR: none is above the floor on every frame."
    assert any(
        "floor (Mean), of 9 values: Physical_BRDF & fit in 3 and URHand in 3." in text for text in found.warnings
    )
    assert "15.00▽" in render_markdown(result)


def test_what_prints_like_the_floor_is_not_above_it(run_folder: Path, set_scores: Callable[..., None]) -> None:
    set_scores(run_folder, "mean", psnr=20.0)
    set_scores(run_folder, "urhand", psnr=20.004)
    assert {row.name: row.cells[0].sunk for row in table(run_folder).rows}["urhand"]


def test_several_seeds_widen_the_interval_and_are_told(tmp_path: Path) -> None:
    def value(method: str, metric: str, subject: int, seed: int, frame: int) -> float:
        return plain(method, metric, subject, seed, frame) + 0.5 * seed

    one, three = (table(write_run(tmp_path / f"{n}", value, seeds=range(n))) for n in (1, 3))
    width = [result.rows[1].cells[0].high - result.rows[1].cells[0].low for result in (one, three)]  # type: ignore[operator]
    assert width[1] > width[0] + 0.5, "trainings are half a decibel apart"
    assert (one.trainings, three.trainings) == ("these weights (one seed)", "3 seeds")
    assert "3 seeds" in conclusion(three).claim and "these weights" not in conclusion(three).claim


def test_methods_alone_and_alike_are_told(tmp_path: Path) -> None:
    alone = table(write_run(tmp_path / "alone", methods=("oracle", "good")))
    assert conclusion(alone).best == "Good stands alone: there is no method to compare it with."
    alike = table(write_run(tmp_path / "alike"))
    assert conclusion(alike).best == (
        "Good and Fair share the lead: each is best, alone or with others, in both columns by PSNR. Ahead: Good and "
        "Fair level in Unseen light; Good and Fair level in Unseen pose."
    )
    assert (
        conclusion(alike).cost
        == "A new pose under a single light, and training: Good 4.20 ms, 10.0 s; Fair 4.20 ms, 10.0 s."
    )
    assert "nothing to compare" in conclusion(table(write_run(tmp_path / "none", methods=("oracle",)))).best


def test_titles_that_two_methods_have_are_told_apart(tmp_path: Path) -> None:
    methods = read_run(write_run(tmp_path / "run")).plan.methods
    twice = [replace(method, title="Phong") if method.name != "oracle" else method for method in methods]
    assert [method.title for method in titled_apart(twice)] == ["Oracle", "Phong (good)", "Phong (fair)"]


@pytest.mark.parametrize(("subjects", "counted"), [(1, "1 subject, 8 frames"), (6, "6 subjects, 48 frames")])
def test_heads_count_subjects_and_frames(tmp_path: Path, subjects: int, counted: str) -> None:
    result = table(write_run(tmp_path / "run", subjects=subjects))
    assert [group.counted for group in result.groups] == [counted, counted]
    assert f"{counted}." in render_markdown(result)


def test_the_page_says_what_the_audit_found(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path / "run", subjects=1, frames=2))
    assert audit_told(run).startswith("Not audited")
    fine, none, bad = Found("keys", True, ""), Found("shards", None, "one cell"), Found("coverage", False, "a gap")
    keep_audit(run, [fine, none, fine])
    assert audit_told(run) == "The audit holds in all 2 checks."
    keep_audit(run, [fine, none, bad])
    assert audit_told(run) == "The audit found 1 of 2 checks broken: coverage (a gap)."
    assert "The audit found 1 of 2 checks broken" in write_reports(run.folder)["index.html"].read_text()
    run.store.write_run(replace(run.plan, cells=run.plan.cells[1:]))
    assert "of other cells than these" in audit_told(read_run(run.folder))
