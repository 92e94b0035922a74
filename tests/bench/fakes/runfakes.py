"""Run folders as `handbench run` leaves them, with values of a test's choice."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

# (method, metric, subject, seed, frame) to a value, or to a reason why there is none.
Value: TypeAlias = Callable[[str, str, int, int, int], float | str]

METRICS = (("psnr", True, "dB", 2), ("lpips", False, "", 4))
COLUMNS = ("light", "pose")
CPU = {"cpu": "Example CPU", "cores": 2, "threads": 2, "memory_gb": 8.0, "gpus": [], "networks": "cpu"}


def plain(method: str, metric: str, subject: int, seed: int, frame: int) -> float:
    """30 dB and 0.1, a little more with each subject and frame."""
    return {"psnr": 30.0, "lpips": 0.1}[metric] * (1 + 0.01 * subject + 0.001 * frame)


def write_run(
    folder: Path,
    value: Value = plain,
    methods: Sequence[str] = ("oracle", "good", "fair"),
    subjects: int = 6,
    frames: int = 8,
    seeds: Sequence[int] = (0,),
    salt: Mapping[str, str] = MappingProxyType({}),
    **changes: Any,
) -> Path:
    """Write a run. `salt` changes the keys of a method's cells; `changes`: version, digest, capture, device, relight.

    `relight`: (method) to the repeats of a known pose in milliseconds.
    """
    (folder / "cells").mkdir(parents=True)
    infos = [
        {
            "name": name,
            "title": name.title(),
            "fidelity": "calibration: truth" if name == "oracle" else "for tests",
            "truth": name == "oracle",
            "universal": True,
            "linear": False,
            "preset": "quick",
            "config": {"texture": 64},
        }
        for name in methods
    ]
    keys = []
    for info in infos:
        for seed in seeds:
            for subject in range(subjects):
                key = hashlib.sha256(f"{info['name']} {subject} {seed} {salt.get(info['name'])}".encode()).hexdigest()
                keys.append(key)
                cell = _cell(info, subject, seed, frames, value, changes)
                (folder / "cells" / f"{key}.json").write_text(json.dumps({"schema": 1, "key": key, **cell}))
    plan = _plan(infos, seeds, subjects, frames, keys, changes)
    (folder / "run.json").write_text(json.dumps(plan))
    return folder


def _query(subject: int, column: str, frame: int) -> str:
    return f"s{subject:02d}/{column}-{frame}/dorsal/olat-1"


def _signature(metric: str) -> str:
    return f"{metric}|region:mask|v1"


def _cell(
    info: dict[str, Any], subject: int, seed: int, frames: int, value: Value, changes: dict[str, Any]
) -> dict[str, Any]:
    scores = []
    for column in COLUMNS:
        for frame in range(frames):
            for metric, *_ in METRICS:
                found = value(info["name"], metric, subject, seed, frame)
                score = {"column": column, "query": _query(subject, column, frame), "kind": "olat"}
                told = (None, found) if isinstance(found, str) else (found, None)
                scores.append({**score, "metric": _signature(metric), "value": told[0], "reason": told[1]})
    repeats = changes.get("relight", lambda name: [4.0, 4.1, 4.2, 4.3])(info["name"])
    spread = {"median": sorted(repeats)[len(repeats) // 2], "min": min(repeats), "max": max(repeats)}
    spread |= {"n": len(repeats), "values": repeats}
    times = {
        "train_s": 10.0,
        "personalise_s": 1.0,
        "new_pose_ms": {"olat": spread},
        "known_pose_ms": {"olat": spread},
        "score_s": 1.0,
    }
    return {
        "method": info,
        "subject": f"s{subject:02d}",
        "seed": seed,
        "device": changes.get("device", CPU),
        "times": times,
        "laws": {"linearity": 1e-7},
        "same_pixels": True,
        "error": None,
        "scores": scores,
    }


def _plan(
    infos: list[dict[str, Any]],
    seeds: Sequence[int],
    subjects: int,
    frames: int,
    keys: list[str],
    changes: dict[str, Any],
) -> dict[str, Any]:
    columns = [
        {
            "name": column,
            "title": f"Unseen {column}",
            "queries": [_query(subject, column, frame) for subject in range(subjects) for frame in range(frames)],
        }
        for column in COLUMNS
    ]
    metrics = [
        {
            "name": name,
            "title": name.upper(),
            "signature": _signature(name),
            "higher_is_better": higher,
            "unit": unit,
            "latex": name.upper(),
            "decimals": decimals,
        }
        for name, higher, unit, decimals in METRICS
    ]
    return {
        "schema": 1,
        "protocol": {
            "name": "toy",
            "version": changes.get("version", 1),
            "title": "Toy",
            "digest": changes.get("digest", "d" * 64),
            "columns": columns,
            "metrics": metrics,
        },
        "methods": infos,
        "seeds": list(seeds),
        "capture": {"name": "openstage", "size": "tiny", "digest": changes.get("capture", "c" * 16)},
        "cells": keys,
        "provenance": {
            "version": "0.1.0",
            "git": {"commit": "0" * 40, "dirty": False},
            "device": CPU,
            "command": "handbench run toy",
            "started": "2026-01-02T03:04:05+00:00",
        },
    }
