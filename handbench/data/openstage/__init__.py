"""The open captures: path-traced pictures of the open hand, made on the user's machine by one generator.

`open_capture(size)` gives the light stage of a size, generating what is missing; its `mini` ships with the package.

presets.py     what is declared: sizes, recipes, the generator's version
cast.py        people, looks and poses
stage.py       the light stage, planned
production.py  what a plan consists of; plans.py: from a preset to its plan
make.py        a plan made, by any number of processes; performance.py: one pose of it
describe.py    what capture.json says; manifest.py reads and checks it; inventory.py: files and their sums
capture.py     the reader; reading.py: its files
trace/         the path tracer
"""

from __future__ import annotations

from pathlib import Path

from ...cache import cache_folder
from ...errors import InputError
from ...method import Progress, silent
from ..capture import Capture
from .presets import PRESETS, CaptureName, preset

__all__ = ["PRESETS", "capture_folder", "check_made", "generated", "lacking", "open_capture", "preset"]


def generated(name: str) -> CaptureName:
    """The name of a capture that this generator makes. Raises `InputError` for any other."""
    for known in PRESETS:
        if name == known:
            return known
    raise InputError(f"capture {name!r} is not generated in parts; leave out --shard and --executor")


def capture_folder(size: str, folder: Path | None = None, capture: CaptureName = "openstage") -> Path:
    """Where a capture of this size lives: in the package if it ships, else in `folder`, $HANDBENCH_DATA or cache."""
    recipe = preset(size, capture).recipe
    if folder is None and (shipped := _shipped(size, capture)).is_dir():
        return shipped
    return (folder or cache_folder()) / f"{capture}-{size}-{recipe[:8]}"


def _shipped(size: str, capture: CaptureName) -> Path:
    return Path(__file__).parent / (size if capture == "openstage" else f"{size}-{capture}")


def lacking(place: Path) -> list[str]:
    """The files that a capture's folder lacks; none if it is finished. Raises `InputError` for a damaged one."""
    from .inventory import missing
    from .manifest import FILE, read_manifest

    return missing(place, read_manifest(place / FILE)) if (place / FILE).is_file() else [FILE]


def check_made(size: str, folder: Path | None, capture: CaptureName) -> None:
    """Raises `InputError` for a capture that `open_capture` would make first, which takes minutes or hours."""
    from .manifest import FILE, command

    place = capture_folder(size, folder, capture)
    if not (lost := lacking(place)):
        return
    remedy = command(capture, size, place)
    if lost != [FILE]:
        raise InputError(f"{place} lacks {len(lost)} of its files, the first is {lost[0]}; '{remedy}' makes them anew")
    if place.is_dir():
        raise InputError(f"{capture} of size {size} is made in part only; '{remedy}' makes the rest")
    older = [other for other in sorted(place.parent.glob(f"{capture}-{size}-*")) if (other / FILE).is_file()]
    aside = f" ({older[0]} is another version's, which this one does not read; delete it)" if older else ""
    raise InputError(f"{capture} of size {size} is not made yet{aside}; '{remedy}' makes it")


def open_capture(
    size: str = "quick", folder: Path | None = None, progress: Progress = silent, capture: CaptureName = "openstage"
) -> Capture:
    """The capture of a size, generated first where it is missing or unfinished.

    Raises `InputError` for an unknown size or damaged files, `StorageError` when it cannot be written.
    """
    from .capture import OpenCapture
    from .manifest import command

    place = capture_folder(size, folder, capture)
    lost = lacking(place)
    if lost and place == _shipped(size, capture):
        raise InputError(f"the capture in the package, {place}, lacks {lost[0]}; install handbench again")
    if lost:
        from .make import make
        from .plans import production

        make(production(preset(size, capture)), place, progress)
    found = OpenCapture(place)
    if found.digest != preset(size, capture).recipe:
        remedy = command(capture, size, place)
        raise InputError(f"{place} is of another preset than {capture} {size}; delete it and make it again: {remedy}")
    return found
