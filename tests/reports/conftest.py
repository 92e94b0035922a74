"""A run folder as `handbench run` leaves it, made up: five methods, three subjects, three columns, small images."""

from __future__ import annotations

import json
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends import _backend_pdf_ps
from matplotlib.font_manager import get_font

from handbench.bench.store import Store
from handbench.data.exr import rgb, write_exr
from handbench.reports.build import build
from handbench.reports.figures import panels
from handbench.reports.page import PageContent, render_page
from handbench.reports.pareto import plots
from handbench.reports.run import Run, read_run
from handbench.reports.viewer import viewer
from handbench.results.measured import CellTimes, ScoredFrame, Spread
from handbench.results.origin import Git, Provenance
from handbench.results.record import (
    CaptureRecord,
    CellRecord,
    ColumnRecord,
    MethodRecord,
    MetricRecord,
    ProtocolRecord,
    RunRecord,
)

SIZE = 72
COLUMNS = (
    ("unseen-segment", "Unseen segment", "group"),
    ("unseen-light", "Unseen light", "olat"),
    ("environment", "Environment", "environment"),
)
METRICS = (
    ("psnr", "PSNR", "psnr|region:mask|space:srgb|scale:none|mask:alpha>0.5|peak:1|cap:100|v1", True, "dB", 2),
    ("ssim", "SSIM", "ssim|region:mask|space:srgb|scale:none|mask:alpha>0.5|window:gauss11|v1", True, "", 3),
    ("lpips-alex", "LPIPS (Alex)", "lpips-alex|region:box|space:srgb|scale:none|mask:alpha>0.5|v1", False, "", 3),
)
METHODS = (
    # name, title, fidelity, truth, quality
    ("oracle", "Oracle", "calibration: the truth fed back", True, 1.0),
    ("mean", "Mean", "calibration: mean texture under mean light", False, 0.2),
    ("phong", "Phong", "classical baseline, fitted here", False, 0.45),
    ("physical", "Physical_BRDF & fit", "the physical branch alone, fitted here", False, 0.55),
    ("urhand", "URHand", "faithful reimplementation, trained here", False, 0.9),
)
FOUR = (
    ("psnr", "PSNR", True, "dB", 2),
    ("ssim", "SSIM", True, "", 4),
    ("lpips-alex", "LPIPS (Alex)", False, "", 4),
    ("lpips-vgg", "LPIPS (VGG)", False, "", 4),
)
SUBJECTS = ("s01", "s02", "s03")
POSES = ("fist", "open")


def _signature(name: str) -> str:
    return next(metric[2] for metric in METRICS if metric[0] == name)


