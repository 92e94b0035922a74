"""The protocols that come with handbench: every TOML file beside this one; `ENTRIES` is the table the harness reads.

A package brings its own by an entry point to an `Entry` whose target is a `Protocol`, made with `load(path)`.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from handbench.registry import Entry

from .loader import load, parse

__all__ = ["ENTRIES", "load", "parse"]

_FILES = sorted(Path(__file__).parent.glob("*.toml"))

ENTRIES: tuple[Entry, ...] = tuple(
    Entry(file.stem, f"handbench.protocols.shipped:{file.stem}", tomllib.loads(file.read_text("utf-8"))["summary"])
    for file in _FILES
)
