"""Methods as a user names them: registered names, patterns of them, and files; and how run folders are called."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from ..errors import unknown_name
from ..localfile import entry_of, is_file
from ..registry import METHODS, Broken, Entry
from ..settings import Setting
from .protocol import Protocol


def named_methods(names: Iterable[str]) -> tuple[tuple[str, ...], tuple[Entry, ...]]:
    """The names of methods, and those that are not registered: "urhand", "urhand-*", "./mine.py".

    Raises `InputError` for a pattern that fits no method and for a file that cannot be used.
    """
    found: list[str] = []
    extra: list[Entry] = []
    for name in names:
        if is_file(name):
            extra.append(entry_of(Path(name)))
            found.append(extra[-1].name)
        elif set("*?[") & set(name):
            found += matching(name)
        else:
            found.append(name)
    return tuple(dict.fromkeys(found)), tuple(extra)


def matching(pattern: str) -> list[str]:
    """The registered methods that a pattern fits. Raises `InputError` if there is none."""
    known = [name for name, entry in METHODS.entries().items() if not isinstance(entry, Broken)]
    fitting = [name for name in known if fnmatchcase(name, pattern)]
    if not fitting:
        raise unknown_name("method", pattern, known)
    return fitting


def run_folder(protocol: Protocol, settings: Sequence[Setting] = ()) -> Path:
    """Where a run goes if nobody says: what was narrowed or set is in the folder's name, so that it does not take the
    place of the whole run."""
    changes = [protocol.part, *(f"{each.methods}-{each.name}-{each.value}" for each in settings)]
    told = (re.sub(r"[^A-Za-z0-9.]+", "-", change).strip("-.") for change in changes if change)
    return Path("runs") / "-".join([protocol.name, *told])[:120]
