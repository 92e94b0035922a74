"""Measure speed on this machine: `python -m benchmarks`; see README.md."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from handbench.bench.provenance import device

from .command_line import cached_run, start_up
from .measure import Measurement
from .metrics import scoring
from .poses import poses
from .shading import shading
from .urhand import urhand
from .whole import whole_run

RESULTS = Path(__file__).parent / "results.json"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Measure the speed of handbench.")
    parser.add_argument(
        "--size", default="quick", help="the openstage size that urhand is measured on (default: quick)"
    )
    parser.add_argument("--whole", action="store_true", help="also generate and run `quick` from nothing; many minutes")
    arguments = parser.parse_args()
    found = [*start_up(), *shading(), *scoring(), *urhand(arguments.size), *poses(arguments.size), *cached_run()]
    if arguments.whole:
        found += whole_run()
    content = {"device": asdict(device()), "measurements": [asdict(measurement) for measurement in found]}
    RESULTS.write_text(json.dumps(content, indent=1) + "\n")
    Console().print(_table(found))
    print(f"written to {RESULTS}")


def _table(found: list[Measurement]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("what")
    for title in ("median", "min", "max", "goal"):
        table.add_column(title, justify="right")
    for m in found:
        colour = "default" if m.goal is None else "green" if m.median <= m.goal else "red"
        goal = "" if m.goal is None else f"≤ {m.goal:g} {m.unit}"
        median = f"[{colour}]{m.median:.3g} {m.unit}[/]"
        table.add_row(m.name, median, f"{m.least:.3g}", f"{m.most:.3g}", goal)
    return table


main()
