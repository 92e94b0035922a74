"""The leaderboard: static files whose links lead somewhere, standing and history by protocol version."""

from __future__ import annotations

import json
import re
import sys
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

import pytest

from handbench.cli import main
from handbench.errors import InputError
from handbench.reports.board import BoardRun, Section, write_board
from handbench.reports.build import build
from handbench.results.reading import read_run

sys.path.append(str(Path(__file__).parents[1] / "bench" / "fakes"))
from runfakes import plain, write_run


def _run(folder: Path, gain: float, day: int, **more: object) -> Path:
    def value(method: str, metric: str, subject: int, seed: int, frame: int) -> float:
        return plain(method, metric, subject, seed, frame) + gain * (metric == "psnr")

    made = write_run(folder, value, subjects=1, frames=2, salt={"good": str(gain)}, **more)  # type: ignore[arg-type]
    plan = json.loads((made / "run.json").read_text())
    plan["provenance"]["started"] = f"2026-01-{day:02d}T03:04:05+00:00"
    (made / "run.json").write_text(json.dumps(plan))
    return made


def test_a_board_is_static_files_whose_links_lead_somewhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [_run(tmp_path / "late", 1.0, 9), _run(tmp_path / "early & <b>", 0.0, 2)]
    other = _run(tmp_path / "other", 0.0, 5, version=2, digest="e" * 64)
    assert main(["leaderboard", str(tmp_path / "site"), *map(str, runs), str(other)]) == 0
    page = Path(capsys.readouterr().out.strip())
    text = page.read_text()
    assert page == tmp_path / "site" / "index.html" and not re.search(r"https?://|url\(", text)
    links = re.findall(r'href="(runs/[^"]+)"', text)
    assert len(links) == 6 and all((page.parent / unquote(link)).is_file() for link in links)
    assert text.count("<h2") == 2 and "toy@1" in text and "toy@2" in text, "versions are never mixed"
    assert text.index("2026-01-09") < text.index("2026-01-02"), "the newest run first"
    assert "<b></" not in text and '<b class="open">' in text, "best in its run, for these hands"
    assert "early &amp; &lt;b&gt;" in text


def test_a_board_is_not_written_into_a_run(tmp_path: Path) -> None:
    run = _run(tmp_path / "run", 0.0, 1)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match="is one of the runs, which are only read; give another folder"):
        write_board(tmp_path / "elsewhere" / ".." / "run", [run])
    assert sorted(tmp_path.rglob("*")) == before


def test_a_history_goes_from_the_earliest_run_to_the_latest_with_better_up(tmp_path: Path) -> None:
    folders = [_run(tmp_path / name, gain, day) for name, gain, day in (("a", 0.0, 1), ("b", 2.0, 2), ("c", 1.0, 3))]
    entries = [BoardRun(folder.name, run := read_run(folder), build(run)) for folder in folders]
    history = next(Section(tuple(entries)).histories)
    line = next(line for line in history.lines if line.title == "Good")
    across, up = [x for x, _, _ in line.points], [y for _, y, _ in line.points]
    assert across == sorted(across) and up[1] < up[2] < up[0], "y grows downwards"
    assert line.points[1][2] == "Good, b: 32.02"
    assert list(history.places) == across, "every run has its number below"
    labels = sorted(line.label for line in history.lines)
    assert all(later - earlier >= 12 for earlier, later in pairwise(labels))


def test_two_runs_of_one_name_are_refused(tmp_path: Path) -> None:
    runs = [_run(tmp_path / "x" / "run", 0.0, 1), _run(tmp_path / "y" / "run", 0.0, 2)]
    with pytest.raises(InputError, match="two runs are named 'run'"):
        write_board(tmp_path / "site", runs)
    assert not (tmp_path / "site").exists()
