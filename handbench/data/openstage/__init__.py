"""The open light stage: path-traced captures of the open hand, made on the user's machine.

`open_capture(size)` gives a capture, generating what is missing; `mini` ships with the package.
"""

from __future__ import annotations

from pathlib import Path

from ...cache import cache_folder
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
    return (folder or cache_folder()) / f"openstage-{size}-{recipe[:8]}"


def open_capture(size: str = "quick", folder: Path | None = None, progress: Progress = silent) -> Capture:
    """The capture of a size, generated first where it is missing or unfinished.

    Raises `InputError` for an unknown size or damaged files, `StorageError` when it cannot be written.
    """
    from .capture import OpenStage, read_manifest
    from .inventory import missing

    place = capture_folder(size, folder)
    path = place / "capture.json"
    lost = missing(place, read_manifest(path)[1]) if path.is_file() else [path.name]
    if lost and size == "mini" and folder is None:
        raise InputError(f"the mini capture at {place} lacks {lost[0]}; install handbench again")
    if lost:
        from .make import make

        make(preset(size), place, progress)
    return OpenStage(place)
