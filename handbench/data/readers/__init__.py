"""Readers of captures that others publish, in their layouts, and plain folders: `open_at` tells which a folder is."""

from __future__ import annotations

from pathlib import Path

from ...errors import InputError
from ..capture import Capture
from ..folder import FILE, open_folder

__all__ = ["open_at"]


def open_at(folder: Path) -> Capture:
    """The capture in a folder, by its layout. Raises `InputError` for a folder that is of none that is known."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"folder {folder} does not exist; give a capture's name or a folder")
    if (folder / FILE).exists():
        return open_folder(folder)
    raise InputError(
        f"folder {folder} has no {FILE} and is of no layout that is known; write one with "
        f"'handbench data template {folder}'"
    )
