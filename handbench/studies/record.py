"""What studies leave, as files: JSON sealed by a digest, read whole and checked, or refused in one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ..errors import InputError
from ..files import read_json, whole, writing
from ..results.recordfile import sealed
from ..results.schema import Misfit, plain, read

SCHEMA = 2
"""The version of the format. 1 had no digest."""

_Record = TypeVar("_Record")


def write_study(path: Path, record: Any) -> Path:
    """Write a record, whole or not at all; its folder is made. Raises `StorageError` if that cannot be."""
    with writing(path.parent, "give another --out"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as part:
            told = {**plain(record), "schema": SCHEMA}
            part.write_text(json.dumps(sealed(told), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


def read_study(
    kind: type[_Record], path: Path, verb: str, older: Callable[[dict[str, Any]], dict[str, Any]] = dict
) -> _Record:
    """The record in a file; `older` brings one of version 1 to today's form, `verb` is what measures it again.

    Raises `InputError` for a file that is no such record, naming the field, and for a newer version's.
    """
    content = read_json(path, what=f"{verb} study")
    schema = content.get("schema") if isinstance(content, dict) else None
    if type(schema) is not int or not 1 <= schema <= SCHEMA:
        raise InputError(f"{path} has schema {schema!r:.40}, this version reads {SCHEMA}; run 'handbench {verb}' again")
    try:
        if schema == SCHEMA and content.get("digest") != sealed(content)["digest"]:
            raise Misfit("does not fit the rest: the file was changed after it was written", "digest")
        return read(kind, older(content) if schema < SCHEMA else content)
    except Misfit as misfit:
        raise InputError(f"{path} is damaged: {misfit}; run 'handbench {verb}' again") from None
