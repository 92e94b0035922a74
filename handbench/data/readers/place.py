"""Where a capture that others publish lies on the user's disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from ...errors import Absent, InputError, unknown_name


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


def check_size(name: str, size: str, known: tuple[str, ...]) -> None:
    """Raises `InputError` for a size that a capture does not come in."""
    if size not in known:
        raise unknown_name(f"size of {name}:", size, known)


def lacking(folder: Path, name: str) -> InputError:
    """The error for a file of a layout that is not there."""
    return Absent(f"{folder} has no {name}, which its layout has; get the capture anew")
