"""The table: what is averaged, what may win, what is said of gaps."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handbench.errors import InputError
from handbench.reports import render_csv, render_markdown, table, write_reports
from handbench.reports.aggregate import Footnotes
from handbench.reports.model import Aggregate, Row, Table
from handbench.reports.pareto import in_words as told_plot
from handbench.reports.pareto import plots
from handbench.reports.printed import MEMORY_TITLES, letter, memory_texts, number, signed
from handbench.results.measured import Cost
from handbench.results.reading import read_run

sys.path.append(str(Path(__file__).parents[1] / "bench" / "fakes"))
from runfakes import plain, write_run

SetScores = Callable[..., None]


def _row(result: Table, name: str) -> Row:
    return next(row for row in result.rows if row.name == name)


def _cell(result: Table, method: str, column: int = 0) -> Aggregate:
    return _row(result, method).cells[column]


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
    assert (cell.value, cell.covered, cell.rank, cell.nonfinite) == (None, 0, 0, cell.expected)
    assert cell.notes


def test_values_that_print_alike_share_their_rank(run_folder: Path, set_scores: SetScores) -> None:
    set_scores(run_folder, "urhand", psnr=33.001)
    set_scores(run_folder, "physical", psnr=33.004)
    result = table(run_folder)
    assert _cell(result, "urhand").rank == _cell(result, "physical").rank == 1


def _shift(run: Path, method: str, other: str, by: Callable[[int], float]) -> None:
    """Give a method the PSNR of another one, frame by frame, and `by(number of the frame)` more."""
    cells = {path: json.loads(path.read_text()) for path in (run / "cells").glob("*.json")}
    for path, cell in cells.items():
        if cell["method"]["name"] == method:
            (like,) = (c for c in cells.values() if (c["method"]["name"], c["subject"]) == (other, cell["subject"]))
            for i, (score, source) in enumerate(zip(cell["scores"], like["scores"], strict=True)):
                if score["metric"].startswith("psnr"):
                    score["value"] = source["value"] + by(i // 3)
            path.write_text(json.dumps(cell))


def test_methods_that_their_paired_interval_cannot_tell_apart_share_the_mark(run_folder: Path) -> None:
    _shift(run_folder, "physical", "urhand", lambda i: 0.05 + (2.0 if i % 2 else -2.0))
    assert [_cell(table(run_folder), name).rank for name in ("urhand", "physical")] == [1, 1]
    # A tenth of the interval of either method, but on every frame.
    _shift(run_folder, "physical", "urhand", lambda i: 0.05)
    result = table(run_folder)
    assert [_cell(result, name).rank for name in ("urhand", "physical")] == [2, 1]
    ours, theirs = (_cell(result, name) for name in ("urhand", "physical"))
    assert ours.high is not None and theirs.low is not None and ours.high > theirs.low


def test_differences_to_a_baseline_are_paired_and_corrected(run_folder: Path) -> None:
    _shift(run_folder, "physical", "urhand", lambda i: -0.3 + 0.1 * (i % 2))
    assert all(cell.difference is None for row in table(run_folder).rows for cell in row.cells)
    result = table(run_folder, baseline="urhand")
    assert result.baseline == "URHand"
    assert [row.name for row in result.compared] == ["mean", "phong", "physical"], "the truth tells nothing of methods"
    found = _cell(result, "physical").difference
    assert found is not None and found.value == pytest.approx(-0.25) and found.separated
    assert (found.paired, found.subjects) == (24, 3)
    assert (found.p, found.adjusted) == (0.25, 0.5), "three subjects, two measured methods beside the baseline"
    phong = _cell(result, "phong").difference
    assert phong is not None and (phong.paired, phong.subjects) == (16, 2), "only frames that both have"
    mean = _cell(result, "mean").difference
    assert mean is not None and mean.adjusted == mean.p, "calibration rows are no part of the family"
    assert "Too few subjects" in result.limits[-1] and "with 3 subjects p cannot fall below 0.25" in result.limits[-1]
    with pytest.raises(InputError, match="unknown baseline 'urhnad'; did you mean 'urhand'"):
        table(run_folder, baseline="urhnad")


def _better(method: str, metric: str, subject: int, seed: int, frame: int) -> float:
    return plain(method, metric, subject, seed, frame) + (1.0 if (method, metric) == ("good", "psnr") else 0.0)


def test_runs_of_one_protocol_are_one_table(tmp_path: Path) -> None:
    first = write_run(tmp_path / "first", methods=("oracle", "good"))
    second = write_run(tmp_path / "second", methods=("oracle", "fair", "good"))
    assert [row.title for row in table(first, second).rows] == ["Oracle", "Good", "Fair"], "equal cells are one row"
    assert _row(table(first, second), "good") == _row(table(first), "good")
    third = write_run(tmp_path / "third", _better, methods=("good",), salt={"good": "another version"})
    result = table(first, second, third)
    assert [row.title for row in result.rows] == ["Oracle", "Good", "Fair", "Good (third)"]
    assert [_cell(result, name).rank for name in ("good", "fair", "good (third)")] == [2, 2, 1]
    apart = _cell(table(first, third, baseline="good"), "good (third)").difference
    assert apart is not None and apart.value == pytest.approx(1.0) and apart.separated


def test_parts_of_a_sharded_run_are_the_whole_run(tmp_path: Path) -> None:
    whole, *parts = (write_run(tmp_path / name) for name in ("whole", "one", "two"))
    for part, kept in zip(parts, (0, 1), strict=True):
        for i, path in enumerate(sorted((part / "cells").iterdir())):
            if i % 2 != kept:
                path.unlink()
    assert not _cell(table(parts[0]), "good").complete
    assert table(*parts) == table(whole)


def test_versions_and_data_are_not_mixed(tmp_path: Path) -> None:
    first = write_run(tmp_path / "first")
    newer = write_run(tmp_path / "newer", version=2)
    other = write_run(tmp_path / "other", capture="e" * 16)
    with pytest.raises(
        InputError, match=r"cannot share a table: the protocols differ: .*first ran toy@1.*newer ran toy@2"
    ):
        table(first, newer)
    with pytest.raises(InputError, match=r"the data differ: .*first used openstage tiny \(cccccccc\).*\(eeeeeeee\)"):
        table(first, other)


def test_reasons_that_differ_in_a_number_are_one_footnote() -> None:
    notes = Footnotes()
    texts = ["non-finite: 3 values are NaN", "out of memory", "non-finite: 70 values are NaN", "failed: 3", "failed: 4"]
    texts += ["non-finite: loss 0.5 of s01", "non-finite: loss 1.5 of s02"]
    assert [notes.number(text) for text in texts] == [1, 2, 1, 3, 4, 5, 6]
    assert notes.texts() == ("non-finite: 3 to 70 values are NaN", "out of memory", *texts[3:])


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
    assert [signed(value, 2) for value in (0.5, -0.5, 0.001, 0.0, None)] == ["+0.50", "−0.50", "0.00", "0.00", "–"]
    assert [letter(note) for note in (1, 26, 27, 53)] == ["a", "z", "aa", "ba"]


def test_non_linearity_is_the_worst_cell_and_old_cells_have_none(run_folder: Path) -> None:
    assert _row(table(run_folder), "urhand").nonlinearity is None
    cells = [path for path in (run_folder / "cells").glob("*.json") if _is(path, "urhand", "s01")]
    cells += [path for path in (run_folder / "cells").glob("*.json") if _is(path, "urhand", "s02")]
    for path, value in zip(cells, (0.0, 3e-7), strict=True):
        cell = json.loads(path.read_text())
        path.write_text(json.dumps({**cell, "laws": {"linearity": value}}))
    assert _row(table(run_folder), "urhand").nonlinearity == 3e-7


def test_memory_is_told_where_cells_tell_it(tmp_path: Path, run_folder: Path) -> None:
    assert not table(run_folder).footprints, "a run of before it was measured"
    run = read_run(write_run(tmp_path / "run", methods=("oracle", "good"), subjects=2))
    for place, cell in enumerate(run.of_method("good")):
        cost = Cost(peak_mb=500.0 + 20 * place, energy_j=50.0, drawn=10, parameters=1_234_567, avatar_bytes=3 << 20)
        run.store.write_cell(replace(cell, cost=cost))
    result = table(run.folder)
    (row,) = result.footprints
    told = dict(zip(MEMORY_TITLES, memory_texts(row), strict=True))
    assert told == {
        **dict.fromkeys(("training MiB", "GPU MiB", "weights MiB"), "–"),
        **{"drawing MiB": "510", "avatar MiB": "3.00", "parameters": "1.2 million", "J a frame": "5.00"},
    }
    assert "| Good | 510 |" in render_markdown(result)
    assert "memory_mb,,MiB,False,510.0,500.0,520.0" in render_csv(result)
    plot = next(plot for plot in plots(result) if plot.time == "memory")
    assert [point.title for point in plot.points] == ["Good"] and "510 MiB" in told_plot(plot)


def test_one_page_of_several_runs_with_a_baseline(tmp_path: Path) -> None:
    first = write_run(tmp_path / "first", methods=("oracle", "good"))
    second = write_run(tmp_path / "second", _better, methods=("oracle", "good"), salt={"good": "another version"})
    files = write_reports(first, others=[second], baseline="good")
    page = files["index.html"].read_text()
    assert files["index.html"].parent == first / "compared" and not (first / "report").exists()
    for text in ("Good (second)", "Difference to Good", "2 runs: first, second", "<h3>second</h3>"):
        assert text in page, text
    shown = [page.count(f'scope="row" data-value="{title}"') for title in ("Oracle", "Good (second)")]
    assert shown == [4, 6], "the truth is in no table of differences"
    stamp = files["index.html"].stat().st_mtime_ns
    assert write_reports(first, others=[second], baseline="good")["index.html"].stat().st_mtime_ns == stamp
    elsewhere = write_reports(first, others=[second], out=tmp_path / "page")
    assert elsewhere["index.html"] == tmp_path / "page" / "index.html"
