from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path

import pytest

from handbench.errors import InputError
from handbench.reports import write_reports
from handbench.reports.stress import stress_section
from handbench.results.origin import Hardware, Provenance
from handbench.results.schema import plain
from handbench.studies.stress.case import Result
from handbench.studies.stress.record import StressRecord, read_record, write_record

RESULTS = (
    Result("brdf", "roughness 0.1", "accurate(1e-05)", "jax float64", "relative error 3.1e-06", 3.1e-6, 1.5, True),
    Result("brdf", "d = -ω", "finite", "", "finite", None, 0.2, True),
    Result("hand", "pose <script>", "finite", "", "crashes: the process ended with SIGSEGV", None, 4000.0, False),
)
ABOUT = Provenance("0", None, "handbench stress", device=Hardware("Example CPU 9000", 2, 2))


OLD = {"schema": 1, **plain(StressRecord.of(RESULTS, 12.3, ABOUT))}


class _Balanced(HTMLParser):
    """Fails on a tag that is closed out of turn."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_folder_without_a_stress_run_has_no_section(tmp_path: Path) -> None:
    assert stress_section(tmp_path) is None


def test_the_section_shows_failures_first_then_families_then_all(tmp_path: Path) -> None:
    write_record(tmp_path, RESULTS, 12.3, ABOUT)
    html = stress_section(tmp_path)
    assert html is not None
    parser = _Balanced()
    parser.feed(html)
    assert not parser.open
    assert "1 of 3 hard cases came out other than expected" in html and "Example CPU 9000" in html
    assert html.index("SIGSEGV") < html.index("Families") < html.index("Every case")
    assert "pose &lt;script&gt;" in html and "<script" not in html
    assert "3.1e-06" in html and "jax float64" in html
    assert "http" not in html, "needs nothing from elsewhere"


def test_a_run_of_version_1_is_read(tmp_path: Path) -> None:
    (tmp_path / "stress.json").write_text(json.dumps(OLD))
    assert read_record(tmp_path) == StressRecord.of(RESULTS, 12.3, ABOUT)


def test_a_clean_run_says_so(tmp_path: Path) -> None:
    write_record(tmp_path, RESULTS[:2], 1.0, ABOUT)
    html = stress_section(tmp_path)
    assert html is not None and "All 2 hard cases came out as expected" in html and "Failures" not in html


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "is no JSON"),
        ('{"schema": 99}', "schema 99, this version reads 2"),
        ("[]", "schema None"),
        ('{"schema": 1, "cases": []}', "provenance is missing; run 'handbench stress' again"),
        (
            json.dumps({**OLD, "cases": [{**OLD["cases"][0], "passed": 1}]}),
            r"cases\[0\].passed is 1, not true",
        ),
        (json.dumps({**OLD, "schema": 2}), "digest does not fit the rest"),
    ],
)
def test_a_damaged_file_is_an_input_error(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "stress.json").write_text(text)
    with pytest.raises(InputError, match=told):
        stress_section(tmp_path)


def test_a_study_in_the_folder_of_a_run_is_shown_on_its_page(small_run: Path) -> None:
    before = write_reports(small_run)["index.html"].read_text(encoding="utf-8")
    write_record(small_run, RESULTS, 12.3, ABOUT)
    after = write_reports(small_run)["index.html"].read_text(encoding="utf-8")
    assert "1 of 3 hard cases came out other than expected" not in before
    assert "1 of 3 hard cases came out other than expected" in after
