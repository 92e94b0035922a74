"""The open light stage: path-traced captures of the open hand, made on the user's machine.

`open_capture(size)` gives a capture, generating what is missing; `mini` ships with the package.
"""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import InputError
from ...method import Progress, silent
from ..capture import Capture
from .presets import PRESETS, preset

__all__ = ["PRESETS", "capture_folder", "open_capture", "preset"]


def capture_folder(size: str, folder: Path | None = None) -> Path:
    """Where a capture of this size lives: `mini` in the package, others in `folder`, $HANDBENCH_DATA or the cache."""
    recipe = preset(size).recipe
    if size == "mini" and folder is None:
        return Path(__file__).parent / "mini"
    root = folder or Path(os.environ.get("HANDBENCH_DATA") or Path.home() / ".cache" / "handbench")
    return root / f"openstage-{size}-{recipe[:8]}"


def open_capture(size: str = "quick", folder: Path | None = None, progress: Progress = silent) -> Capture:
    """The capture of a size, generated first where it is missing or unfinished.

    Raises `InputError` for an unknown size or damaged files, `StorageError` when it cannot be written.
    """
    place = capture_folder(size, folder)
    if not (place / "capture.json").is_file():
        if size == "mini" and folder is None:
            raise InputError(f"the mini capture is missing from the package at {place}; install handbench again")
        from .make import make

        make(preset(size), place, progress)
    from .capture import OpenStage

    return OpenStage(place)
