"""The table: what is averaged, what may win, what is said of gaps."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from handbench.errors import InputError
from handbench.reports import table
from handbench.reports.aggregate import aggregate, interval
from handbench.reports.model import Cell, Row, Table, letter, number

SetScores = Callable[..., None]


def _row(result: Table, name: str) -> Row:
    return next(row for row in result.rows if row.name == name)


def _cell(result: Table, method: str, column: int = 0) -> Cell:
    return _row(result, method).cells[column]


def test_subjects_and_seeds_weigh_alike_whatever_their_number_of_frames() -> None:
    assert aggregate({0: {"a": [0.0, 0.0, 0.0, 0.0], "b": [10.0]}}) == 5.0
    # Of seed 1, subject a has no value. Seeds first would give (0 + (10 + 20) / 2) / 2 = 7.5.
    assert aggregate({0: {"a": [0.0, 0.0], "b": [10.0]}, 1: {"b": [20.0]}}) == 12.5


def test_another_seed_with_the_same_values_narrows_no_interval() -> None:
    values = {name: list(np.random.default_rng(ord(name)).normal(size=9)) for name in "abcd"}
    assert interval({0: values, 1: values, 2: values}, seed=5) == pytest.approx(interval({0: values}, seed=5))


def test_the_interval_of_one_frame_a_subject_is_the_bootstrap_of_subjects() -> None:
    values = np.random.default_rng(1).normal(30, 2, 40)
    low, high = interval({0: {str(i): [value] for i, value in enumerate(values)}}, seed=3) or (0.0, 0.0)
    # Normal theory for the mean of 40 independent values; the bootstrap agrees within a tenth of its width.
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert low == pytest.approx(values.mean() - half, abs=0.2 * half)
    assert high == pytest.approx(values.mean() + half, abs=0.2 * half)


def test_frames_of_one_subject_do_not_count_as_independent() -> None:
    rng = np.random.default_rng(2)
    hands = rng.normal(30, 3, 5)
    clustered = interval({0: {str(i): list(hand + rng.normal(0, 0.1, 50)) for i, hand in enumerate(hands)}}, seed=0)
    alone = interval({0: {str(i): [hand] for i, hand in enumerate(hands)}}, seed=0)
    assert clustered is not None and alone is not None
    assert clustered[1] - clustered[0] == pytest.approx(alone[1] - alone[0], rel=0.1)


def test_the_interval_repeats_and_needs_two_values() -> None:
    values = {0: {name: list(np.random.default_rng(ord(name)).normal(size=9)) for name in "abcd"}}
    assert interval(values, seed=5) == interval(values, seed=5) != interval(values, seed=6)
    assert interval({0: {"a": [1.0]}, 1: {"a": [2.0]}}, seed=0) is None


def test_every_method_and_column_is_there(whole_run: Path) -> None:
    result = table(whole_run)
    assert [row.name for row in result.rows] == ["oracle", "mean", "phong", "physical", "urhand"]
    assert [group.name for group in result.groups] == ["unseen-segment", "unseen-light", "environment"]
    assert all(len(row.cells) == len(result.columns) == 9 for row in result.rows)
    assert [row.kind for row in result.rows] == ["calibration", "calibration", "method", "method", "method"]


def test_a_value_is_the_mean_over_subjects_of_their_means(whole_run: Path) -> None:
    column = table(whole_run).columns[0]
    by_subject: dict[str, list[float]] = {}
    for path in (whole_run / "cells").glob("*.json"):
        cell = json.loads(path.read_text())
        if cell["method"]["name"] == "urhand":
            for score in cell["scores"]:
                if (score["column"], score["metric"]) == (column.group.name, column.metric.signature):
                    by_subject.setdefault(cell["subject"], []).append(score["value"])
    cell = _cell(table(whole_run), "urhand")
    assert cell.value == pytest.approx(np.mean([np.mean(values) for values in by_subject.values()]))
    assert cell.low is not None and cell.high is not None and cell.low < cell.value < cell.high


def test_calibration_rows_never_win(whole_run: Path) -> None:
    result = table(whole_run)
    assert all(cell.rank == 0 for name in ("oracle", "mean") for cell in _row(result, name).cells)
    assert all(cell.rank == 1 for cell in _row(result, "urhand").cells)
    assert all(cell.rank == 2 for cell in _row(result, "physical").cells)


def test_incomplete_coverage_never_wins_and_is_told(run_folder: Path, set_scores: SetScores) -> None:
    set_scores(run_folder, "phong", psnr=60.0, ssim=1.0)
    result = table(run_folder)
    phong = _row(result, "phong")
    assert phong.cells[0].value == 60.0 and phong.cells[0].rank == 0
    assert (phong.cells[0].covered, phong.cells[0].expected) == (16, 24)  # a subject of three was not computed
    reasons = [result.footnotes[note - 1] for note in phong.cells[0].notes]
    assert reasons == ["not computed: the run was stopped or the cell failed"]


def test_a_frame_without_a_value_is_counted_and_not_averaged(run_folder: Path) -> None:
    (lost,) = (path for path in (run_folder / "cells").glob("*.json") if _is(path, "urhand", "s02"))
    cell = json.loads(lost.read_text())
    for score in cell["scores"]:
        if score["column"] == "environment" and score["query"] == "s02/fist/dorsal/environment-03":
            score.update(value=None, reason="out of memory")
    lost.write_text(json.dumps(cell))
    result = table(run_folder)
    first = result.of_group(result.groups[2])[0]
    found = _cell(result, "urhand", first)
    assert (found.covered, found.expected, found.rank) == (23, 24, 0)
    assert found.value is not None and np.isfinite(found.value)
    assert result.footnotes[found.notes[0] - 1] == "out of memory"
    assert _cell(result, "physical", first).rank == 1  # the best of those that cover every frame


def _is(path: Path, method: str, subject: str) -> bool:
    cell = json.loads(path.read_text())
    return (cell["method"]["name"], cell["subject"]) == (method, subject)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_value_that_is_not_finite_cannot_hide(run_folder: Path, set_scores: SetScores, bad: float) -> None:
    set_scores(run_folder, "urhand", psnr=bad)
    cell = _cell(table(run_folder), "urhand")
    assert (cell.value, cell.covered, cell.rank) == (None, 0, 0)
    assert cell.notes


def test_values_that_print_alike_share_their_rank(run_folder: Path, set_scores: SetScores) -> None:
    set_scores(run_folder, "urhand", psnr=33.001)
    set_scores(run_folder, "physical", psnr=33.004)
    result = table(run_folder)
    assert _cell(result, "urhand").rank == _cell(result, "physical").rank == 1


def test_seeds_are_averaged_and_owed(run_folder: Path) -> None:
    plan = json.loads((run_folder / "run.json").read_text())
    plan["seeds"] = [0, 1]
    for path in list((run_folder / "cells").glob("*.json")):
        cell = json.loads(path.read_text())
        if cell["method"]["name"] == "urhand":
            cell["key"] += "-again"
            cell["seed"] = 1
            for score in cell["scores"]:
                score["value"] += 1.0
            (run_folder / "cells" / f"{cell['key']}.json").write_text(json.dumps(cell))
            plan["cells"].append(cell["key"])
    once = _cell(table(run_folder), "urhand").value
    (run_folder / "run.json").write_text(json.dumps(plan))
    result = table(run_folder)
    assert _cell(result, "urhand").value == pytest.approx((once or 0) + 0.5)
    assert _cell(result, "urhand").complete
    assert _cell(result, "urhand").spread == pytest.approx(0.5**0.5), "two seeds one apart"
    assert _cell(result, "physical").spread is None
    assert (_cell(result, "physical").covered, _cell(result, "physical").expected) == (24, 48)


def test_a_folder_without_a_run_is_one_clear_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no readable run\.json; give the folder"):
        table(tmp_path)


def test_numbers_as_text() -> None:
    assert [number(value, 2) for value in (None, 1.005, -3.456, -0.001, float("inf"))] == [
        "–",
        "1.00",
        "−3.46",
        "0.00",
        "∞",
    ]
    assert [letter(note) for note in (1, 26, 27, 53)] == ["a", "z", "aa", "ba"]


def test_non_linearity_is_the_worst_cell_and_old_cells_have_none(run_folder: Path) -> None:
    assert _row(table(run_folder), "urhand").nonlinearity is None
    cells = [path for path in (run_folder / "cells").glob("*.json") if _is(path, "urhand", "s01")]
    cells += [path for path in (run_folder / "cells").glob("*.json") if _is(path, "urhand", "s02")]
    for path, value in zip(cells, (0.0, 3e-7), strict=True):
        cell = json.loads(path.read_text())
        path.write_text(json.dumps({**cell, "laws": {"linearity": value}}))
    assert _row(table(run_folder), "urhand").nonlinearity == 3e-7
