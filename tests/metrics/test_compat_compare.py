"""The table of `handbench metrics compare`: groups, means, and values that are missing."""

from __future__ import annotations

import csv
import io
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from handbench.metrics import Family, Pair, Score
from handbench.metrics.compat.compare import MetricScores, lines, notes, render_csv, render_markdown, render_terminal


def line(name: str, title: str, *values: float | None, unit: str = "", higher: bool = True) -> MetricScores:
    about = {"name": name, "title": title, "unit": unit, "decimals": 2, "higher_is_better": higher}
    found = [Score(v) if v is not None else Score(None, f"{name} failed") for v in values]
    return MetricScores(SimpleNamespace(**about, signature=f"{name}|v1"), dict(zip("abc", found, strict=False)))


LINES = [
    line("psnr", "PSNR", 30.0, 31.0, unit="dB"),
    line("lpips", "LPIPS (Alex)", 0.1, 0.3, higher=False),
    line("x-psnr-hdr", "PSNR-H (x)", 40.0, None, unit="dB"),
    line("y-psnr", "PSNR (y)", None, None, unit="dB"),
]


def shown(lines: list[MetricScores]) -> str:
    console = Console(width=60, file=io.StringIO())
    console.print(render_terminal(lines))
    return "\n".join(text.rstrip() for text in console.file.getvalue().splitlines())


def test_values_of_one_quantity_stand_together_and_say_what_they_lack() -> None:
    assert shown(LINES) == (
        "PSNR ↑\n"
        "  psnr        30.50  dB\n"
        "  x-psnr-hdr  40.00  dB 1/2\n"
        "LPIPS ↓\n"
        "  lpips        0.20"
    )  # fmt: skip


def test_notes_give_signatures_of_what_has_a_value_and_reasons_for_what_has_none() -> None:
    assert notes(LINES, ["a remark"]) == [
        *("", "Signatures", "psnr|v1", "lpips|v1", "x-psnr-hdr|v1"),
        *("no value (x-psnr-hdr failed): x-psnr-hdr", "no value (y-psnr failed): y-psnr", "a remark"),
    ]


def test_csv_averages_what_is_there_and_says_how_much() -> None:
    rows = [row for row in csv.DictReader(io.StringIO(render_csv(LINES))) if row["metric"] == "x-psnr-hdr"]
    assert [(row["file"], row["value"], row["scored"], row["reason"]) for row in rows] == [
        ("a", "40.0", "1/1", ""),
        ("b", "", "0/1", "x-psnr-hdr failed"),
        ("", "40.0", "1/2", "x-psnr-hdr failed"),
    ]
    assert rows[0]["better"] == "higher" and rows[0]["signature"] == "x-psnr-hdr|v1"


def test_markdown_escapes_signatures() -> None:
    assert r"| x-psnr-hdr | ↑ | 40.00 | dB 1/2 | `x-psnr-hdr\|v1` |" in render_markdown(LINES).splitlines()


def test_a_picture_that_memory_does_not_hold_has_no_value_and_the_reason() -> None:
    def measure(error: Exception) -> Family:
        def fail(view: object) -> float:
            raise error

        fail.__module__ = "handbench.metrics.large"  # as one of ours: a plug-in's that crashes has a reason of its own
        return Family("large", "Large", fail, higher_is_better=True)

    pair = Pair(np.ones((4, 6, 3)), np.ones((4, 6, 3)), np.ones((4, 6)))
    for error in (MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried 9 bytes")):
        (found,) = lines([measure(error).with_options({})], [("a", pair)])
        assert found.reason == "not enough memory for 6x4 pixels; ask for fewer metrics with --only"
    with pytest.raises(RuntimeError, match="broken"):
        lines([measure(RuntimeError("broken")).with_options({})], [("a", pair)])
    (found,) = lines([measure(MemoryError()).with_options({})], [("a", "the file is damaged")])
    assert found.reason == "the file is damaged"