def _hand(seed: int, light: np.ndarray, tone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A shaded bump shaped like a palm with fingers: image (SIZE, 3/4 SIZE, 3) and alpha."""
    rng = np.random.default_rng(seed)
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    height = np.clip(0.08 - (x - 0.5) ** 2 - (y - 0.68) ** 2 * 0.7, 0, None)
    for finger in range(5):
        lean = (finger - 2) * 0.16 + rng.normal(0, 0.02)
        axis = x - 0.5 - lean * (1.15 - y)
        height = np.maximum(height, np.clip(0.0016 - axis**2, 0, None) * 30 * (y > 0.12 + 0.1 * abs(lean)) * (y < 0.7))
    slope_y, slope_x = np.gradient(np.sqrt(height) * SIZE * 0.5)
    normal = np.stack([-slope_x, slope_y, np.ones_like(slope_x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    shade = np.clip(normal @ light, 0, None) + 0.05
    alpha = (height > 0).astype(np.float32)
    image = (shade[..., None] * tone * alpha[..., None]).astype(np.float32)
    edge = SIZE // 8
    return image[:, edge:-edge], alpha[:, edge:-edge]


def _light(name: str) -> np.ndarray:
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    light = rng.normal(loc=(0, 0, 1.5))
    return light / np.linalg.norm(light)


def _queries(subject: str) -> list[tuple[str, str, str]]:
    """(column, kind, query) of a subject."""
    return [
        (column, kind, f"{subject}/{pose}/{camera}/{kind}-{index:02d}")
        for column, _, kind in COLUMNS
        for pose in POSES
        for camera in ("dorsal", "palmar")
        for index in (3, 7)
    ]


def make_run(folder: Path, methods: tuple[str, ...] = tuple(m[0] for m in METHODS)) -> Path:
    """Write the run; phong diverges on one frame and has no cell of the last subject."""
    infos, keys = [], []
    for number, (name, title, fidelity, truth, quality) in enumerate(m for m in METHODS if m[0] in methods):
        infos.append({"name": name, "title": title, "fidelity": fidelity, "truth": truth})
        for subject in SUBJECTS:
            key = f"{zlib.crc32(f'{name}{subject}'.encode()):08x}"
            keys.append(key)
            if (name, subject) != ("phong", "s03"):
                _write_cell(folder, key, infos[-1], subject, number, quality)
    plan = {
        "schema": 1,
        "protocol": {
            "name": "quick",
            "version": 1,
            "title": "Quick comparison on the open light stage",
            "digest": "5d" * 32,
            "columns": [
                {
                    "name": name,
                    "title": title,
                    "queries": [query for s in SUBJECTS for column, _, query in _queries(s) if column == name],
                }
                for name, title, _ in COLUMNS
            ],
            "metrics": [
                {
                    "name": name,
                    "title": title,
                    "signature": signature,
                    "higher_is_better": higher,
                    "latex": f"{title}$\\{'up' if higher else 'down'}arrow$",
                    "unit": unit,
                    "decimals": decimals,
                }
                for name, title, signature, higher, unit, decimals in METRICS
            ],
        },
        "methods": infos,
        "seeds": [0],
        "capture": {"name": "openstage-quick", "digest": "c4" * 8},
        "cells": keys,
        "provenance": {
            "version": "0.1.0",
            "git": {"commit": "0123456789abcdef0123456789abcdef01234567", "dirty": True},
            "python": "3.11.7",
            "packages": {"numpy": "2.4.6", "torch": "2.13.0", "mitsuba": "3.9.1", "scipy": "1.17.1"},
            "os": "Linux-6.1-x86_64",
            "device": {"cpu": "Example CPU 9000", "cores": 2, "threads": 2, "memory_gb": 23.4, "gpus": []},
            "command": "handbench run quick",
            "started": "2026-01-02T03:04:05+00:00",
        },
    }
    (folder / "run.json").write_text(json.dumps(plan))
    return folder


def _write_cell(folder: Path, key: str, info: dict[str, Any], subject: str, number: int, quality: float) -> None:
    place = folder / "predictions" / key
    place.mkdir(parents=True)
    rng = np.random.default_rng(zlib.crc32(key.encode()))
    tone = {
        "s01": np.array([0.8, 0.58, 0.45]),
        "s02": np.array([0.25, 0.15, 0.1]),
        "s03": np.array([0.55, 0.36, 0.26]),
    }[subject]
    scores = []
    for column, kind, query in _queries(subject):
        diverged = info["name"] == "phong" and query == "s01/fist/dorsal/olat-03"
        light = _light(query)
        seed = zlib.crc32("/".join(query.split("/")[:2]).encode())
        image, alpha = _hand(seed, quality * light + (1 - quality) * np.array([0, 0, 1.0]), tone)
        if not diverged:
            path = place / f"{query.replace('/', '__')}.exr"
            write_exr(path, {**rgb(image), "A": alpha.astype(np.float16)})
        for name, _, signature, _, _, _ in METRICS:
            spread = rng.normal()
            value = {"psnr": 20 + 15 * quality + spread, "ssim": 0.8 + 0.18 * quality + 0.01 * spread}.get(
                name, 0.2 * (1.05 - quality) + 0.002 * spread
            )
            if info["truth"]:
                value = {"psnr": 100.0, "ssim": 1.0}.get(name, 0.0)
            bad = "non-finite: 3 pixels of the answer are NaN" if diverged else None
            scores.append(
                {
                    "column": column,
                    "query": query,
                    "kind": kind,
                    "metric": signature,
                    "value": None if bad else value,
                    "reason": bad,
                }
            )
    relight = {"median": 4.0 + 9 * number, "min": 3.5 + 9 * number, "max": 6.1 + 11 * number, "n": 24}
    first = {"median": 31.0 + 9 * number, "min": 30.5, "max": 51.1 + 11 * number, "n": 24}
    cell = {
        "schema": 1,
        "key": key,
        "method": {**info, "config": {}, "linear": False, "universal": True},
        "subject": subject,
        "seed": 0,
        "scores": scores,
        "times": {
            "train_s": 41.3 * number,
            "personalise_s": 0.21 + number,
            "new_pose_ms": {"group": first},
            "known_pose_ms": {"group": relight},
            "score_s": 3.0,
        },
        "predictions": f"predictions/{key}",
        "same_pixels": True,
    }
    (folder / "cells").mkdir(exist_ok=True)
    (folder / "cells" / f"{key}.json").write_text(json.dumps(cell))


@pytest.fixture(autouse=True, scope="session")
def letters_once() -> Iterator[None]:
    """Half the time of a figure goes into cutting its letters out of the font for the PDF: all of Latin-1 once only."""
    cut, write = _backend_pdf_ps.get_glyphs_subset, _backend_pdf_ps.font_as_file

    @cache
    def part(font: Any, letters: frozenset[int]) -> Any:
        return cut(font, letters).__enter__()

    @cache
    def usual(font: Any) -> frozenset[int]:
        return frozenset(get_font(font).get_char_index(code) for code in (*range(32, 127), *range(160, 256)))

    def enough(font: Any, letters: Iterable[int]) -> Any:
        wanted = frozenset(letters)
        return nullcontext(part(font, usual(font) if wanted <= usual(font) else wanted))

    @cache
    def written(part: Any) -> bytes:
        return write(part).getvalue()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_backend_pdf_ps, "get_glyphs_subset", enough)
        patch.setattr(_backend_pdf_ps, "font_as_file", lambda part: BytesIO(written(part)))
        yield


@pytest.fixture(scope="session")
def whole_run(untouched: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that tests may read and report on, not change."""
    return Path(shutil.copytree(untouched, tmp_path_factory.mktemp("run"), dirs_exist_ok=True))


@pytest.fixture(scope="session")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run as it was made: no test gets it, they get copies."""
    return make_run(tmp_path_factory.mktemp("untouched"))


@pytest.fixture(scope="session")
def small_untouched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With two methods, whose pictures are made faster."""
    return make_run(tmp_path_factory.mktemp("small"), ("oracle", "urhand"))


@pytest.fixture
def run_folder(untouched: Path, tmp_path: Path) -> Path:
    """A run of a test's own."""
    return Path(shutil.copytree(untouched, tmp_path, dirs_exist_ok=True))


@pytest.fixture
def small_run(small_untouched: Path, tmp_path: Path) -> Path:
    """A run of a test's own with two methods."""
    return Path(shutil.copytree(small_untouched, tmp_path, dirs_exist_ok=True))


@pytest.fixture
def set_scores() -> Callable[..., None]:
    """A function that sets scores in every cell of a method: `set_scores(run, "urhand", psnr=60.0)`."""

    def set_scores(run: Path, method: str, **values: float) -> None:
        for path in (run / "cells").glob("*.json"):
            cell = json.loads(path.read_text())
            if cell["method"]["name"] == method:
                for score in cell["scores"]:
                    score["value"] = values.get(score["metric"].split("|")[0], score["value"])
                path.write_text(json.dumps(cell))

    return set_scores


@pytest.fixture(scope="session")
def many(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of 15 methods in six columns of four metrics, two seeds, without pictures; three methods share a title."""
    names = [f"method-{number}" for number in range(15)]
    metrics = [
        MetricRecord(name, title, f"{name}|v1", up, unit, name, decimals) for name, title, up, unit, decimals in FOUR
    ]
    queries = [f"s{s:02d}/pose-{p}/dorsal/group-{i}" for s in range(6) for p in range(2) for i in range(2)]
    columns = [ColumnRecord(f"c{i}", f"Unseen thing {i}", tuple(queries), "unseen", ("light",)) for i in range(6)]
    protocol = ProtocolRecord("wide", 1, "A wide comparison", "ab" * 32, tuple(columns), tuple(metrics))
    methods, cells = [], []
    for number, name in enumerate(names):
        title = f"w/o part {number}" if number % 5 else "The full model"
        method = MethodRecord(name, title, fidelity="faithful reimplementation", enrolment="fully lit views")
        methods.append(method)
        for seed in (0, 1):
            rng = np.random.default_rng((number, seed))
            for subject in range(6):
                mine = [query for query in queries if query.startswith(f"s{subject:02d}/")]
                scores = [
                    ScoredFrame(column.name, query, "group", tuple(_four(number, rng.normal())))
                    for column in columns
                    for query in mine
                ]
                spread = Spread(10.0 + number, 9.0, 30.0, 4)
                times = CellTimes(60.0 * number, 2.0, {"group": spread}, {"group": spread})
                key = f"{name}-{subject}-{seed}"
                signatures = tuple(metric.signature for metric in metrics)
                cells.append(CellRecord(key, method, f"s{subject:02d}", seed, signatures, tuple(scores), times))
    origin = Provenance("0.1.0", Git("0" * 40, False), "handbench run wide")
    capture, keys = CaptureRecord("openstage", "c4" * 8), tuple(cell.key for cell in cells)
    plan = RunRecord(protocol, tuple(methods), (0, 1), capture, keys, origin)
    store = Store(tmp_path_factory.mktemp("wide"))
    store.write_run(plan)
    for cell in cells:
        store.write_cell(cell)
    return read_run(store.folder)


def _four(number: int, noise: float) -> list[float]:
    return [20 + number + noise, 0.8 + 0.01 * number, 0.2 - 0.01 * number + 0.001 * noise, 0.3 - 0.01 * number]


@pytest.fixture(scope="session")
def page_of() -> Callable[[Path | Run], str]:
    """A function that gives the page of a run as text, without writing it or making the figures beside it."""

    def page_of(given: Path | Run) -> str:
        run = given if isinstance(given, Run) else read_run(given)
        rows = build(run)
        return render_page(rows, run, PageContent(tuple(panels(run)), (), plots(rows), viewer(run, rows)))

    return page_of
