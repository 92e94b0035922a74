"""What a run's cells say they skipped, on the page."""

from __future__ import annotations

import json
from pathlib import Path

from handbench.reports import write_reports


def test_the_page_says_what_was_skipped(small_run: Path) -> None:
    """Summed over a method's cells; cells of older runs say nothing, and nothing is shown of them."""
    cells = [path for path in (small_run / "cells").glob("*.json") if '"name": "urhand"' in path.read_text()]
    write_reports(small_run)
    assert "What was skipped" not in (small_run / "report" / "index.html").read_text()
    for path in cells:
        cell = json.loads(path.read_text())
        cell["skipped"] = {
            "shadow rays": {"total": 3_000_000, "skipped": 2_130_000},
            "lobes": {"total": 10, "skipped": 0},
        }
        path.write_text(json.dumps(cell))
    write_reports(small_run)
    page = (small_run / "report" / "index.html").read_text()
    total = 3 * len(cells)
    assert f"shadow rays 71 % of {total:.1f} million" in page or f"shadow rays 71 % of {total} million" in page
    assert "lobes 0" not in page
