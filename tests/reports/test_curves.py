"""Loss curves: what trainings told, drawn once a method with all its seeds."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handbench.reports import pareto_figures, pictures, write_reports
from handbench.reports.curves import INK, LossCurve, LossPlot, curves, loss_figures
from handbench.reports.run import read_run

TOLD = [
    {"step": 20, "loss": 0.5, "l1": 0.4, "adversarial": 0.1},
    {"step": 40, "loss": 0.3, "l1": None, "adversarial": -0.1},
    {"step": 60, "loss": 0.2, "l1": 0.2, "adversarial": 0.2},
]


def _train(run: Path, method: str, told: list[dict], name: str = "p0", seed: int = 0) -> None:
    """Give the cells of a method's seed a prior with this curve."""
    folder = run / "priors" / name
    folder.mkdir(parents=True)
    about = {"schema": 1, "method": method, "seed": seed, "train_s": 1.0, "curve": told}
    (folder / "train.json").write_text(json.dumps(about))
    for path in (run / "cells").glob("*.json"):
        cell = json.loads(path.read_text())
        if (cell["method"]["name"], cell["seed"]) == (method, seed):
            path.write_text(json.dumps({**cell, "prior": name}))


def test_a_prior_is_told_once_for_all_subjects_and_a_gap_is_left_out(run_folder: Path) -> None:
    _train(run_folder, "urhand", TOLD)
    found = curves(read_run(run_folder))
    assert set(found) == {"urhand"}, "cells without a prior, and methods that tell nothing, have no curve"
    (curve,) = found["urhand"]
    told = {
        "loss": [(20, 0.5), (40, 0.3), (60, 0.2)],
        "l1": [(20, 0.4), (60, 0.2)],
        "adversarial": [(20, 0.1), (40, -0.1), (60, 0.2)],
    }
    assert curve == LossCurve(0, "", told)


def test_every_seed_and_every_personalisation_has_its_own(run_folder: Path) -> None:
    _train(run_folder, "urhand", TOLD)
    plan = json.loads((run_folder / "run.json").read_text())
    for path in list((run_folder / "cells").glob("*.json")):
        cell = json.loads(path.read_text())
        if cell["method"]["name"] == "urhand":
            again = {**cell, "key": f"{cell['key']}-1", "seed": 1, "prior": None, "curve": TOLD[:1]}
            (run_folder / "cells" / f"{again['key']}.json").write_text(json.dumps(again))
            plan["cells"].append(again["key"])
    (run_folder / "run.json").write_text(json.dumps(plan))
    _train(run_folder, "urhand", TOLD[1:], "p1", seed=1)
    found = curves(read_run(run_folder))["urhand"]
    assert sorted((curve.seed, curve.subject) for curve in found) == [
        (0, ""),
        (1, ""),
        (1, "s01"),
        (1, "s02"),
        (1, "s03"),
    ]


def test_losses_that_change_sign_get_a_linear_axis_beside_the_logarithmic_one() -> None:
    points = [(step, 1.0 / step) for step in range(1, 50)]
    positive = LossCurve(0, "", {"loss": points})
    signed = LossCurve(0, "", {"loss": points, "adversarial": [(step, 0.5 - step) for step, _ in points]})
    one, two = (LossPlot("urhand", "URHand $x_", (curve,)) for curve in (positive, signed))
    small, large = (Image.open(io.BytesIO(each.png)) for each in (one, two))
    assert large.width == 2 * small.width and large.height == small.height
    assert two.size == (2 * one.size[0], one.size[1])
    assert np.asarray(small.convert("L")).min() < 128, "something is drawn"


def test_on_a_page_curves_have_the_ink_of_the_scheme_and_no_ground() -> None:
    points = [(step, 1.0 / step) for step in range(1, 50)]
    svg = LossPlot("urhand", "URHand", (LossCurve(0, "", {"loss": points}),)).svg.decode()
    assert svg.startswith("<svg") and "prefers-color-scheme: dark" in svg
    assert svg.count(INK) == 1 and "fill: currentColor" in svg, "ink is named once, in the light scheme"
    assert not {"#ffffff", "#000000", "white", "black"} & set(re.findall(r"(?:fill|stroke): ([#\w]+)", svg))
    assert svg == LossPlot("urhand", "URHand", (LossCurve(0, "", {"loss": points}),)).svg.decode()


def test_the_page_shows_them_and_the_run_keeps_the_pictures(small_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "grid", lambda *_: {})  # the other figures have tests of their own
    monkeypatch.setattr(pareto_figures, "pareto_figures", lambda *_: ())
    _train(small_run, "urhand", TOLD)
    files = write_reports(small_run, figures=True)
    assert files["figures/losses-urhand.png"].read_bytes().startswith(b"\x89PNG")
    page = files["index.html"].read_text()
    assert 'alt="Loss curves of URHand"' in page and "Losses as they were told" in page
    terms = {name for losses in loss_figures(read_run(small_run)) for curve in losses.trainings for name in curve.terms}
    assert terms == {"loss", "adversarial"}, "two points are no line"
    before = files["index.html"].stat().st_mtime_ns
    assert write_reports(small_run)["index.html"].stat().st_mtime_ns == before
    (small_run / "priors" / "p0" / "train.json").unlink()
    assert "losses-urhand" not in str(write_reports(small_run)), "a report follows what the run holds"


def test_a_run_without_trainings_has_no_such_section(small_run: Path) -> None:
    assert "Losses as they were told" not in write_reports(small_run)["index.html"].read_text()
