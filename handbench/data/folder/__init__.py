"""A plain folder of pictures with a `handbench.toml` beside them, as a capture: see docs/own-hands.md.

manifest.py    what handbench.toml says, checked;  pattern.py: paths that tell subject, pose, camera, lighting
cameras.py     where the pictures were taken from: nerfstudio.py, colmap.py, or a field of view
lights.py      lights that are told;  poses and meshes: `handbench.data.poses`, `handbench.data.meshfile`
capture.py     the reader;  template.py: a handbench.toml for pictures that are there
"""

from __future__ import annotations

from pathlib import Path

from ...errors import InputError
from .capture import Folder
from .manifest import FILE, read_manifest

__all__ = ["FILE", "Folder", "open_folder"]


def open_folder(folder: Path) -> Folder:
    """The capture in a folder. Raises `InputError` for whatever handbench.toml or the files beside it have wrong."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"folder {folder} does not exist; give a folder with a {FILE}")
    if not (folder / FILE).exists():
        raise InputError(f"folder {folder} has no {FILE}; write one with 'handbench data template {folder}'")
    return Folder(folder, read_manifest(folder / FILE))
