"""OpenEXR files: named channels in, named channels out, nothing half-written."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import whole
from ..scene import Array
from .exrheader import ExrPart, opened, read_parts, the_part
from .filekind import MAX_PIXELS


def write_exr(path: Path | str, channels: Mapping[str, Array]) -> None:
    """Write float16 or float32 channels, each (H, W), under names such as "R" or "normal.X".

    The file appears whole or not at all. Raises `InputError` for a shape or type that EXR lacks and
    `StorageError` when the disk is full or the folder cannot be written.
    """
    import OpenEXR

    path = Path(path)
    shapes = {np.shape(pixels) for pixels in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise InputError(f"{path}: the channels of an EXR must share one (H, W) shape, got {sorted(shapes)}")
    for name, pixels in channels.items():
        if pixels.dtype not in (np.float16, np.float32):
            raise InputError(f"{path}: channel {name!r} is {pixels.dtype}, expected float16 or float32")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with whole(path) as part:
        try:
            OpenEXR.File(header, {name: np.ascontiguousarray(p) for name, p in channels.items()}).write(str(part))
        except RuntimeError as error:  # the library's only word for a full disk or a folder that is none
            raise OSError(str(error)) from error


def read_exr(
    path: Path,
    names: Collection[str] | None = None,
    part: str | None = None,
    what: str = "image",
    max_pixels: int = MAX_PIXELS,
    finite: bool = True,
) -> dict[str, Array]:
    """Channels of an EXR file by name, each (H, W) float32 in the file's display window, zero where none is stored.

    `names` are the channels that count, by default all: others never decide. `part` is needed where there are several.
    Raises `InputError`, which calls the file `what`, if it is missing, no EXR, damaged or larger than `max_pixels`,
    states primaries other than Rec. 709, lacks a channel, or if one that counts holds whole numbers, is subsampled,
    or (unless `finite` is false) has NaN or infinite pixels.
    """
    chosen = the_part(read_parts(path, what, max_pixels), part, path, what)
    return read_channels(path, chosen, chosen.channels if names is None else names, what, finite)


def read_channels(
    path: Path, part: ExrPart, names: Collection[str], what: str = "image", finite: bool = True
) -> dict[str, Array]:
    """`read_exr` of a part whose header is known."""
    if part.colours is not None:
        raise InputError(f"{what} {path} states the primaries {part.colours}; convert it to linear Rec. 709")
    for name in names:
        if name not in part.channels:
            raise _lacking(name, part.channels, path, what)
        if part.channels[name] != (1, 1):
            across, down = part.channels[name]
            raise InputError(f"{what} {path}: channel {name!r} is subsampled {across}x{down}; write every pixel of it")
    with opened(path, what) as file:
        stored = {name: file.parts[part.index].channels[name].pixels for name in names}
    found = {}
    for name, pixels in stored.items():
        if pixels.dtype not in (np.float16, np.float32):
            raise InputError(
                f"{what} {path}: channel {name!r} holds whole numbers ({pixels.dtype}); write half or float"
            )
        if finite and not np.isfinite(pixels).all():
            raise InputError(f"{what} {path}: {not_finite(name, pixels)}; mend or clamp it")
        found[name] = _placed(pixels.astype(np.float32), part)
    return found


def not_finite(name: str, pixels: Array) -> str:
    """What is wrong with a channel (H, W) that has NaN or infinite pixels: how many, and where the first is."""
    bad = ~np.isfinite(pixels)
    row, column = np.unravel_index(int(bad.argmax()), bad.shape)
    kind = "NaN" if np.isnan(pixels[row, column]) else "infinite"
    count = int(np.count_nonzero(bad))
    return f"channel {name!r} has {count} NaN or infinite pixels, the first ({kind}) in row {row}, column {column}"


def _placed(pixels: Array, part: ExrPart) -> Array:
    """A channel of the data window in the display window."""
    data, display = part.data, part.display
    if data == display:
        return pixels
    shown = np.zeros((display.height, display.width), pixels.dtype)
    top, bottom = max(data.top, display.top), min(data.bottom, display.bottom) + 1
    left, right = max(data.left, display.left), min(data.right, display.right) + 1
    if top < bottom and left < right:
        inner = pixels[top - data.top : bottom - data.top, left - data.left : right - data.left]
        shown[top - display.top : bottom - display.top, left - display.left : right - display.left] = inner
    return shown


def rgb(image: Array, prefix: str = "", dtype: type = np.float16) -> dict[str, Array]:
    """The channels of an (H, W, 3) image, named R, G, B."""
    return {f"{prefix}{name}": image[..., i].astype(dtype) for i, name in enumerate("RGB")}


def stack(channels: Mapping[str, Array], names: tuple[str, ...], path: Path) -> Array:
    """Named channels as one (H, W, C) array; `InputError` if the file lacks one."""
    for name in names:
        if name not in channels:
            raise _lacking(name, channels, path)
    return np.stack([channels[name] for name in names], axis=-1)


def _lacking(name: str, channels: Collection[str], path: Path, what: str = "image") -> InputError:
    return InputError(f"{what} {path} has no channel {name!r}; it has {', '.join(sorted(channels))}")
