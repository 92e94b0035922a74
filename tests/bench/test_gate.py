"""The gate: its four exit codes, and that a regression needs both effect and interval."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handbench.cli import main
from handbench.errors import InputError
from handbench.results.gate import Quality, gate
from handbench.results.measured import Cost
from handbench.results.outcome import Check, Outcome, Verdict
from handbench.results.reading import Run, read_run

sys.path.append(str(Path(__file__).parent / "fakes"))
from runfakes import CPU, plain, write_run


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    return write_run(tmp_path / "baseline")


def _changed(method: str, metric: str, change: Callable[[int, int], float]) -> Any:
    """Values that differ for one method and metric by `change(subject, frame)`."""

    def value(name: str, of: str, subject: int, seed: int, frame: int) -> float | str:
        more = change(subject, frame) if (name, of) == (method, metric) else 0.0
        return plain(name, of, subject, seed, frame) + more

    return value


def _gate(candidate: Path, baseline: Path, time: float | None = 0.1, **more: Any) -> Outcome:
    return gate(read_run(candidate), read_run(baseline), more.pop("quality", Quality(0.01)), time, **more)


def _check(outcome: Outcome, method: str, metric: str, column: str = "Unseen light") -> Check:
    (found,) = (c for c in outcome.checks if (c.method, c.metric, c.column) == (method, metric, column))
    return found


def test_a_run_passes_beside_itself(baseline: Path) -> None:
    outcome = _gate(baseline, baseline)
    assert outcome.verdict is Verdict.PASS == 0 and {check.verdict for check in outcome.checks} == {"same"}
    assert {check.method for check in outcome.checks} == {"good", "fair"}, "no calibration rows"
    assert len(outcome.checks) == 2 * (2 * 2 + 2)
    assert outcome.sentence == "pass: none of 12 comparisons is a regression"


def test_a_clear_loss_is_a_regression_whichever_way_is_better(baseline: Path, tmp_path: Path) -> None:
    down = write_run(tmp_path / "down", _changed("good", "psnr", lambda s, f: -0.5))
    up = write_run(tmp_path / "up", _changed("fair", "lpips", lambda s, f: 0.01))
    outcome = _gate(down, baseline)
    assert outcome.verdict is Verdict.REGRESSION == 1
    assert outcome.sentence == "regression: 2 of 12 comparisons, in good"
    found = _check(outcome, "good", "PSNR")
    assert (found.worse, found.low) == (pytest.approx(0.5), pytest.approx(0.5)) and found.allowed == pytest.approx(
        0.01 * found.baseline
    )
    assert _check(_gate(up, baseline), "fair", "LPIPS").verdict == "regression"
    assert (
        _gate(baseline, down).verdict is Verdict.PASS
        and _check(_gate(baseline, down), "good", "PSNR").verdict == "better"
    )


def test_noise_as_large_as_the_loss_is_no_regression(baseline: Path, tmp_path: Path) -> None:
    """The mean loss, 0.5 dB, is beyond the threshold; half of the subjects gained."""
    rng = np.random.default_rng(0)
    hands = rng.permutation([-4.5, 3.5, -4.0, 3.0, -3.5, 2.5])
    noisy = write_run(tmp_path / "noisy", _changed("good", "psnr", lambda s, f: hands[s]))
    outcome = _gate(noisy, baseline)
    found = _check(outcome, "good", "PSNR")
    assert found.worse == pytest.approx(0.5) and found.worse > found.allowed
    assert found.low is not None and found.low < 0 and found.verdict == "cannot tell"
    assert outcome.verdict is Verdict.TOO_NOISY == 4
    assert outcome.sentence.startswith("too noisy to tell: 2 of 12 comparisons, in good, may be worse than is allowed")
    assert _gate(noisy, baseline, quality=Quality(0.2)).verdict is Verdict.PASS, "the interval excludes 20 %"


def test_a_certain_loss_below_the_threshold_is_no_regression(baseline: Path, tmp_path: Path) -> None:
    little = write_run(tmp_path / "little", _changed("good", "psnr", lambda s, f: -0.2))
    assert _check(_gate(little, baseline), "good", "PSNR").verdict == "worse"
    assert _gate(little, baseline).verdict is Verdict.PASS
    assert _gate(little, baseline, quality=Quality(0.01, {"psnr": 0.15})).verdict is Verdict.REGRESSION
    assert _gate(little, baseline, quality=Quality(0.005)).verdict is Verdict.REGRESSION


def test_what_does_not_show_in_print_is_no_regression(baseline: Path, tmp_path: Path) -> None:
    hidden = write_run(tmp_path / "hidden", _changed("good", "psnr", lambda s, f: -0.004))
    assert _gate(hidden, baseline, quality=Quality(0.0)).verdict is Verdict.PASS
    shown = write_run(tmp_path / "shown", _changed("good", "psnr", lambda s, f: -0.006))
    assert _gate(shown, baseline, quality=Quality(0.0)).verdict is Verdict.REGRESSION


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "the protocols differ: .*toy@1.*toy@2"),
        ({"digest": "e" * 64}, r"the protocols differ: .*\(dddddddd\).*\(eeeeeeee\)"),
        ({"capture": "f" * 16}, "the data differ: .*cccccccc.*ffffffff"),
        ({"seeds": (1,)}, r"the seeds of good differ: .*\[1\].*\[0\]"),
        ({"methods": ("oracle", "fair")}, "candidate has no method 'good', which .*baseline has"),
        ({"frames": 7}, "the scored frames of column 'light' differ"),
    ],
)
def test_what_cannot_be_compared_is_said(
    baseline: Path, tmp_path: Path, changes: dict[str, Any], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    candidate = write_run(tmp_path / "candidate", **changes)
    outcome = _gate(candidate, baseline)
    assert outcome.verdict is Verdict.NOT_COMPARABLE == 2
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(outcome.sentence)
    assert main(["gate", str(candidate), "--baseline", str(baseline)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("handbench: not comparable: ") and err.count("\n") == 1


def test_another_coverage_is_not_comparable(baseline: Path, tmp_path: Path) -> None:
    def diverges(method: str, metric: str, subject: int, seed: int, frame: int) -> float | str:
        gap = (method, subject, frame) == ("good", 1, 2)
        return "non-finite: 3 values" if gap else plain(method, metric, subject, seed, frame)

    outcome = _gate(write_run(tmp_path / "candidate", diverges), baseline)
    assert outcome.verdict is Verdict.NOT_COMPARABLE
    told = "the coverage of good in column 'light' differs: 94 of 96 values in"
    assert told in outcome.sentence and "96 in" in outcome.sentence and "(non-finite: 3 values)" in outcome.sentence
    assert _gate(tmp_path / "candidate", baseline, methods=["fair"]).verdict is Verdict.PASS


def test_a_failed_candidate_is_told_first(baseline: Path, tmp_path: Path) -> None:
    candidate = write_run(tmp_path / "candidate", _changed("good", "psnr", lambda s, f: -5))
    cells = {path: json.loads(path.read_text()) for path in (candidate / "cells").iterdir()}
    path, cell = next((path, cell) for path, cell in cells.items() if cell["method"]["name"] == "good")
    path.write_text(json.dumps({**cell, "error": "Traceback …\nRuntimeError: boom\n"}))
    outcome = _gate(candidate, baseline)
    assert outcome.verdict is Verdict.FAILED == 3
    assert f"{cell['method']['name']} {cell['subject']} seed 0 crashed (RuntimeError: boom)" in outcome.sentence
    path.unlink()
    assert f"1 of 18 cells of {candidate} are not computed" in _gate(candidate, baseline).sentence
    assert main(["gate", str(candidate), "--baseline", str(baseline)]) == 3
    assert _gate(baseline, candidate).verdict is Verdict.NOT_COMPARABLE, "the baseline lacks a cell"


def _noisy(scale: float) -> Callable[[str], list[float]]:
    return lambda name: [scale * value for value in (3.9, 4.0, 4.05, 4.1, 4.2, 4.3, 4.4, 5.0)]


def test_times_regress_beyond_threshold_and_spread(tmp_path: Path) -> None:
    old = write_run(tmp_path / "old", relight=_noisy(1.0))
    slow = write_run(tmp_path / "slow", relight=_noisy(1.4))
    assert _gate(slow, old, time=0.25).verdict is Verdict.REGRESSION
    assert _gate(slow, old, time=0.5).verdict is Verdict.PASS
    assert _gate(slow, old, time=None).verdict is Verdict.PASS
    found = _check(_gate(slow, old, time=0.25), "good", "known pose, new light, olat, ms", "")
    assert found.kind == "time" and found.worse == pytest.approx(0.4) and found.low is not None and found.low > 0.25
    assert _check(_gate(old, slow, time=0.25), "good", "known pose, new light, olat, ms", "").verdict == "better"


def test_times_within_their_spread_do_not_regress(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    wild = [write_run(tmp_path / n, relight=lambda name: list(rng.lognormal(1, 1.5, 4)), subjects=1) for n in "ab"]
    found = [
        c
        for c in _gate(wild[0], wild[1], time=0.0).checks + _gate(wild[1], wild[0], time=0.0).checks
        if c.kind == "time"
    ]
    assert "regression" not in {check.verdict for check in found} and max(check.worse for check in found) > 0.1
    assert all(check.verdict == "cannot tell" for check in found if check.worse > 0)


def test_one_frame_of_one_subject_cannot_be_told(tmp_path: Path) -> None:
    one, other = (
        write_run(tmp_path / name, _changed("good", "psnr", lambda s, f, more=more: more), subjects=1, frames=1)
        for name, more in (("one", 0.0), ("other", 0.1))
    )
    assert _gate(one, one).verdict is Verdict.PASS
    assert _gate(other, one, time=None).verdict is Verdict.TOO_NOISY, "a gain of one frame is no gain"
    assert main(["gate", str(other), "--baseline", str(one), "--time", "off"]) == 4


def test_times_of_another_device_are_left_out_or_refused(baseline: Path, tmp_path: Path) -> None:
    candidate = write_run(tmp_path / "candidate", device={**CPU, "cores": 64}, relight=_noisy(9.0))
    outcome = _gate(candidate, baseline)
    assert outcome.verdict is Verdict.PASS and {check.kind for check in outcome.checks} == {"quality"}
    assert "Not compared: times of different devices" in outcome.remarks[0] and "64 cores" in outcome.remarks[0]
    asked = _gate(candidate, baseline, time_asked=True)
    assert asked.verdict is Verdict.NOT_COMPARABLE and asked.sentence.startswith("not comparable: times of different")
    mine = {**CPU, "memory_gb": 8.1}
    assert len(_gate(write_run(tmp_path / "same", device=mine), baseline).checks) == 12, "memory that is free varies"


def test_thresholds_and_methods_that_are_not_there(baseline: Path) -> None:
    with pytest.raises(InputError, match="unknown metric of toy@1 'pnsr'; did you mean 'psnr'"):
        _gate(baseline, baseline, quality=Quality(0.01, {"pnsr": 0.1}))
    with pytest.raises(InputError, match=r"unknown method of .*baseline 'god'; did you mean 'good'"):
        _gate(baseline, baseline, methods=["god"])


def test_the_verb(baseline: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    worse = str(write_run(tmp_path / "worse", _changed("good", "psnr", lambda s, f: -0.5), relight=_noisy(2.0)))
    against = ["--baseline", str(baseline)]
    assert main(["gate", str(baseline), *against]) == 0
    out, err = capsys.readouterr()
    assert "handbench: pass: none of 12 comparisons is a regression" in out and err == ""
    assert main(["gate", worse, *against, "--time", "off"]) == 1
    out, err = capsys.readouterr()
    assert err == "handbench: regression: 2 of 8 comparisons, in good\n" and out.count("regression") == 2
    assert main(["gate", worse, *against, "--quality", "5%,psnr=1", "--time", "150%"]) == 0
    capsys.readouterr()
    assert main(["gate", worse, *against, "--json", "--time", "30%"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["verdict"], told["exit_code"]) == ("regression", 1) and len(told["checks"]) == 12
    assert sum(check["verdict"] == "regression" for check in told["checks"]) == 2 + 4
    assert main(["gate", worse, "--baseline", str(tmp_path / "nowhere")]) == 2
    assert main(["gate", worse, *against, "--time", "fast"]) == 2
    err = capsys.readouterr().err
    assert "nowhere holds no readable run.json" in err and "time 'fast' is no threshold" in err
    with pytest.raises(SystemExit) as stop:
        main(["gate", worse, *against, "--quality", "0.1"])
    assert stop.value.code == 2 and "'0.1' is no threshold; give a share (1%) or an amount" in capsys.readouterr().err


def test_unequal_enrolment_is_marked(baseline: Path) -> None:
    def told(enrolment: str) -> Run:
        run = read_run(baseline)
        methods = tuple(
            replace(method, enrolment=enrolment if method.name == "good" else "one picture")
            for method in run.plan.methods
        )
        return replace(run, plan=replace(run.plan, methods=methods))

    outcome = gate(told("single lights"), told("one picture"), Quality(0.01), 0.1)
    assert {check.method for check in outcome.checks if check.unequal} == {"good"}
    assert outcome.remarks == ("≠ Enrolment gave good 'single lights', the baseline 'one picture'.",)
    assert not any(check.unequal for check in gate(told("one picture"), told(""), Quality(0.01), 0.1).checks)


def test_one_cell_cannot_tell_and_what_is_not_compared_is_told(tmp_path: Path) -> None:
    def taking(name: str, **peaks: float) -> Path:
        run = read_run(write_run(tmp_path / name, subjects=1))
        for cell in run.cells:
            run.store.write_cell(replace(cell, cost=Cost(peak_mb=peaks.get(cell.method.name))))
        return run.folder

    before = taking("before", good=500.0)
    outcome = _gate(taking("after", good=510.0), before, memory=0.25)
    assert outcome.verdict is Verdict.TOO_NOISY and [check.kind for check in outcome.noisy] == ["memory"]
    assert "more subjects, frames, seeds or repeats tell" in outcome.sentence
    assert "Not compared: no memory of fair in both runs." in outcome.remarks
    assert _gate(taking("same", good=500.0), before, memory=0.25).noisy == ()


def test_memory_is_gated_where_it_is_asked_for(baseline: Path, tmp_path: Path) -> None:
    def taking(name: str, peak: float) -> Path:
        run = read_run(write_run(tmp_path / name))
        for number, cell in enumerate(run.cells):
            run.store.write_cell(replace(cell, cost=Cost(peak_mb=peak + number % 3)))
        return run.folder

    small, large = taking("small", 500), taking("large", 700)
    assert _gate(large, small).verdict is Verdict.PASS, "off unless asked for"
    outcome = _gate(large, small, memory=0.25)
    assert outcome.verdict is Verdict.REGRESSION and {c.kind for c in outcome.regressions} == {"memory"}
    assert _gate(large, small, memory=0.5).verdict is Verdict.PASS
    untold = _gate(small, baseline, memory=0.25)
    assert untold.verdict is Verdict.NOT_COMPARABLE, "a run of before it was measured: nothing was compared"
    assert untold.sentence == "not comparable: no memory of good, fair in both runs"
    assert main(["gate", str(large), "--baseline", str(small), "--memory", "25%", "--time", "off"]) == 1
    assert main(["gate", str(large), "--baseline", str(small), "--memory", "much"]) == 2
