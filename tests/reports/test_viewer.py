"""The viewer's data: every scored frame with its pictures and scores, few enough to keep the page small."""

from __future__ import annotations

import base64
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handbench.bench.store import Store
from handbench.reports import table
from handbench.reports import viewer as viewer_module
from handbench.reports.frames import Framing, answers
from handbench.reports.pictures import KNEE, STOPS, beyond_white
from handbench.reports.run import read_run
from handbench.reports.truth import truth_of
from handbench.reports.viewer import Viewer, viewer
from handbench.scene.colour import srgb


def _viewer(folder: Path) -> Viewer:
    found = viewer(read_run(folder), table(folder))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def shown(whole_run: Path) -> Viewer:
    return _viewer(whole_run)


def _pixels(picture: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))), float) / 255


def test_every_scored_frame_is_there_once(whole_run: Path, shown: Viewer) -> None:
    plan = read_run(whole_run).plan
    queries = [query for column in plan.protocol.columns for query in column.queries]
    found = ["/".join(frame[key] for key in ("subject", "pose", "camera", "light")) for frame in shown.data["frames"]]
    assert found == queries and shown.shown == shown.scored == len(queries)
    assert shown.data["titles"] == ["Truth", "Mean", "Phong", "Physical_BRDF & fit", "URHand"], (
        "the oracle is the truth"
    )
    assert shown.data["titles"][shown.data["best"]] == "URHand"
    assert shown.seed is None


def test_pictures_are_the_truth_and_the_answers_cut_and_exposed_alike(whole_run: Path, shown: Viewer) -> None:
    run = read_run(whole_run)
    truth, given = truth_of(run), answers(run)
    frame = shown.data["frames"][9]
    query = "/".join(frame[key] for key in ("subject", "pose", "camera", "light"))
    view = Framing.of(*truth(query))
    for picture, linear in (
        (frame["pictures"][0], truth(query)[0]),
        (frame["pictures"][4], given["urhand"][query].picture(run, query)[0]),
    ):
        expected = view.linear(linear)
        assert _pixels(picture).shape == expected.shape
        assert np.abs(_pixels(picture) - beyond_white(expected)).mean() < 0.01
    assert frame["files"][4].endswith(f"{query.replace('/', '__')}.exr") and (whole_run / frame["files"][4]).is_file()
    assert (whole_run / frame["files"][0]).is_file() and frame["files"][0] != frame["files"][4]


def test_the_light_of_a_frame_is_shown_where_the_run_keeps_a_picture_of_it(small_run: Path) -> None:
    """One of a lighting, or one of a frame before it; each is in the page once."""
    assert {frame["lamp"] for frame in _viewer(small_run).data["frames"]} == {None}, "a run of before they were kept"
    store = Store(small_run)
    store.write_light("olat-03", b"of the lighting")
    store.write_light("s01/fist/dorsal/olat-03", b"of one frame")
    data = _viewer(small_run).data
    lit = {
        (frame["subject"], frame["pose"], frame["camera"]): frame["lamp"]
        for frame in data["frames"]
        if frame["light"] == "olat-03"
    }
    of_one = lit.pop(("s01", "fist", "dorsal"))
    assert base64.b64decode(data["lamps"][of_one]) == b"of one frame"
    assert {base64.b64decode(data["lamps"][lamp]) for lamp in lit.values()} == {b"of the lighting"} and len(
        data["lamps"]
    ) == 2
    assert {frame["lamp"] for frame in data["frames"] if frame["light"] != "olat-03"} == {None}


def test_pictures_have_four_stops_above_white() -> None:
    """Encoding and back: half floats above white come back within a step of eight bits, and what is darker too."""
    linear = np.array([0.0, 0.001, 0.2, 0.999, 1.0, 1.5, 4.0, 15.9, 40.0, -1.0])
    stored = np.round(255 * beyond_white(linear)) / 255
    shown = np.where(stored <= KNEE, 0.0, 2.0 ** ((stored - KNEE) / (1 - KNEE) * STOPS))
    above = linear > 1.1
    assert shown[above] == pytest.approx(np.minimum(linear[above], 16.0), rel=0.03)
    assert stored[~above] == pytest.approx(KNEE * srgb(np.clip(linear[~above], 0, 1)), abs=1 / 255)
    assert (np.diff(beyond_white(np.linspace(0, 17, 500))) >= 0).all()


def test_scores_are_those_of_the_cells_and_a_gap_says_why(whole_run: Path, shown: Viewer) -> None:
    run = read_run(whole_run)
    gap = next(
        f for f in shown.data["frames"] if f["light"] == "olat-03" and f["subject"] == "s01" and f["pose"] == "fist"
    )
    assert gap["pictures"][2] is None and gap["scores"][2] == ["–", "–", "–"]
    assert gap["reasons"][2] == "non-finite: 3 pixels of the answer are NaN"
    late = shown.data["frames"][-1]
    assert late["subject"] == "s03" and late["reasons"][2] == "not computed", "phong has no cell of the last subject"
    query = "s01/fist/dorsal/olat-03"
    (told,) = (f.values for cell in run.of_method("urhand") for f in cell.scores if f.query == query)
    assert gap["scores"][4] == [f"{told[0]:.2f}", f"{told[1]:.3f}", f"{told[2]:.3f}"]
    assert gap["scores"][0] is None and gap["columns"] == ["unseen-light"]


