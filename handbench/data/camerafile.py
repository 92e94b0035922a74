"""Cameras from a file of one's own, in the forms that plain folders read: nerfstudio's transforms.json, COLMAP's model.

    transforms.json      sparse/0:y-down      path.json:z-up,millimetres      path.json:frame=3

`z-up` and `y-down` say which axis of the file is up, else +y is; `centimetres` and `millimetres` what it counts in,
else metres; `frame` takes one of the cameras, from 0, else all of them, in the file's order (COLMAP's: by the
pictures' names).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene import Camera
from .folder.colmap import read_colmap
from .folder.manifest import UNITS, UP
from .folder.nerfstudio import read_nerfstudio

FLAGS = ("y-up", "z-up", "y-down", "metres", "centimetres", "millimetres")
NUMBERS = ("frame",)
_UP = {"y-up": "y", "z-up": "z", "y-down": "-y"}


def is_camera_file(source: str) -> bool:
    """Whether a text names a file of cameras, or a folder that holds COLMAP's model."""
    path = Path(source)
    return path.suffix.lower() == ".json" or any((path / f"cameras.{kind}").is_file() for kind in ("txt", "bin"))


def read_cameras(source: str, options: Mapping[str, float]) -> tuple[Camera, ...]:
    """The cameras of a file, in metres and with +y up.

    Raises `InputError` for options that exclude each other, a file that is missing or damaged, lenses that distort, and
    a number of a camera that there is not.
    """
    up, unit = (_one(source, options, names) for names in (tuple(_UP), tuple(UNITS)))
    path = Path(source)
    found = read_nerfstudio(path) if path.suffix.lower() == ".json" else dict(sorted(read_colmap(path).items()))
    turn, scale = np.array(UP[_UP[up or "y-up"]], np.float64), UNITS[unit or "metres"]
    cameras = [
        Camera(name, *size, K, np.c_[placed[:, :3] @ turn.T, scale * placed[:, 3]])
        for name, (K, placed, size) in found.items()
    ]
    if not cameras:
        raise InputError(f"camera file {source} has no cameras; give one at least")
    if "frame" not in options:
        return tuple(cameras)
    chosen = options["frame"]
    if chosen != int(chosen) or not 0 <= chosen < len(cameras):
        raise InputError(f"camera file {source} has no frame {chosen:g}; give 0 to {len(cameras) - 1}")
    return (cameras[int(chosen)],)


def _one(source: str, options: Mapping[str, float], names: tuple[str, ...]) -> str | None:
    given = [name for name in names if name in options]
    if len(given) > 1:
        raise InputError(f"camera {source} is said to be both {given[0]} and {given[1]}; leave one out")
    return given[0] if given else None
