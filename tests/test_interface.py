"""handbench in Python: tables, scores and pictures as plain values."""

from __future__ import annotations

import numpy as np
import pytest

import handbench
from handbench.errors import InputError


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory):
    """Two methods on one subject of the packaged capture."""
    folder = tmp_path_factory.mktemp("run")
    return handbench.run("smoke", ["oracle", "mean"], subjects=["s02"], out=folder)


def test_a_run_gives_its_table_as_plain_values(results):
    assert results.methods == ("oracle", "mean") and results.outcome.computed == 2
    rows = [row for row in results.rows() if row["metric"] == "psnr"]
    assert {row["method"] for row in rows} == {"oracle", "mean"}
    column = rows[0]["column"]
    means = results.mean("psnr", column)
    assert means["oracle"] == 100.0 > means["mean"] > 5.0
    assert "| Mean predictor" in results._repr_markdown_()


def test_scores_are_arrays_of_one_length(results):
    scores = results.scores
    assert len({len(array) for array in scores.values()}) == 1 and set(scores["frame"]) == set(results.frames)
    mine = (scores["method"] == "mean") & (scores["metric"] == "psnr")
    for column in set(scores["column"]):
        of_column = scores["value"][mine & (scores["column"] == column)]
        assert np.isclose(of_column.mean(), results.mean("psnr", column)["mean"]), "frames of one subject"


def test_pictures_are_linear_and_the_truth_is_the_oracles(results):
    frame = results.frames[0]
    truth, drawn = results.truth(frame), results.picture("mean", frame)
    assert truth.shape == drawn.shape and truth.shape[2] == 3 and drawn.max() > 0
    assert results.alpha("mean", frame).shape == truth.shape[:2]
    assert np.array_equal(truth, results.picture("oracle", frame, seed=0))


def test_what_is_not_there_is_told_with_what_is(results):
    for call, message in (
        (lambda: results.picture("maen", results.frames[0]), "unknown method 'maen'; did you mean 'mean'"),
        (lambda: results.picture("mean", "s01"), "unknown frame 's01'"),
        (lambda: results.picture("mean", results.frames[0], seed=3), "no picture of .* by mean with seed 3 is kept"),
        (lambda: results.mean("pnsr", "environment"), "unknown metric 'pnsr'; did you mean 'psnr'"),
        (lambda: handbench.run("smoke", settings={"stpes": 3}), "cannot be set|unknown setting 'stpes'"),
        (lambda: handbench.load(), "there is nothing to load"),
        (lambda: handbench.load("nowhere"), "nowhere holds no readable run.json"),
    ):
        with pytest.raises(InputError, match=message):
            call()


def test_loaded_results_are_those_that_were_run(results):
    again = handbench.load(*results.folders)
    assert again.rows() == results.rows() and again.outcome is None
    assert again.query("SELECT count(*) FROM cells") == [(2,)]


def test_settings_are_values_or_texts():
    from handbench.interface import _text
    from handbench.settings import Setting

    assert Setting.parse(f"rate={_text((1e-3, 1e-4))}").value == "0.001,0.0001"
    assert _text(None) == "None" and _text("display") == "display"


def test_a_protocol_can_be_a_file(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        handbench.run(tmp_path / "absent.toml")
