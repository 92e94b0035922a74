"""Records as files: JSON with a digest over the rest, read whole and checked, or refused in one sentence."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from ..errors import Damaged, InputError
from . import measured, origin, record
from .fieldtypes import documented
from .oldrecord import UPGRADES
from .record import SCHEMA, CellRecord, PriorRecord, RunRecord
from .schema import Misfit, plain, read

_Record = TypeVar("_Record", RunRecord, CellRecord, PriorRecord)


def dump(record: RunRecord | CellRecord | PriorRecord) -> str:
    """The text of a record, with the digest that seals it. Raises `ValueError` for a value that is no JSON."""
    return json.dumps(sealed(plain(replace(record, schema=SCHEMA))), indent=1, allow_nan=False) + "\n"


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """A record's JSON value with its digest: SHA-256 of the rest, with sorted names and without spaces."""
    rest = {name: value for name, value in content.items() if name != "digest"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return {**rest, "digest": hashlib.sha256(text.encode()).hexdigest()}


def parse(kind: type[_Record], text: bytes, path: Path) -> _Record:
    """The record in a file's text; `path` names the file.

    Raises `Damaged` for what is no such record, naming the field, and `InputError` for a newer version's.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        why = "is nested too deep" if isinstance(error, RecursionError) else "is no JSON"
        raise Damaged(f"{path} {why}; {_REMEDY}") from error
    if not isinstance(content, dict):
        raise Damaged(f"{path} is no record but {type(content).__name__}; {_REMEDY}")
    schema = content.get("schema")
    if type(schema) is int and schema > SCHEMA:
        raise InputError(
            f"{path} was written by a newer version (schema {schema}, we read {SCHEMA}); upgrade handbench"
        )
    try:
        if type(schema) is int and schema == 1:
            content = UPGRADES[kind](content)
        elif schema not in (2, SCHEMA):  # what came after version 2 may be missing
            raise Misfit("is missing" if schema is None else f"is no version: {schema!r:.40}", "schema")
        elif content.get("digest") != sealed(content)["digest"]:
            raise Misfit("does not fit the rest: the file was changed after it was written", "digest")
        return read(kind, content)
    except Misfit as misfit:
        raise Damaged(f"{path} is damaged: {misfit}; {_REMEDY}") from None


_REMEDY = "run again into this folder, or take it from a copy"


def documentation() -> str:
    """docs/records.md: every record and its fields."""
    return "\n".join(_documentation())


def _documentation() -> Iterator[str]:
    yield _HEAD.format(schema=SCHEMA)
    for kind in _mentioned():
        yield f"## {kind.__name__}\n\n{kind.__doc__}\n"
        yield "| field | type | what it is |\n| --- | --- | --- |"
        for name, words, text in documented(kind):
            yield f"| `{name}` | {words} | {text} |"
        yield ""


def _mentioned() -> list[type]:
    """The records, then their parts, in the order of their modules."""
    parts = [
        each
        for module in (origin, record, measured)
        for each in vars(module).values()
        if isinstance(each, type) and is_dataclass(each) and each.__module__ == module.__name__
    ]
    return [*UPGRADES, *(part for part in parts if part not in UPGRADES)]


_HEAD = """# Records

What a run folder tells, file by file: JSON in format version {schema} (field `schema`). Older versions are read,
newer ones refused. Fields that are not needed may be missing. `digest` is the SHA-256 of all other fields (sorted
names, no spaces): a file that was changed afterwards is refused by name. This page is made by
`python -m handbench.results.recordfile`, from the types that read the files.
"""


if __name__ == "__main__":
    sys.stdout.write(documentation())
