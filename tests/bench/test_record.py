"""Records: what is written is read again, and every other content is one sentence that names file and field."""

from __future__ import annotations

import json
import os
import random
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handbench.bench.store import Store
from handbench.cli import main
from handbench.errors import Damaged, InputError, StorageError
from handbench.reports import render_csv, render_latex, render_markdown, render_terminal, table
from handbench.reports.curves import curves
from handbench.reports.figures import chosen
from handbench.reports.page import PageContent, render_page
from handbench.reports.pareto import draw, in_words, plots
from handbench.results.gate import Quality, gate
from handbench.results.measured import CellTimes, CurvePoint, ScoredFrame, Spread
from handbench.results.query import ResultsDatabase
from handbench.results.reading import read_run
from handbench.results.record import CellRecord, MethodRecord
from handbench.results.recordfile import documentation, dump, parse, sealed
from handbench.results.schema import plain
from handbench.results.values import values_of
from handbench.scene import Prediction

sys.path.append(str(Path(__file__).parent / "fakes"))
from runfakes import write_run

ROOT = Path(__file__).parents[2]
ODD: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 3.5, -2.0, 1e300, 10**30, float("nan"), float("inf")),
    *(
        "",
        "x",
        "../../../etc/passwd",
        "/etc/passwd",
        "a\0b",
        "\ud800",
        "=cmd",
        "\\input{x}",
        "a\n\nb",
        "\x1b[2J",
        "[/b]",
    ),
    *([], {}, [1], [[]], {"a": 1}, ["x"] * 3, [None], {"": {}}),
)


def cell() -> CellRecord:
    frames = tuple(
        ScoredFrame("light", f"s01/pose/cam/olat-{i}", "olat", (30.0 + i, None), (None, "failed")) for i in range(3)
    )
    times = CellTimes(1.0, 0.1, {"olat": Spread(2.0, 1.0, 3.0, 3, (1.0, 2.0, 3.0))})
    about = {"prior": "p", "curve": (CurvePoint(1, {"loss": 0.5, "l1": None}),)}
    return CellRecord("key", MethodRecord("m", "M"), "s01", 0, ("psnr|v1", "ssim|v1"), frames, times, **about)


def test_what_is_written_is_read_again() -> None:
    assert parse(CellRecord, dump(cell()).encode(), Path("cell.json")) == cell()


def test_any_other_digit_is_noticed() -> None:
    text = dump(cell())
    assert text.count("31.0") == 1
    with pytest.raises(Damaged, match=r"^cell.json is damaged: digest does not fit the rest.*; run again"):
        parse(CellRecord, text.replace("31.0", "31.1").encode(), Path("cell.json"))
    reordered = json.dumps(dict(reversed(json.loads(text).items())))
    assert parse(CellRecord, reordered.encode(), Path("cell.json")) == cell(), "another layout is the same content"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": "0"}, 'seed is "0", not a whole number'),
        ({"seed": 2**63}, "seed is a whole number beyond 64 bits"),
        ({"key": "../key"}, 'key is "../key", not a name that a file can have'),
        ({"times": {"train_s": -1}}, "times.train_s is -1, not a time from 0 to 1e12"),
        ({"predictions": {"q": 1}}, 'predictions."q" is 1, not a text'),
        ({"scores": [{"column": "c"}]}, r"scores\[0\].query is missing"),
        ({"metrics": ["a", "a"]}, 'metrics holds "a" twice'),
        (
            {"curve": [{"step": 1, "values": {"loss": float("inf")}}]},
            r'curve\[0\].values."loss" is not a finite number',
        ),
    ],
)
def test_a_field_that_does_not_fit_is_named(change: dict[str, Any], message: str) -> None:
    content = sealed({**plain(cell()), **change})
    with pytest.raises(Damaged, match=message):
        parse(CellRecord, json.dumps(content).encode(), Path("cell.json"))


