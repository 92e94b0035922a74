"""The page and the files beside it."""

from __future__ import annotations

import base64
import html
import io
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handbench.cli import main
from handbench.errors import StorageError
from handbench.reports import table, write_reports
from handbench.reports.figures import Panel, Tile, chosen, detail, panels
from handbench.reports.pictures import grid
from handbench.reports.printed import moment
from handbench.reports.run import machine, read_run
from handbench.results.origin import Hardware

VOID = {"meta", "img", "br", "link", "input", "hr"}


class _Page(HTMLParser):
    """Checks that tags close in order, and collects what the tests ask for."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def report(whole_run: Path) -> dict[str, Path]:
    return write_reports(whole_run, figures=True)


@pytest.fixture(scope="module")
def page(report: dict[str, Path]) -> str:
    return report["index.html"].read_text()


def test_all_files_are_there(report: dict[str, Path]) -> None:
    kinds = ("environment", "group", "olat")
    plots = [f"pareto-psnr-{time}" for time in ("known", "new", "training")]
    figures = [f"figures/{name}.{kind}" for name in (*kinds, *plots) for kind in ("png", "pdf")]
    assert sorted(report) == sorted([*figures, "index.html", "table.csv", "table.md", "table.tex"])
    for kind in kinds:
        width, height = Image.open(report[f"figures/{kind}.png"]).size
        assert width > 800 and height > 800
    for name in figures:
        assert report[name].read_bytes().startswith(b"%PDF" if name.endswith("pdf") else b"\x89PNG")


def test_the_page_is_well_formed_and_needs_nothing_else(page: str) -> None:
    parsed = _Page(page)
    assert not parsed.of("link") and all("src" not in script for script in parsed.of("script"))
    assert all((image["src"] or "").startswith("data:image/") for image in parsed.of("img"))
    assert not re.search(r"https?://|@import|url\(", page)


def test_every_picture_has_a_text_and_shows_something(page: str) -> None:
    images = _Page(page).of("img")
    # Six frames; truth, and image and error of mean, physical, urhand, and of phong where it has an answer.
    assert len(images) >= 6 * 7
    assert all(image["alt"] for image in images)
    for image in images:
        picture = Image.open(io.BytesIO(base64.b64decode((image["src"] or "").partition(",")[2])))
        # The frames are three quarters as wide as tall, and so are the crops.
        assert picture.size[0] / picture.size[1] == pytest.approx(0.75, abs=0.02)
        assert np.asarray(picture.convert("L")).max() > 3


def test_the_page_says_what_a_reader_must_know(page: str) -> None:
    for text in (
        "14 of 15 cells computed",
        "uncommitted changes",
        "trained here",
        "not the authors' code",
        "Example CPU 9000",
        "psnr|region:mask|space:srgb",
        "0123456789abcdef",
        "16/24",
        "non-finite: 3 pixels of the answer are NaN",
        "Physical_BRDF & fit",
    ):
        assert text in html.unescape(page), text


def test_titles_cannot_break_out_of_the_page(small_run: Path, page_of: Callable[[Path], str]) -> None:
    path = small_run / "run.json"
    plan = json.loads(path.read_text())
    plan["methods"][1]["title"] = "<script>alert(1)</script>"
    path.write_text(json.dumps(plan))
    assert "<script>alert" not in page_of(small_run)


def test_images_are_the_frames_of_median_score(whole_run: Path) -> None:
    run = read_run(whole_run)
    found = chosen(run)
    assert [kind for kind, _ in found] == ["olat", "olat", "group", "group", "environment", "environment"]
    assert {query.split("/")[0] for _, query in found} == {"s01", "s03"}
    scores = {}
    for cell in run.cells:
        if cell.subject == "s03" and not cell.method.truth:
            for frame, signature, value, _ in cell.each():
                if signature.startswith("psnr") and frame.kind == "group":
                    scores.setdefault(frame.query, []).append(value)
    means = {query: np.mean(values) for query, values in scores.items()}
    assert found[3][1] == sorted(means, key=lambda query: means[query])[len(means) // 2]


def test_the_detail_is_where_the_typical_answer_is_most_wrong() -> None:
    truth = np.full((60, 45, 3), 0.5)
    here, there = np.zeros((60, 45)), np.zeros((60, 45))
    here[40:46, 10:16], there[:12, 30:42] = 0.1, 0.9
    tiles = [Tile("", 1.0, truth, error) for error in (here, here, here + there)]
    rows, columns = detail(Panel("q", "olat", 1.0, truth, tuple(tiles)))
    assert rows.stop - rows.start == columns.stop - columns.start == round(0.28 * 45)
    assert rows.start <= 40 and rows.stop >= 46 and columns.start <= 10 and columns.stop >= 16, (
        "one outlier has no vote"
    )
    rows, columns = detail(Panel("q", "olat", 1.0, truth, (Tile("a", None, None, None, "failed"),)))
    assert rows.start + rows.stop == pytest.approx(60, abs=1) and columns.start + columns.stop == pytest.approx(
        45, abs=1
    )


def test_grids_have_the_same_bytes_every_time_and_text_that_can_be_searched(whole_run: Path) -> None:
    run = read_run(whole_run)
    shown = [panel for panel in panels(run) if panel.kind == "group"]
    once, again = (grid(shown, table(whole_run).metrics[0]) for _ in range(2))
    assert once == again and b"CreationDate" not in once["pdf"]
    assert b"/FontFile2" in once["pdf"], "TrueType, so that a publisher accepts it"


def test_errors_are_zero_for_the_truth_and_grow_with_bad_methods(whole_run: Path) -> None:
    for panel in panels(read_run(whole_run)):
        tiles = {tile.title: tile for tile in panel.tiles}
        assert "Oracle" not in tiles
        assert tiles["Mean"].error is not None and tiles["URHand"].error is not None
        assert tiles["Mean"].error.mean() > tiles["URHand"].error.mean() > 0


def test_a_second_call_does_nothing_and_is_quick(small_run: Path) -> None:
    first = write_reports(small_run)
    before = {path: path.stat().st_mtime_ns for path in first.values()}
    start = time.perf_counter()
    assert write_reports(small_run) == first
    assert time.perf_counter() - start < 1.0
    assert {path: path.stat().st_mtime_ns for path in first.values()} == before


@pytest.fixture
def narrow_run(small_run: Path) -> Path:
    """With one column, whose figures are drawn faster."""
    path = small_run / "run.json"
    plan = json.loads(path.read_text())
    del plan["protocol"]["columns"][1:]
    path.write_text(json.dumps(plan))
    for cell in (small_run / "cells").glob("*.json"):
        told = json.loads(cell.read_text())
        told["scores"] = [score for score in told["scores"] if score["column"] == "unseen-segment"]
        cell.write_text(json.dumps(told))
    return small_run


def test_figures_are_made_when_asked_for_and_then_kept_up_to_date(
    narrow_run: Path, set_scores: Callable[..., None]
) -> None:
    assert not (narrow_run / "report" / "figures").exists() and "figures" not in str(sorted(write_reports(narrow_run)))
    asked = write_reports(narrow_run, figures=True)
    before = {path: path.stat().st_mtime_ns for path in asked.values()}
    assert asked == write_reports(narrow_run) == write_reports(narrow_run, figures=True)
    assert {path: path.stat().st_mtime_ns for path in asked.values()} == before
    grid, plot = (asked[f"figures/{name}.png"] for name in ("group", "pareto-psnr-known"))
    stale = plot.read_bytes()
    (grid.parent / "olat-of-a-former-run.png").write_bytes(b"")
    (grid.parent / "notes.txt").write_text("mine")
    set_scores(narrow_run, "urhand", psnr=30.0)
    assert write_reports(narrow_run).keys() == asked.keys()
    assert plot.read_bytes() != stale
    assert {path.name for path in grid.parent.iterdir()} - {path.name for path in asked.values()} == {"notes.txt"}


def test_the_command_line_writes_them(narrow_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(narrow_run), "--format", "figures"]) == 0
    folder = Path(capsys.readouterr().out.strip())
    assert {path.suffix for path in folder.iterdir()} == {".png", ".pdf"}
    assert main(["report", str(narrow_run), str(narrow_run), "--format", "figures"]) == 2
    assert capsys.readouterr().err.startswith("handbench: --format figures shows one run without a baseline")


def test_a_report_is_made_anew_when_a_cell_changes_or_a_file_is_lost(
    small_run: Path, set_scores: Callable[..., None]
) -> None:
    first = write_reports(small_run)["index.html"].read_bytes()
    write_reports(small_run)["index.html"].unlink()
    assert write_reports(small_run)["index.html"].read_bytes() == first  # and the same bytes
    set_scores(small_run, "urhand", psnr=30.0)
    assert write_reports(small_run)["index.html"].read_bytes() != first


def test_a_cached_report_imports_neither_matplotlib_nor_torch(small_run: Path) -> None:
    write_reports(small_run)
    code = (
        "import sys, pathlib; from handbench.reports import write_reports;"
        f"write_reports(pathlib.Path({str(small_run)!r}));"
        "print([name for name in ('matplotlib', 'torch', 'jinja2', 'open3d') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=small_run)
    assert done.stdout.strip() == "[]"


def test_without_an_oracle_the_page_says_why_it_has_no_images(small_run: Path) -> None:
    path = small_run / "run.json"
    plan = json.loads(path.read_text())
    plan["methods"] = plan["methods"][1:]
    path.write_text(json.dumps(plan))
    files = write_reports(small_run, figures=True)
    assert {name.partition("-")[0] for name in files if name.startswith("figures")} == {"figures/pareto"}
    assert "No images: the truth is read from the oracle" in files["index.html"].read_text()


def test_a_lost_picture_is_told_in_its_place(small_run: Path, page_of: Callable[[Path], str]) -> None:
    lost = next(cell for cell in read_run(small_run).cells if cell.method.name == "urhand")
    shutil.rmtree(small_run / "predictions" / lost.key)
    assert "does not exist" in page_of(small_run)


def test_a_full_disk_leaves_the_earlier_report_intact(
    small_run: Path, set_scores: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = write_reports(small_run)["index.html"].read_bytes()
    set_scores(small_run, "urhand", psnr=30.0)

    def full(path: Path, content: bytes) -> None:
        with path.open("wb") as file:
            file.write(content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(StorageError, match="disk is full"):
        write_reports(small_run)
    assert (small_run / "report" / "index.html").read_bytes() == before
    assert not list((small_run / "report").rglob("*.part"))


def test_a_run_folder_that_cannot_be_written_gets_a_remedy_that_exists(small_run: Path) -> None:
    (small_run / "report").write_text("")  # no folder can be made here
    with pytest.raises(StorageError, match="make it writable, or copy the run") as caught:
        write_reports(small_run)
    assert "--out" not in str(caught.value)


def test_laws_are_shown_and_a_broken_promise_is_a_warning(small_run: Path, page_of: Callable[[Path], str]) -> None:
    path = small_run / "run.json"
    plan = json.loads(path.read_text())
    plan["methods"][1]["linear"] = True
    path.write_text(json.dumps(plan))
    cells = [file for file in (small_run / "cells").glob("*.json") if _method(file) == "urhand"]
    for file, value in zip(cells, (3e-7, None, 2e-8), strict=True):
        laws = {"additivity": value, "homogeneity": value, "linearity": value, "pairs": 3, "reason": None}
        file.write_text(json.dumps({**json.loads(file.read_text()), "laws": laws}))
    page = page_of(small_run)
    assert ">3.0e-07<" in page and "declared linear in light, but not" not in page
    cells[0].write_text(cells[0].read_text().replace("3e-07", "0.002"))
    page = page_of(small_run)
    assert ">2.0e-03<" in page and "declared linear in light, but not: URHand" in page


def _method(cell: Path) -> str:
    return json.loads(cell.read_text())["method"]["name"]


def test_the_origin_says_when_and_on_what_in_plain_words() -> None:
    assert machine(Hardware("CPU", 1, 1, 8.0)) == "CPU, 1 core, 1 thread, 8 GB"
    assert machine(Hardware("CPU", 4, 2, 8.0, ("GPU",))) == "CPU, 4 cores, 2 threads, 8 GB, GPU"
    assert moment("2026-03-01T14:05:00+00:00") == "2026-03-01, 14:05 UTC"
