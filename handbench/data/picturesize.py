"""How large a picture is, and whether it has an alpha channel, by its header alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError
from .codes import EXIF_ORIENTATION, opened_codes
from .exrheader import read_parts, the_part
from .filekind import MAX_PIXELS, check_kind, check_size


def picture_size(path: Path, max_pixels: int = MAX_PIXELS) -> tuple[int, int]:
    """Width and height in pixels of an EXR, PNG, JPEG, AVIF or numpy file, upright as Exif says.

    Raises `InputError` for a file that is missing, damaged, of another kind, or larger than `max_pixels`.
    """
    check_kind(path, "picture")
    if path.suffix.lower() == ".exr":
        window = the_part(read_parts(path, "picture", max_pixels), None, path, "picture").display
        return window.width, window.height
    try:
        if path.suffix.lower() == ".npy":
            height, width = np.load(path, mmap_mode="r", allow_pickle=False).shape[:2]
        else:
            width, height = _coded(path)
    except Exception as error:  # decoders raise their own types for damaged files
        told = " ".join(str(error).replace(str(path), "").split())[:120]
        raise InputError(f"picture {path} is damaged or no picture ({told}); write it anew") from error
    check_size(path, "picture", width, height, max_pixels)
    return width, height


def has_alpha(path: Path) -> bool:
    """Whether a picture has an alpha channel. Raises `InputError` for a file that is missing or damaged."""
    check_kind(path, "picture")
    if path.suffix.lower() == ".exr":
        return bool({"A", "a"} & set(the_part(read_parts(path, "picture"), None, path, "picture").channels))
    try:
        if path.suffix.lower() == ".npy":
            return bool(np.load(path, mmap_mode="r", allow_pickle=False).shape[-1] == 4)
        with opened_codes(path) as image:
            return image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
    except Exception as error:  # decoders raise their own types for damaged files
        raise InputError(f"picture {path} is damaged or no picture ({error}); write it anew") from error


def _coded(path: Path) -> tuple[int, int]:
    with opened_codes(path) as image:
        width, height = image.size
        lying = image.getexif().get(EXIF_ORIENTATION, 1) >= 5
    return (height, width) if lying else (width, height)
