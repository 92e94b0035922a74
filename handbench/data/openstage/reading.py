"""The files of a capture folder, read with care: of the size they should have, and what was generated."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import read_bytes
from ...memory import physical_memory
from ...scene import Array
from ..arrays import read_arrays
from ..exr import read_exr, stack

_ARRAYS = 256 << 20  # bytes of a file of vertices
_CACHE_SHARE = 1 / 16  # of the machine's memory, for single-light images as half floats: 295 kB each at `quick`
_MAPS = {"alpha": ("A",), "depth": ("depth.Z",), "normal": ("normal.X", "normal.Y", "normal.Z"), "uv": ("uv.U", "uv.V")}


class Files:
    """Reads files of `folder` by their names; what was read is compared once with `sums`, the SHA-256 of each.

    `pixels` is the size of a picture, which decides how many are kept. Every method raises `InputError` for a file that
    is missing, damaged, of the wrong size, or not what was generated.
    """

    def __init__(self, folder: Path, sums: Mapping[str, str], pixels: int) -> None:
        self._folder, self._sums = folder, sums
        self._sound: set[str] = set()
        self.image = lru_cache(max(1, int(_CACHE_SHARE * (physical_memory() or 8e9) / (6 * pixels))))(self._image)
        self.geometry = lru_cache(256)(self._geometry)

    def radiance(self, name: str) -> Array:
        """An environment map (H, W, 3)."""
        found = stack(self._channels(name), ("R", "G", "B"), self._folder / name)
        self.compare(name)
        return found

    def arrays(self, name: str) -> Any:
        """What a numpy file holds: an array, or a mapping of arrays."""
        path = self._folder / name
        try:
            found = read_arrays(path) if path.suffix == ".npz" else np.load(BytesIO(read_bytes(path, _ARRAYS)))
            found = found if isinstance(found, np.ndarray) else {key: found[key] for key in found}
        except InputError as error:
            raise InputError(f"{error}; delete it and make the capture again") from error
        except Exception as error:  # of numpy, zip and zlib: whatever a flipped byte leads to
            raise InputError(f"{path} cannot be read ({error}); delete it and make the capture again") from error
        self.compare(name)
        return found

    def compare(self, name: str) -> None:
        """Once a file: what was read is what was generated."""
        if name not in self._sound:
            path = self._folder / name
            if hashlib.sha256(path.read_bytes()).hexdigest() != self._sums[name]:
                raise InputError(
                    f"{path} is damaged: it is not what was generated; delete it and make the capture again"
                )
            self._sound.add(name)

    def _channels(self, name: str) -> dict[str, Array]:
        path = self._folder / name
        try:
            return read_exr(path)
        except InputError:
            if path.is_file():
                self.compare(name)  # which says what to do about a file that was generated whole
            raise

    def _image(self, name: str, height: int, width: int) -> Array:
        path = self._folder / name
        image = _sized(stack(self._channels(name), ("R", "G", "B"), path), height, width, path).astype(np.float16)
        self.compare(name)
        return image

    def _geometry(self, name: str, height: int, width: int) -> dict[str, Array]:
        path, channels = self._folder / name, self._channels(name)
        self.compare(name)
        found = {}
        for part, names in _MAPS.items():
            if part == "alpha" or names[0] in channels:
                pixels = _sized(stack(channels, names, path), height, width, path)
                found[part] = pixels[..., 0] if len(names) == 1 else pixels
                found[part].flags.writeable = False  # shared by all frames of the view
        return found


def _sized(image: Array, height: int, width: int, path: Path) -> Array:
    if image.shape[:2] != (height, width):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"image {path} is {got}, its camera says {width}x{height}; make the capture again")
    return image
