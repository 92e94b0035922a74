"""What a run was made of, opened again: the same protocol, data and settings, or a sentence about what is another."""

from __future__ import annotations

import re
from pathlib import Path

from ..data.capture import Capture
from ..errors import InputError
from ..registry import METHODS
from ..results.reading import Run
from ..results.record import MethodRecord
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
    """The settings of a run's method that were changed, which its title tells; () if it is not registered here."""
    if method.name not in METHODS.entries():
        return ()
    title = make_method(METHODS.entry(method.name), method.preset).info.title
    told = method.title.removeprefix(f"{title} (")
    if told == method.title:
        return ()
    changes = (each.partition("=") for each in re.split(r", (?=[\w.]+=)", told.removesuffix(")")))
    return ((method.name, tuple((name, value) for name, _, value in changes)),)
