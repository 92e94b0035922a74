"""What a run was made of, opened again: the same protocol and the same data, or a sentence about what is another."""

from __future__ import annotations

from pathlib import Path

from ..data.capture import Capture
from ..errors import InputError
from ..results.reading import Run
from .opening import open_data
from .progress import Steps
from .protocol import Protocol
from .run import find_protocol


def protocol_of(run: Run, name: str | None) -> Protocol:
    """The protocol of a run: the registered one of its name, or what `name` names, such as a file.

    Raises `InputError` for one that is not known, or not the one that was run.
    """
    told = run.plan.protocol
    try:
        found = find_protocol(name or told.name)
    except InputError as error:
        raise InputError(f"{error}; {run.folder} is of {told.label}, give its file with --protocol") from error
    if found.digest != told.digest:
        raise InputError(
            f"protocol {found.label} is not the one that {run.folder} was run with ({told.label}); "
            "give the run's own file with --protocol, or run it without --subjects and --limit"
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
