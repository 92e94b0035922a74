"""Pictures from anywhere: EXR, PNG, JPEG, AVIF and numpy files as linear images, folders of them, and masks.

File            is taken to be                                          alpha
.exr            linear Rec. 709, channels R, G, B, and A if there is one    premultiplied
.png .jpg .avif sRGB display codes of 8 or 16 bits                      straight, as PNG defines it
.npy float      linear, (H, W, 3) or (H, W, 4)                          premultiplied
.npy uint8/16   the encoding must be said                               straight

What is said of a file (`Stated`) wins over what its type suggests. sRGB values are decoded and straight colours are
multiplied by their alpha, so that every `Picture` is linear and premultiplied over black. What a file states of itself
(an EXR's windows and primaries, a PNG's curve and profile, Exif's orientation) is followed where that is certain and
refused by name where it is not.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene import Array
from ..scene.colour import linear
from .arrays import read_array
from .codes import read_codes
from .exr import read_channels
from .exrheader import colour_channels, read_parts, the_part
from .filekind import MAX_PIXELS, check_kind

SUFFIXES = (".exr", ".png", ".jpg", ".jpeg", ".avif", ".npy")
_SOME = 4  # names that a message lists
ALPHA_SLACK = 1e-3
"""How far outside [0, 1] an alpha may be to be clamped: filters and half floats do that."""


@dataclass(frozen=True)
class Stated:
    """What is said of a file: the encoding of its values, its alpha, a layer or part of an EXR, and the size limit."""

    encoding: str = "auto"
    alpha: str = "auto"
    layer: str | None = None
    part: str | None = None
    max_pixels: int = MAX_PIXELS


@dataclass(frozen=True, eq=False)
class Picture:
    """A linear image (H, W, 3) float32, premultiplied, and its alpha (H, W) float32 if the file has one."""

    image: Array
    alpha: Array | None


@dataclass(frozen=True, eq=False)
class _Raw:
    """What a file holds: (H, W) or (H, W, C), unsigned integers, booleans or finite floats, and their curve."""

    values: Array
    curve: str


def read_picture(path: Path, stated: Stated = Stated()) -> Picture:
    """The picture in a file. Links are followed.

    Raises `InputError` for a file that is missing, damaged, larger than the limit, of another type, not of 3 or 4
    channels, not finite, whose alpha is not in [0, 1], that states colours which are not certain, or of integers in a
    numpy file whose encoding is not said.
    """
    raw = _read(path, "picture", stated)
    values = raw.values
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InputError(f"picture {path} has shape {values.shape}, expected (H, W, 3) or (H, W, 4)")
    codes = values.dtype.kind in "ub"
    if codes and stated.encoding == "auto" and path.suffix.lower() == ".npy":
        raise InputError(
            f"picture {path} holds integers ({values.dtype}) whose encoding is unknown; say linear or srgb, or save "
            "linear floating-point values"
        )
    curve = raw.curve if stated.encoding == "auto" else stated.encoding
    scaled = _scaled(values)
    image, alpha = scaled[..., :3], None
    if scaled.shape[2] == 4:
        alpha = clamped_alpha(scaled[..., 3], f"picture {path}")
    if curve == "srgb":
        image = _linear(path, image)
    if alpha is not None and (codes or curve == "srgb" if stated.alpha == "auto" else stated.alpha == "straight"):
        image = image * alpha[..., None]
    return Picture(np.ascontiguousarray(image, np.float32), alpha)


def read_mask(path: Path, stated: Stated = Stated()) -> Array:
    """A mask (H, W) float32 in [0, 1]: the alpha of a file unless it is opaque, else its one or equal channels.

    Raises `InputError` as `read_picture` does, and for values outside [0, 1], channels that differ, or codes that are
    all so small that nothing is inside.
    """
    raw = _read(path, "mask", stated).values
    values = _scaled(raw)
    if values.ndim == 3:
        if values.shape[2] in (2, 4):
            values = values[..., :-1] if (values[..., -1] == 1).all() else values[..., -1:]
        if not (values == values[..., :1]).all():
            raise InputError(f"mask {path} has colours; give one channel, or an alpha channel")
        values = values[..., 0]
    if values.ndim != 2:
        raise InputError(f"mask {path} has shape {values.shape}, expected (H, W)")
    if values.min() < -ALPHA_SLACK or values.max() > 1 + ALPHA_SLACK:
        raise InputError(f"mask {path} has values from {values.min():g} to {values.max():g}; expected 0 to 1")
    if raw.dtype.kind == "u" and 0 < values.max() < 0.5:
        largest = np.iinfo(raw.dtype).max
        raise InputError(
            f"mask {path}: its greatest value is {round(values.max() * largest)} of {largest}, so no pixel is inside; "
            f"save {largest} where the hand is"
        )
    return np.ascontiguousarray(values.clip(0, 1), np.float32)


def clamped_alpha(alpha: Array, what: str) -> Array:
    """An alpha of any shape as float32 in [0, 1]; NaN stays.

    Raises `InputError`, which begins with `what`, if it is outside by more than `ALPHA_SLACK`.
    """
    if (alpha < -ALPHA_SLACK).any() or (alpha > 1 + ALPHA_SLACK).any():
        raise InputError(f"{what} has alpha from {np.nanmin(alpha):.4g} to {np.nanmax(alpha):.4g}; expected 0 to 1")
    return np.clip(alpha, 0, 1, dtype=np.float32)


def folder_of(path: Path) -> dict[str, Path]:
    """The pictures of a folder and the folders in it, by path without suffix, in the order of the paths.

    Other and hidden files, hidden folders and links to folders are left out.

    Raises `InputError` for a folder that is missing or has none, or two of one name.
    """
    if not path.is_dir():
        raise InputError(f"folder {path} does not exist; give a picture, or a folder of pictures")
    found: dict[str, Path] = {}
    for parent, folders, names in os.walk(path):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for file in (Path(parent) / name for name in sorted(names)):
            if file.suffix.lower() in SUFFIXES and not file.name.startswith("."):
                name = file.relative_to(path).with_suffix("").as_posix()
                if name in found:
                    raise InputError(f"folder {path} has {found[name].name} and {file.name}; keep one of them")
                found[name] = file
    if not found:
        raise InputError(f"folder {path} holds no pictures; expected files ending in {', '.join(SUFFIXES)}")
    return dict(sorted(found.items()))


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


def _read(path: Path, what: str, stated: Stated) -> _Raw:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES and path.is_file():
        raise InputError(f"{what} {path} is of an unknown type; expected a file ending in {', '.join(SUFFIXES)}")
    check_kind(path, what)
    if suffix != ".exr":
        for option in ("layer", "part"):
            if getattr(stated, option) is not None:
                raise InputError(f"{what} {path} is no EXR and has no {option}s; leave out --{option}")
    if suffix == ".exr":
        return _Raw(_read_exr(path, what, stated), "linear")
    if suffix != ".npy":
        codes = read_codes(path, what, stated.max_pixels, said=stated.encoding != "auto" or what == "mask")
        return _Raw(codes.values, codes.curve)
    values = read_array(path, what, stated.max_pixels)
    if values.dtype.kind == "f":
        with np.errstate(over="ignore"):  # of what is beyond single precision
            values = values.astype(np.float32)
        if not np.isfinite(values).all():
            bad = int(np.count_nonzero(~np.isfinite(values)))
            raise InputError(
                f"{what} {path} holds {bad} values that are NaN, infinite or beyond 32-bit floats; remove them first"
            )
    return _Raw(values, "linear")


def _read_exr(path: Path, what: str, stated: Stated) -> Array:
    part = the_part(read_parts(path, what, stated.max_pixels), stated.part, path, what)
    if what == "mask" and stated.layer is None and ("A" in part.channels or len(part.channels) == 1):
        names: tuple[str, ...] = ("A",) if "A" in part.channels else tuple(part.channels)
    else:
        names = colour_channels(part, stated.layer, path, what)
    channels = read_channels(path, part, names, what)
    return np.stack([channels[name] for name in names], axis=-1)


def _scaled(values: Array) -> Array:
    """Codes as float32 in [0, 1]; floating point as float32."""
    largest = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1
    return values.astype(np.float32) / np.float32(largest)


def _linear(path: Path, codes: Array) -> Array:
    """sRGB values in [0, 1] decoded (IEC 61966-2-1)."""
    if codes.min() < 0 or codes.max() > 1:
        raise InputError(f"picture {path} has values from {codes.min():g} to {codes.max():g}; sRGB values are 0 to 1")
    return linear(codes)
