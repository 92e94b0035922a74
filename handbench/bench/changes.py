"""Which settings change in which methods of a run."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

from ..errors import InputError, unknown_name
from ..registry import Entry
from ..settings import Setting, names_in
from .plan import ChangesOf, make_method


def assigned(settings: Sequence[Setting], entries: Mapping[str, Entry], presets: Mapping[str, str]) -> ChangesOf:
    """The changes of each method: a setting without methods goes to all that have it.

    A change that leaves a configuration as it is counts as none. Raises `InputError` for a setting that no method has,
    for methods that are not in the run, and for a value that a configuration refuses.
    """
    if not settings:
        return ()
    known = settable(entries, presets)
    if not known:
        raise InputError(f"{settings[0].name!r} cannot be set: {', '.join(entries)} take no settings; leave --set out")
    found: dict[str, dict[str, str]] = {name: {} for name in known}
    for setting in settings:
        for name in _methods(setting, known, entries):
            found[name][setting.name] = setting.value
    changes = []
    for name, of_method in found.items():
        entry = replace(entries[name], changes=tuple(sorted(of_method.items())))
        if of_method and make_method(entry, presets[name]).config != make_method(entries[name], presets[name]).config:
            changes.append((name, entry.changes))
    return tuple(changes)


def settable(entries: Mapping[str, Entry], presets: Mapping[str, str]) -> dict[str, dict[str, object]]:
    """The settings of each method that takes changes, with their values at its preset."""
    return {
        name: dict(names_in(make_method(entry, presets[name]).config))
        for name, entry in entries.items()
        if "changes" in inspect.signature(entry.load()).parameters
    }


def _methods(setting: Setting, known: Mapping[str, Mapping[str, object]], entries: Mapping[str, Entry]) -> list[str]:
    """The methods that a setting is for."""
    if not setting.methods:
        having = [name for name, names in known.items() if setting.name in names]
        if not having:
            raise unknown_name("setting", setting.name, {name for names in known.values() for name in names})
        return having
    named = [name for name in entries if fnmatchcase(name, setting.methods)]
    if not named:
        raise unknown_name("method", setting.methods, entries)
    chosen = [name for name in named if name in known]
    if not chosen:
        raise InputError(f"{setting.name!r} cannot be set: {', '.join(named)} take no settings; leave it out")
    for name in chosen:
        if setting.name not in known[name]:
            raise unknown_name(f"setting of {name}:", setting.name, known[name])
    return chosen
