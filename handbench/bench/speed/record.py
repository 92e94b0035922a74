"""The study on disk, and its names: reports read it without loading what it measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...files import whole, writing

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
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); run 'handbench speed' first") from error
    if found.get("schema") != SCHEMA:
        raise InputError(f"{path} has schema {found.get('schema')}, this version reads {SCHEMA}; measure again")
    return found
