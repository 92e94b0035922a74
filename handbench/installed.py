"""Packages that are installed beside handbench: their entry points, their versions, and whose a module is.

Going through all of them takes as long as a small run, and a run asks many times. So what was found is remembered for
as long as Python's search path and the folders on it stay as they are.
"""

from __future__ import annotations

import importlib.metadata
import os
import re
import sys
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint
from typing import TypeAlias

SearchPath: TypeAlias = tuple[tuple[str, int, int, int], ...]


def points(group: str) -> tuple[EntryPoint, ...]:
    """The entry points of a group, of all packages."""
    return _points(_search_path(), group)


def version(name: str) -> str | None:
    """The version of an installed package; None for one that is not there."""
    return _version(_search_path(), name)


def owner_version(module: str) -> str | None:
    """The version of the package that brought a top-level module; None if no package says that it did."""
    return _owner_version(_search_path(), module)


def _search_path() -> SearchPath:
    """Where packages may be, with the folders' times: one that is installed or removed changes its folder's."""
    return tuple((place, *_stamp(place)) for place in sys.path)


def _stamp(place: str) -> tuple[int, int, int]:
    try:
        found = os.stat(place or os.curdir)  # noqa: PTH116 - asked thousands of times; a path takes thrice as long
    except OSError:
        return (0, 0, 0)
    return found.st_dev, found.st_ino, found.st_mtime_ns


@lru_cache(maxsize=64)
def _points(path: SearchPath, group: str) -> tuple[EntryPoint, ...]:
    return tuple(importlib.metadata.entry_points(group=group))


@lru_cache(maxsize=256)
def _version(path: SearchPath, name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


@lru_cache(maxsize=64)
def _owner_version(path: SearchPath, module: str) -> str | None:
    return next((each.version for each in importlib.metadata.distributions() if _brings(each, module)), None)


def _brings(package: Distribution, module: str) -> bool:
    """What `importlib.metadata.packages_distributions` tells, of one module: that parses every name of every file."""
    if declared := (package.read_text("top_level.txt") or "").split():
        return module in declared
    listed = package.read_text("RECORD") or ""
    return re.search(rf"^{re.escape(module)}(/.*)?\.py,", listed, re.MULTILINE) is not None
