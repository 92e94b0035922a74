"""The cameras of a plain folder's pictures."""

from __future__ import annotations

import math
from pathlib import Path, PurePosixPath

import numpy as np

from ...errors import InputError
from ...scene import Array, Camera, Uncalibrated
from ..picturesize import picture_size
from .colmap import read_colmap
from .manifest import FolderManifest
from .nerfstudio import read_nerfstudio
from .pattern import inside


class Cameras:
    """Gives each picture, by its path below the folder, its camera, in metres and with +y up; None where the folder's
    calibration does not know the picture.

    Cameras of equal calibration and name are one object.
    """

    def __init__(self, folder: Path, manifest: FolderManifest) -> None:
        self._folder, self._manifest, said = folder, manifest, manifest.cameras
        self._known: dict[str, tuple[Array, Array, tuple[int, int]]] | None = None
        if "file" in said:
            self._known = read_nerfstudio(inside(folder, said["file"]))
            self._known = {_joined(said["file"], name): found for name, found in self._known.items()}
        elif "colmap" in said:
            self._known = read_colmap(inside(folder, said["colmap"]))
        self._used: dict[str, str] = {}
        self._made: dict[tuple[str, bytes], Camera] = {}

    def of(self, picture: str, name: str) -> Camera | None:
        if self._known is None:
            return self._uncalibrated(picture, name)
        found = self._lookup(picture)
        if found is None:
            return None
        K, placed, size = found
        to_folder = np.c_[placed[:, :3] @ self._manifest.up.T, self._manifest.unit * placed[:, 3]]
        return self._camera(name, size, K, to_folder)

    def _uncalibrated(self, picture: str, name: str) -> Camera:
        size = picture_size(self._folder / picture)
        angle = self._manifest.cameras.get("field_of_view")
        if angle is None:
            return Uncalibrated(name, *size)
        focal = 0.5 * size[0] / math.tan(math.radians(0.5 * angle))
        K = np.array([[focal, 0, 0.5 * size[0]], [0, focal, 0.5 * size[1]], [0, 0, 1.0]])
        return self._camera(name, size, K, np.c_[np.diag([1.0, -1.0, -1.0]), np.zeros(3)])

    def _camera(self, name: str, size: tuple[int, int], K: Array, world_to_camera: Array) -> Camera:
        key = name, K.tobytes() + world_to_camera.tobytes() + bytes(str(size), "ascii")
        if key not in self._made:
            self._made[key] = Camera(name, *size, K, world_to_camera)
        return self._made[key]

    def _lookup(self, picture: str) -> tuple[Array, Array, tuple[int, int]] | None:
        """The calibration of a picture: by its path, with or without the suffix, or by the end that is told of it."""
        assert self._known is not None
        parts = PurePosixPath(picture).parts
        for start in range(len(parts)):
            end = PurePosixPath(*parts[start:])
            for name in (str(end), str(end.with_suffix(""))):
                if name in self._known:
                    if (other := self._used.setdefault(name, picture)) != picture:
                        raise InputError(
                            f"pictures {other} and {picture} are both {name} in the calibration; name pictures in it "
                            "by their paths below the folder"
                        )
                    return self._known[name]
        return None


def _joined(file: str, name: str) -> str:
    """A path that is told from the place of a file, below the folder."""
    parts: list[str] = []
    for part in (PurePosixPath(file).parent / name).parts:
        if part == "..":
            parts = parts[:-1]
        elif part != ".":
            parts.append(part)
    return "/".join(parts)
