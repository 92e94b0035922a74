"""Figures that are asked for: the frame, the methods, the place and the size that were named."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handbench.errors import InputError
from handbench.reports.drawn import Figures, chosen, write_figures
from handbench.reports.figures import detail, panels
from handbench.reports.pictures import Sheet, _Grid, grid
from handbench.reports.run import read_run
from handbench.reports.selection import ReportFilter

FRAME = "s02/open/dorsal/group-03"


def test_a_frame_is_drawn_by_its_name_as_wide_as_it_is_asked_for(whole_run, tmp_path):
    paths = list(write_figures(whole_run, ReportFilter(methods=("urhand",)), Figures((FRAME,), 3.3, 100), tmp_path))
    assert [path.name for path in paths] == ["frames.png", "frames.pdf"]
    with Image.open(paths[0]) as picture:
        assert abs(picture.width - 330) <= 1
    assert b"/MediaBox [ 0 0 237" in paths[1].read_bytes(), "3.3 inches are 237.6 points"


def test_a_pattern_is_every_frame_that_fits(whole_run):
    run = read_run(whole_run)
    assert chosen(run, ["s02/open/*/group-*"]) == [
        f"s02/open/{camera}/group-0{light}" for camera in ("dorsal", "palmar") for light in (3, 7)
    ]
    with pytest.raises(InputError, match="unknown frame 's09/open/dorsal/group-03'; did you mean 's0"):
        chosen(run, ["s09/open/dorsal/group-03"])
    with pytest.raises(InputError, match="72 frames fit --frame, a figure shows 12 at most"):
        chosen(run, ["*"])


def test_a_detail_is_where_it_was_asked_for_in_the_recorded_picture(whole_run):
    run = read_run(whole_run)
    (usual,) = panels(run, [FRAME])
    (asked,) = panels(run, [FRAME], (20, 30, 9))
    rows, columns = detail(asked)
    assert (rows.stop - rows.start, columns.stop - columns.start) == (9, 9) and detail(usual) != (rows, columns)
    (moved,) = panels(run, [FRAME], (23, 31, 9))
    assert (detail(moved)[0].start - rows.start, detail(moved)[1].start - columns.start) == (1, 3)
    (outside,) = panels(run, [FRAME], (5000, 5000, 9))
    assert detail(outside)[0].stop == outside.truth.shape[0], "it is moved into the picture"


def test_fifteen_methods_go_on_below(whole_run):
    (panel,) = panels(read_run(whole_run), [FRAME])
    many = type(panel)(panel.query, panel.kind, panel.exposure, panel.truth, panel.tiles[:1] * 15)
    layout = _Grid.of(16, Sheet(width=3.3))
    assert layout.line == 4 and layout.tile >= 0.62 and len(layout.strips(many)) == 4
    assert sum(map(len, layout.strips(many))) == 16
    assert _Grid.of(16, Sheet()).line == 8


def test_without_a_detail_a_figure_is_lower(whole_run):
    shown = tuple(panels(read_run(whole_run), [FRAME]))
    heights = []
    for wanted in (Sheet(dpi=40), Sheet(dpi=40, detail=False)):
        with Image.open(io.BytesIO(grid(shown, _metric(whole_run), wanted)["png"])) as picture:
            heights.append(np.asarray(picture).shape[0])
    assert heights[1] < heights[0] - 30


def test_a_figure_that_no_memory_holds_is_refused(whole_run):
    shown = tuple(panels(read_run(whole_run), [FRAME]))
    for wanted in (Sheet(dpi=100_000_000), Sheet(width=60.0, dpi=2400)):
        with pytest.raises(InputError, match=r"a figure of [\d,]+x[\d,]+ pixels is too large to draw; give a smaller"):
            grid(shown, _metric(whole_run), wanted)


def test_a_run_without_the_truth_is_told(run_folder: Path, tmp_path):
    for path in (run_folder / "cells").glob("*.json"):
        if '"oracle"' in path.read_text():
            path.unlink()
    with pytest.raises(InputError, match="keeps no truth of these frames; run it with the method oracle"):
        list(write_figures(run_folder, ReportFilter(), Figures((FRAME,)), tmp_path / "out"))


def _metric(run: Path):
    from handbench.reports import table

    return table(run).metrics[0]