def test_the_page_of_the_records_is_made_from_them() -> None:
    told = (ROOT / "docs" / "records.md").read_text(encoding="utf-8")
    assert told == documentation(), "write it anew: python -m handbench.results.recordfile > docs/records.md"


def test_times_of_version_1_that_did_not_say_what_they_measured_are_left_out_with_a_remark(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", subjects=2)
    for path in (folder / "cells").iterdir():
        told = json.loads(path.read_text())
        told["times"] = {"train_s": 1.0, "personalise_s": 1.0, "first_ms": {"median": 1}, "relight_ms": None}
        path.write_text(json.dumps(told))
    made = table(folder)
    assert not made.rows[0].times.new_pose_ms and made.rows[0].times.train_s
    assert any("were measured by a version" in remark for remark in made.remarks)


# -- random changes --------------------------------------------------------------------------------------------------


def spots(value: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to every value inside a JSON value, but only the first and last of long lists."""
    items = (
        list(value.items()) if isinstance(value, dict) else list(enumerate(value)) if isinstance(value, list) else []
    )
    for name, inner in items if len(items) < 8 else (items[0], items[len(items) // 2], items[-1]):
        yield (*way, name)
        yield from spots(inner, (*way, name))


def changed(content: dict[str, Any], random: random.Random) -> dict[str, Any]:
    """A copy with one to three values replaced, removed or doubled, and a digest that fits."""
    content = json.loads(json.dumps(content))
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        way = random.choice(list(spots(content)))
        place = content
        for name in way[:-1]:
            place = place[name]
        kind = random.random()
        if kind < 0.15:
            del place[way[-1]]
        elif kind < 0.25 and isinstance(place, list):
            place.append(place[way[-1]])
        else:
            place[way[-1]] = random.choice(ODD)
    return sealed(content) if "digest" in content else content


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A run of version 1, and the same one as it is written today, with a training and times."""
    old = write_run(tmp_path_factory.mktemp("old") / "run", subjects=2, frames=2, methods=("oracle", "good"))
    run, store = read_run(old), Store(tmp_path_factory.mktemp("new") / "run")
    store.prepare()
    store.write_run(run.plan)
    with store.writing_prior("p", "good", 0, {"a": 1}) as new:
        new.train_s, new.curve = 1.0, (CurvePoint(1, {"loss": 0.5}),)
        (new.state / "weights").write_text("w")
    for each in run.cells:
        store.write_cell(replace(each, prior="p", curve=(CurvePoint(1, {"loss": 0.1}),)))
    return old, store.folder


def everything(folder: Path, beside: Path) -> None:
    """What readers do with a run: tables in every format, plots, curves, a page, a query, the gate against another."""
    run = read_run(folder)
    made = table(folder, folder)
    for text in (render_csv(made), render_latex(made), render_markdown(made)):
        text.encode()
    for plot in plots(made):
        draw(plot), in_words(plot)
    render_page(made, run, PageContent())
    curves(run), chosen(run), render_terminal(made)
    gate(run, read_run(beside), Quality(), 0.25)
    for values in values_of(run).values():
        assert np.isfinite(values.values[~np.isnan(values.values)]).all()
    with ResultsDatabase([run]) as results:
        for view in ("runs", "methods", "cells", "times", "scores"):
            results.query(f"SELECT * FROM {view}")


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("seed", range(3))
def test_random_changes_give_a_sentence_or_an_answer(
    runs: tuple[Path, Path], tmp_path: Path, version: int, seed: int
) -> None:
    """Anything but an `InputError` of one line fails."""
    rng = random.Random(f"{seed} {version}")
    folder = Path(shutil.copytree(runs[version], tmp_path / "run"))
    files = sorted(path for path in folder.rglob("*.json"))
    refused = 0
    for _ in range(25):
        path = rng.choice(files)
        before = path.read_text()
        path.write_text(json.dumps(changed(json.loads(before), rng)))
        try:
            everything(folder, runs[version])
        except InputError as error:
            refused += 1
            assert "\n" not in str(error), str(error)
        path.write_text(before)
    assert refused > 5


# -- strangers' folders ----------------------------------------------------------------------------------------------


def test_a_flipped_bit_of_a_picture_or_of_weights_is_named(tmp_path: Path) -> None:
    store = Store(tmp_path)
    query = "s01/pose/cam/olat-0"
    digest = store.write_prediction("key", query, Prediction(np.full((4, 5, 3), 0.5, np.float32), np.ones((4, 5))))
    kept = replace(cell(), predictions={query: digest})
    assert store.read_prediction(kept, query).image.shape == (4, 5, 3)
    path = store.picture("key", query)
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    with pytest.raises(Damaged, match=rf"^{path} is damaged: it was changed after it was written"):
        store.read_prediction(kept, query)
    with store.writing_prior("p", "m", 0, {}) as new:
        (new.state / "weights").write_text("0.5")
    assert store.sound_state("p") == store.prior_state("p")
    (store.prior_state("p") / "weights").write_text("0.7")
    with pytest.raises(Damaged, match="weights is damaged"):
        store.sound_state("p")


@pytest.mark.parametrize("name", ["run[1]", "run*", "run?"])
def test_patterns_in_the_name_of_a_folder_match_no_sibling(tmp_path: Path, name: str) -> None:
    write_run(tmp_path / "run1", lambda *_: 10.0, subjects=2)
    folder = write_run(tmp_path / name / "run", lambda *_: 20.0, subjects=2)
    with ResultsDatabase([read_run(folder)]) as results:
        assert results.query("SELECT DISTINCT value FROM scores").rows == [(20.0,)]
    assert {row.cells[0].value for row in table(folder).rows} == {20.0}


@pytest.mark.parametrize("place", ["run.json", "cells/{key}.json", "priors/p/train.json"])
@pytest.mark.parametrize("kind", ["fifo", "device", "folder", "deep", "large"])
def test_what_is_no_small_regular_file_is_refused(
    runs: tuple[Path, Path], tmp_path: Path, place: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(shutil.copytree(runs[1], tmp_path / "run"))
    path = folder / place.format(key=read_run(folder).plan.cells[0])
    path.unlink()
    match kind:
        case "fifo":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir()
        case "deep":
            path.write_text('{"schema": 2, "a": ' * 50_000)
        case "large":
            with path.open("wb") as file:
                file.truncate(1 << 40)
    with pytest.raises((InputError, StorageError)) as caught:
        everything(folder, folder)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_links_lead_nowhere_outside(runs: tuple[Path, Path], tmp_path: Path) -> None:
    other = Path(shutil.copytree(runs[1], tmp_path / "other"))
    folder = Path(shutil.copytree(runs[1], tmp_path / "run"))
    shutil.rmtree(folder / "cells")
    (folder / "cells").symlink_to(other / "cells")
    with pytest.raises(StorageError, match="leads out of"):
        everything(folder, folder)
    (other / "report").mkdir()
    (other / "report" / "index.html").write_text("theirs")
    (folder / "cells").unlink()
    shutil.copytree(other / "cells", folder / "cells")
    (folder / "report").symlink_to(other / "report")
    assert main(["report", str(folder), "--format", "html"]) == 2
    assert (other / "report" / "index.html").read_text() == "theirs"


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"\n\n", b"x" * (2 << 20), None])
def test_a_damaged_stamp_of_a_report_breaks_nothing(
    runs: tuple[Path, Path], tmp_path: Path, content: bytes | None
) -> None:
    from handbench.reports import write_reports

    folder = Path(shutil.copytree(runs[1], tmp_path / "run"))
    first = write_reports(folder)["table.csv"].read_bytes()
    stamp = folder / "report" / ".inputs"
    stamp.write_bytes(stamp.read_bytes().splitlines()[0] + b"\n../../run.json" if content is None else content)
    files = write_reports(folder)
    assert files["table.csv"].read_bytes() == first and "index.html" in files