def test_a_lost_picture_is_told(small_run: Path) -> None:
    lost = read_run(small_run).of_method("urhand")[0]
    shutil.rmtree(small_run / "predictions" / lost.key)
    frame = next(f for f in _viewer(small_run).data["frames"] if f["subject"] == lost.subject)
    assert frame["pictures"][1] is None and "does not exist" in frame["reasons"][1]
    assert frame["scores"][1][0] != "–", "the score was computed all the same"


def test_frames_whose_truth_is_lost_are_left_out_and_counted(small_run: Path, page_of: Callable[[Path], str]) -> None:
    shutil.rmtree(small_run / "predictions" / read_run(small_run).of_method("oracle")[0].key)
    found = _viewer(small_run)
    assert (found.shown, found.chosen) == (48, 72) and {f["subject"] for f in found.data["frames"]} == {"s02", "s03"}
    page = page_of(small_run)
    assert "The truth of 24 is not in the run" in page and "s03/" in page


def test_without_truth_there_is_no_viewer(small_run: Path, page_of: Callable[[Path], str]) -> None:
    path = small_run / "run.json"
    plan = json.loads(path.read_text())
    plan["methods"] = plan["methods"][1:]
    path.write_text(json.dumps(plan))
    assert viewer(read_run(small_run), table(small_run)) is None
    assert 'id="viewer"' not in page_of(small_run)


def test_many_pixels_are_limited_evenly_and_the_page_says_so(
    small_run: Path, page_of: Callable[[Path], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer_module, "PIXELS", 54 * 72 * 2 * 3 * 3.5)  # three frames of two pictures in three columns
    found = _viewer(small_run)
    assert (found.shown, found.scored) == (9, 72)
    by_column = {name: [f for f in found.data["frames"] if f["columns"] == [name]] for name in found.data["columns"]}
    assert [len(frames) for frames in by_column.values()] == [3, 3, 3]
    assert [frame["subject"] for frame in by_column["environment"]] == ["s01", "s02", "s03"]
    page = page_of(small_run)
    assert "9 of the 72 scored frames were taken" in page


@pytest.mark.parametrize(
    ("size", "pictures", "columns", "limit"),
    (((256, 192), 8, 4, 38), ((256, 192), 1000, 40, 1), ((2048, 1334), 8, 4, 10)),
)
def test_the_limit_follows_from_the_pixels_shown(
    size: tuple[int, int], pictures: int, columns: int, limit: int
) -> None:
    assert viewer_module.per_column(size, pictures, columns) == limit


def test_of_several_seeds_the_first_is_shown_and_named(small_run: Path, page_of: Callable[[Path], str]) -> None:
    plan = json.loads((small_run / "run.json").read_text())
    for path in list((small_run / "cells").glob("*.json")):
        cell = json.loads(path.read_text())
        scores = [{**score, "value": 1.0} for score in cell["scores"]]
        again = {**cell, "key": f"{cell['key']}-1", "seed": 1, "scores": scores}
        (small_run / "cells" / f"{again['key']}.json").write_text(json.dumps(again))
        plan["cells"].append(again["key"])
    before = _viewer(small_run)
    (small_run / "run.json").write_text(json.dumps({**plan, "seeds": [0, 1]}))
    after = _viewer(small_run)
    assert after.data["frames"] == before.data["frames"] and after.seed == 0
    assert "those of seed 0" in page_of(small_run)


def test_no_text_of_a_run_can_end_the_data(small_run: Path, page_of: Callable[[Path], str]) -> None:
    path = small_run / "run.json"
    plan = json.loads(path.read_text())
    plan["methods"][1]["title"] = "</script><b>out"
    path.write_text(json.dumps(plan))
    page = page_of(small_run)
    assert "</script><b>out" not in page
    data = page.partition('id="viewer-data">')[2].partition("</script>")[0]
    assert json.loads(data)["titles"] == ["Truth", "</script><b>out"]


def test_a_view_cuts_around_the_hand_even_at_the_edge() -> None:
    image = np.zeros((40, 30, 3), np.float32)
    image[30:40, 20:30] = 0.5
    view = Framing.of(image, (image[..., 0] > 0).astype(np.float32))
    assert view.height / view.width == pytest.approx(4 / 3, abs=0.15)
    assert view.top + view.height > 40, "the margin lies outside of the picture, and is black"
    found = view(image)
    assert found.shape == (view.height, view.width, 3)
    lit = np.argwhere(found[..., 0] > 0)
    assert len(lit) == 100 and found.max() == pytest.approx(0.9063, abs=1e-3), "0.8 in sRGB"
    assert (lit.min(0) == (30 - view.top, 20 - view.left)).all()
