"""Reports over many values: a made-up run folder of 100,000, its table, its differences to a baseline, a query."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .measure import Measurement, summary

METHODS, SUBJECTS, FRAMES = 10, 25, 20  # frames of a subject in a column
METRICS = ("psnr", "ssim", "lpips-alex", "lpips-vgg", "flip")
COLUMNS = ("unseen-segment", "unseen-subject", "unseen-light", "environment")
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


def write_run(folder: Path) -> Path:
    """A run folder as `handbench run` leaves it, with random values and no pictures."""
    generator = np.random.default_rng(0)
    (folder / "cells").mkdir(parents=True)
    infos = [_info(f"method-{i}", i == METHODS - 1) for i in range(METHODS)]
    keys = []
    for number, info in enumerate(infos):
        for subject in range(SUBJECTS):
            key = f"{number:032x}{subject:032x}"
            keys.append(key)
            values = generator.normal(30 + 0.3 * number + 0.1 * subject, 2, size=VALUES // METHODS // SUBJECTS)
            cell = {"schema": 1, "key": key, "method": info, **_cell(subject, values)}
            (folder / "cells" / f"{key}.json").write_text(json.dumps(cell, indent=1))
    (folder / "run.json").write_text(json.dumps(_plan(infos, keys), indent=1))
    return folder


def _info(name: str, truth: bool) -> dict[str, Any]:
    told = {"name": name, "title": name.title(), "summary": "made up", "fidelity": "made up", "truth": truth}
    return {**told, "universal": True, "linear": True, "lights": ["directional"], "preset": "quick", "config": {}}


def _signature(metric: str) -> str:
    return f"{metric}|region:mask|space:srgb|scale:none|mask:alpha>0.5|v1"


def _queries(subject: int, column: str) -> list[str]:
    return [f"s{subject:02d}/pose-{i % 4}/camera-{i % 3}/{column}-{i}" for i in range(FRAMES)]


def _cell(subject: int, values: np.ndarray) -> dict[str, Any]:
    places = [(c, q, m) for c in COLUMNS for q in _queries(subject, c) for m in METRICS]
    scores = [
        {"column": c, "query": q, "kind": "olat", "metric": _signature(m), "value": value, "reason": None}
        for (c, q, m), value in zip(places, values.tolist(), strict=True)
    ]
    spread = {"median": 4.0, "min": 3.0, "max": 6.0, "n": 12, "values": [4.0] * 12}
    times = {
        "train_s": 40.0,
        "personalise_s": 0.2,
        "new_pose_ms": {"olat": spread},
        "known_pose_ms": {"olat": spread},
        "score_s": 3.0,
    }
    device = {"cpu": "made up", "cores": 2, "threads": 2, "memory_gb": 8.0, "gpus": [], "networks": "cpu"}
    about = {"subject": f"s{subject:02d}", "seed": 0, "device": device, "laws": {"linearity": 1e-7}}
    return {**about, "times": times, "same_pixels": True, "predictions": None, "error": None, "scores": scores}


def _plan(infos: list[dict[str, Any]], keys: list[str]) -> dict[str, Any]:
    columns = [
        {"name": c, "title": c.capitalize(), "queries": [q for s in range(SUBJECTS) for q in _queries(s, c)]}
        for c in COLUMNS
    ]
    kinds = [(name, not name.startswith(("lpips", "flip"))) for name in METRICS]
    metrics = [
        {"name": n, "title": n.upper(), "signature": _signature(n), "higher_is_better": h, "unit": "", "decimals": 2}
        for n, h in kinds
    ]
    protocol = {"name": "made-up", "version": 1, "title": "Made up", "digest": "d" * 64, "columns": columns}
    return {
        "schema": 1,
        "protocol": {**protocol, "metrics": [{**metric, "latex": metric["title"]} for metric in metrics]},
        "methods": infos,
        "seeds": [0],
        "capture": {"name": "made-up", "size": "large", "digest": "c" * 16},
        "cells": keys,
        "provenance": {"version": "0", "git": None, "device": {}, "command": "", "started": ""},
    }


def peek() -> None:
    """Print the measurements alone: `python -m benchmarks.reports`."""
    for each in reports():
        print(f"{each.name:<45} {each.median:8.2f} {each.unit}  ({each.least:.2f} to {each.most:.2f})")


if __name__ == "__main__":
    peek()
