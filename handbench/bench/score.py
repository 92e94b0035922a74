"""Score pictures that a method drew elsewhere, and write down what such a method is asked."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..data.capture import Capture
from ..data.predictions import Asked, read_folder, write_template
from ..data.predictions.manifest import name_fits
from ..errors import InputError
from ..method import MethodInfo
from ..registry import METHODS
from . import given
from .naming import run_folder
from .opening import open_data, select
from .plan import make_method, method_entries
from .progress import Steps, steps
from .protocol import Protocol
from .resolving import Selected
from .run import RunSummary, run

# Whoever draws elsewhere is told what any method is: [train] as a whole shows a subject's training frames too.
_ANY = MethodInfo("elsewhere", "Elsewhere", "draws its pictures elsewhere", universal=True)


def score(
    protocol: Protocol,
    folder: Path,
    out: Path | None = None,
    data: Path | None = None,
    name: str | None = None,
    allow_missing: bool = False,
    command: Iterable[str] = (),
) -> RunSummary:
    """Score a prediction folder beside the protocol's calibration rows, into `out` (default: runs/PROTOCOL-NAME, and
    what was narrowed).

    `name` is the method's name in the run, by default the manifest's. With `allow_missing`, a query without a picture
    and a picture with NaN become missing scores with their reason.
    Raises `Unfit` with all that is wrong with the folder, before anything is written, and what `run` raises.
    """
    if name is not None and not name_fits(name):
        raise InputError(f"name {name!r} cannot be a method's; use letters, digits, points, dashes and underscores")
    if out is not None and out.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{out} is in the prediction folder, which is only read; choose another folder with --out")
    from ..methods.predictions import entry_of

    with steps() as told:
        asked, _, _ = _asked(protocol, data, told)
    found = read_folder(folder, asked, allow_missing)
    entry = entry_of(found, name or found.manifest.method)
    method_entries((), (entry,))  # a name that is taken is told before the calibration rows are made
    methods = (*_calibration(protocol), entry.name)
    place = out or Path(f"{run_folder(protocol)}-{entry.name}")
    return run(protocol, methods, (found.manifest.seed,), None, place, data, command, extra=(entry,))


def template(protocol: Protocol, folder: Path, data: Path | None = None, images: bool = False) -> int:
    """Write what the protocol asks into a new folder, which the pictures then go to; how many are asked for.

    With `images`, the recorded pictures of training and enrolment come along.
    Raises `InputError` if the folder is not empty, `StorageError` if it cannot be written.
    """
    with steps() as told:
        asked, selected, capture = _asked(protocol, data, told)
        training = given.training(selected, capture.observe)
        enrolments = [given.enrolment(selected, _ANY, subject, capture.observe) for subject in protocol.subjects]
        write_template(folder, asked, training, enrolments, images, told("images of training and enrolment"))
    return len(asked.queries)


def _asked(protocol: Protocol, data: Path | None, told: Steps) -> tuple[Asked, Selected, Capture]:
    capture = open_data(protocol, data, told)
    selected = select(protocol, capture)
    scored = {frame.key: frame for frames in selected.scored.values() for frame in frames}
    queries = [given.asked(selected, _ANY, frame) for frame in scored.values()]
    return Asked.of(protocol.label, protocol.digest, capture.digest, queries), selected, capture


def _calibration(protocol: Protocol) -> list[str]:
    """The protocol's rows that say whether a run is right: the truth and the floor."""
    infos = {name: make_method(METHODS.entry(name), protocol.preset_of(name)).info for name in protocol.methods}
    return [name for name, info in infos.items() if info.role == "calibration"]
