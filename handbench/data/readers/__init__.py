"""Readers of captures that others publish, in their layouts, and plain folders: `open_at` tells which a folder is.

interhand.py    InterHand2.6M; annotations.py: its files
reinterhand.py  Re:InterHand;  harp.py: HARP;  goliath.py: Goliath's hands;  palm.py: PALM
uhm.py          phone scans as UHM reads them; scans.py: their two layouts
place.py        where captures lie, and how frames are listed;  mano.py: MANO's hand;  masked.py: masks from meshes
zipped.py       files in archives;  keypoints.py: key points and numbers of others
"""

from __future__ import annotations

from pathlib import Path

from ...errors import InputError
from ..capture import Capture
from ..folder import FILE, open_folder
from ..openstage.capture import OpenCapture
from ..openstage.manifest import FILE as GENERATED
from . import goliath, harp, interhand, palm, reinterhand, uhm

__all__ = ["open_at"]

_LAYOUTS = (
    (interhand.fits, interhand.InterHandCapture),
    (reinterhand.fits, reinterhand.ReInterHandCapture),
    (harp.fits, harp.HarpCapture),
    (goliath.fits, goliath.GoliathCapture),
    (palm.fits, palm.PalmCapture),
    (uhm.fits, uhm.UhmCapture),
)


def open_at(folder: Path) -> Capture:
    """The capture in a folder, by its layout. Raises `InputError` for a folder that is of none that is known."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"folder {folder} does not exist; give a capture's name or a folder")
    if (folder / FILE).exists():
        return open_folder(folder)
    if (folder / GENERATED).exists():
        return OpenCapture(folder)
    for fits, made in _LAYOUTS:
        if fits(folder):
            return made(folder)
    known = ", ".join(str(made.layout) for _, made in _LAYOUTS)
    raise InputError(
        f"folder {folder} has no {FILE} and is of no layout that is known ({known}); write one with 'handbench data "
        f"template {folder}'"
    )
