"""What a run was made of, opened again: the same protocol, data and settings, or a sentence about what is another."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..data.capture import Capture
from ..errors import InputError
from ..method import Method
from ..registry import METHODS, Entry
from ..results.reading import Run
from ..results.record import MethodRecord
from ..settings import names_in
from .narrowing import narrowed_as
from .opening import open_data
from .plan import ChangesOf, make_method
from .progress import Steps
from .protocol import Protocol
from .run import find_protocol


def protocol_of(run: Run, name: str | None) -> Protocol:
    """The protocol of a run: the registered one of its name, or a file that `name` names, narrowed as the run was.

    Raises `InputError` for one that is not known, or not the one that was run.
    """
    told = run.plan.protocol
    try:
        whole = find_protocol(name or told.name)
    except InputError as error:
        raise InputError(f"{error}; {run.folder} is of {told.label}, give its file with --protocol") from error
    found = whole if whole.digest == told.digest else narrowed_as(whole, told.title)
    if found.digest != told.digest:
        raise InputError(
            f"protocol {whole.label} is not the one that {run.folder} was run with ({told.label}); "
            "give the run's own file with --protocol, or run it again"
        )
    return found


def capture_of(run: Run, protocol: Protocol, data: Path | None, told: Steps) -> Capture:
    """The capture of a run's protocol. Raises `InputError` as `open_data` does, and for one that was not run on."""
    capture, of_run = open_data(protocol, data, told), run.plan.capture
    if capture.digest != of_run.digest:
        raise InputError(
            f"capture {capture.name} has digest {capture.digest}, {run.folder} was run on {of_run.digest}; "
            "name the folder of the run's own capture with --data"
        )
    return capture


def changes_of(method: MethodRecord) -> ChangesOf:
    """The settings of a run's method that its preset does not have; () if it is not registered here."""
    if method.name not in METHODS.entries() or method.config is None:
        return ()
    made = make_method(METHODS.entry(method.name), method.preset)
    changes = changes_between(made.config, method.config)
    return ((method.name, changes),) if changes else ()


def changes_between(config: Mapping[str, Any], wanted: Any) -> tuple[tuple[str, str], ...]:
    """The settings, as texts, that make a method's configuration another one; those that only one has are left out."""
    if not isinstance(wanted, Mapping):
        return ()
    known, there = (dict(names_in(each)) for each in (_as_json(config), wanted))
    return tuple((name, _text(there[name])) for name in known if name in there and there[name] != known[name])


def method_as(entry: Entry, preset: str, config: Any) -> Method:
    """The method of a plug-in with the settings of a record, whichever they are; None: those of its preset.

    Raises `InputError` if this version has no such settings.
    """
    made = make_method(entry, preset)
    if config is None or _as_json(made.config) == config:
        return made
    changes = changes_between(made.config, config)
    if changes and "changes" in inspect.signature(entry.load()).parameters:
        made = make_method(replace(entry, changes=changes), preset)
    if _as_json(made.config) != config:
        told = config if isinstance(config, Mapping) else {}
        known, there = (dict(names_in(each)) for each in (_as_json(made.config), told))
        odd = sorted(name for name in known.keys() | there.keys() if known.get(name) != there.get(name))
        raise InputError(f"{entry.name} has other settings here ({', '.join(odd[:3])}) and cannot be given those")
    return made


def _as_json(config: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(config))


def _text(value: Any) -> str:
    """A setting's value as a command line gives it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "none"
    return ",".join(map(_text, value)) if isinstance(value, list) else str(value)
