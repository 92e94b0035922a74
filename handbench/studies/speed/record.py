"""The study on disk, and its names: reports read it without loading what it measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...files import read_json, whole, writing

SCHEMA = 1
RESULT = "speed.json"
MITSUBA = {"default": "Mitsuba direct", "tuned": "Mitsuba direct, tuned"}


def write(folder: Path, found: dict[str, Any]) -> Path:
    """`speed.json` in the folder, whole or not at all. Raises `StorageError` if it cannot be written."""
    path = folder / RESULT
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with whole(path) as part:
            part.write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


def read(folder: Path) -> dict[str, Any]:
    """What `write` wrote. Raises `InputError` where there is none or another version wrote it."""
    path = folder / RESULT
    found: dict[str, Any] = read_json(path, what="speed study")
    schema = found.get("schema") if isinstance(found, dict) else None
    if schema != SCHEMA:
        raise InputError(f"{path} has schema {schema}, this version reads {SCHEMA}; measure again")
    return found
