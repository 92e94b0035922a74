"""Runs beside a first one: paired by method and frame, corrected, and only where they can be compared."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest
from rich.console import Console

from handbench.cli import main
from handbench.errors import InputError
from handbench.reports.comparison import Comparison, ComparisonLine, compare, render_comparison

sys.path.append(str(Path(__file__).parents[1] / "bench" / "fakes"))
from runfakes import plain, write_run


def _better(method: str, metric: str, subject: int, seed: int, frame: int) -> float:
    """0.2 dB more for "good", a little less on odd frames."""
    more = 0.2 - 0.01 * (frame % 2) if (method, metric) == ("good", "psnr") else 0.0
    return plain(method, metric, subject, seed, frame) + more


@pytest.fixture
def runs(tmp_path: Path) -> list[Path]:
    first = write_run(tmp_path / "first", methods=("oracle", "good", "fair"))
    second = write_run(tmp_path / "second", _better, methods=("good", "fair", "new"))
    third = write_run(tmp_path / "third", methods=("fair",))
    return [first, second, third]


def _line(found: Comparison, method: str, metric: str) -> ComparisonLine:
    return next(line for line in found.lines if (line.method, line.metric.name) == (method, metric))


def test_methods_are_matched_by_name_and_paired(runs: list[Path]) -> None:
    found = compare(*runs)
    assert found.runs == tuple(map(str, runs)) and found.alone == ("oracle", "good", "new")
    assert [line.method for line in found.lines[:2]] == ["Good", "Fair"] and len(found.lines) == 2 * 2 * 2
    good = _line(found, "Good", "psnr")
    (value, apart), (nothing, none) = good.others
    assert apart is not None and apart.value == pytest.approx(0.195) and apart.separated
    assert value == pytest.approx((good.value or 0.0) + 0.195) and (nothing, none) == (None, None)
    assert (apart.p, apart.adjusted) == (2 / 2**6, 2 * 2 / 2**6), "two methods in the family"
    same = _line(found, "Fair", "psnr").others
    assert [each.value for _, each in same if each] == [0.0, 0.0] and not any(
        each.separated for _, each in same if each
    )


def test_it_is_printed_with_names_and_limits(runs: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    out = io.StringIO()
    Console(file=out, width=100).print(render_comparison(compare(*runs)))
    text = out.getvalue()
    assert f"B  {runs[1]}" in text and "C − A" in text and "+0.20" in text and "[+0.1" in text and "p 0.062" in text
    assert "Not in every run: oracle, good, new." in text and "Too few subjects" not in text
    assert main(["compare", str(runs[0]), str(runs[1])]) == 0
    assert "Unseen light, PSNR ↑" in capsys.readouterr().out


def test_too_few_subjects_are_told(tmp_path: Path) -> None:
    few = [write_run(tmp_path / name, subjects=3) for name in "ab"]
    out = io.StringIO()
    Console(file=out, width=300).print(render_comparison(compare(*few)))
    assert "Too few subjects to claim a difference for other hands: with 3 p cannot fall below 0.25" in out.getvalue()


def test_what_cannot_be_compared_is_one_sentence(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = write_run(tmp_path / "other", version=2)
    with pytest.raises(InputError, match=r"cannot be compared: the protocols differ: .*toy@1.*toy@2"):
        compare(runs[0], runs[1], other)
    lone = write_run(tmp_path / "lone", methods=("unheard",))
    with pytest.raises(InputError, match=r"no method is in .*first and in another"):
        compare(runs[0], lone)
    assert main(["compare", str(runs[0])]) == 2 and main(["compare", str(runs[0]), str(tmp_path / "nowhere")]) == 2
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 2 and "nothing to compare" in err[0] and "holds no readable run.json" in err[1]


def test_unequal_enrolment_is_marked(runs: list[Path]) -> None:
    for folder, label in zip(runs, ("single lights", "one picture", ""), strict=True):
        plan = json.loads((folder / "run.json").read_text())
        for method in plan["methods"]:
            method["enrolment"] = label
        (folder / "run.json").write_text(json.dumps(plan))
    found = compare(*runs)
    assert {line.across for line in found.lines} == {(True, False)}  # the third does not tell
    out = io.StringIO()
    Console(file=out, width=140).print(render_comparison(found))
    assert "single lights" in out.getvalue() and "p 0.062≠" in out.getvalue()
    assert "≠: compared with rows to which enrolment gave something else" in out.getvalue()
