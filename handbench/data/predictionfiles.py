"""What the file of a picture is called, by the key of its query: subject/pose/camera/light.

Folders that people exchange have a folder for each part of a key; a run folder, which nobody browses, has none.
"""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError


def nested_path(folder: Path, key: str, suffix: str = ".exr") -> Path:
    """`folder`/subject/pose/camera/light.exr; `InputError` for a key that would lead out of the folder."""
    if ".." in Path(key).parts or Path(key).is_absolute():
        raise InputError(f"query {key!r} would lead out of {folder}; the capture must name its frames otherwise")
    return folder / f"{key}{suffix}"


def flat_path(folder: Path, key: str, suffix: str = ".exr") -> Path:
    """`folder`/subject__pose__camera__light.exr."""
    return folder / f"{key.replace('/', '__')}{suffix}"
