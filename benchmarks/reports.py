"""Reports over many values: a made-up run folder of 100,000, its table, its differences to a baseline, a query."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from handbench.bench.store import Store
from handbench.results.measured import CellTimes, Laws, ScoredFrame, Spread
from handbench.results.origin import Hardware, Provenance
from handbench.results.record import (
    CaptureRecord,
    CellRecord,
    ColumnRecord,
    MethodRecord,
    MetricRecord,
    ProtocolRecord,
    RunRecord,
)

from .measure import Measurement, summary

METHODS, SUBJECTS, FRAMES = 10, 25, 20  # frames of a subject in a column
METRICS = ("psnr", "ssim", "lpips-alex", "lpips-vgg", "flip")
COLUMNS = ("unseen-segment", "unseen-subject", "unseen-light", "environment")
DEVICE = Hardware("made up", 2, 2, 8.0)
VALUES = METHODS * SUBJECTS * FRAMES * len(METRICS) * len(COLUMNS)

# The seconds and the peak memory in MB of a command, interpreter and imports included.
_MEASURE = """
import resource, subprocess, sys, time
start = time.perf_counter()
subprocess.run([sys.executable, "-m", "handbench.cli", *sys.argv[1:]], check=True, stdout=subprocess.DEVNULL)
print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)
"""


def reports() -> list[Measurement]:
    """Wall time and peak memory over 100,000 stored values, from the command to its last character."""
    with tempfile.TemporaryDirectory() as folder:
        run = write_run(Path(folder) / "run")
        commands = {
            "terminal table": ["report", str(run)],
            "LaTeX table": ["report", str(run), "--format", "latex"],
            "CSV table": ["report", str(run), "--format", "csv"],
            "table with differences": ["report", str(run), "--baseline", "method-0"],
            "gate": ["gate", str(run), "--baseline", str(run)],
            "query": ["query", str(run), "SELECT method, metric, avg(value) FROM scores GROUP BY ALL"],
        }
        found = []
        for name, command in commands.items():
            wall, peak = zip(*(_measured(command) for _ in range(3)), strict=True)
            found.append(summary(f"{name} of {VALUES:,} values", "s", wall, goal=5))
            found.append(summary(f"{name}, peak memory", "MB", peak, goal=1024))
        return found


def _measured(command: list[str]) -> tuple[float, float]:
    done = subprocess.run([sys.executable, "-c", _MEASURE, *command], check=True, capture_output=True, text=True)
    wall, peak = map(float, done.stdout.split())
    return wall, peak


def write_run(folder: Path, frames: int = FRAMES) -> Path:
    """A run folder as `handbench run` leaves it, with random values and no pictures."""
    generator, store = np.random.default_rng(0), Store(folder)
    infos = [_info(f"method-{i}", i == METHODS - 1) for i in range(METHODS)]
    keys = []
    for number, info in enumerate(infos):
        for subject in range(SUBJECTS):
            keys.append(f"{number:032x}{subject:032x}")
            values = generator.normal(30 + 0.3 * number + 0.1 * subject, 2, size=(len(COLUMNS), frames, len(METRICS)))
            store.write_cell(_cell(keys[-1], info, subject, values))
    store.write_run(_plan(infos, keys, frames))
    return folder


def _info(name: str, truth: bool) -> MethodRecord:
    return MethodRecord(name, name.title(), "made up", truth=truth, linear=True, preset="quick", config={})


def _signature(metric: str) -> str:
    return f"{metric}|region:mask|space:srgb|scale:none|mask:alpha>0.5|v1"


def _queries(subject: int, column: str, frames: int) -> list[str]:
    return [f"s{subject:02d}/pose-{i % 4}/camera-{i % 3}/{column}-{i}" for i in range(frames)]


def _cell(key: str, info: MethodRecord, subject: int, values: np.ndarray) -> CellRecord:
    scores = tuple(
        ScoredFrame(column, query, "olat", tuple(of_query))
        for column, of_column in zip(COLUMNS, values.tolist(), strict=True)
        for query, of_query in zip(_queries(subject, column, values.shape[1]), of_column, strict=True)
    )
    spread = Spread(4.0, 3.0, 6.0, 12, (4.0,) * 12)
    times = CellTimes(40.0, 0.2, {"olat": spread}, {"olat": spread}, score_s=3.0)
    about = {"device": DEVICE, "laws": Laws(linearity=1e-7), "same_pixels": True}
    return CellRecord(key, info, f"s{subject:02d}", 0, tuple(map(_signature, METRICS)), scores, times, **about)


def _plan(infos: list[MethodRecord], keys: list[str], frames: int) -> RunRecord:
    columns = tuple(
        ColumnRecord(name, name.capitalize(), tuple(q for s in range(SUBJECTS) for q in _queries(s, name, frames)))
        for name in COLUMNS
    )
    metrics = tuple(
        MetricRecord(name, name.upper(), _signature(name), not name.startswith(("lpips", "flip")), "", name.upper(), 2)
        for name in METRICS
    )
    protocol = ProtocolRecord("made-up", 1, "Made up", "d" * 64, columns, metrics)
    capture = CaptureRecord("made-up", "c" * 16, "large")
    return RunRecord(protocol, tuple(infos), (0,), capture, tuple(keys), Provenance("0", None, "", device=DEVICE))


def peek() -> None:
    """Print the measurements alone: `python -m benchmarks.reports`."""
    for each in reports():
        print(f"{each.name:<45} {each.median:8.2f} {each.unit}  ({each.least:.2f} to {each.most:.2f})")


if __name__ == "__main__":
    peek()
