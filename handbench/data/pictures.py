"""Pictures from anywhere: EXR, PNG, JPEG and numpy files as linear images, folders of them, and masks.

File            is taken to be                                          alpha
.exr            linear, channels R, G, B, and A if there is one         premultiplied
.png .jpg       sRGB display codes of 8 or 16 bits                      straight, as PNG defines it
.npy float      linear, (H, W, 3) or (H, W, 4)                          premultiplied
.npy uint8/16   the encoding must be said                               straight

An encoding that is said ("linear", "srgb") wins over what the file's type suggests. sRGB values and integers are
decoded and then multiplied by their alpha, so that every `Picture` is linear and premultiplied over black.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene import Array
from .exr import read_exr, stack

ENCODINGS = ("auto", "linear", "srgb")
SUFFIXES = (".exr", ".png", ".jpg", ".jpeg", ".npy")
_SOME = 4  # names that a message lists


@dataclass(frozen=True, eq=False)
class Picture:
    """A linear image (H, W, 3) float32, premultiplied, and its alpha (H, W) float32 if the file has one."""

    image: Array
    alpha: Array | None


def read_picture(path: Path, encoding: str = "auto") -> Picture:
    """The picture in a file. Links are followed.

    Raises `InputError` for a file that is missing, damaged, of another type, not of 3 or 4 channels, not finite, or of
    integers in a numpy file whose encoding is not said.
    """
    values = _read(path)
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InputError(f"picture {path} has shape {values.shape}, expected (H, W, 3) or (H, W, 4)")
    codes = values.dtype.kind == "u"
    if codes and encoding == "auto" and path.suffix.lower() == ".npy":
        raise InputError(
            f"picture {path} holds integers ({values.dtype}) whose encoding is unknown; say linear or srgb, or save "
            "linear floating-point values"
        )
    scaled = _scaled(values)
    image, alpha = scaled[..., :3], scaled[..., 3] if scaled.shape[2] == 4 else None
    if encoding == "srgb" or (encoding == "auto" and codes):
        image = _linear(path, image)
    if alpha is not None and (codes or encoding == "srgb"):
        image = image * alpha[..., None]
    return Picture(np.ascontiguousarray(image, np.float32), alpha)


def read_mask(path: Path) -> Array:
    """A mask (H, W) float32 in [0, 1]: the alpha of a file unless it is opaque, else its one or equal channels.

    Raises `InputError` as `read_picture` does, and for values outside [0, 1] or channels that differ.
    """
    values = _scaled(_read(path))
    if values.ndim == 3:
        if values.shape[2] in (2, 4):
            values = values[..., :-1] if (values[..., -1] == 1).all() else values[..., -1:]
        if not (values == values[..., :1]).all():
            raise InputError(f"mask {path} has colours; give one channel, or an alpha channel")
        values = values[..., 0]
    if values.min() < 0 or values.max() > 1:
        raise InputError(f"mask {path} has values from {values.min():g} to {values.max():g}; expected 0 to 1")
    return np.ascontiguousarray(values, np.float32)


def folder_of(path: Path) -> dict[str, Path]:
    """The pictures of a folder by name without suffix, in the order of the names; other and hidden files are left out.

    Raises `InputError` for a folder that is missing or has none, or two of one name.
    """
    if not path.is_dir():
        raise InputError(f"folder {path} does not exist; give a picture, or a folder of pictures")
    found: dict[str, Path] = {}
    for file in sorted(path.iterdir()):
        if file.suffix.lower() in SUFFIXES and not file.name.startswith("."):
            if file.stem in found:
                raise InputError(f"folder {path} has {found[file.stem].name} and {file.name}; keep one of them")
            found[file.stem] = file
    if not found:
        raise InputError(f"folder {path} holds no pictures; expected files ending in {', '.join(SUFFIXES)}")
    return found


def matched(folders: Mapping[str, Mapping[str, Path]]) -> list[str]:
    """The names that all folders share, given by what they are ("prediction", "truth"); they must be the same.

    Raises `InputError` that tells for the first folder that lacks names which they are.
    """
    every = dict.fromkeys(name for names in folders.values() for name in names)
    for what, names in folders.items():
        missing = [name for name in every if name not in names]
        if missing:
            raise InputError(f"{what} lacks {some_of(missing)}; pictures of equal names are compared")
    return sorted(every)


def some_of(names: Iterable[str]) -> str:
    """The first few of many names: "a, b, c, d and 7 more"."""
    names = list(names)
    rest = f" and {len(names) - _SOME} more" if len(names) > _SOME else ""
    return ", ".join(names[:_SOME]) + rest


def _read(path: Path) -> Array:
    """What a file holds: (H, W) or (H, W, C), unsigned integers, booleans or finite floating point."""
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError(f"picture {path} does not exist")
    if suffix == ".exr":
        return _read_exr(path)
    if suffix == ".npy":
        return _read_npy(path)
    if suffix in SUFFIXES:
        return _read_codes(path)
    raise InputError(f"picture {path} is of an unknown type; expected a file ending in {', '.join(SUFFIXES)}")


def _read_exr(path: Path) -> Array:
    channels = read_exr(path)
    if {"R", "G", "B"} <= channels.keys():
        return stack(channels, ("R", "G", "B", "A") if "A" in channels else ("R", "G", "B"), path)
    if "A" in channels or len(channels) == 1:
        return channels.get("A", next(iter(channels.values())))
    return stack(channels, ("R", "G", "B"), path)


def _read_npy(path: Path) -> Array:
    try:
        values: Array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"picture {path} is damaged or no numpy file ({error})") from error
    if values.dtype.kind not in "fb" and values.dtype not in (np.uint8, np.uint16):
        raise InputError(f"picture {path} holds {values.dtype}; expected floating point, uint8 or uint16")
    if values.size == 0:
        raise InputError(f"picture {path} is empty: its shape is {values.shape}")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        bad = int(np.count_nonzero(~np.isfinite(values)))
        raise InputError(f"picture {path} holds {bad} values that are NaN or infinite; remove them first")
    return values


def _read_codes(path: Path) -> Array:
    """The codes of a PNG or JPEG, uint8 or uint16."""
    from PIL import Image

    try:
        with path.open("rb") as file:
            head = file.read(26)
        if head.startswith(b"\x89PNG") and len(head) > 24 and head[24] == 16:
            import mitsuba  # Pillow drops the lower byte of colours of 16 bits

            return np.array(mitsuba.Bitmap(str(path)))
        with Image.open(path) as image:
            if image.mode in ("P", "CMYK", "YCbCr"):
                return np.asarray(image.convert("RGBA" if "transparency" in image.info else "RGB"))
            return np.asarray(image)
    except Exception as error:  # decoders raise their own types for damaged files
        raise InputError(f"picture {path} is damaged or no picture ({' '.join(str(error).split())})") from error


def _scaled(values: Array) -> Array:
    """Codes as float32 in [0, 1]; floating point as float32."""
    largest = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1
    return values.astype(np.float32) / np.float32(largest)


def _linear(path: Path, codes: Array) -> Array:
    """sRGB values in [0, 1] decoded (IEC 61966-2-1)."""
    if codes.min() < 0 or codes.max() > 1:
        raise InputError(f"picture {path} has values from {codes.min():g} to {codes.max():g}; sRGB values are 0 to 1")
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
