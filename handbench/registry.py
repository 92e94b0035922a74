"""Lazy tables of plug-ins: a name, one line about it, and where its code is.

A table is a module of light data (`handbench.methods` and its three sisters); other packages add to it
through entry points of the same group, whose object is an `Entry`. Code is imported when it is used.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from dataclasses import dataclass
from functools import partial
from typing import Any

from .errors import InputError, text_of, unknown_name
from .installed import points


@dataclass(frozen=True)
class Entry:
    """A plug-in: `target` is "module:attribute"; `summary` is one line for `handbench list`.

    `settings` are keyword arguments the target is always called with: several entries may share one factory.
    `presets` is False for a method whose presets are all the same, so that asking it for one can be refused.
    `changes` are settings of a method's configuration that a run changes, as texts: see `handbench.settings`.
    """

    name: str
    target: str
    summary: str
    settings: tuple[tuple[str, str], ...] = ()
    presets: bool = True
    changes: tuple[tuple[str, str], ...] = ()

    def load(self) -> Any:
        module, _, attribute = self.target.partition(":")
        try:
            loaded = getattr(importlib.import_module(module), attribute)
        except (Exception, SystemExit) as error:  # whatever foreign code raises
            text = f"{type(error).__name__}: {text_of(error)}"
            raise InputError(f"plug-in {self.name!r} at {self.target!r} cannot be loaded: {text}; mend it") from error
        given = dict(self.settings) | ({"changes": dict(self.changes)} if self.changes else {})
        return partial(loaded, **given) if given else loaded


@dataclass(frozen=True)
class Broken(Entry):
    """A plug-in that cannot be used; `summary` says why and what helps, and naming it is an `InputError`."""

    def load(self) -> Any:
        raise InputError(f"plug-in {self.name!r} is {self.summary}")


@dataclass(frozen=True)
class Registry:
    """One kind of plug-in: `kind` for messages, `package` holds our own ENTRIES, `group` is for entry points."""

    kind: str
    package: str
    group: str

    def entries(self) -> dict[str, Entry]:
        """All plug-ins by name, ours first; one that is broken, or whose name is taken, is there as `Broken`."""
        found: dict[str, Entry] = {entry.name: entry for entry in importlib.import_module(self.package).ENTRIES}
        for point in points(self.group):
            entry = _entry(point)
            if entry.name in found:
                why = f"broken: two {self.kind} plug-ins have this name; uninstall one of them"
                entry = Broken(entry.name, entry.target, why)
            found[entry.name] = entry
        return found

    def entry(self, name: str) -> Entry:
        known = self.entries()
        if name not in known:
            raise unknown_name(self.kind, name, known)
        if isinstance(known[name], Broken):
            known[name].load()
        return known[name]

    def load(self, name: str) -> Any:
        return self.entry(name).load()


def _entry(point: importlib.metadata.EntryPoint) -> Entry:
    try:
        entry = point.load()
        if not isinstance(entry, Entry):
            raise TypeError(f"{point.value} is no handbench.registry.Entry")
    except (Exception, SystemExit) as error:  # whatever foreign code raises must not hide the other plug-ins
        text = f"{type(error).__name__}: {text_of(error)}"
        return Broken(point.name, point.value, f"broken: {text}; uninstall or mend it")
    return entry


METHODS = Registry("method", "handbench.methods", "handbench.methods")
METRICS = Registry("metric", "handbench.metrics", "handbench.metrics")
PROTOCOLS = Registry("protocol", "handbench.protocols", "handbench.protocols")
CAPTURES = Registry("capture", "handbench.data", "handbench.captures")
STUDIES = Registry("study", "handbench.studies", "handbench.studies")
HANDS = Registry("hand model", "handbench.hands", "handbench.hands")
