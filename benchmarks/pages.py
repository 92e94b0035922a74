"""The page of a run of many methods: how large it is, how long it takes to make, and to open in a browser.

The methods of a run stand in for more: each copy has its pictures, and scores and times that are a little others.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handbench.bench.store import Store
from handbench.reports import write_reports
from handbench.results.reading import Run, read_run
from handbench.results.record import CellRecord

from .measure import Measurement, summary

_LOADED = "performance.getEntriesByType('navigation')[0].loadEventEnd"
# Milliseconds until the whole overview is in a picture: the frame after the one that finds what comes after it.
_WATCH = """
const look = () => {
  const row = document.querySelector(".overview tbody tr:last-child") && document.querySelector(".blocks");
  if (row) requestAnimationFrame(() => { window.seen = performance.now(); });
  else requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_SEEN, _OPENED = 0.3, 1.5  # goals in seconds
_SMALL, _LARGE = 6.0, 15.0  # goals in MB: of a run as it is, of many methods


def crowd(run: Run, folder: Path, count: int) -> Path:
    """A run folder of `count` methods: those of a run, then copies of the ones that are no calibration rows."""
    store = Store(folder)
    store.prepare()
    measured = [method for method in run.plan.methods if not method.calibration]
    methods, keys = list(run.plan.methods), []
    sources = {method.name: method.name for method in methods}
    while len(methods) < count:
        number = len(methods)
        source = measured[number % len(measured)]
        name = f"{source.name}-{number}"
        methods.append(replace(source, name=name, title=f"{source.title} without part {number}"))
        sources[name] = source.name
    for number, method in enumerate(methods):
        for cell in run.of_method(sources[method.name]):
            copied = cell.key if method.name == sources[method.name] else f"{method.name}-{cell.key}"[:64]
            keys.append(copied)
            store.write_cell(_changed(replace(cell, key=copied, method=method), number))
            for query in cell.predictions:
                target = store.picture(copied, query)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.link(run.store.picture(cell.key, query), target)
    store.write_run(replace(run.plan, methods=tuple(methods), cells=tuple(keys)))
    return folder


def _changed(cell: CellRecord, number: int) -> CellRecord:
    """A cell with scores, times and memory of its own."""
    generator = np.random.default_rng((number, len(cell.scores)))
    shift, factor = generator.normal(0, 0.03), float(np.exp(generator.normal(0, 1)))

    def other(value: float | None) -> float | None:
        return (
            value if value is None or cell.method.calibration else value * float(1 + shift + generator.normal(0, 0.01))
        )

    scores = tuple(replace(frame, values=tuple(map(other, frame.values))) for frame in cell.scores)
    known, new = (
        {kind: replace(each, median=each.median * factor) for kind, each in told.items()}
        for told in (cell.times.known_pose_ms, cell.times.new_pose_ms)
    )
    cost = replace(cell.cost, peak_mb=cell.cost.peak_mb or 400 + 100 * factor)
    return replace(cell, scores=scores, times=replace(cell.times, known_pose_ms=known, new_pose_ms=new), cost=cost)


def opened(page_path: Path, repeats: int = 5) -> list[Measurement]:
    """Seconds in Chromium until the overview of a page is seen, until it is loaded, and of all its processes' CPU."""
    from playwright.sync_api import sync_playwright

    found: dict[str, list[float]] = {"seen": [], "loaded": [], "cpu": []}
    program = next(path for name in _BROWSERS if (path := shutil.which(name)))
    with sync_playwright() as playwright:
        browser: Any = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        session = browser.new_browser_cdp_session()

        def used() -> float:
            return sum(process["cpuTime"] for process in session.send("SystemInfo.getProcessInfo")["processInfo"])

        for _ in range(repeats + 1):
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            page.add_init_script(_WATCH)
            before = used()
            page.goto(page_path.resolve().as_uri())
            page.wait_for_function(f"{_LOADED} > 0 && window.seen")
            found["cpu"].append(used() - before)
            found["seen"].append(page.evaluate("window.seen") / 1e3)
            found["loaded"].append(page.evaluate(_LOADED) / 1e3)
            page.close()
        browser.close()
    seen, loaded, cpu = (values[1:] for values in found.values())  # the browser itself is cold in the first
    return [
        summary("table seen", "s", seen, _SEEN),
        summary("loaded", "s", loaded, _OPENED),
        summary("CPU of the browser", "s", cpu),
    ]


def measured(run_folder: Path, goal: float) -> list[Measurement]:
    """A run's page: CPU seconds to make it, its size, and how it opens."""
    start = time.process_time()
    page = write_reports(run_folder)["index.html"]
    made = time.process_time() - start
    size = summary("size", "MB", [page.stat().st_size / 1e6], goal)
    return [summary("CPU to make", "s", [made]), size, *opened(page)]


def peek() -> None:
    """Print the measurements alone: `python -m benchmarks.pages runs/quick`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pages", description=__doc__)
    parser.add_argument("run", type=Path, help="the folder of a run with pictures")
    parser.add_argument("--methods", type=int, default=15, help="how many the second page has (default: 15)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the larger run and its page there")
    arguments = parser.parse_args()
    run = read_run(arguments.run)
    with tempfile.TemporaryDirectory(dir=arguments.run.resolve().parent) as temporary:
        own = crowd(run, Path(temporary) / "own", 0)
        many = crowd(run, arguments.keep or Path(temporary) / "many", arguments.methods)
        for title, folder, goal in ((f"{len(run.plan.methods)} methods", own, _SMALL), ("many methods", many, _LARGE)):
            for m in measured(folder, goal):
                within = "" if m.goal is None else f"   (goal: ≤ {m.goal:g})"
                print(f"{title}: {m.name:<20} {m.median:8.2f} {m.unit} ({m.least:.2f} to {m.most:.2f}){within}")


if __name__ == "__main__":
    peek()
