"""PNG, JPEG and AVIF files: the codes they hold, turned upright, and what the file says that the codes mean.

A PNG may state its curve (gAMA, sRGB, cICP, an ICC profile) and its primaries (cHRM), both kinds may state how the
camera was held (Exif). sRGB and linear codes are told apart; whatever else is stated is refused by name, unless the
caller says what the codes are.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import InputError
from ..scene import Array
from .filekind import MAX_PIXELS, check_size

EXIF_ORIENTATION = 0x0112
_SRGB = (0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)  # white, red, green, blue
_GAMMAS = {"srgb": 1 / 2.2, "linear": 1.0}
# Primaries, transfer, matrix, full range (ITU-T H.273): codes of a narrow range, 16 to 235, are others.
_CICP = {b"\x01\x0d\0\x01": "srgb", b"\x01\x08\0\x01": "linear"}
_NEAR = 5e-3
_CODES = 2  # of 255: what roundings of profiles of sRGB differ by


@dataclass(frozen=True, eq=False)
class Codes:
    """Codes (H, W) or (H, W, C), uint8, uint16 or bool, and their curve: "srgb" or "linear"."""

    values: Array
    curve: str


def read_codes(path: Path, what: str = "picture", max_pixels: int = MAX_PIXELS, said: bool = False) -> Codes:
    """The codes of a PNG, JPEG or AVIF file; with `said`, what the file states of curve and primaries is not looked at.

    Raises `InputError` for a file that is damaged, animated, of CMYK, larger than `max_pixels`, or that states a curve
    or primaries that are neither sRGB's nor linear.
    """
    try:
        with opened_codes(path) as image:
            width, height = image.size
            check_size(path, what, width, height, max_pixels)
            if image.mode == "CMYK" or getattr(image, "n_frames", 1) > 1:
                kind = "in CMYK" if image.mode == "CMYK" else "animated"
                raise InputError(f"{what} {path} is {kind}, which is not supported; save it as a plain sRGB PNG")
            curve = "srgb" if said else _curve(path, what, image)
            values = _values(path, image)
            turn = image.getexif().get(EXIF_ORIENTATION, 1)
    except InputError:
        raise
    except Exception as error:  # decoders raise their own types for damaged files
        told = " ".join(str(error).replace(str(path), "").split())
        raise InputError(f"{what} {path} is damaged or no picture ({told}); write it anew") from error
    return Codes(np.ascontiguousarray(_upright(values, turn)), curve)


_PILLOW = threading.Lock()


@contextmanager
def opened_codes(file: Path | IO[bytes]) -> Iterator[Any]:
    """Pillow's image of a PNG, JPEG or AVIF file, none of whose pixels is decoded yet; Pillow's errors pass.

    `check_size` has to follow: the limit is ours, and Pillow's own, which calls a large picture an attack, is put off
    while it opens the file.
    """
    from PIL import Image

    with _PILLOW:
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            image = Image.open(file, formats=("PNG", "JPEG", "AVIF"))
        finally:
            Image.MAX_IMAGE_PIXELS = limit
    with image:
        yield image


def _values(path: Path, image: Any) -> Array:
    with path.open("rb") as file:
        head = file.read(26)
    if head.startswith(b"\x89PNG") and head[24] == 16:
        import mitsuba  # Pillow drops the lower byte of colours of 16 bits

        return np.array(mitsuba.Bitmap(str(path)))
    if image.mode == "P" or "transparency" in image.info:
        return np.asarray(image.convert("RGBA" if "transparency" in image.info else "RGB"))
    if image.mode == "YCbCr":
        return np.asarray(image.convert("RGB"))
    return np.asarray(image)


def _upright(values: Array, orientation: int) -> Array:
    """Pixels turned and mirrored as Exif's orientation, 1 to 8, says; other numbers mean nothing."""
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values


def _curve(path: Path, what: str, image: Any) -> str:
    """The curve that the file states, "srgb" if it states none; the first of cICP, iCCP, sRGB, gAMA counts."""
    remedy = "say what the values are (--pred-encoding, --truth-encoding), or convert it to sRGB"
    info, coded = image.info, _cicp(path)
    if coded is not None:
        if coded not in _CICP:
            raise InputError(f"{what} {path} states the video colours {list(coded)} (cICP); {remedy}")
        return _CICP[coded]
    if info.get("icc_profile"):
        name = _other_profile(info["icc_profile"], image.mode)
        if name is not None:
            raise InputError(f"{what} {path} has the colour profile {name}, which is not sRGB; {remedy}")
        return "srgb"
    if "srgb" in info:
        return "srgb"
    primaries = info.get("chromaticity")
    if primaries is not None and not np.allclose(primaries, _SRGB, atol=_NEAR):
        raise InputError(f"{what} {path} states the primaries {list(primaries)} (cHRM), not those of sRGB; {remedy}")
    gamma = info.get("gamma")
    if gamma is None:
        return "srgb"
    for curve, known in _GAMMAS.items():
        if abs(gamma - known) < _NEAR:
            return curve
    raise InputError(f"{what} {path} states the gamma {gamma:g} (gAMA), neither sRGB nor linear; {remedy}")


def _cicp(path: Path) -> bytes | None:
    """The four bytes of a PNG's cICP chunk, which stands before the pixels."""
    with path.open("rb") as file:
        if file.read(8) != b"\x89PNG\r\n\x1a\n":
            return None
        while len(head := file.read(8)) == 8 and head[4:] not in (b"IDAT", b"IEND"):
            if head[4:] == b"cICP":
                return file.read(4)
            file.seek(int.from_bytes(head[:4], "big") + 4, io.SEEK_CUR)
    return None


def _other_profile(profile: bytes, mode: str) -> str | None:
    """The name of an ICC profile under which colours are not those of sRGB; None if they are."""
    from PIL import Image, ImageCms

    steps = np.linspace(0, 255, 9).astype(np.uint8)
    grey = mode in ("1", "L", "LA", "I;16", "I")
    grid = steps[None] if grey else np.stack(np.meshgrid(steps, steps, steps), -1).reshape(1, -1, 3)
    try:
        stated = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        name = repr(ImageCms.getProfileDescription(stated).strip())
        turn = ImageCms.buildTransform(stated, ImageCms.createProfile("sRGB"), "L" if grey else "RGB", "RGB")
        shown = np.asarray(ImageCms.applyTransform(Image.fromarray(grid), turn)).astype(int)
    except (ImageCms.PyCMSError, OSError):
        return "that cannot be read"
    same = np.abs(shown - (grid[..., None] if grey else grid)).max() <= _CODES
    return None if same else name
