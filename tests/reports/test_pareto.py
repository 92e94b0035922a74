"""Score against time: who is on the front, where things stand in the drawing, and the files for papers."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from handbench.reports import table, write_reports
from handbench.reports.cost import MethodTimes, Span
from handbench.reports.model import Aggregate, ColumnGroup, MetricColumn, Row, Table
from handbench.reports.pareto import FRAME, TIMES, WIDTH, Plot, clock, draw, in_words, plots, seconds
from handbench.reports.pareto_figures import pareto_figures
from handbench.reports.places import SIZE, width
from handbench.results.record import MetricRecord

UP = MetricRecord("psnr", "PSNR", "psnr|v1", True, "dB", "", 2)
DOWN = MetricRecord("lpips", "LPIPS", "lpips|v1", False, "", "", 3)
GROUP = ColumnGroup("unseen", "Unseen")
TITLES = (
    "URHand",
    "Physical BRDF",
    "w/o light-aware L_GAN",
    "MLP-based linear",
    "Phong",
    "RelightableHands",
    "A",
    "$x_1",
)


def _row(title: str, milliseconds: float | None, value: float | None, kind: str = "method", covered: int = 4) -> Row:
    known = {} if milliseconds is None else {"olat": Span(milliseconds, milliseconds, milliseconds)}
    cell = Aggregate(value, None, None, covered, 4)
    return Row(title, title, kind, "", (cell,), MethodTimes(Span(60.0, 50.0, 70.0), Span(2.5, 1.0, 3.0), {}, known))


def _plot(rows: list[Row], metric: MetricRecord = UP) -> Plot:
    (plot,) = [
        plot for plot in plots(Table("t", (MetricColumn(GROUP, metric),), tuple(rows), ())) if plot.time == "known"
    ]
    return plot


@given(
    st.lists(st.tuples(st.floats(0.1, 1e4), st.floats(10, 40)), min_size=1, max_size=12, unique=True),
    st.sampled_from((UP, DOWN)),
)
def test_the_front_is_what_no_other_method_beats(found: list[tuple[float, float]], metric: MetricRecord) -> None:
    plot = _plot([_row(f"m{i}", ms, value) for i, (ms, value) in enumerate(found)], metric)
    better = 1 if metric.higher_is_better else -1

    def beats(one: tuple[float, float], other: tuple[float, float]) -> bool:
        return one != other and one[0] <= other[0] and better * one[1] >= better * other[1]

    expected = {f"m{i}" for i, one in enumerate(found) if not any(beats(other, one) for other in found)}
    assert {point.title for point in plot.front} == expected


def test_calibration_and_gaps_are_drawn_but_never_on_the_front() -> None:
    plot = _plot(
        [
            _row("quick and perfect", 1.0, 31.0, "calibration"),
            _row("gap", 2.0, 33.0, covered=3),
            _row("slow", 50.0, 30.0),
            _row("slower", 60.0, 29.0),
        ]
    )
    assert {p.title: p.kind for p in plot.points} == {
        "quick and perfect": "calibration",
        "gap": "gap",
        "slow": "front",
        "slower": "beaten",
    }
    assert "gap: 2 ms, 33.00 dB, frames missing" in in_words(
        plot
    ) and "slow: 50 ms, 30.00 dB, on the front" in in_words(plot)


def test_what_is_not_drawn_is_named() -> None:
    plot = _plot(
        [
            _row("Oracle", 1.0, 100.0, "calibration"),
            _row("One", 5.0, 30.0),
            _row("Two", 9.0, 33.0),
            _row("Untimed", None, 32.0),
            _row("Failed", 7.0, None),
            _row("Paper", None, 35.0, "published"),
        ]
    )
    assert [p.title for p in plot.points] == ["One", "Two"]
    assert plot.left_out == ("Untimed: no time", "Failed: no value", "Oracle: off the scale at 1 ms, 100.00 dB")


def test_a_table_without_times_has_no_plots() -> None:
    row = replace(_row("One", None, 30.0), times=MethodTimes(None, None, {}, {}))
    assert plots(Table("t", (MetricColumn(GROUP, UP),), (row,), ())) == ()


def test_training_is_one_training_and_one_personalisation() -> None:
    row = _row("One", 5.0, 30.0)
    assert tuple(seconds(row, time, "olat") for time in ("known", "new", "training")) == (0.005, None, 62.5)


def test_every_column_metric_and_time_of_a_run_is_drawn(whole_run: Path) -> None:
    found = plots(table(whole_run))
    measured = [time for time in TIMES if time != "memory"]  # nobody told of theirs
    assert len(found) == 3 * 3 * len(measured) and len({plot.name for plot in found}) == len(found)
    phong = [point for point in found[0].points if point.title == "Phong"]
    assert phong[0].seconds == pytest.approx(0.022) and phong[0].kind == "gap"


@pytest.mark.parametrize("metric", (UP, DOWN))
def test_faster_is_left_and_better_is_up(metric: MetricRecord) -> None:
    plot = _plot([_row("fast", 3.0, 21.0), _row("slow", 700.0, 30.0)], metric)
    drawing = draw(plot)
    (_, fast_x, fast_y, _), (_, slow_x, slow_y, _) = drawing.marks
    assert fast_x < slow_x and (slow_y < fast_y) == metric.higher_is_better
    xs, ys = ([place for place, _ in ticks] for ticks in (drawing.x_ticks, drawing.y_ticks))
    assert len(xs) >= 3 and len(ys) >= 3
    assert FRAME.left <= min(xs) and max(xs) <= FRAME.right and FRAME.top <= min(ys) and max(ys) <= FRAME.bottom
    assert "10 ms" in [text for _, text in drawing.x_ticks] and "26" in [text for _, text in drawing.y_ticks]


def test_ticks_stand_at_their_values() -> None:
    drawing = draw(_plot([_row("a", 1.0, 20.0), _row("b", 1000.0, 30.0)]))
    (_, left, low, _), (_, right, high, _) = drawing.marks
    at = {text: place for place, text in drawing.y_ticks}
    assert at["24"] == pytest.approx(low + 0.4 * (high - low))
    at = {text: place for place, text in drawing.x_ticks}
    assert at["100 ms"] == pytest.approx(left + (right - left) * 2 / 3)


@given(st.floats(1e-2, 1e5), st.floats(1.0, 1e6))
def test_texts_of_times_have_room(first: float, factor: float) -> None:
    ticks = draw(_plot([_row("a", first, 20.0), _row("b", first * factor, 30.0)])).x_ticks
    assert len(ticks) >= 2 or factor < 1.5
    assert all(
        later - earlier >= 1.02 * (width(one) + width(other)) / 2 for (earlier, one), (later, other) in pairwise(ticks)
    )
    assert all(place + width(text) / 2 <= WIDTH for place, text in ticks), "no text is cut at the edge"


@pytest.mark.parametrize("seed", range(40))
def test_labels_of_eight_methods_cover_neither_each_other_nor_the_edge(seed: int) -> None:
    """Drawn, not searched for the worst: eight points on top of each other leave no room for any placement."""
    rng = np.random.default_rng(seed)
    found = zip(10 ** rng.uniform(0.0, 3.5, len(TITLES)), rng.uniform(25.0, 29.0, len(TITLES)), strict=True)
    drawing = draw(_plot([_row(title, *one) for title, one in zip(TITLES, found, strict=True)]))
    boxes = [label.box for *_, label in drawing.marks]
    assert all(box.outside(FRAME) < 1e-6 for box in boxes)
    assert not [(one, other) for one, other in combinations(boxes, 2) if one.overlap(other) > 1.0]


def test_a_crowd_of_thirteen_is_still_readable() -> None:
    rows = [_row(f"w/o something {i}", 14.0 + 0.4 * (i * 7 % 13), 27.0 + 0.05 * (i * 5 % 13)) for i in range(13)]
    boxes = [label.box for *_, label in draw(_plot(rows)).marks]
    assert sum(one.overlap(other) for one, other in combinations(boxes, 2)) < 0.05 * sum(
        b.outside(FRAME) + 700 for b in boxes
    )


@pytest.mark.parametrize("title", (*TITLES, "Non-linear", "w/o visibility", "Mean predictor", "Linear consistency"))
def test_room_for_labels_is_that_of_a_real_font(title: str) -> None:
    text = title.replace("$", r"\$")
    real = TextPath((0, 0), text, size=SIZE, prop=FontProperties(family="DejaVu Sans")).get_extents().width
    assert 0.97 * real <= width(title) <= 1.5 * real + 3


@pytest.mark.parametrize(
    ("value", "text"),
    ((2.5e-4, "0.25 ms"), (0.02, "20 ms"), (0.9999, "1 s"), (1.5, "1.5 s"), (1234.0, "1234 s"), (52.26, "52.3 s")),
)
def test_times_are_read_at_a_glance(value: float, text: str) -> None:
    assert clock(value) == text


def test_figures_have_the_same_bytes_every_time_and_no_date(whole_run: Path) -> None:
    found = plots(table(whole_run))[:3]
    (name, once), (_, again) = (next(pareto_figures(found)) for _ in range(2))
    assert name == "pareto-psnr-known" and once == again
    assert once["png"].startswith(b"\x89PNG") and once["pdf"].startswith(b"%PDF")
    assert b"CreationDate" not in once["pdf"]


def test_the_page_draws_and_tells_them(whole_run: Path) -> None:
    page = write_reports(whole_run)["index.html"].read_text()
    assert page.count('<svg class="pareto"') == 27
    names = re.findall(r'aria-labelledby="(\S+) (\S+)"', page[page.index('<svg class="pareto"') :])
    assert all(f'id="{title}"' in page and f'id="{words}"' in page for title, words in names[:27])
    assert "Phong: 22 ms" in page and "Oracle: off the scale at 4 ms, 100.00 dB" in page


def test_corners_of_the_front_are_a_stair_that_never_gets_worse() -> None:
    drawing = draw(_plot([_row("a", 1.0, 20.0), _row("b", 10.0, 25.0), _row("c", 100.0, 30.0)]))
    assert drawing.front[-1][0] == FRAME.right
    for (x, y), (u, v) in pairwise(drawing.front):
        assert (x == u and v < y) or (y == v and u > x)


def test_points_keep_away_from_the_sides_of_the_plot() -> None:
    (_, left, _, _), (_, right, _, _) = draw(_plot([_row("A", 10.0, 20.0), _row("B", 100.0, 30.0)])).marks
    room = math.log10(1.35) / (1 + 2 * math.log10(1.35)) * (FRAME.right - FRAME.left)
    assert left == pytest.approx(FRAME.left + room) and right == pytest.approx(FRAME.right - room)
