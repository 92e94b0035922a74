"""Readers of captures that others publish, in their layouts, and plain folders: `open_at` tells which a folder is.

interhand.py   InterHand2.6M;  harp.py: HARP;  goliath.py: Goliath's hands;  palm.py: PALM
place.py       where they lie;  masked.py: masks from meshes;  zipped.py: files in archives;  mano.py: MANO's hand
"""

from __future__ import annotations

from pathlib import Path

from ...errors import InputError
from ..capture import Capture
from ..folder import FILE, open_folder
from . import goliath, harp, interhand, palm

__all__ = ["open_at"]


def open_at(folder: Path) -> Capture:
    """The capture in a folder, by its layout. Raises `InputError` for a folder that is of none that is known."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"folder {folder} does not exist; give a capture's name or a folder")
    if (folder / FILE).exists():
        return open_folder(folder)
    if interhand.fits(folder):
        return interhand.InterHand(folder)
    if harp.fits(folder):
        return harp.Harp(folder)
    if goliath.fits(folder):
        return goliath.Goliath(folder)
    if palm.fits(folder):
        return palm.Palm(folder)
    raise InputError(
        f"folder {folder} has no {FILE} and is of no layout that is known (InterHand2.6M, HARP, Goliath hands, PALM); "
        f"write one with 'handbench data template {folder}'"
    )
