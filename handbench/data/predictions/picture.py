"""One picture of a prediction folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...scene import Array, Camera, Prediction
from .. import pictures
from ..exr import not_finite
from ..exrheader import opened, read_parts
from ..pictures import clamped_alpha
from ..picturesize import picture_size

_COLOUR = ("R", "G", "B", "A")
_DEPTH, _NORMAL = ("depth.Z",), ("normal.X", "normal.Y", "normal.Z")
_ALLOWED = [{*_COLOUR, *extra} for extra in ((), _DEPTH, _NORMAL, (*_DEPTH, *_NORMAL))]


class UnfitPicture(InputError):
    """What is wrong with a picture; `kind` is one of `problems.KINDS`."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


def read_picture(path: Path, camera: Camera) -> Prediction:
    """The prediction in an EXR file, or in a PNG file of sRGB values and straight alpha.

    Raises `UnfitPicture` for the first thing that is wrong; NaN is passed on.

    The size is looked at before any pixel is read, so that no file makes us hold more than a camera's picture.
    """
    if path.suffix == ".png":
        return _displayed(path, camera)
    channels = _channels(path, camera)
    if set(channels) not in _ALLOWED:
        raise UnfitPicture("channels", f"has {', '.join(sorted(channels)) or 'none'}")
    for name, pixels in channels.items():
        if pixels.dtype not in (np.float16, np.float32):
            raise UnfitPicture("channels", f"has {name} as {pixels.dtype}")
        if pixels.shape != (camera.height, camera.width):
            raise UnfitPicture("channels", f"has {name} as {pixels.shape}, subsampled")
    try:
        alpha = clamped_alpha(channels["A"].astype(np.float32), "")
    except InputError as error:
        raise UnfitPicture("colour", str(error).strip()) from error
    depth = channels[_DEPTH[0]].astype(np.float32) if _DEPTH[0] in channels else None
    normal = _stacked(channels, _NORMAL) if _NORMAL[0] in channels else None
    return Prediction(_stacked(channels, _COLOUR[:3]), alpha, depth=depth, normal=normal)


def _displayed(path: Path, camera: Camera) -> Prediction:
    """The prediction in a PNG file."""
    wanted = camera.width, camera.height
    try:
        size = picture_size(path)
    except InputError as error:
        raise _unreadable(path, error) from error
    if size != wanted:
        raise UnfitPicture("size", f"is {size[0]}x{size[1]}, its camera says {wanted[0]}x{wanted[1]}")
    try:
        picture = pictures.read_picture(path, pictures.Stated(encoding="srgb", alpha="straight"))
    except InputError as error:
        raise _unreadable(path, error) from error
    if picture.alpha is None:
        raise UnfitPicture("channels", "has no alpha")
    return Prediction(picture.image, picture.alpha)


def what_is_not_finite(prediction: Prediction) -> str | None:
    """Which channel of the picture has NaN or infinite values, how many and where; None if none has."""
    given = {"R": prediction.image[..., 0], "G": prediction.image[..., 1], "B": prediction.image[..., 2]}
    given["A"] = prediction.alpha
    if prediction.depth is not None:
        given[_DEPTH[0]] = np.asarray(prediction.depth)
    if prediction.normal is not None:
        given |= {name: np.asarray(prediction.normal)[..., i] for i, name in enumerate(_NORMAL)}
    found = [not_finite(name, pixels) for name, pixels in given.items() if not np.isfinite(pixels).all()]
    return "; ".join(found) if found else None


def _stacked(channels: Mapping[str, Array], names: tuple[str, ...]) -> Array:
    return np.stack([channels[name] for name in names], axis=-1).astype(np.float32)


def _channels(path: Path, camera: Camera) -> dict[str, Array]:
    """The channels as stored; `UnfitPicture` if the header tells that they are not what is asked for."""
    try:
        parts = read_parts(path, "picture")
    except InputError as error:
        raise _unreadable(path, error) from error
    if len(parts) != 1:
        raise UnfitPicture("unreadable", f"has {len(parts)} parts, expected 1")
    (part,) = parts
    window = part.data
    if (window.left, window.top, window.width, window.height) != (0, 0, camera.width, camera.height):
        at = f" at ({window.left}, {window.top})" if (window.left, window.top) != (0, 0) else ""
        size = f"{window.width}x{window.height}{at}"
        raise UnfitPicture("size", f"is {size}, its camera says {camera.width}x{camera.height}")
    if part.colours is not None:
        raise UnfitPicture("colour", f"states the primaries {part.colours}")
    try:
        with opened(path, "picture") as file:
            return {name: channel.pixels for name, channel in file.channels().items()}
    except InputError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: InputError) -> UnfitPicture:
    return UnfitPicture("unreadable", f"cannot be read ({str(error).removeprefix(f'picture {path} ')})")
