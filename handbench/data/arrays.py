"""Numpy files from outside: looked at before they are read, and never a pickle."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene import Array
from .filekind import MAX_PIXELS, check_kind, check_size

_SAMPLES = 4  # values of a pixel of the largest picture
_BYTES = 1 << 30  # of all arrays of an archive: no mesh is larger


def read_array(path: Path, what: str = "picture", max_pixels: int = MAX_PIXELS) -> Array:
    """The picture, (H, W) or (H, W, C) or of another shape, in a .npy file: floating point, uint8, uint16 or bool.

    Raises `InputError` for a file that is missing, damaged, of another type, empty, or that announces more than
    `max_pixels` of four values, before memory is taken for them.
    """
    check_kind(path, what)
    try:
        with np.errstate(over="ignore"):  # of a size that is announced: numpy looks at it itself
            mapped = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # besides its own errors numpy passes on those of the parser of the header
        told = " ".join(str(error).replace(str(path), "").split())[:160]
        raise InputError(f"{what} {path} is damaged or no numpy file ({told}); write it anew") from error
    native = mapped.dtype.newbyteorder("=")
    if native.kind not in "fb" and native not in (np.uint8, np.uint16):
        raise InputError(f"{what} {path} holds {mapped.dtype}; expected floating point, uint8 or uint16")
    if mapped.size == 0:
        raise InputError(f"{what} {path} is empty: its shape is {mapped.shape}")
    if mapped.ndim >= 2:
        check_size(path, what, mapped.shape[1], mapped.shape[0], max_pixels)
    if mapped.size > _SAMPLES * max_pixels:
        raise InputError(f"{what} {path} has the shape {mapped.shape}; expected (H, W, 3) or (H, W, 4)")
    return np.array(mapped, native)


def read_arrays(path: Path, what: str = "file", limit: int = _BYTES) -> dict[str, Array]:
    """All arrays of a .npz file by name.

    Raises `InputError` for a file that is missing, damaged anywhere, or that announces more than `limit` bytes, before
    memory is taken for them.
    """
    check_kind(path, what)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > limit:
            raise InputError(f"{what} {path} holds {size:,} bytes of arrays, more than the {limit:,} that are read")
        with np.load(path, allow_pickle=False) as held:
            return {name: held[name] for name in held.files}
    except InputError:
        raise
    except Exception as error:  # of the archive, of its compression or of the arrays in it
        told = " ".join(str(error).replace(str(path), "").split())[:160]
        raise InputError(f"{what} {path} is damaged ({told}); get it again") from error
