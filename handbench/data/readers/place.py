"""Where a capture that others publish lies on the user's disk, and how its frames are listed."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from ...errors import Absent, InputError, unknown_name
from ...scene import Frame


def place_of(name: str, folder: Path | None, fits: Callable[[Path], bool]) -> Path:
    """The folder of a capture: what HANDBENCH_NAME names, else `folder` or the folder of its name in there.

    Raises `Absent` if none is of the layout that `fits` knows.
    """
    variable = f"HANDBENCH_{name.upper()}"
    named = os.environ.get(variable)
    candidates = [Path(named)] if named else [] if folder is None else [folder / name, folder]
    for candidate in candidates:
        if candidate.is_dir() and fits(candidate):
            return candidate
    looked = f"; looked at {' and '.join(map(str, candidates))}" if candidates else ""
    raise Absent(
        f"capture {name} is not made but brought: get it from its authors and name its folder in {variable}{looked}"
    )


def listed(frames: Iterable[Frame]) -> tuple[Frame, ...]:
    """All frames of a capture, made with Python's search for unused cycles paused: there are none among millions of
    objects that stay, and looking through them again and again takes longer than making them."""
    paused = gc.isenabled()
    gc.disable()
    try:
        return tuple(frames)
    finally:
        if paused:
            gc.enable()


def check_size(name: str, size: str, known: tuple[str, ...]) -> None:
    """Raises `InputError` for a size that a capture does not come in."""
    if size not in known:
        raise unknown_name(f"size of {name}:", size, known)


def lacking(folder: Path, name: str) -> InputError:
    """The error for a file of a layout that is not there."""
    return Absent(f"{folder} has no {name}, which its layout has; get the capture anew")
