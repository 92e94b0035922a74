"""Lazy tables of plug-ins: a name, one line about it, and where its code is.

A table is a module of light data (`handbench.methods` and its three sisters); other packages add to it
through entry points of the same group, whose object is an `Entry`. Code is imported when it is used.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from dataclasses import dataclass
from typing import Any

from .errors import InputError, unknown_name


@dataclass(frozen=True)
class Entry:
    """A plug-in: `target` is "module:attribute"; `summary` is one line for `handbench list`."""

    name: str
    target: str
    summary: str

    def load(self) -> Any:
        module, _, attribute = self.target.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise InputError(f"plug-in {self.name!r} at {self.target!r} cannot be loaded: {error}") from error


@dataclass(frozen=True)
class Registry:
    """One kind of plug-in: `kind` for messages, `package` holds our own ENTRIES, `group` is for entry points."""

    kind: str
    package: str
    group: str

    def entries(self) -> dict[str, Entry]:
        """All plug-ins by name, ours first; a name given twice is an `InputError`."""
        found: dict[str, Entry] = {entry.name: entry for entry in importlib.import_module(self.package).ENTRIES}
        for point in importlib.metadata.entry_points(group=self.group):
            try:
                entry = point.load()
            except Exception as error:  # a broken plug-in must not hide the others' names
                raise InputError(
                    f"the {self.kind} plug-in {point.name!r} is broken: {error}; uninstall or mend it"
                ) from error
            if entry.name in found:
                raise InputError(f"two {self.kind} plug-ins are called {entry.name!r}; uninstall one of them")
            found[entry.name] = entry
        return found

    def entry(self, name: str) -> Entry:
        known = self.entries()
        if name not in known:
            raise unknown_name(self.kind, name, known)
        return known[name]

    def load(self, name: str) -> Any:
        return self.entry(name).load()


METHODS = Registry("method", "handbench.methods", "handbench.methods")
METRICS = Registry("metric", "handbench.metrics", "handbench.metrics")
PROTOCOLS = Registry("protocol", "handbench.protocols", "handbench.protocols")
CAPTURES = Registry("capture", "handbench.data", "handbench.captures")
