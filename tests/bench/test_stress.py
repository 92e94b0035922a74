"""The runner on a planted suite, and the quick part of the real one."""

from __future__ import annotations

import importlib
import json
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from handbench.cli import main
from handbench.errors import HandbenchError, InputError, Unsupported
from handbench.studies.stress.case import Case, Result
from handbench.studies.stress.judgement import TruthPair, accurate, equal, finite_or, observe, relative_error
from handbench.studies.stress.record import render, summaries
from handbench.studies.stress.runner import Source, run_cases
from handbench.studies.stress.suite import select, suite

FAKES = Path(__file__).parent / "fakes"


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FAKES))
    return importlib.import_module("stressfakes")


@pytest.fixture(scope="module")
def declared() -> tuple[Case, ...]:
    return suite()


def test_every_planted_case_gets_its_verdict(planted: ModuleType) -> None:
    """One worker dies or hangs, the next goes on; the order is that of the suite."""
    results = list(run_cases(Source("stressfakes:suite"), planted.suite()))
    assert [result.name for result in results] == [name for name, *_ in planted.PLANTED]
    for result, (name, _, _, passes, told) in zip(results, planted.PLANTED, strict=True):
        assert result.passed == passes, f"{name}: {result.observed}"
        assert told in result.observed, name


def test_a_suite_that_cannot_be_built_is_an_error_not_a_hang(planted: ModuleType) -> None:
    with pytest.raises(HandbenchError, match="the suite cannot be built"):
        list(run_cases(Source("stressfakes:broken"), planted.suite()))


def test_no_worker_is_left_when_the_results_are_not_all_wanted(planted: ModuleType) -> None:
    import multiprocessing

    results = run_cases(Source("stressfakes:suite"), planted.suite())
    next(results)
    assert multiprocessing.active_children()
    results.close()  # type: ignore[attr-defined]
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("value", "truth", "norm", "error"),
    [
        ([1.01, 100.0], [1.0, 100.0], "largest", 0.01),  # one hundredth of the largest: measured against itself
        ([0.02, 100.0], [0.01, 100.0], "largest", 0.01),  # below: measured against a hundredth of the largest
        ([1.0, 0.0], [0.0, 0.0], "largest", np.inf),
        ([1.5, 2.0], [1.0, 4.0], "mean", 0.5),
        ([0.0, 0.0], [0.0, 0.0], "mean", 0.0),
    ],
)
def test_relative_error(value: list[float], truth: list[float], norm: str, error: float) -> None:
    assert relative_error([np.array(value)], [np.array(truth)], norm) == pytest.approx(error)  # type: ignore[arg-type]


def test_the_least_scale_of_an_error() -> None:
    assert observe(accurate(1e-6), lambda: TruthPair(1e-8, 0.0, least=1.0)).passed
    assert not observe(accurate(1e-6), lambda: TruthPair(1e-5, 0.0, least=1.0)).passed


def test_low_precision_answers_are_judged_in_float64() -> None:
    assert not observe(equal(1e-3), lambda: TruthPair(torch.tensor([1.0, 70000.0]).half(), torch.ones(2))).passed
    assert observe(equal(1e-2), lambda: TruthPair(torch.tensor([0.3]).bfloat16(), torch.tensor([0.3]))).passed


def test_an_alternative_refusal_counts() -> None:
    def refuse() -> None:
        raise Unsupported("cannot")

    assert observe(finite_or(Unsupported), refuse).passed
    assert not observe(finite_or(InputError), refuse).passed


def test_the_suite_is_large_named_once_and_always_the_same(declared: tuple[Case, ...]) -> None:
    assert len(declared) >= 150
    assert [case.id for case in declared] == [case.id for case in suite()]
    families = {case.family.split("/")[0] for case in declared}
    core = {"brdf", "shading", "surface", "atlas", "raster", "visibility", "light", "hand", "metrics", "methods"}
    assert core <= families
    compared = [case for case in declared if case.expected.within is not None]
    assert all(case.reference for case in compared), "every error is against a named reference"


def test_every_registered_method_is_in_the_suite(declared: tuple[Case, ...]) -> None:
    from handbench.registry import METHODS

    tried = {case.family.removeprefix("methods/") for case in declared if case.family.startswith("methods/")}
    assert tried == set(METHODS.entries())
    assert {c.family for c in suite(["mean"]) if c.family.startswith("methods/")} == {"methods/mean"}


def test_a_glob_that_fits_nothing_names_the_families(declared: tuple[Case, ...]) -> None:
    with pytest.raises(InputError, match=r"no case fits 'shadings/.*brdf"):
        select(declared, "shadings/*")


QUICK = (
    "light/environment with *",
    "light/*power kept*",
    "metrics/psnr*",
    "atlas/*",
    "hand/pose with*",
    "methods/mean/NaN*",
    "methods/oracle/*",
)


def test_the_quick_part_of_the_real_suite_passes(declared: tuple[Case, ...]) -> None:
    chosen = [case for glob in QUICK for case in select(declared, glob)]
    assert len(chosen) > 50
    failed = [
        (case.id, outcome.observed) for case in chosen if not (outcome := observe(case.expected, case.run)).passed
    ]
    assert not failed


def test_list_prints_cases_and_runs_none(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["stress", "--list", "--only", "light/*", "--out", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "light/environment with NaN  refused(InputError)" in lines
    assert all(line.startswith("light/") for line in lines)
    assert not (tmp_path / "out").exists()


def test_the_verb_writes_a_record_and_says_by_its_exit_code_whether_all_is_well(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["stress", "--only", "light/distant light*", "--methods", "mean", "--out", str(tmp_path)]) == 0
    assert "every case as expected" in capsys.readouterr().out
    record = json.loads((tmp_path / "stress.json").read_text())
    assert record["schema"] == 2 and record["failed"] == 0 and record["total"] == len(record["cases"]) == 5
    assert record["provenance"]["device"]["cores"] >= 1
    assert record["cases"][0]["expected"] == "refused(InputError)" and record["cases"][0]["passed"]


def test_a_failure_makes_the_exit_code_1(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, planted: ModuleType, tmp_path: Path
) -> None:
    monkeypatch.setattr("handbench.studies.stress.run.suite", lambda methods: planted.suite())
    monkeypatch.setattr("handbench.studies.stress.run.source", lambda methods: Source("stressfakes:suite"))
    assert main(["stress", "--only", "planted/*NaN*", "--out", str(tmp_path)]) == 1
    out = re.sub(r"\s+", " ", capsys.readouterr().out)
    assert "FAIL planted/silent NaN" in out and "2 of 2 cases came out unexpected" in out


def test_bad_arguments_are_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stress", "--methods", "urhandd", "--list"]) == 2
    assert main(["stress", "--only", "nothing", "--list"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 2 and "did you mean 'urhand'" in told[0] and "no case fits 'nothing'" in told[1]


def test_the_terminal_shows_families_and_failures_in_full() -> None:
    from rich.console import Console

    results = (
        Result("brdf", "roughness 0.1", "accurate(1e-05)", "jax", "relative error 3e-06", 3e-6, 1.5, True),
        Result("hand", "pose", "finite", "", "2 of 9 values are NaN or infinite", None, 4.0, False),
    )
    assert [line.failed for line in summaries(results)] == [0, 1]
    console = Console(width=100, record=True, file=sys.stderr)
    console.print(render(results, 2.0))
    text = console.export_text()
    assert "FAIL hand/pose" in text and "observed 2 of 9 values are NaN or infinite" in text
    assert "roughness 0.1" not in text and "1 of 2 cases came out unexpected" in text
