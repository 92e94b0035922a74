"""TOML files of others: what is too large, too deep or too wide is refused before a parser works on it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from .errors import InputError
from .files import check_value, read_text

LIMIT = 1 << 18  # bytes; the longest protocol of ours has some 10,000
DEPTH = 16  # tables, lists and points of a key in one another

# Texts and comments: what stands in them is no structure. Nothing here goes back over what it has seen (`*+`).
_QUIET = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+"'
    r"|'[^'\n]*+'|#[^\n]*+",
    re.DOTALL,
)
_DOTTED = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{DEPTH}}}")


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The table in a TOML file. Raises `InputError` for what `read_text` and `check_value` refuse, for a file that is
    no TOML, and for tables, lists or keys that are nested deeper than `DEPTH`: a parser takes minutes over some."""
    text, owner = read_text(path, LIMIT, what), f"{what} {path}"
    _check_depth(text, owner)
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # of syntax, or a number with thousands of digits
        why = "a number has thousands of digits" if "digits" in str(error) else error
        raise InputError(f"{owner} is not valid TOML: {why}") from error
    check_value(table, owner)
    return table


def _check_depth(text: str, owner: str) -> None:
    structure = _QUIET.sub("_", text)
    depth = 0
    for sign in re.findall(r"[\[\]{}]", structure):
        depth += 1 if sign in "[{" else -1
        if depth > DEPTH:
            break
    if depth > DEPTH or _DOTTED.search(structure):
        raise InputError(f"{owner}: tables, lists or keys are nested deeper than {DEPTH} levels; make them flat")
